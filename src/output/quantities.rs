//! Quantities of a whole scene at one instant: one small function each, one row of [`history`] each.

use crate::particles::{Particles, Vector};
use crate::scheme::Fields;
use crate::simulation::Simulation;

/// What a quantity may look at.
#[derive(Clone, Copy)]
pub struct Scene<'a, const D: usize> {
    /// All particles.
    pub particles: &'a Particles<D>,
    /// What the last step found.
    pub fields: Fields<'a, D>,
    /// Mass of one particle in kg (in 2D for 1 m of width).
    pub mass: f64,
    /// Gravitational acceleration in m/s2, without the motion of a tank: energies of a shaken liquid change by the work
    /// that the shaking does.
    pub gravity: Vector<D>,
    /// Particle spacing in m.
    pub spacing: f64,
}

/// A column of history.csv: name with unit, and how to get it.
pub type Quantity<const D: usize> = (&'static str, fn(&Scene<D>) -> f64);

/// Columns of history.csv after the time.
pub fn history<const D: usize>() -> [Quantity<D>; 11] {
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
        ("particles", |scene| scene.particles.fluid().len() as f64),
    ]
}

impl<'a, const D: usize> Scene<'a, D> {
    /// View of a simulation of particles of `mass` kg.
    pub fn of(simulation: &'a Simulation<D>, mass: f64, gravity: Vector<D>, spacing: f64) -> Self {
        let fields = simulation.scheme.fields();
        Self { particles: &simulation.particles, fields, mass, gravity, spacing }
    }

    /// Kernel mean of the pressure in Pa over the liquid around the particle nearest to `r`.
    pub fn mean_pressure_around(&self, r: &Vector<D>) -> f64 {
        let Self { particles, fields, .. } = self;
        let distance = |a: usize| (particles.position[a] - r).norm_squared();
        let Some(a) = particles.fluid().min_by(|&a, &b| distance(a).total_cmp(&distance(b))) else {
            return 0.0;
        };
        let row = fields.neighbors.row(a);
        let fluid = row.iter().filter(|(b, ..)| particles.original(*b) >= particles.solids());
        let (sum, weights) = fluid
            .fold((0.0, 0.0), |(sum, weights), (b, w, _)| (sum + w * particles.pressure[b], weights + w));
        sum / weights
    }
}

/// Largest x of the liquid in m, lone particles of spray left out: at least 3 fluid neighbours within 1.5 spacings.
pub fn front<const D: usize>(scene: &Scene<D>) -> f64 {
    let Scene { particles, fields, .. } = scene;
    let near = (1.5 * scene.spacing).powi(2);
    let solids = particles.solids();
    let is_fluid = |b: usize| particles.original(b) >= solids;
    let in_company = |a: usize| {
        let r_a = particles.position[a];
        let row = fields.neighbors.row(a).index.iter().map(|&b| b as usize);
        row.filter(|&b| is_fluid(b) && (particles.position[b] - r_a).norm_squared() < near).count() >= 3
    };
    let mut front = f64::NEG_INFINITY;
    for a in particles.fluid() {
        let x = particles.position[a][0];
        if x > front && in_company(a) {
            front = x;
        }
    }
    front
}

/// Kinetic energy of the liquid in J.
pub fn kinetic_energy<const D: usize>(scene: &Scene<D>) -> f64 {
    let squares: f64 = scene.particles.fluid().map(|a| scene.particles.velocity[a].norm_squared()).sum();
    0.5 * scene.mass * squares
}

/// Potential energy of the liquid in J, zero at the origin.
pub fn potential_energy<const D: usize>(scene: &Scene<D>) -> f64 {
    let sum: Vector<D> = scene.particles.fluid().map(|a| scene.particles.position[a]).sum();
    -scene.mass * scene.gravity.dot(&sum)
}

/// Size of the liquid's linear momentum in kg m/s.
pub fn momentum<const D: usize>(scene: &Scene<D>) -> f64 {
    let sum: Vector<D> = scene.particles.fluid().map(|a| scene.particles.velocity[a]).sum();
    scene.mass * sum.norm()
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
