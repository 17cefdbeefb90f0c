//! Particles as a structure of arrays, laid out as one rank of many.
//!
//! Order in every array: wall | dummy | fluid | ghost. Walls and dummies keep their places for a whole run;
//! the fluid may be reordered and shrink; ghosts ([`halo`](crate::halo)) come last, those of solids before those of
//! fluid.

use rayon::prelude::*;
use std::ops::Range;

/// A vector in `D` dimensions.
pub type Vector<const D: usize> = nalgebra::SVector<f64, D>;
/// A `D` x `D` matrix.
pub type Matrix<const D: usize> = nalgebra::SMatrix<f64, D, D>;

/// The axis that a unit vector lies along, if any.
#[inline]
pub fn axis_of<const D: usize>(unit: &Vector<D>) -> Option<usize> {
    unit.iter().position(|n| n.abs() > 1.0 - 1e-9)
}

/// Position, velocity, pressure and id: all that a fluid particle is.
pub type Fluid<const D: usize> = (Vector<D>, Vector<D>, f64, u64);

/// What a particle is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Kind {
    /// Liquid.
    Fluid = 0,
    /// First layer of a solid, half a spacing behind its face: carries a pressure unknown where it is wet.
    Wall = 1,
    /// Deeper layer of a solid: its pressure follows from the wall particle it is tied to.
    Dummy = 2,
}

/// All particles of one rank. Arrays have one entry a particle unless stated otherwise.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Particles<const D: usize> {
    /// Position in m.
    pub position: Vec<Vector<D>>,
    /// Velocity in m/s.
    pub velocity: Vec<Vector<D>>,
    /// Pressure in Pa.
    pub pressure: Vec<f64>,
    /// Number that stays with a particle for the whole run.
    pub id: Vec<u64>,
    /// For each dummy (length = dummies): the wall particle whose pressure it extends.
    pub tie: Vec<u32>,
    /// For each wall and dummy particle: unit normal into the liquid.
    pub normal: Vec<Vector<D>>,
    /// For each wall and dummy particle: distance to the solid's face in m (half a spacing for walls).
    pub depth: Vec<f64>,
    walls: usize,
    /// For each wall particle: whether its solid is flat there, in the position it starts from.
    flat: Vec<bool>,
    /// For each ghost: the particle of which it is a copy, or itself if that is on another rank.
    originals: Vec<u32>,
}

impl<const D: usize> Particles<D> {
    /// Solid particles in the order wall | dummy, with the normals of all and for each wall whether it is flat there; `tie` numbers walls.
    pub fn from_solid(
        position: Vec<Vector<D>>,
        (normal, flat): (Vec<Vector<D>>, Vec<bool>),
        depth: Vec<f64>,
        tie: Vec<u32>,
    ) -> Self {
        let count = position.len();
        let walls = count - tie.len();
        debug_assert_eq!(flat.len(), walls);
        Self {
            flat,
            velocity: vec![Vector::zeros(); count],
            pressure: vec![0.0; count],
            id: (0..count as u64).collect(),
            walls,
            position,
            tie,
            normal,
            depth,
            originals: vec![],
        }
    }

    /// Appends one fluid particle; there must be no ghosts yet.
    pub fn push_fluid(&mut self, position: Vector<D>, velocity: Vector<D>) {
        debug_assert!(self.originals.is_empty());
        self.id.push(self.id.len() as u64);
        self.position.push(position);
        self.velocity.push(velocity);
        self.pressure.push(0.0);
    }

    /// Takes all ghosts away.
    pub fn drop_ghosts(&mut self) {
        let owned = self.owned();
        self.position.truncate(owned);
        self.velocity.truncate(owned);
        self.pressure.truncate(owned);
        self.id.truncate(owned);
        self.originals.clear();
    }

    /// Appends a ghost of each of `originals`, in ascending order, at the same place.
    pub fn append_ghosts(&mut self, originals: impl Iterator<Item = u32>) {
        debug_assert!(self.originals.is_empty());
        self.originals.extend(originals);
        debug_assert!(self.originals.is_sorted());
        for k in 0..self.originals.len() {
            let a = self.originals[k] as usize;
            self.position.push(self.position[a]);
            self.velocity.push(self.velocity[a]);
            self.pressure.push(self.pressure[a]);
            self.id.push(self.id[a]);
        }
    }

    /// Appends fluid particles: position, velocity, pressure, id; there must be no ghosts yet.
    pub fn take_in(&mut self, fluid: impl Iterator<Item = Fluid<D>>) {
        debug_assert!(self.originals.is_empty());
        fluid.for_each(|particle| self.push_particle(particle));
    }

    /// Appends ghosts of fluid particles on other ranks, after all [`append_ghosts`](Self::append_ghosts).
    pub fn append_foreign_ghosts(&mut self, fluid: impl Iterator<Item = Fluid<D>>) {
        for particle in fluid {
            self.originals.push(self.len() as u32);
            self.push_particle(particle);
        }
    }

    /// Fluid particle `a` as it travels between ranks.
    pub fn fluid_particle(&self, a: usize) -> Fluid<D> {
        (self.position[a], self.velocity[a], self.pressure[a], self.id[a])
    }

    fn push_particle(&mut self, (position, velocity, pressure, id): Fluid<D>) {
        self.position.push(position);
        self.velocity.push(velocity);
        self.pressure.push(pressure);
        self.id.push(id);
    }

    /// Number of particles that are no ghosts; also the index of the first ghost.
    pub fn owned(&self) -> usize {
        self.position.len() - self.originals.len()
    }

