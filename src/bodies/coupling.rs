//! The motion of bodies and the pressure of the liquid, found together.
//!
//! Let q be the accelerations of all bodies along and about their free axes. By [`crate::boundary`], Eq. (1), the pressure equation
//! depends on them through the dummies of the bodies alone, and linearly: A p = b + C q. Eq. (1) of [`crate::bodies`] depends on
//! the pressure p through the faces. Eliminating p = p_0 + Y q, with A p_0 = b and A Y = C, leaves for each body
//!
//! M q = G(p_0 + Y q) + forces that do not depend on p                                             (1)
//!
//! G being the surface integral and -dG/dq = -G Y the added mass: with it the motion of a body that is much lighter than the
//! liquid it pushes is as stable as that of a heavy one. This is the *strong* coupling: one more right-hand side for each free
//! axis on a matrix and a preconditioner that are there already. Where negative pressures are set to zero, so they are in G, and (1) is
//! solved by Newton's method. *Explicit* coupling takes Y = 0: dummies feel the acceleration of the last step, and the liquid
//! at a light body answers to it in the next step, with the wrong sign and more of it.
//!
//! **Exact solution.** A circular cylinder of density rho_b that is let go in liquid of density rho at rest carries the added mass
//! rho V far from everything, rho V (b^2 + r^2) / (b^2 - r^2) in the middle of a round vessel of radius b (Lamb 1932, art. 68): it
//! starts with the acceleration g (rho - rho_b) / (rho_b + C rho), C = 1 or that factor. A light one rises at almost g.
//! Found of C = 1.05: 0.82, 0.94, 0.99 at 4, 8, 16 spacings a radius; what is missing is of first order, most of it the steps of
//! the lattice's circle.
//!
//! **Positive added mass.** Half -q . G Y q is the kinetic energy of the liquid that moves with the bodies: the added mass is
//! positive. Its discrete form need not be, because a wall at a corner may get its pressure from liquid that the body's motion takes it
//! away from. A light body that is barely wet then has almost no inertia, or a negative one, and one step throws it: in `debris` at
//! 0.02 m a box of 100 kg/m3 at 46 m/s, from a flood of 2. What the symmetric part of -dG/dq has of negative eigenvalues, as shares of
//! the mass, is therefore left out; where all are positive nothing changes.
//!
//! **Covered faces**, those that lie on another solid, are dry in (1) unless liquid seeps under the body: then they carry the
//! mean pressure of the wet rim of the covered patch, dry parts of the rim counting as 0; see [`super::friction`].

use super::friction::{Friction, Regime};
use super::{Bodies, Body, Motion, prescribed, restrict};
use crate::form::{Point, point};
use crate::halo::Halo;
use crate::particles::{Particles, Vector};
use nalgebra::{DMatrix, DVector};

/// What bodies feel of the flow.
pub struct Flow<'a, const D: usize> {
    /// Particles; their pressures are p_0.
    pub particles: &'a Particles<D>,
    /// Which walls are wet.
    pub active: &'a [bool],
    /// Who holds which wall.
    pub halo: &'a Halo<D>,
    /// Body force per mass in m/s2.
    pub gravity: Vector<D>,
    /// Density of the liquid in kg/m3.
    pub density: f64,
    /// Accelerations in m/s2 of solids that went into p_0.
    pub accelerations: &'a [Vector<D>],
    /// Whether walls carry a pressure.
    pub pressure: bool,
    /// Repulsion on each wall particle in N, if any.
    pub repulsion: &'a [Vector<D>],
    /// Whether negative pressures are set to zero.
    pub clip: bool,
    /// Y: for each of [`Bodies::unknowns`] the pressure by row, in Pa s2/m (or Pa s2); and the row of each particle.
    pub response: Option<(&'a [Vec<f64>], &'a [u32])>,
}

/// Part of a body's surface that liquid presses on.
struct Patch<const D: usize> {
    body: usize,
    wall: usize,
    /// Generalised force along and about the axes for a pressure of 1 Pa.
    push: [f64; 6],
    /// Face minus wall particle, in m.
    to_face: Vector<D>,
    /// Wall particle minus centre, in m.
    arm: Vector<D>,
}

