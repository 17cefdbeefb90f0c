//! Quantities of a whole scene at one instant: one small function each, one row of [`history`] each.
//!
//! Each is a sum or an extremum over the particles of this rank and then over ranks: all ranks ask for it together, and each gets it.

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
    /// What schemes share.
    pub params: &'a Params<D>,
    /// Gravity in m/s2 that is there without the motion of a tank: energies of a shaken liquid change by the work that the shaking does.
    pub gravity: Vector<D>,
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
        ("particles", particles),
    ]
}

impl<'a, const D: usize> Scene<'a, D> {
    /// View of a simulation.
    pub fn of(simulation: &'a Simulation<D>) -> Self {
        let (scheme, particles) = (&simulation.scheme, &simulation.particles);
        let (gravity, roughness) = (simulation.gravity, simulation.invariants.last_roughness);
        Self { particles, fields: scheme.fields(), params: scheme.params(), gravity, roughness }
    }

    /// Liquid and its ghosts.
    fn liquid(&self) -> impl Iterator<Item = usize> {
        self.particles.fluid().chain(self.particles.solid_ghosts().end..self.particles.len())
    }

    /// Over the particles of the liquid of all ranks.
    fn sums<const N: usize>(&self, of: impl Fn(usize) -> [f64; N]) -> [f64; N] {
        let mut local = [0.0; N];
        for a in self.particles.fluid() {
            local.iter_mut().zip(of(a)).for_each(|(sum, value)| *sum += value);
        }
        self.params.ranks.sums(&local).try_into().expect("as many sums as were asked for")
    }

    /// Largest value over the particles of the liquid of all ranks.
    fn largest(&self, of: impl Fn(usize) -> f64) -> f64 {
        self.params.ranks.max(self.particles.fluid().map(of).fold(f64::NEG_INFINITY, f64::max))
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
    scene.params.ranks.max(front_here(scene))
}

/// That of this rank.
fn front_here<const D: usize>(scene: &Scene<D>) -> f64 {
    let (position, fluid) = (&scene.particles.position, scene.particles.fluid());
    let near = 1.5 * scene.params.spacing;
    let x = |a: usize| position[a][0];
    let (first, last) = fluid
        .clone()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(first, last), a| (x(a).min(first), x(a).max(last)));
    // The front is mostly within a few spacings of the foremost particle: not all of the liquid needs to be sorted.
    let mut depth = 8.0 * near;
    loop {
        let is_near = |a: &usize| x(*a) > last - depth - near && x(*a) < last + near;
        let mut slab: Vec<usize> = scene.liquid().filter(is_near).collect();
        slab.sort_unstable_by(|&a, &b| x(b).total_cmp(&x(a)));
        let mut begin = 0;
        // Ghosts keep company, but the front is another rank's to tell where they are.
        for &a in slab.iter().filter(|a| fluid.contains(a)).take_while(|a| x(**a) > last - depth) {
            begin += slab[begin..].iter().take_while(|b| x(**b) > x(a) + near).count();
            let beside = slab[begin..].iter().take_while(|b| x(**b) > x(a) - near);
            let company = beside.filter(|b| (position[**b] - position[a]).norm() < near).count();
            // It keeps itself company.
            if company > 3 {
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
    let [squares] = scene.sums(|a| [scene.particles.velocity[a].norm_squared()]);
    0.5 * scene.params.mass() * squares
}

/// Potential energy of the liquid in J, zero at the origin.
pub fn potential_energy<const D: usize>(scene: &Scene<D>) -> f64 {
    let [falls] = scene.sums(|a| [scene.gravity.dot(&scene.particles.position[a])]);
    -scene.params.mass() * falls
}

/// Size of the liquid's linear momentum in kg m/s.
pub fn momentum<const D: usize>(scene: &Scene<D>) -> f64 {
    let sums: [f64; D] = scene.sums(|a| scene.particles.velocity[a].into());
    scene.params.mass() * Vector::<D>::from(sums).norm()
}

/// Largest speed of the liquid in m/s.
pub fn fastest<const D: usize>(scene: &Scene<D>) -> f64 {
    scene.params.ranks.max(scene.particles.fastest_liquid())
}

/// Height of the liquid's centre of mass in m.
pub fn centre_height<const D: usize>(scene: &Scene<D>) -> f64 {
    let [heights, count] = scene.sums(|a| [scene.particles.position[a][D - 1], 1.0]);
    heights / count
}

/// Largest kernel sum of the liquid over that of the regular lattice: how much it is compressed at worst.
pub fn largest_crowding<const D: usize>(scene: &Scene<D>) -> f64 {
    scene.largest(|a| scene.fields.crowding.get(a).copied().unwrap_or(0.0)).max(0.0)
}

/// Mean volume of a particle inside the liquid by its kernel sum, over that on the regular lattice: 1 if the liquid keeps its
/// volume. Particles on the surface are left out, their sums are cut off.
pub fn kernel_volume<const D: usize>(scene: &Scene<D>) -> f64 {
    let fields = &scene.fields;
    let [volume, count] = scene.sums(|a| match fields.surface.get(a) {
        Some(0.0) => [1.0 / fields.crowding[a], 1.0],
        _ => [0.0; 2],
    });
    volume / count
}

/// Largest pressure of the liquid in Pa.
pub fn largest_pressure<const D: usize>(scene: &Scene<D>) -> f64 {
    scene.largest(|a| scene.particles.pressure[a])
}

/// How many particles the liquid has.
pub fn particles<const D: usize>(scene: &Scene<D>) -> f64 {
    scene.params.ranks.sum(scene.particles.fluid().len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::{build, read};

    /// Against every pair; spray flies ahead of the liquid, farther than the slab that is looked at first.
    #[test]
    fn the_front_is_the_foremost_particle_in_company() {
        let text = "name = 'f'\ndimension = 2\nspacing = 0.05\ntime.until = 1\n\
                    fluid.block = [{min = [0, 0], max = [1, 0.5]}]";
        let scene = build::scene::<2>(&read::read(text, "front", &[]).unwrap());
        let (mut particles, near) = (scene.particles, 1.5 * scene.params.spacing);
        let front_of = |particles: &Particles<2>| {
            let fields = Fields::none();
            let (params, gravity) = (&scene.params, Vector::zeros());
            front(&Scene { particles, fields, params, gravity, roughness: 0.0 })
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