    /// For each ghost: the particle of which it is a copy, or itself if that is on another rank.
    pub fn originals(&self) -> &[u32] {
        &self.originals
    }

    /// Particle `a` itself, or the one on this rank of which it is a ghost.
    #[inline]
    pub fn original(&self, a: usize) -> usize {
        match a.checked_sub(self.owned()) {
            None => a,
            Some(ghost) => self.originals[ghost] as usize,
        }
    }

    /// Whether `a` is a ghost of a particle on another rank.
    #[inline]
    pub fn is_foreign(&self, a: usize) -> bool {
        a >= self.owned() && self.original(a) == a
    }

    /// Index range of the ghosts of solids.
    pub fn solid_ghosts(&self) -> Range<usize> {
        let solids = self.solids() as u32;
        self.owned()..self.owned() + self.originals.partition_point(|&a| a < solids)
    }

    /// Number of particles of all kinds, ghosts included.
    pub fn len(&self) -> usize {
        self.position.len()
    }

    /// True if there is no particle at all.
    pub fn is_empty(&self) -> bool {
        self.position.is_empty()
    }

    /// Normal of a wall particle of a flat wall, which lies across an axis unless a body has turned; none for other solids, and at
    /// edges and corners.
    pub fn flat_normal(&self, b: usize) -> Option<&Vector<D>> {
        self.flat.get(b)?.then(|| &self.normal[b])
    }

    /// Largest speed of the particles `some` in m/s.
    pub fn fastest(&self, some: Range<usize>) -> f64 {
        let squares = self.velocity[some].par_iter().with_min_len(1024).map(|v| v.norm_squared());
        squares.reduce(|| 0.0, f64::max).sqrt()
    }

    /// Largest speed of the liquid in m/s.
    pub fn fastest_liquid(&self) -> f64 {
        self.fastest(self.fluid())
    }

    /// Index range of wall particles.
    pub fn walls(&self) -> Range<usize> {
        0..self.walls
    }

    /// Index range of dummy particles.
    pub fn dummies(&self) -> Range<usize> {
        self.walls..self.solids()
    }

    /// Number of wall and dummy particles, which is also the index of the first fluid particle.
    pub fn solids(&self) -> usize {
        self.walls + self.tie.len()
    }

    /// Index range of fluid particles.
    pub fn fluid(&self) -> Range<usize> {
        self.solids()..self.owned()
    }

    /// Kind of particle `a`.
    pub fn kind(&self, a: usize) -> Kind {
        match self.original(a) {
            a if a < self.walls => Kind::Wall,
            a if a < self.solids() => Kind::Dummy,
            _ => Kind::Fluid,
        }
    }

    /// Puts the fluid into the order `order[new] = old` (indices within the fluid range).
    /// `scratch` is reused between calls. Ghosts are dropped.
    pub fn reorder_fluid(&mut self, order: &[u32], scratch: &mut ReorderScratch<D>) {
        self.drop_ghosts();
        let first = self.solids();
        permute(&mut self.position[first..], order, &mut scratch.vectors);
        permute(&mut self.velocity[first..], order, &mut scratch.vectors);
        permute(&mut self.pressure[first..], order, &mut scratch.scalars);
        permute(&mut self.id[first..], order, &mut scratch.ids);
    }

    /// Keeps only the fluid particles for which `keep(index)` holds, in their order; returns how many left.
    /// Ghosts are dropped.
    pub fn retain_fluid(&mut self, keep: impl Fn(usize) -> bool) -> usize {
        self.drop_ghosts();
        let mut kept = self.solids();
        for a in self.fluid() {
            if keep(a) {
                self.position[kept] = self.position[a];
                self.velocity[kept] = self.velocity[a];
                self.pressure[kept] = self.pressure[a];
                self.id[kept] = self.id[a];
                kept += 1;
            }
        }
        let removed = self.len() - kept;
        self.position.truncate(kept);
        self.velocity.truncate(kept);
        self.pressure.truncate(kept);
        self.id.truncate(kept);
        removed
    }
}

/// Buffers of [`Particles::reorder_fluid`].
#[derive(Debug, Clone, Default)]
pub struct ReorderScratch<const D: usize> {
    vectors: Vec<Vector<D>>,
    scalars: Vec<f64>,
    ids: Vec<u64>,
}

fn permute<T: Copy>(values: &mut [T], order: &[u32], scratch: &mut Vec<T>) {
    scratch.clear();
    scratch.extend(order.iter().map(|&old| values[old as usize]));
    values.copy_from_slice(scratch);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn three() -> Particles<2> {
        let mut particles = Particles::default();
        for k in 0..3 {
            particles.push_fluid(Vector::<2>::new(k as f64, 0.0), Vector::<2>::new(0.0, k as f64));
        }
        particles
    }

    #[test]
    fn reordering_moves_every_field_together() {
        let mut particles = three();
        particles.reorder_fluid(&[2, 0, 1], &mut ReorderScratch::default());
        assert_eq!(particles.id, [2, 0, 1]);
        assert_eq!(particles.position[0].x, 2.0);
        assert_eq!(particles.velocity[0].y, 2.0);
    }

    #[test]
    fn removed_particles_leave_the_others_in_order() {
        let mut particles = three();
        assert_eq!(particles.retain_fluid(|a| a != 1), 1);
        assert_eq!(particles.id, [0, 2]);
        assert_eq!(particles.len(), 2);
    }
}