/// Displacement of a point at `arm` for a unit along or about axis `k`.
pub(super) fn mode(k: usize, arm: &Point) -> Point {
    let mut axis = Point::zeros();
    axis[k % 3] = 1.0;
    if k < 3 { axis } else { axis.cross(arm) }
}

/// A force at `arm` from the centre as forces along and torques about the axes.
pub(super) fn generalised(force: &Point, arm: &Point) -> [f64; 6] {
    let torque = arm.cross(force);
    [force.x, force.y, force.z, torque.x, torque.y, torque.z]
}

/// Newton steps at most: each settles which walls are clipped, usually at once.
const STEPS: usize = 30;
/// A change of this share of the accelerations ends them.
const CLOSE: f64 = 1e-13;

impl<const D: usize> Bodies<D> {
    /// Body and axis of each component of q.
    pub fn unknowns(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.list.iter().enumerate().flat_map(|(b, body)| body.freedoms().iter().map(move |k| (b, *k)))
    }

    /// Acceleration at point `at` when unknown (b, k) is 1 and all else 0.
    pub fn mode_at(&self, (b, k): (usize, usize), at: &Point) -> Point {
        mode(k, &(at - self.list[b].state.position))
    }

    /// Accelerations and loads of a step of `dt` s, and from them the velocities at its end; returns q.
    pub fn advance(&mut self, flow: &Flow<'_, D>, dt: f64) -> Vec<f64> {
        let unknowns: Vec<(usize, usize)> = self.unknowns().collect();
        let patches = self.patches(flow);
        let mut regimes: Vec<Regime> = self.list.iter().map(|body| Regime::first(body.slide().0)).collect();
        let mut q = DVector::zeros(unknowns.len());
        let mut force = vec![[0.0; 6]; self.list.len()];
        // Each body changes its regime once at most; without sliding ones there is one pass.
        for _ in 0..=2 * self.list.len() {
            q = self.newton(flow, &patches, &unknowns, &regimes, dt);
            force = self.load(flow, &patches, &unknowns, &q, dt).0;
            let mut changed = false;
            for (b, body) in self.list.iter().enumerate() {
                let Some((k, friction)) = body.sliding() else { continue };
                let (u, driving) = (body.slide().0, body.driving(k, force[b][k], &flow.gravity));
                let limit = body.friction_limit(friction, &force[b], &flow.gravity);
                let at = unknowns.iter().position(|unknown| *unknown == (b, k)).expect("it is free along k");
                if let Some(next) = regimes[b].correction(u, u + dt * q[at], driving, limit) {
                    (regimes[b], changed) = (next, true);
                }
            }
            if !changed {
                break;
            }
        }
        let drag = |b: usize| Point::from_column_slice(&self.drag_on(b, &unknowns, q.as_slice(), dt)[..3]);
        let drags: Vec<Point> = (0..self.list.len()).map(drag).collect();
        for (b, body) in self.list.iter_mut().enumerate() {
            let mine = unknowns.iter().zip(q.iter()).filter(|((owner, _), _)| *owner == b);
            body.state.loads.viscous = drags[b];
            body.state.hits = [Point::zeros(); 2];
            body.settle(&force[b], mine.map(|((_, k), q)| (*k, *q)), regimes[b], &flow.gravity, dt);
            if let Motion::Prescribed(rows) = &body.motion {
                let [velocity, spin] = prescribed(rows, self.time + dt);
                body.state.acceleration = (velocity - body.state.velocity) / dt;
                body.state.angular_acceleration = (spin - body.state.spin) / dt;
                (body.state.velocity, body.state.spin) = (velocity, spin);
            }
        }
        self.keep_apart(dt);
        q.iter().copied().collect()
    }

    /// Accelerations of prescribed bodies over the step of `dt` s that begins, before their velocities change.
    pub fn foresee(&mut self, dt: f64) {
        for body in &mut self.list {
            if let Motion::Prescribed(rows) = &body.motion {
                let [velocity, spin] = prescribed(rows, self.time + dt);
                body.state.acceleration = (velocity - body.state.velocity) / dt;
                body.state.angular_acceleration = (spin - body.state.spin) / dt;
            }
        }
    }

