//! Rigid bodies in the flow: fixed, moved as prescribed, sliding with friction, or free.
//!
//! A body is a set of solid particles, walls and dummies like those of a tank ([`crate::geometry`]), that keep their places relative
//! to its centre of mass x. With its velocity v, spin w, mass m and moment of inertia I in the frame of the scene,
//!
//! m dv/dt = F + f + m g + push,   dL/dt = T,   L = I w,   dx/dt = v,   dR/dt = w x R                (1)
//!
//! F and T are force and torque of the liquid, the surface integral of its pressure over the faces of the wall cells as in
//! [`crate::output::forces`], the viscous force of liquid that sticks to it ([`drag`]) and the impulse of particles that hit it ([`crate::terms::collision`]), f friction ([`friction`]) and contact. Any component of v and w may be locked: it stays zero. A point
//! at s from the centre moves with, and is accelerated by,
//!
//! u = v + w x s,   a = dv/dt + dw/dt x s + w x (w x s)                                             (2)
//!
//! which is what liquid at the body's walls feels: u in the divergence and in viscous terms, a in the pressure of
//! dummies ([`crate::boundary`], Eq. 1). Module [`coupling`] finds v at the end of a step and the pressure together.
//!
//! **In time** positions follow the trapezoidal rule, as those of liquid do: half a step with the velocity at its beginning
//! ([`Bodies::depart`]), half a step with that at its end ([`Bodies::arrive`]). Rotations do the same with exp(dt/2 w), the
//! second half implicit in w = I(R)^-1 L: angular momentum is kept to round-off, energy to second order.
//!
//! A box under a constant force P on a floor with Coulomb friction mu m g is the exact solution for (1): from rest it moves
//! (P / m - mu g) t^2 / 2, and coasts from v to rest within v / (mu g) over v^2 / (2 mu g). Both are reproduced to
//! round-off but for the step in which it stops. A free top keeps L and its energy.
//!
//! In 2D everything is in the plane z = 0 of the same formulas, per metre of width: bodies move along x and y and turn about z.

pub mod contact;
pub mod coupling;
pub mod drag;
pub mod friction;

use crate::form::{Form, Point, Surface, point};
use crate::geometry::{Aabb, BodyCells};
use crate::neighbors::Neighbors;
use crate::parallel::Ranks;
use crate::particles::{Particles, Vector};
use contact::Surroundings;
use drag::Drag;
use friction::Friction;
use rayon::prelude::*;
use std::collections::HashSet;

/// A 3 x 3 matrix.
pub type Matrix3 = nalgebra::Matrix3<f64>;

/// Number of a body for solids that belong to none.
pub const NO_BODY: u32 = u32::MAX;

/// All bodies of a scene.
#[derive(Debug, Clone, Default)]
pub struct Bodies<const D: usize> {
    /// Each of them.
    pub list: Vec<Body<D>>,
    /// Time in s up to which they have been moved.
    pub time: f64,
    /// Whether velocities are found together with the pressure, or from the pressure at the last ones.
    pub strong: bool,
    spacing: f64,
    surroundings: Surroundings,
    /// Viscous force of the present step on each, where liquid sticks to them.
    pub drags: Vec<Drag>,
    /// Body of each solid particle, or [`NO_BODY`].
    owner: Vec<u32>,
    /// For each dummy: the wall particle right before it.
    ties: Vec<u32>,
}

/// What a body may do.
#[derive(Debug, Clone, PartialEq)]
pub enum Motion {
    /// Nothing.
    Fixed,
    /// Times in s, ascending, with velocities in m/s and spins in rad/s there: linear between, constant beyond the ends.
    Prescribed(Vec<(f64, [f64; 6])>),
    /// It moves by the forces on it, along and about the axes among these: 0 to 2 along, 3 to 5 about x, y and z.
    Free {
        /// The free ones, ascending.
        freedoms: Vec<usize>,
        /// Friction on the floor it slides on; only where it is free along one axis alone.
        friction: Option<Friction>,
    },
}

