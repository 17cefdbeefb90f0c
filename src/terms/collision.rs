//! Collisions of pairs that come too close, as in MPS (Koshizuka et al. 1998; Lee et al. 2011).
//!
//! In spray and at impact the pressure alone cannot keep single particles apart. A pair closer than the collision
//! distance that still approaches exchanges an impulse along its line of centres with restitution e, so that its
//! relative normal velocity becomes -e times itself: momentum is conserved and energy never grows. Walls have
//! infinite mass, and flat ones take the impulse along their normal: along the line of centres a film would stumble over the
//! particles of the floor it glides on. Pairs are treated one after the other in a fixed order, those across ranks first and at once.
//!
//! **Bodies** that are free take part with the mass that they show at the point where they are hit, 1 / (n . K n) with K = 1 / M there:
//! the impulse on the particle is (1 + e) of the approach times the reduced mass of both, the body takes the opposite one, and the
//! next hit meets a body that has it. It acts on the body in its next step, with what else it feels then ([`crate::bodies::coupling`]): so
//! friction and the added mass of the liquid have their say.
//!
//! Between the particles of a wall a single drop on a dry floor would still slip through, as nothing but a collision stops it
//! there. So a particle that has got behind the face of a wall is put back on it and rebounds.

use crate::bodies::Bodies;
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
    /// Mass of a particle in kg, in 2D per metre of width.
    pub mass: f64,
}

impl Collisions {
    /// Lets all pairs collide once; `position` is where the neighbours were searched. Returns the number of
    /// collisions, and adds to `received` the impulse in N s on each wall particle that cannot move. `pairs` is a buffer.
    pub fn apply<const D: usize>(
        &self,
        particles: &mut Particles<D>,
        neighbors: &Neighbors<D>,
        bodies: &mut Bodies<D>,
        pairs: &mut Vec<(u32, u32)>,
        received: &mut [Vector<D>],
    ) -> usize {
        let (fluid, solids, walls) = (particles.fluid(), particles.solids(), particles.walls().end);
        let square = self.distance * self.distance;
        let (then, position) = (&*particles, &particles.position);
        let close = |a: usize| {
            let r_a = position[a];
            let row = neighbors.row(a).index.iter().copied();
            row.filter(move |&b| then.original(b as usize) < a || then.is_foreign(b as usize))
                .filter(move |&b| (r_a - position[b as usize]).norm_squared() < square)
                .map(move |b| (a as u32, b))
        };
        pairs.clear();
        pairs.par_extend(fluid.into_par_iter().with_min_len(256).flat_map_iter(close));
        let normal = |particles: &Particles<D>, a: usize, b: usize| match particles
            .flat_normal(particles.original(b))
        {
            Some(normal) => Some(*normal),
            None => (particles.position[a] - particles.position[b]).try_normalize(0.0),
        };
        let impulse = |particles: &Particles<D>, a: usize, b: usize| -> Option<Vector<D>> {
            let (original, normal) = (particles.original(b), normal(particles, a, b)?);
            let v_ab = particles.velocity[a] - particles.velocity[original];
            let approach = v_ab.dot(&normal);
            (approach < 0.0).then(|| -(1.0 + self.restitution) * approach * normal)
        };
        let mut collided = 0;
        // Both ranks find the same impulse, from the velocities that they shared, and each takes its half of it.
        let across: Vec<(usize, Vector<D>)> = pairs
            .extract_if(.., |(_, b)| particles.is_foreign(*b as usize))
            .filter_map(|(a, b)| {
                let (a, b) = (a as usize, b as usize);
                let impulse = impulse(particles, a, b)?;
                collided += usize::from(particles.id[a] > particles.id[b]);
                Some((a, 0.5 * impulse))
            })
            .collect();
        across.into_iter().for_each(|(a, half)| particles.velocity[a] += half);
        for &(a, b) in pairs.iter() {
            let (a, b) = (a as usize, b as usize);
            if let Some(body) = bodies.free(particles.original(b)) {
                let normal = normal(particles, a, b);
                let hit = |normal| self.strike(particles, bodies, body, a, &normal);
                collided += usize::from(normal.is_some_and(hit));
                continue;
            }
            let Some(impulse) = impulse(particles, a, b) else { continue };
            collided += 1;
            let b = particles.original(b);
            if b < solids {
                particles.velocity[a] += impulse;
                let wall = if b < walls { b } else { particles.tie[b - walls] as usize };
                received[wall] -= self.mass * impulse;
            } else {
                particles.velocity[a] += 0.5 * impulse;
                particles.velocity[b] -= 0.5 * impulse;
            }
        }
        collided
    }