    /// Wet parts of the surfaces, those whose walls this rank holds.
    fn patches(&self, flow: &Flow<'_, D>) -> Vec<Patch<D>> {
        let Flow { particles, halo, .. } = flow;
        let mut patches = vec![];
        if !flow.pressure {
            return patches;
        }
        let area = self.spacing.powi(D as i32 - 1);
        let is_wet = |a: usize| flow.active.get(a).copied().unwrap_or(false);
        for (b, body) in self.list.iter().enumerate() {
            let centre = restrict::<D>(&body.state.position);
            let wall_of = |member: u32| body.members[member as usize].particle as usize;
            let mut add = |wall: usize, normal: &Point, push: [f64; 6]| {
                if halo.holds(wall) && is_wet(wall) {
                    let to_face = 0.5 * self.spacing * restrict(normal);
                    patches.push(Patch {
                        body: b,
                        wall,
                        push,
                        to_face,
                        arm: particles.position[wall] - centre,
                    });
                }
            };
            let at_face = |member: u32, normal: &Point| {
                let arm =
                    point(&(particles.position[wall_of(member)] - centre)) + 0.5 * self.spacing * normal;
                generalised(&(-area * normal), &arm)
            };
            let mut open = vec![false; body.walls];
            for face in body.faces.iter().filter(|face| face.open) {
                let normal = body.state.rotation * face.normal;
                open[face.member as usize] = true;
                add(wall_of(face.member), &normal, at_face(face.member, &normal));
            }
            if !body.is_seeped_under() {
                continue;
            }
            for side in 0..2 * D {
                let mut outward = Point::zeros();
                outward[side / 2] = [-1.0, 1.0][side % 2];
                let covered = || body.faces.iter().filter(|face| !face.open && face.normal == outward);
                let rim: Vec<u32> =
                    covered().map(|face| face.member).filter(|member| open[*member as usize]).collect();
                if rim.is_empty() {
                    continue;
                }
                let normal = body.state.rotation * outward;
                let mut whole = [0.0; 6];
                for face in covered() {
                    let push = at_face(face.member, &normal);
                    (0..6).for_each(|k| whole[k] += push[k] / rim.len() as f64);
                }
                rim.iter().for_each(|member| add(wall_of(*member), &normal, whole));
            }
        }
        patches
    }

    /// Generalised forces of the liquid on each body at q, with those of hits over a step of `dt` s, and their derivatives by q.
    fn load(
        &self,
        flow: &Flow<'_, D>,
        patches: &[Patch<D>],
        unknowns: &[(usize, usize)],
        q: &DVector<f64>,
        dt: f64,
    ) -> (Vec<[f64; 6]>, DMatrix<f64>) {
        let mut force = vec![[0.0; 6]; self.list.len()];
        let mut slope = DMatrix::zeros(unknowns.len(), unknowns.len());
        let mut change = vec![0.0; unknowns.len()];
        for patch in patches {
            let &Patch { body, wall, ref push, to_face, arm } = patch;
            let mut p = flow.particles.pressure[wall];
            let mut at_face = flow.density * (flow.gravity - flow.accelerations[wall]).dot(&to_face);
            change.fill(0.0);
            if let Some((response, row_of)) = flow.response {
                let row = row_of[wall] as usize;
                for (l, response) in response.iter().enumerate() {
                    let per_unit = response.get(row).copied().unwrap_or(0.0);
                    (p, change[l]) = (p + q[l] * per_unit, per_unit);
                }
            }
            if flow.clip && p < 0.0 {
                p = 0.0;
                change.fill(0.0);
            }
            if flow.response.is_some() {
                for (l, (_, k)) in unknowns.iter().enumerate().filter(|(_, (b, _))| *b == body) {
                    let per_unit = -flow.density * mode(*k, &point(&arm)).dot(&point(&to_face));
                    (at_face, change[l]) = (at_face + q[l] * per_unit, change[l] + per_unit);
                }
            }
            (0..6).for_each(|k| force[body][k] += push[k] * (p + at_face));
            for (i, (_, k)) in unknowns.iter().enumerate().filter(|(_, (b, _))| *b == body) {
                (0..unknowns.len()).for_each(|l| slope[(i, l)] += push[*k] * change[l]);
            }
        }
        if !flow.repulsion.is_empty() {
            self.add_repulsion(flow, &mut force);
        }
        let local: Vec<f64> = force.iter().flatten().copied().chain(slope.iter().copied()).collect();
        let whole = flow.halo.ranks().sums(&local);
        let (forces, slopes) = whole.split_at(6 * self.list.len());
        for (force, sum) in force.iter_mut().flatten().zip(forces) {
            *force = *sum;
        }
        for (body, force) in self.list.iter().zip(&mut force) {
            let hits = body.state.hits.iter().flatten();
            force.iter_mut().zip(hits).for_each(|(force, impulse)| *force += impulse / dt);
        }
        let mut slope = DMatrix::from_column_slice(unknowns.len(), unknowns.len(), slopes);
        if let Some(excess) = self.negative_added_mass(unknowns, &slope) {
            let pull = &excess * q;
            for (&(b, k), pull) in unknowns.iter().zip(pull.iter()) {
                force[b][k] -= pull;
            }
            slope -= excess;
        }
        for (b, force) in force.iter_mut().enumerate() {
            let drag = self.drag_on(b, unknowns, q.as_slice(), dt);
            force.iter_mut().zip(drag).for_each(|(force, drag)| *force += drag);
        }
        for (i, &(b, k)) in unknowns.iter().enumerate() {
            let Some(drag) = self.drags.get(b) else { continue };
            for (l, &(_, m)) in unknowns.iter().enumerate().filter(|(_, (c, _))| *c == b) {
                slope[(i, l)] -= drag.resistance(k, m, dt);
            }
        }
        (force, slope)
    }