/// Where a body is and how it moves; all that changes about it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct State {
    /// Centre of mass in m.
    pub position: Point,
    /// Rotation since the start.
    pub rotation: Matrix3,
    /// Velocity of the centre in m/s.
    pub velocity: Point,
    /// Angular velocity in rad/s.
    pub spin: Point,
    /// Angular momentum in kg m2/s.
    pub angular_momentum: Point,
    /// Acceleration of the centre over the last step in m/s2.
    pub acceleration: Point,
    /// Change of the angular velocity over the last step in rad/s2.
    pub angular_acceleration: Point,
    /// What acted in the last step.
    pub loads: Loads,
    /// Impulse in N s of particles that hit it at the end of the last step, and its moment in N m s about the centre.
    pub hits: [Point; 2],
    /// Force and torque of contact that the next step expects: what the last two have in common.
    pub expected: [Point; 2],
}

/// Forces in N and torques about the centre in N m; in 2D per metre of width.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Loads {
    /// Force of the liquid.
    pub liquid: Point,
    /// Torque of the liquid.
    pub torque: Point,
    /// What of the force of the liquid is viscous.
    pub viscous: Point,
    /// Friction on the floor that a sliding body moves over.
    pub friction: Point,
    /// Force of other solids in contact, their friction included.
    pub contact: Point,
    /// Torque of other solids in contact.
    pub contact_torque: Point,
}

/// One rigid body.
#[derive(Debug, Clone)]
pub struct Body<const D: usize> {
    /// Its name.
    pub name: String,
    /// Mass in kg.
    pub mass: f64,
    /// What it may do.
    pub motion: Motion,
    /// A constant force in N that pushes it, at its centre.
    pub push: Point,
    /// Where it is.
    pub state: State,
    /// Its surface at the start, relative to its centre.
    pub surface: Surface,
    /// Form, and half the extent in m: what contacts are found from.
    pub form: (Form, Point),
    /// Middle of the extent relative to the centre at the start, in m.
    pub middle: Point,
    /// Coefficient of friction with what it touches.
    pub contact_friction: f64,
    /// Moment of inertia about the centre at the start, in kg m2.
    inertia: Matrix3,
    members: Vec<Member<D>>,
    walls: usize,
    faces: Vec<Face>,
    /// Cells behind the walls, counted from the centre of the first cell of all.
    inner: HashSet<[i64; D]>,
    /// Centre of that first cell relative to the body's at the start, in m.
    first_cell: Point,
    /// Radius in m about the centre that holds all cells.
    radius: f64,
    /// Place and rotation at the beginning and in the middle of a step.
    origin: (Point, Matrix3),
    half: (Point, Matrix3),
    /// Velocity and spin at the beginning of a step.
    start: (Point, Point),
    /// Where contact takes it in the present step, if it touches anything.
    touching: Option<(Point, Matrix3)>,
}

/// A solid particle of a body: its number, its place relative to the centre, and its normal, both at the start.
#[derive(Debug, Clone, Copy)]
struct Member<const D: usize> {
    particle: u32,
    arm: Vector<D>,
    normal: Vector<D>,
}

/// An outer side of a wall cell.
#[derive(Debug, Clone, Copy)]
struct Face {
    /// Its member.
    member: u32,
    /// Outward normal at the start.
    normal: Point,
    /// Whether liquid can reach it: not where another solid fills the next cell.
    open: bool,
}

/// First `D` components of a point.
pub fn restrict<const D: usize>(p: &Point) -> Vector<D> {
    Vector::from_fn(|d, _| p[d])
}

/// Rotation by the vector `by` in rad (Rodrigues).
fn rotation(by: &Point) -> Matrix3 {
    nalgebra::Rotation3::new(*by).into_inner()
}

/// Times the half diagonal of a face, rounded up, in spacings: a solid particle this near the middle of the cell before a face
/// leaves no room for liquid there, whatever the offset of the two lattices.
const FILLED: f64 = 0.75;

/// What a body is built from.
#[derive(Debug, Clone)]
pub struct Plan<const D: usize> {
    /// Its name.
    pub name: String,
    /// Mass in kg; else its density in kg/m3, times the volume of its cells.
    pub mass: std::result::Result<f64, f64>,
    /// What it may do.
    pub motion: Motion,
    /// Force in N.
    pub push: Vector<D>,
    /// Velocity at the start in m/s.
    pub velocity: Vector<D>,
    /// Spin at the start in rad/s.
    pub spin: Point,
    /// Form.
    pub form: Form,
    /// Coefficient of friction with what it touches.
    pub contact_friction: f64,
}

