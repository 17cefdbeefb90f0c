//! Ghosts: copies of particles seen from beyond a side of this rank's domain.
//!
//! A periodic side is a copy of the opposite one: particles that cross it come back in on the other side, and whatever lies within a
//! kernel support of one side appears as a ghost beyond the other. A ghost is the same particle at another place, so
//! every field of it is that of its original. Fields computed for the originals are copied over by
//! [`Halo::refresh`] before a sum over neighbours reads them.

use crate::particles::{Particles, Vector};

/// A box that repeats itself along some of its axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PeriodicBox<const D: usize> {
    /// Lower corner in m.
    pub min: Vector<D>,
    /// Length of a period in m, along the axes that have one.
    pub period: [Option<f64>; D],
}

/// Makes ghosts and keeps their fields up to date.
#[derive(Debug, Clone, Default)]
pub struct Halo<const D: usize> {
    domain: Option<PeriodicBox<D>>,
    /// How far ghosts reach, in m.
    reach: f64,
    /// How far each ghost lies from its original.
    offset: Vec<Vector<D>>,
    found: Vec<(u32, Vector<D>)>,
}

impl<const D: usize> Halo<D> {
    /// Ghosts within `reach` m of the sides of `domain`; without one there are none.
    pub fn new(domain: Option<PeriodicBox<D>>, reach: f64) -> Self {
        Self { domain, reach, ..Self::default() }
    }

    /// Brings particles that left over a periodic side back in, and makes the ghosts anew.
    pub fn renew(&mut self, particles: &mut Particles<D>) {
        let Some(domain) = self.domain else { return };
        particles.drop_ghosts();
        self.found.clear();
        for a in 0..particles.len() {
            let r = &mut particles.position[a];
            for d in 0..D {
                if let Some(period) = domain.period[d] {
                    r[d] -= period * ((r[d] - domain.min[d]) / period).floor();
                }
            }
            let first = self.found.len();
            for d in 0..D {
                let Some(period) = domain.period[d] else { continue };
                let from_low = r[d] - domain.min[d];
                let shift = |offset: f64, found: &mut Vec<(u32, Vector<D>)>| {
                    let mut along = Vector::<D>::zeros();
                    along[d] = offset;
                    found.push((a as u32, along));
                    // Near an edge the ghosts of the axes before have ghosts of their own.
                    for k in first..found.len() - 1 {
                        let (_, before) = found[k];
                        if before[d] == 0.0 {
                            found.push((a as u32, before + along));
                        }
                    }
                };
                if from_low < self.reach {
                    shift(period, &mut self.found);
                }
                if period - from_low < self.reach {
                    shift(-period, &mut self.found);
                }
            }
        }
        // In the order of all particles: walls and dummies before the fluid.
        particles.append_ghosts(self.found.iter().map(|(a, _)| *a));
        self.offset.clear();
        self.offset.extend(self.found.iter().map(|(_, offset)| *offset));
        self.place(particles);
    }

    /// Puts the ghosts where their originals are now.
    pub fn place(&self, particles: &mut Particles<D>) {
        let first = particles.owned();
        for (k, offset) in self.offset.iter().enumerate() {
            let original = particles.original(first + k);
            particles.position[first + k] = particles.position[original] + offset;
        }
    }

    /// Gives the ghosts the values of their originals; `field` has one entry a particle, ghosts included.
    pub fn refresh<T: Copy>(&self, originals: &[u32], field: &mut [T]) {
        let (own, ghosts) = field.split_at_mut(field.len() - originals.len());
        for (ghost, &original) in ghosts.iter_mut().zip(originals) {
            *ghost = own[original as usize];
        }
    }

    /// [`refresh`](Self::refresh) of a field of the particles themselves.
    pub fn share<T: Copy>(&self, particles: &mut Particles<D>, field: fn(&mut Particles<D>) -> &mut Vec<T>) {
        let mut values = std::mem::take(field(particles));
        self.refresh(particles.originals(), &mut values);
        *field(particles) = values;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_particle_in_a_corner_has_three_ghosts() {
        let domain = PeriodicBox { min: Vector::<2>::zeros(), period: [Some(1.0), Some(2.0)] };
        let mut particles = Particles::default();
        particles.push_fluid(Vector::<2>::new(1.05, 1.95), Vector::<2>::new(1.0, 2.0));
        particles.push_fluid(Vector::<2>::new(0.5, 1.0), Vector::zeros());
        let mut halo = Halo::new(Some(domain), 0.1);
        for _ in 0..2 {
            halo.renew(&mut particles);
            assert_eq!((particles.owned(), particles.len()), (2, 5));
            let mut found: Vec<_> = particles.position[2..].iter().map(|r| (r.x, r.y)).collect();
            found.sort_by(|a, b| a.partial_cmp(b).unwrap());
            for (r, expected) in found.iter().zip([(0.05, -0.05), (1.05, -0.05), (1.05, 1.95)]) {
                assert!((r.0 - expected.0).abs() < 1e-14 && (r.1 - expected.1).abs() < 1e-14, "{found:?}");
            }
            assert!(particles.velocity[2..].iter().all(|v| *v == Vector::<2>::new(1.0, 2.0)));
        }
        let mut field = vec![3.0, 4.0, 0.0, 0.0, 0.0];
        halo.refresh(particles.originals(), &mut field);
        assert_eq!(field, [3.0, 4.0, 3.0, 3.0, 3.0]);
    }
}