    /// Minus the negative part of the added mass, given the derivatives of the forces by q; none if there is none.
    fn negative_added_mass(&self, unknowns: &[(usize, usize)], slope: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        let n = unknowns.len();
        if n == 0 {
            return None;
        }
        let inertia = DMatrix::from_fn(n, n, |i, l| {
            let ((b, k), (c, m)) = (unknowns[i], unknowns[l]);
            if b == c { self.list[b].mass_between(k, m) } else { 0.0 }
        });
        let root = inertia.cholesky()?.unpack();
        let added = -0.5 * (slope + slope.transpose());
        let scaled = root.solve_lower_triangular(&added)?;
        let scaled = root.solve_lower_triangular(&scaled.transpose())?;
        let eigen = scaled.symmetric_eigen();
        if eigen.eigenvalues.iter().all(|share| *share >= 0.0) {
            return None;
        }
        let negative = eigen.eigenvalues.map(|share| (-share).max(0.0));
        let modes = root * eigen.eigenvectors;
        Some(&modes * DMatrix::from_diagonal(&negative) * modes.transpose())
    }

    fn add_repulsion(&self, flow: &Flow<'_, D>, force: &mut [[f64; 6]]) {
        for (body, force) in self.list.iter().zip(force) {
            let centre = restrict::<D>(&body.state.position);
            for member in &body.members[..body.walls] {
                let a = member.particle as usize;
                if flow.halo.holds(a) {
                    let arm = point(&(flow.particles.position[a] - centre));
                    let one = generalised(&point(&flow.repulsion[a]), &arm);
                    (0..6).for_each(|k| force[k] += one[k]);
                }
            }
        }
    }

    /// Solves (1) by Newton's method, with friction as the regimes say.
    fn newton(
        &self,
        flow: &Flow<'_, D>,
        patches: &[Patch<D>],
        unknowns: &[(usize, usize)],
        regimes: &[Regime],
        dt: f64,
    ) -> DVector<f64> {
        let mut q = DVector::zeros(unknowns.len());
        if unknowns.is_empty() {
            return q;
        }
        for _ in 0..STEPS {
            let (force, slope) = self.load(flow, patches, unknowns, &q, dt);
            let mut matrix = -slope;
            let mut rest = DVector::zeros(unknowns.len());
            for (i, &(b, k)) in unknowns.iter().enumerate() {
                let body = &self.list[b];
                rest[i] = body.driving(k, force[b][k], &flow.gravity);
                for (l, &(_, m)) in unknowns.iter().enumerate().filter(|(_, (c, _))| *c == b) {
                    let inertia = body.mass_between(k, m);
                    matrix[(i, l)] += inertia;
                    rest[i] -= inertia * q[l];
                }
                let Some((_, friction)) = body.sliding() else { continue };
                match regimes[b] {
                    Regime::Slides(direction) => {
                        rest[i] -= direction * body.friction_limit(friction, &force[b], &flow.gravity);
                    }
                    Regime::Rests => {
                        matrix.row_mut(i).fill(0.0);
                        matrix[(i, i)] = 1.0;
                        rest[i] = -body.slide().0 / dt - q[i];
                    }
                }
            }
            let Some(step) = matrix.lu().solve(&rest) else { break };
            q += &step;
            if step.amax() <= CLOSE * q.amax() {
                break;
            }
        }
        q
    }
}