impl<const D: usize> Bodies<D> {
    /// Bodies at the start, `cells[k]` being the particles of `plans[k]`.
    pub fn new(
        plans: Vec<Plan<D>>,
        cells: Vec<BodyCells<D>>,
        particles: &Particles<D>,
        spacing: f64,
        strong: bool,
    ) -> Self {
        let mut owner = vec![];
        if !plans.is_empty() {
            owner.resize(particles.solids(), NO_BODY);
        }
        for (k, body) in cells.iter().enumerate() {
            body.members.iter().for_each(|&a| owner[a as usize] = k as u32);
        }
        let bodies = plans.into_iter().zip(cells);
        let list = bodies.map(|(plan, cells)| Body::new(plan, &cells, particles, spacing)).collect();
        let ties = particles.tie.clone();
        Self {
            list,
            time: 0.0,
            strong,
            spacing,
            surroundings: Surroundings::default(),
            drags: vec![],
            owner,
            ties,
        }
    }

    /// Lets bodies touch walls and boxes.
    pub fn set_surroundings(&mut self, surroundings: Surroundings) {
        self.surroundings = surroundings;
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// Whether any of them can move.
    pub fn can_move(&self) -> bool {
        self.list.iter().any(|body| body.motion != Motion::Fixed)
    }

    /// Centre and rotation of each.
    pub fn poses(&self) -> impl Iterator<Item = (Point, Matrix3)> + '_ {
        self.list.iter().map(|body| (body.state.position, body.state.rotation))
    }

    /// Body of solid particle `a`, if it belongs to one.
    #[inline]
    pub fn of(&self, a: usize) -> Option<usize> {
        let k = *self.owner.get(a)?;
        (k != NO_BODY).then_some(k as usize)
    }

    /// Body of solid particle `a`, if it belongs to one that can move.
    #[inline]
    pub fn movable(&self, a: usize) -> Option<usize> {
        self.of(a).filter(|&k| self.list[k].motion != Motion::Fixed)
    }

    /// Body of solid particle `a`, if it moves by the forces on it.
    #[inline]
    pub fn free(&self, a: usize) -> Option<usize> {
        self.of(a).filter(|&k| matches!(self.list[k].motion, Motion::Free { .. }))
    }

    /// Adds up the hits that all ranks have seen.
    pub fn sum_hits(&mut self, ranks: &Ranks) {
        if self.list.iter().any(|body| !body.freedoms().is_empty()) {
            let numbers = |body: &Body<D>| body.state.hits.iter().flatten().copied().collect::<Vec<f64>>();
            let sums = ranks.sums(&self.list.iter().flat_map(numbers).collect::<Vec<f64>>());
            let hits = self.list.iter_mut().flat_map(|body| body.state.hits.iter_mut().flatten());
            hits.zip(sums).for_each(|(hit, sum)| *hit = sum);
        }
    }

    /// First half of a step of `dt` s, with the present velocities; then on by `ahead` s for a look at where that leads.
    pub fn depart(&mut self, dt: f64, ahead: f64) {
        for body in &mut self.list {
            let State { position, rotation: turned, velocity, spin, .. } = body.state;
            body.origin = (position, turned);
            body.start = (velocity, spin);
            body.half = (position + 0.5 * dt * velocity, rotation(&(0.5 * dt * spin)) * turned);
            body.state.position = body.half.0 + ahead * velocity;
            body.state.rotation = rotation(&(ahead * spin)) * body.half.1;
        }
    }

    /// Back to where the last [`depart`](Self::depart) began.
    pub fn turn_back(&mut self) {
        for body in &mut self.list {
            (body.state.position, body.state.rotation) = body.origin;
        }
    }

    /// Second half of a step of `dt` s, with the new velocities.
    pub fn arrive(&mut self, dt: f64) {
        for body in &mut self.list {
            if let Some((position, turned)) = body.touching {
                (body.state.position, body.state.rotation) = (position, turned);
                continue;
            }
            let (position, turned) = body.half;
            body.state.position = position + 0.5 * dt * body.state.velocity;
            let before = body.state.spin;
            body.turn(turned, 0.5 * dt);
            body.state.angular_acceleration += (body.state.spin - before) / dt;
        }
        self.time += dt;
    }

    /// Puts particles where their bodies are; `velocity` too, or only places and normals.
    pub fn place(&self, particles: &mut Particles<D>, velocity: bool) {
        for body in self.list.iter().filter(|body| body.motion != Motion::Fixed) {
            let State { position, rotation, .. } = &body.state;
            let turned = *rotation != Matrix3::identity();
            let centre = restrict::<D>(position);
            for member in &body.members {
                let (a, arm) = (member.particle as usize, body.turned(&member.arm));
                particles.position[a] = centre + arm;
                if velocity {
                    particles.velocity[a] = body.velocity_at(&arm);
                }
                if turned {
                    particles.normal[a] = body.turned(&member.normal);
                }
            }
        }
    }

