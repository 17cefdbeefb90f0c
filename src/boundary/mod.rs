//! Walls of dummy particles (Koshizuka et al. 1998; Gotoh & Sakai 1999; Jian et al. 2016).
//!
//! The first layer of a solid carries pressure unknowns, each with its own row of Eq. (3). Behind it, dummies
//! fill up the kernel support and carry the consistent Neumann condition dp/dn = rho (g - a_wall) . n:
//!
//! p_dummy = p_wall + rho (g - a_wall) . (r_dummy - r_wall)                                      (1)
//!
//! so that still water is an exact solution next to any wall. The wall's own predicted velocity is
//! v* = v_wall + g dt, for the same reason: in still water div v* is then zero everywhere.
//!
//! A wall particle takes part only where it is *wet*: where liquid fills at least half of that part of its kernel
//! support which its solid leaves open. No normals are needed for that, flat walls, edges and corners obey one
//! rule, and the water line beside a wall is the water line of the particles next to it: on a lattice the wall
//! particle level with the top row is wet (0.81 of its open support is filled), the one above is dry (0.19).
//! Half and twice the threshold would wet the wall a whole row above, or leave the top row's neighbour dry.
//!
//! **Covered walls.** Where a body stands on a floor, the first layers of both lie on each other, and liquid beside the body sees
//! them. A wall particle none of whose 3^D - 1 neighbouring cells is open is therefore never wet, and the dummies behind it follow
//! the nearest wall particle of the same solid that can be. What such walls leave empty is not taken for air: a wall at the foot
//! of a body would pass for a free surface, with p = 0 ([`crate::bodies::Bodies::find_covered`]).

pub mod extrapolation;
pub mod kinematic;
pub mod repulsion;

use crate::halo::{Halo, Kinds};
use crate::kernel::LatticeSums;
use crate::neighbors::Neighbors;
use crate::particles::{Particles, Vector};
use rayon::prelude::*;

/// Share of its open support that liquid must fill for a wall particle to be wet.
const WET_SHARE: f64 = 0.5;

/// The state of all walls.
#[derive(Debug, Clone)]
pub struct DummyWalls<const D: usize> {
    /// Kernel sum over the liquid, in 1/m^D, from which a wall particle is wet (one entry a wall particle).
    threshold: Vec<f64>,
    /// Body force per volume that walls at rest feel, rho g, in N/m3.
    hydrostatic_gradient: Vector<D>,
    /// rho a_wall in N/m3 of each solid; empty where none moves.
    inertial: Vec<Vector<D>>,
}

impl<const D: usize> DummyWalls<D> {
    /// Measures the open support of each wall particle; `solids` are the neighbours of solids among themselves.
    pub fn new(
        particles: &Particles<D>,
        solids: &Neighbors<D>,
        lattice: &LatticeSums,
        volume: f64,
        hydrostatic_gradient: Vector<D>,
    ) -> Self {
        let mut walls =
            Self { threshold: vec![0.0; particles.walls().len()], hydrostatic_gradient, inertial: vec![] };
        walls.measure(solids, lattice, volume, |_| true, |_| false);
        walls
    }

    /// Measures the open support of the walls for which `changed` holds; those for which `covered` does have none.
    pub fn measure(
        &mut self,
        solids: &Neighbors<D>,
        lattice: &LatticeSums,
        volume: f64,
        changed: impl Fn(usize) -> bool,
        covered: impl Fn(usize) -> bool,
    ) {
        for (a, threshold) in self.threshold.iter_mut().enumerate().filter(|(a, _)| changed(*a)) {
            let open = lattice.kernel_sum - lattice.own_share - volume * solids.row(a).kernel_sum();
            *threshold = if covered(a) { f64::INFINITY } else { WET_SHARE * open / volume };
        }
    }

    /// Changes the accelerations of solids in m/s2, in liquid of `density` kg/m3: `set` fills an entry a solid.
    pub fn set_accelerations(&mut self, density: f64, set: impl FnOnce(&mut Vec<Vector<D>>)) {
        set(&mut self.inertial);
        self.inertial.iter_mut().for_each(|a| *a *= density);
    }

    /// Changes the body force per volume that walls feel, in N/m3.
    pub fn set_hydrostatic_gradient(&mut self, gradient: Vector<D>) {
        self.hydrostatic_gradient = gradient;
    }

    /// Kernel sum over the liquid from which particle `a` takes part: always for liquid, never for dummies.
    #[inline]
    pub fn threshold(&self, particles: &Particles<D>, a: usize) -> f64 {
        match a {
            a if a < self.threshold.len() => self.threshold[a],
            a if a < particles.solids() => f64::INFINITY,
            _ => f64::NEG_INFINITY,
        }
    }

    /// Marks liquid, wet walls and their dummies in `active` (one entry a particle).
    pub fn mark_active(
        &self,
        particles: &Particles<D>,
        neighbors: &Neighbors<D>,
        halo: &Halo<D>,
        active: &mut Vec<bool>,
    ) {
        let walls = self.threshold.len();
        active.clear();
        active.resize(walls, false);
        for a in neighbors.with_neighbors(walls) {
            active[a] = neighbors.row(a).split().0.kernel_sum() >= self.threshold[a];
        }
        active.resize(particles.len(), true);
        halo.refresh(Kinds::Solids, particles.originals(), active);
        let (walls, rest) = active.split_at_mut(particles.walls().len());
        rest.iter_mut().zip(&particles.tie).for_each(|(dummy, wall)| *dummy = walls[*wall as usize]);
        halo.copy(particles.originals(), active);
    }

    /// rho (g - a_wall), the gradient of the pressure at solid particle `w`, in Pa/m.
    #[inline]
    pub fn pressure_gradient(&self, w: usize) -> Vector<D> {
        self.hydrostatic_gradient - self.inertial.get(w).copied().unwrap_or_else(Vector::zeros)
    }

    /// Pressure of dummy `d` above that of its wall particle, Eq. (1), in Pa.
    #[inline]
    pub fn pressure_step(&self, particles: &Particles<D>, d: usize) -> f64 {
        let wall = particles.tie[d - particles.walls().len()] as usize;
        let step = particles.position[d] - particles.position[wall];
        // The mean is that in the middle: exact where it is linear in space, as in a spinning body.
        (0.5 * (self.pressure_gradient(d) + self.pressure_gradient(wall))).dot(&step)
    }

    /// Extends the wall pressures, which all ranks that need them know, to the dummies, Eq. (1).
    pub fn extend_pressure(&self, particles: &mut Particles<D>, halo: &Halo<D>, active: &[bool]) {
        let dummies = particles.dummies();
        let mut pressure = std::mem::take(&mut particles.pressure);
        let (walls, rest) = pressure.split_at_mut(dummies.start);
        rest[..dummies.len()].par_iter_mut().enumerate().with_min_len(1024).for_each(|(k, p)| {
            let d = dummies.start + k;
            *p = match active[d] {
                true => walls[particles.tie[k] as usize] + self.pressure_step(particles, d),
                false => 0.0,
            };
        });
        halo.copy(particles.originals(), &mut pressure);
        particles.pressure = pressure;
    }
}
