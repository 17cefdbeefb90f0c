//! Collisions of pairs that come too close, as in MPS (Koshizuka et al. 1998; Lee et al. 2011).
//!
//! In spray and at impact the pressure alone cannot keep single particles apart. A pair closer than the collision
//! distance that still approaches exchanges an impulse along its line of centres with restitution e, so that its
//! relative normal velocity becomes -e times itself: momentum is conserved and energy never grows. Walls have
//! infinite mass. Pairs are treated one after the other in a fixed order.

use crate::neighbors::Neighbors;
use crate::particles::{Particles, Vector};
use rayon::prelude::*;

/// Collision parameters.
#[derive(Debug, Clone, Copy)]
pub struct Collisions {
    /// Distance in m below which approaching pairs collide.
    pub distance: f64,
    /// Coefficient of restitution e.
    pub restitution: f64,
}

impl Collisions {
    /// Lets all pairs collide once; `position` is where the neighbours were searched. Returns the number of
    /// collisions. `pairs` is a buffer.
    pub fn apply<const D: usize>(
        &self,
        particles: &mut Particles<D>,
        neighbors: &Neighbors<D>,
        pairs: &mut Vec<(u32, u32)>,
    ) -> usize {
        let (fluid, solids) = (particles.fluid(), particles.solids());
        let square = self.distance * self.distance;
        let (then, position) = (&*particles, &particles.position);
        let close = |a: usize| {
            let r_a = position[a];
            let row = neighbors.row(a).index.iter().copied();
            row.filter(move |&b| then.original(b as usize) < a)
                .filter(move |&b| (r_a - position[b as usize]).norm_squared() < square)
                .map(move |b| (a as u32, b))
        };
        pairs.clear();
        pairs.par_extend(fluid.into_par_iter().with_min_len(256).flat_map_iter(close));
        let mut collided = 0;
        for &(a, b) in pairs.iter() {
            let (a, b) = (a as usize, b as usize);
            let Some(normal) = (particles.position[a] - particles.position[b]).try_normalize(0.0) else {
                continue;
            };
            let b = particles.original(b);
            let approach = (particles.velocity[a] - particles.velocity[b]).dot(&normal);
            if approach < 0.0 {
                collided += 1;
                let impulse: Vector<D> = -(1.0 + self.restitution) * approach * normal;
                if b < solids {
                    particles.velocity[a] += impulse;
                } else {
                    particles.velocity[a] += 0.5 * impulse;
                    particles.velocity[b] -= 0.5 * impulse;
                }
            }
        }
        collided
    }
}