    /// Acceleration in m/s2 of every solid particle, Eq. (2); with `known` that part of it which the pressure does not change.
    pub fn accelerations(&self, particles: &Particles<D>, known: bool, accelerations: &mut Vec<Vector<D>>) {
        accelerations.clear();
        accelerations.resize(particles.solids(), Vector::zeros());
        for body in self.list.iter().filter(|body| body.motion != Motion::Fixed) {
            let given = !known || matches!(body.motion, Motion::Prescribed(_));
            for member in &body.members {
                let arm = body.turned(&member.arm);
                accelerations[member.particle as usize] = body.acceleration_at(&arm, given);
            }
        }
    }

    /// Looks which outer sides other solids cover; `solids` has the rows of body walls among solids.
    pub fn find_open_faces(&mut self, particles: &Particles<D>, solids: &Neighbors<D>) {
        let near = (FILLED * self.spacing).powi(2);
        for (k, body) in self.list.iter_mut().enumerate() {
            let rotation = body.state.rotation;
            for face in &mut body.faces {
                let a = body.members[face.member as usize].particle as usize;
                let before = particles.position[a] + self.spacing * restrict::<D>(&(rotation * face.normal));
                let row = solids.row(a).index.iter().map(|&b| b as usize);
                let fills = |b: usize| {
                    self.owner[b] != k as u32 && (particles.position[b] - before).norm_squared() < near
                };
                face.open = !row.into_iter().any(fills);
            }
        }
    }

    /// Finds the walls that other solids cover, none of whose neighbouring cells is open, and ties the dummies behind each to the
    /// nearest wall of its own solid that is not covered; `solids` has the rows of those that `changed`, the only ones looked at.
    pub fn find_covered(
        &self,
        particles: &mut Particles<D>,
        solids: &Neighbors<D>,
        changed: &[bool],
        covered: &mut Vec<bool>,
    ) {
        let near = (FILLED * self.spacing).powi(2);
        let position = &particles.position;
        let row = |a: usize| solids.row(a).index.iter().map(|&b| b as usize);
        let digit = |site: usize, d: usize| (site / 3_usize.pow(d as u32) % 3) as f64 - 1.0;
        let sites: Vec<Point> = (0..3_usize.pow(D as u32))
            .map(|site| point(&Vector::<D>::from_fn(|d, _| digit(site, d))))
            .filter(|site| *site != Point::zeros())
            .collect();
        let is_covered = |a: usize| {
            let rotation = self.movable(a).map_or(Matrix3::identity(), |k| self.list[k].state.rotation);
            sites.iter().all(|site| {
                let cell = position[a] + self.spacing * restrict::<D>(&(rotation * site));
                row(a).any(|b| (position[b] - cell).norm_squared() < near)
            })
        };
        covered.resize(changed.len(), false);
        let looked_at = covered.par_iter_mut().enumerate().filter(|(a, _)| changed[*a]);
        looked_at.for_each(|(a, covered)| *covered = is_covered(a));
        let bearer = |a: usize| {
            let away = |b: &usize| (position[*b] - position[a]).norm_squared();
            let own = |b: &usize| *b < changed.len() && self.owner[*b] == self.owner[a] && !covered[*b];
            row(a).filter(own).min_by(|b, c| away(b).total_cmp(&away(c))).unwrap_or(a)
        };
        let ties = self.ties.iter().map(|&wall| wall as usize).enumerate();
        let moved = ties.filter(|(_, wall)| changed[*wall]);
        let tie = moved.map(|(k, wall)| (k, if covered[wall] { bearer(wall) } else { wall } as u32));
        tie.for_each(|(k, wall)| particles.tie[k] = wall);
    }

    /// Whether solid particle `a` or what lies within `reach` m of it belongs to a body: a wall whose surroundings change.
    pub fn is_near(&self, particles: &Particles<D>, a: usize, reach: f64) -> bool {
        let r = point(&particles.position[a]);
        let near = |body: &Body<D>| (r - body.state.position).norm_squared() < (body.radius + reach).powi(2);
        self.owner[a] != NO_BODY || self.list.iter().any(near)
    }

