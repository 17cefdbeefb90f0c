//! Quantities of a whole scene at one instant: one small function each, one row of [`history`] each.

use crate::particles::{Particles, Vector};
use crate::scheme::{Fields, Params};
use crate::simulation::Simulation;

/// What a quantity may look at.
#[derive(Clone, Copy)]
pub struct Scene<'a, const D: usize> {
    /// All particles.
    pub particles: &'a Particles<D>,
    /// What the last step found.
    pub fields: Fields<'a, D>,
    /// What schemes share, with the gravity that is there without the motion of a tank: energies of a shaken liquid change by the work that
    /// the shaking does.
    pub params: &'a Params<D>,
    /// Roughness of the pressure as last sampled, see [`crate::invariants`].
    pub roughness: f64,
}

/// A column of history.csv: name with unit, and how to get it.
pub type Quantity<const D: usize> = (&'static str, fn(&Scene<D>) -> f64);

/// Columns of history.csv after the time.
pub fn history<const D: usize>() -> [Quantity<D>; 12] {
    [
        ("front_m", front),
        ("kinetic_energy_j", kinetic_energy),
        ("potential_energy_j", potential_energy),
        ("energy_j", |scene| kinetic_energy(scene) + potential_energy(scene)),
        ("momentum_kg_m_per_s", momentum),
        ("fastest_m_per_s", fastest),
        ("centre_height_m", centre_height),
        ("largest_crowding", largest_crowding),
        ("kernel_volume", kernel_volume),
        ("pressure_max_pa", largest_pressure),
        ("pressure_roughness", |scene| scene.roughness),
        ("particles", |scene| scene.particles.fluid().len() as f64),
    ]
}

impl<'a, const D: usize> Scene<'a, D> {
    /// View of a simulation with the parameters of its case.
    pub fn of(simulation: &'a Simulation<D>, params: &'a Params<D>) -> Self {
        let (fields, roughness) = (simulation.scheme.fields(), simulation.invariants.last_roughness);
        Self { particles: &simulation.particles, fields, params, roughness }
    }

    /// Liquid and its ghosts.
    fn liquid(&self) -> impl Iterator<Item = usize> {
        let (particles, solids) = (self.particles, self.particles.solids());
        (solids..particles.len()).filter(move |a| particles.original(*a) >= solids)
    }

    /// Kernel mean of the pressure in Pa over the liquid around the particle nearest to `r`.
    pub fn mean_pressure_around(&self, r: &Vector<D>) -> f64 {
        let Self { particles, params, .. } = self;
        let distance = |a: usize| (particles.position[a] - r).norm_squared();
        let Some(a) = particles.fluid().min_by(|&a, &b| distance(a).total_cmp(&distance(b))) else {
            return 0.0;
        };
        let (mut sum, mut weights) = (0.0, 0.0);
        for b in self.liquid() {
            let r_ab = (particles.position[a] - particles.position[b]).norm();
            if r_ab < params.support() {
                let w = params.kernel.value::<D>(r_ab, params.smoothing_length());
                (sum, weights) = (sum + w * particles.pressure[b], weights + w);
            }
        }
        sum / weights
    }
}

/// Largest x of the liquid in m, lone particles of spray left out: at least 3 fluid neighbours within 1.5 spacings.
pub fn front<const D: usize>(scene: &Scene<D>) -> f64 {
    let (position, near) = (&scene.particles.position, 1.5 * scene.params.spacing);
    let x = |a: usize| position[a][0];
    let (first, last) = scene
        .particles
        .fluid()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(first, last), a| (x(a).min(first), x(a).max(last)));
    // The front is mostly within a few spacings of the foremost particle: not all of the liquid needs to be sorted.
    let mut depth = 8.0 * near;
    loop {
        let mut slab: Vec<usize> = scene.liquid().filter(|a| x(*a) > last - depth - near).collect();
        slab.sort_unstable_by(|&a, &b| x(b).total_cmp(&x(a)));
        let mut begin = 0;
        for &a in slab.iter().take_while(|a| x(**a) > last - depth) {
            begin += slab[begin..].iter().take_while(|b| x(**b) > x(a) + near).count();
            let beside = slab[begin..].iter().take_while(|b| x(**b) > x(a) - near);
            let company = beside.filter(|b| (position[**b] - position[a]).norm() < near).count();
            // It keeps itself company.
            if scene.particles.fluid().contains(&a) && company > 3 {
                return x(a);
            }
        }
        // Without liquid as well: the bounds are then the wrong way round.
        if last - depth < first {
            return f64::NEG_INFINITY;
        }
        depth *= 4.0;
    }
}