impl<const D: usize> Body<D> {
    /// The axis it slides along and its friction, if it slides.
    fn sliding(&self) -> Option<(usize, Friction)> {
        match &self.motion {
            Motion::Free { freedoms, friction: Some(friction) } => Some((*freedoms.first()?, *friction)),
            _ => None,
        }
    }

    /// Its velocity in m/s along the axis it slides along, and the axis.
    fn slide(&self) -> (f64, usize) {
        self.sliding().map_or((0.0, 0), |(k, _)| (self.state.velocity[k], k))
    }

    /// Whether liquid gets under it where it stands on something.
    fn is_seeped_under(&self) -> bool {
        match self.sliding() {
            Some((_, friction)) => friction.uplift,
            None => true,
        }
    }

    /// Force in N or torque in N m along or about axis `k` but for friction, with that of the liquid.
    fn driving(&self, k: usize, liquid: f64, gravity: &Vector<D>) -> f64 {
        let [contact, contact_torque] = &self.state.expected;
        match k {
            0..3 => liquid + self.mass * point(gravity)[k] + self.push[k] + contact[k],
            _ => {
                let spin = self.state.spin;
                liquid + contact_torque[k - 3] - spin.cross(&(self.inertia() * spin))[k - 3]
            }
        }
    }

    fn friction_limit(&self, friction: Friction, liquid: &[f64; 6], gravity: &Vector<D>) -> f64 {
        let down = point(gravity);
        let size = down.norm();
        let lift = if size > 0.0 { -Point::from_column_slice(&liquid[..3]).dot(&down) / size } else { 0.0 };
        friction.limit(self.mass, self.mass * size, lift)
    }

    /// Entry of the mass matrix between two axes.
    fn mass_between(&self, k: usize, m: usize) -> f64 {
        match (k < 3, m < 3) {
            (true, true) if k == m => self.mass,
            (false, false) => self.inertia()[(k - 3, m - 3)],
            _ => 0.0,
        }
    }

    /// Takes the loads of a step and what it does by them.
    fn settle(
        &mut self,
        liquid: &[f64; 6],
        q: impl Iterator<Item = (usize, f64)>,
        regime: Regime,
        gravity: &Vector<D>,
        dt: f64,
    ) {
        self.state.loads.liquid = Point::from_column_slice(&liquid[..3]);
        self.state.loads.torque = Point::from_column_slice(&liquid[3..]);
        self.state.loads.friction = Point::zeros();
        if self.freedoms().is_empty() {
            return;
        }
        (self.state.acceleration, self.state.angular_acceleration) = (Point::zeros(), Point::zeros());
        for (k, q) in q {
            if k >= 3 {
                self.state.angular_acceleration[k - 3] = q;
                continue;
            }
            let driving = self.driving(k, liquid[k], gravity);
            let friction = match (self.sliding(), regime) {
                (None, _) => 0.0,
                (Some((_, friction)), Regime::Slides(direction)) => {
                    -direction * self.friction_limit(friction, liquid, gravity)
                }
                (Some(_), Regime::Rests) => -self.mass * self.state.velocity[k] / dt - driving,
            };
            self.state.loads.friction[k] = friction;
            self.state.acceleration[k] = (driving + friction) / self.mass;
        }
        let before = self.slide();
        self.kick(dt);
        if self.sliding().is_some() && regime == Regime::Rests {
            // Zero as such: it decides on the regime of the next step.
            self.state.velocity[before.1] = 0.0;
            self.state.acceleration[before.1] = -before.0 / dt;
        }
    }
}