    /// Is a point inside a body, behind its first layer of cells?
    pub fn contain(&self, r: &Vector<D>) -> bool {
        self.list.iter().any(|body| body.contains(&point(r), self.spacing))
    }

    /// All that changes about bodies, as numbers.
    pub fn state(&self) -> Vec<f64> {
        let of = |body: &Body<D>| {
            let s = body.state;
            let vectors = [
                s.position,
                s.velocity,
                s.spin,
                s.angular_momentum,
                s.acceleration,
                s.angular_acceleration,
                s.loads.liquid,
                s.loads.torque,
                s.loads.friction,
                s.loads.contact,
                s.loads.contact_torque,
                s.hits[0],
                s.hits[1],
                s.expected[0],
                s.expected[1],
                s.loads.viscous,
            ];
            let numbers = s.rotation.iter().copied().collect::<Vec<f64>>().into_iter();
            numbers.chain(vectors.into_iter().flat_map(|v| [v.x, v.y, v.z])).collect::<Vec<_>>()
        };
        std::iter::once(self.time).chain(self.list.iter().flat_map(of)).collect()
    }

    /// Takes back a [`state`](Self::state); `None` if it is not one.
    pub fn set_state(&mut self, numbers: &[f64]) -> Option<()> {
        const WIDTH: usize = 9 + 16 * 3;
        let (time, rest) = numbers.split_first()?;
        if rest.len() != WIDTH * self.list.len() {
            return None;
        }
        self.time = *time;
        for (body, words) in self.list.iter_mut().zip(rest.chunks_exact(WIDTH)) {
            let vector = |k: usize| Point::from_column_slice(&words[9 + 3 * k..12 + 3 * k]);
            body.state = State {
                rotation: Matrix3::from_column_slice(&words[..9]),
                position: vector(0),
                velocity: vector(1),
                spin: vector(2),
                angular_momentum: vector(3),
                acceleration: vector(4),
                angular_acceleration: vector(5),
                loads: Loads {
                    liquid: vector(6),
                    torque: vector(7),
                    friction: vector(8),
                    contact: vector(9),
                    contact_torque: vector(10),
                    viscous: vector(15),
                },
                hits: [vector(11), vector(12)],
                expected: [vector(13), vector(14)],
            };
        }
        Some(())
    }
}

impl<const D: usize> Body<D> {
    fn new(plan: Plan<D>, cells: &BodyCells<D>, particles: &Particles<D>, spacing: f64) -> Self {
        let count = cells.cells.len() as f64;
        let volume = spacing.powi(D as i32);
        let mass = plan.mass.unwrap_or_else(|density| density * count * volume);
        let centre: Point = cells.cells.iter().map(point).sum::<Point>() / count;
        let mut inertia = Matrix3::zeros();
        for r in &cells.cells {
            let s = point(r) - centre;
            inertia += Matrix3::identity() * s.norm_squared() - s * s.transpose();
        }
        // A cell's own: dx^2 / 6 about each axis, in 2D about z alone.
        let own =
            if D == 2 { Matrix3::from_diagonal(&Point::new(0.0, 0.0, 1.0)) } else { Matrix3::identity() };
        inertia = mass * (inertia / count + own * (spacing * spacing / 6.0));
        let member = |&particle: &u32| {
            let a = particle as usize;
            Member { particle, arm: particles.position[a] - restrict(&centre), normal: particles.normal[a] }
        };
        let face = |&(member, axis, end): &(u32, usize, f64)| {
            let mut normal = Point::zeros();
            normal[axis] = end;
            Face { member, normal, open: true }
        };
        let radius = cells.cells.iter().map(|r| (point(r) - centre).norm()).fold(0.0, f64::max) + spacing;
        let first = cells.cells.first().map_or(centre, point);
        let number = |r: &Vector<D>| -> [i64; D] {
            std::array::from_fn(|d| ((r[d] - first[d]) / spacing).round() as i64)
        };
        let walls: HashSet<[i64; D]> =
            cells.members[..cells.walls].iter().map(|&a| number(&particles.position[a as usize])).collect();
        let extent = cells.extent.unwrap_or(Aabb { min: Vector::zeros(), max: Vector::zeros() });
        let mut surface = plan.form.surface(&extent);
        surface.points.iter_mut().for_each(|p| *p -= centre);
        let spin = if matches!(plan.motion, Motion::Fixed) { Point::zeros() } else { plan.spin };
        let mut body = Self {
            name: plan.name,
            mass,
            push: point(&plan.push),
            surface,
            middle: point(&extent.centre()) - centre,
            form: (plan.form, point(&(0.5 * (extent.max - extent.min)))),
            contact_friction: plan.contact_friction,
            state: State {
                position: centre,
                rotation: Matrix3::identity(),
                velocity: point(&plan.velocity),
                spin,
                angular_momentum: inertia * spin,
                acceleration: Point::zeros(),
                angular_acceleration: Point::zeros(),
                loads: Loads::default(),
                hits: [Point::zeros(); 2],
                expected: [Point::zeros(); 2],
            },
            motion: plan.motion,
            inertia,
            members: cells.members.iter().map(member).collect(),
            walls: cells.walls,
            faces: cells.faces.iter().map(face).collect(),
            inner: cells.cells.iter().map(number).filter(|cell| !walls.contains(cell)).collect(),
            first_cell: first - centre,
            radius,
            origin: (centre, Matrix3::identity()),
            half: (centre, Matrix3::identity()),
            start: (Point::zeros(), Point::zeros()),
            touching: None,
        };
        if let Motion::Prescribed(rows) = &body.motion {
            let [velocity, spin] = prescribed(rows, 0.0);
            (body.state.velocity, body.state.spin) = (velocity, spin);
        }
        body
    }