    /// Lets particle `a` hit a free body, along the line through `a` across the unit `normal`; returns whether they approached.
    fn strike<const D: usize>(
        &self,
        particles: &mut Particles<D>,
        bodies: &mut Bodies<D>,
        body: usize,
        a: usize,
        normal: &Vector<D>,
    ) -> bool {
        let body = &mut bodies.list[body];
        let at = particles.position[a];
        let approach = (particles.velocity[a] - body.velocity_after_hits(&at)).dot(normal);
        if approach >= 0.0 {
            return false;
        }
        let share = 1.0 / (1.0 + self.mass * body.mobility(&at, normal));
        let change = -(1.0 + self.restitution) * approach * share * normal;
        particles.velocity[a] += change;
        body.hit(&at, &(-self.mass * change));
        true
    }

    /// Keeps the liquid before the faces of walls, at the end of a step. Returns the number of rebounds; `received` as for
    /// [`apply`](Self::apply).
    pub fn hold<const D: usize>(
        &self,
        particles: &mut Particles<D>,
        neighbors: &Neighbors<D>,
        bodies: &mut Bodies<D>,
        spacing: f64,
        received: &mut [Vector<D>],
    ) -> usize {
        let (first, walls) = (particles.solids(), particles.walls().end);
        // Half a cell's diagonal in 3D, rounded up: every place before a flat wall is before one of its particles.
        let aside = (0.75 * spacing).powi(2);
        let owned = particles.owned();
        let mut position = std::mem::take(&mut particles.position);
        let mut velocity = std::mem::take(&mut particles.velocity);
        let (solid_position, fluid_position) = position.split_at_mut(first);
        let (solid_velocity, fluid_velocity) = velocity.split_at_mut(first);
        let (mut rebounds, hits, pushes) =
            (&mut fluid_position[..owned - first], &mut fluid_velocity[..owned - first])
                .into_par_iter()
                .enumerate()
                .with_min_len(256)
                .map(|(k, (r, v))| {
                    let (mut rebounds, mut hits, mut pushes) = (0, vec![], vec![]);
                    let row = neighbors.row(first + k).split().1.index.iter();
                    // Ghosts of walls repeat what their originals do beyond a periodic side: too far away to touch.
                    for w in row.map(|&w| w as usize).filter(|&w| w < walls) {
                        let (away, normal) = (*r - solid_position[w], particles.normal[w]);
                        let height = away.dot(&normal);
                        let gap = height - particles.depth[w];
                        if gap >= 0.0 || away.norm_squared() - height * height > aside {
                            continue;
                        }
                        let approach = (*v - solid_velocity[w]).dot(&normal);
                        if bodies.free(w).is_some() {
                            hits.push((first + k, w));
                        } else if approach < 0.0 {
                            let change = (1.0 + self.restitution) * approach * normal;
                            *v -= change;
                            pushes.push((w, self.mass * change));
                            rebounds += 1;
                        }
                        *r -= gap * normal;
                    }
                    (rebounds, hits, pushes)
                })
                .reduce(Default::default, |(m, mut all, mut given), (n, hits, pushes)| {
                    all.extend(hits);
                    given.extend(pushes);
                    (m + n, all, given)
                });
        (particles.position, particles.velocity) = (position, velocity);
        pushes.into_iter().for_each(|(w, push)| received[w] += push);
        for (a, w) in hits {
            let (body, normal) = (bodies.free(w), particles.normal[w]);
            let hit = |body| self.strike(particles, bodies, body, a, &normal);
            rebounds += usize::from(body.is_some_and(hit));
        }
        rebounds
    }
}