/// Kinetic energy of the liquid in J.
pub fn kinetic_energy<const D: usize>(scene: &Scene<D>) -> f64 {
    let squares: f64 = scene.particles.fluid().map(|a| scene.particles.velocity[a].norm_squared()).sum();
    0.5 * scene.params.mass() * squares
}

/// Potential energy of the liquid in J, zero at the origin.
pub fn potential_energy<const D: usize>(scene: &Scene<D>) -> f64 {
    let sum: Vector<D> = scene.particles.fluid().map(|a| scene.particles.position[a]).sum();
    -scene.params.mass() * scene.params.gravity.dot(&sum)
}

/// Size of the liquid's linear momentum in kg m/s.
pub fn momentum<const D: usize>(scene: &Scene<D>) -> f64 {
    let sum: Vector<D> = scene.particles.fluid().map(|a| scene.particles.velocity[a]).sum();
    scene.params.mass() * sum.norm()
}

/// Largest speed of the liquid in m/s.
pub fn fastest<const D: usize>(scene: &Scene<D>) -> f64 {
    scene.particles.fastest_liquid()
}

/// Height of the liquid's centre of mass in m.
pub fn centre_height<const D: usize>(scene: &Scene<D>) -> f64 {
    let fluid = scene.particles.fluid();
    let count = fluid.len() as f64;
    fluid.map(|a| scene.particles.position[a][D - 1]).sum::<f64>() / count
}

/// Largest kernel sum of the liquid over that of the regular lattice: how much it is compressed at worst.
pub fn largest_crowding<const D: usize>(scene: &Scene<D>) -> f64 {
    scene.particles.fluid().filter_map(|a| scene.fields.crowding.get(a)).copied().fold(0.0, f64::max)
}

/// Mean volume of a particle inside the liquid by its kernel sum, over that on the regular lattice: 1 if the liquid keeps its
/// volume. Particles on the surface are left out, their sums are cut off.
pub fn kernel_volume<const D: usize>(scene: &Scene<D>) -> f64 {
    let fields = &scene.fields;
    let inside = scene.particles.fluid().filter(|&a| fields.surface.get(a).is_some_and(|s| *s == 0.0));
    let (sum, count) = inside.fold((0.0, 0), |(sum, count), a| (sum + 1.0 / fields.crowding[a], count + 1));
    sum / f64::from(count)
}

/// Largest pressure of the liquid in Pa.
pub fn largest_pressure<const D: usize>(scene: &Scene<D>) -> f64 {
    scene.particles.fluid().map(|a| scene.particles.pressure[a]).fold(f64::NEG_INFINITY, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::{build, read};
    use crate::neighbors::Neighbors;

    /// Against every pair; spray flies ahead of the liquid, farther than the slab that is looked at first.
    #[test]
    fn the_front_is_the_foremost_particle_in_company() {
        let text = "name = 'f'\ndimension = 2\nspacing = 0.05\ntime.until = 1\n\
                    fluid.block = [{min = [0, 0], max = [1, 0.5]}]";
        let scene = build::scene::<2>(&read::read(text, "front", &[]).unwrap());
        let (mut particles, near) = (scene.particles, 1.5 * scene.params.spacing);
        let neighbors = Neighbors::default();
        let front_of = |particles: &Particles<2>| {
            let fields = Fields::none(&neighbors);
            front(&Scene { particles, fields, params: &scene.params, roughness: 0.0 })
        };
        let naive = |particles: &Particles<2>| {
            let r = &particles.position;
            let company = |a: usize| r.iter().filter(|r_b| (*r_b - r[a]).norm() < near).count();
            (0..r.len()).filter(|&a| company(a) > 3).map(|a| r[a].x).fold(f64::NEG_INFINITY, f64::max)
        };
        assert!((front_of(&particles) - 0.975).abs() < 1e-12);
        let count = particles.len();
        for k in 0..count {
            // Every third flies, the fastest twelve spacings beyond the rest.
            let share = (k * 7919 % count) as f64 / count as f64;
            particles.position[k] +=
                if k % 3 == 0 { Vector::<2>::new(3.0 * share, share) } else { Vector::zeros() };
            assert_eq!(front_of(&particles), naive(&particles), "after {k}");
        }
        for (k, r) in particles.position.iter_mut().enumerate() {
            r.x = 0.1 * k as f64;
        }
        assert_eq!(front_of(&particles), f64::NEG_INFINITY);
    }
}