    /// The axes along and about which it is free.
    pub fn freedoms(&self) -> &[usize] {
        match &self.motion {
            Motion::Free { freedoms, .. } => freedoms,
            _ => &[],
        }
    }

    /// Whether all its rotations are free, about z in 2D.
    fn turns_freely(&self) -> bool {
        self.freedoms().iter().filter(|k| **k >= 3).count() == if D == 2 { 1 } else { 3 }
    }

    /// Moment of inertia in the frame of the scene, in kg m2.
    pub fn inertia(&self) -> Matrix3 {
        let turned = self.state.rotation;
        turned * self.inertia * turned.transpose()
    }

    /// Rotational and translational energy in J.
    pub fn kinetic_energy(&self) -> f64 {
        let State { velocity, spin, .. } = self.state;
        0.5 * self.mass * velocity.norm_squared() + 0.5 * spin.dot(&(self.inertia() * spin))
    }

    /// Turns on from `turned` over `time` s with the spin at the end of it, which its angular momentum tells.
    fn turn(&mut self, turned: Matrix3, time: f64) {
        if D == 2 || !self.turns_freely() {
            self.state.rotation = rotation(&(time * self.state.spin)) * turned;
            return;
        }
        // The spin changes by the turn within a step: a contraction by that angle each time.
        for _ in 0..SPIN_ITERATIONS {
            self.state.rotation = rotation(&(time * self.state.spin)) * turned;
            let spin = inverse(&self.inertia()) * self.state.angular_momentum;
            let change = (spin - self.state.spin).norm();
            self.state.spin = spin;
            if change <= f64::EPSILON * spin.norm() {
                break;
            }
        }
    }

    /// A vector of the body, given as at the start, as it lies now.
    pub fn turned(&self, v: &Vector<D>) -> Vector<D> {
        match self.state.rotation == Matrix3::identity() {
            true => *v,
            false => restrict(&(self.state.rotation * point(v))),
        }
    }

    /// Velocity in m/s at `arm` m from the centre.
    pub fn velocity_at(&self, arm: &Vector<D>) -> Vector<D> {
        restrict(&(self.state.velocity + self.state.spin.cross(&point(arm))))
    }

    /// A vector's components along (`first` = 0) or about (3) the axes that it is free along or about.
    fn free_part(&self, v: &Point, first: usize) -> Point {
        Point::from_fn(|k, _| if self.freedoms().contains(&(first + k)) { v[k] } else { 0.0 })
    }

    /// Change of its spin by a torque's impulse in N m s, about the axes that it is free about.
    fn spin_by(&self, impulse: &Point) -> Point {
        let is_free = |k: usize| self.freedoms().contains(&(3 + k));
        let inertia = self.inertia();
        let among_free = Matrix3::from_fn(|i, j| match is_free(i) && is_free(j) {
            true => inertia[(i, j)],
            false => f64::from(u8::from(i == j)),
        });
        self.free_part(&(inverse(&among_free) * self.free_part(impulse, 3)), 3)
    }

    /// Velocity in m/s of its point at `r` m once the hits have acted.
    pub fn velocity_after_hits(&self, r: &Vector<D>) -> Vector<D> {
        let State { position, velocity, spin, hits, .. } = &self.state;
        let moved = velocity + self.free_part(&hits[0], 0) / self.mass;
        restrict(&(moved + (spin + self.spin_by(&hits[1])).cross(&(point(r) - position))))
    }

    /// Velocity in m/s along the unit vector `n` that a unit of impulse along it gives to the point at `r` m.
    pub fn mobility(&self, r: &Vector<D>, n: &Vector<D>) -> f64 {
        let (arm, n) = (point(r) - self.state.position, point(n));
        let turned = self.spin_by(&arm.cross(&n)).cross(&arm);
        n.dot(&(self.free_part(&n, 0) / self.mass + turned))
    }

    /// Takes an impulse in N s at the point at `r` m; it acts in the next step.
    pub fn hit(&mut self, r: &Vector<D>, impulse: &Vector<D>) {
        let (arm, impulse) = (point(r) - self.state.position, point(impulse));
        self.state.hits[0] += impulse;
        self.state.hits[1] += arm.cross(&impulse);
    }

    /// Acceleration in m/s2 at `arm` m from the centre; without those of centre and spin if not `given`.
    fn acceleration_at(&self, arm: &Vector<D>, given: bool) -> Vector<D> {
        let (spin, s) = (self.state.spin, point(arm));
        let mut a = spin.cross(&spin.cross(&s));
        if given {
            a += self.state.acceleration + self.state.angular_acceleration.cross(&s);
        }
        restrict(&a)
    }

    fn contains(&self, r: &Point, spacing: f64) -> bool {
        let away = r - self.state.position;
        if away.norm_squared() > self.radius * self.radius {
            return false;
        }
        let at = self.state.rotation.tr_mul(&away) - self.first_cell;
        self.inner.contains(&std::array::from_fn(|d| (at[d] / spacing).round() as i64))
    }

    /// Corners of its surface in m, where it is now.
    pub fn corners(&self) -> impl Iterator<Item = Point> + '_ {
        let State { position, rotation, .. } = &self.state;
        self.surface.points.iter().map(move |p| position + rotation * p)
    }

    /// Changes velocity and spin by the accelerations of a step of `dt` s; torques in `loads` turn it.
    fn kick(&mut self, dt: f64) {
        let spin = self.state.spin;
        self.state.velocity += dt * self.state.acceleration;
        if self.turns_freely() {
            let (torque, contact_torque) = (self.state.loads.torque, self.state.expected[1]);
            let free = |k: usize| if D == 3 || k == 2 { 1.0 } else { 0.0 };
            let torque = (torque + contact_torque).component_mul(&Point::from_fn(|k, _| free(k)));
            self.state.angular_momentum += dt * torque;
            self.state.spin = inverse(&self.inertia()) * self.state.angular_momentum;
        } else {
            self.state.spin += dt * self.state.angular_acceleration;
            self.state.angular_momentum = self.inertia() * self.state.spin;
        }
        self.state.angular_acceleration = (self.state.spin - spin) / dt;
    }
}

/// Most evaluations of a spin by itself: a turn of 0.1 rad a step gains a digit with each.
const SPIN_ITERATIONS: usize = 20;

/// Inverse of a moment of inertia; one that is singular, as in 2D about x and y, has it where it can.
fn inverse(inertia: &Matrix3) -> Matrix3 {
    inertia.try_inverse().unwrap_or_else(|| {
        Matrix3::from_diagonal(&inertia.diagonal().map(|i| if i > 0.0 { 1.0 / i } else { 0.0 }))
    })
}

/// Velocity and spin at `time` s of a motion given by rows.
fn prescribed(rows: &[(f64, [f64; 6])], time: f64) -> [Point; 2] {
    let after = rows.partition_point(|(t, _)| *t <= time);
    let at = match (after.checked_sub(1).map(|k| rows[k]), rows.get(after)) {
        (Some((t0, v0)), Some((t1, v1))) => {
            let share = (time - t0) / (t1 - t0);
            std::array::from_fn(|k| v0[k] + share * (v1[k] - v0[k]))
        }
        (Some((_, v)), None) | (None, Some(&(_, v))) => v,
        (None, None) => [0.0; 6],
    };
    [Point::from_column_slice(&at[..3]), Point::from_column_slice(&at[3..])]
}
