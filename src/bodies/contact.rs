//! Contact of free bodies with walls, boxes and each other, and the friction there: the work of rapier, a library for rigid bodies.
//!
//! This is its only adapter. At the end of a step it is shown all bodies where the step found them, with the velocities that
//! they would have without touching anything, and gives back velocities (and, of bodies that do touch, places)
//! that keep them apart, with Coulomb friction and without rebound. The force that this takes, over the step, is the contact
//! force of [`super::Loads`]. The next step's coupling expects what the last two steps have in common of it, so that a body at rest
//! on the floor does not seem to fall to the liquid around it. The blow of an impact lasts for one step: expected to last, it makes
//! the liquid around a light body push back at nothing, which a jam of boxes amplifies until they fly apart.
//!
//! Nothing is kept from one step to the next: a resumed run meets the same contacts. A body in 2D is one in 3D, a metre
//! wide, that stays in its plane. Fixed and prescribed bodies push others and are not pushed. One that slides along one axis stops at
//! what stands in its way, and is pushed along that axis alone; the floor under it acts by its own law of friction.
//!
//! **Places.** Rapier moves a body with the velocity after contact, a half-step's worth of friction behind the trapezoidal rule: a box
//! coasts too short by v dt / 2. So a body goes along its contacts as the rule has it, and across them as rapier has it, which
//! keeps what lands from sinking in.

use super::{Bodies, Body, Matrix3, State};
use crate::form::{Form, Point};
use crate::geometry::Enclosure;
use nalgebra::{Isometry3, Rotation3, Translation3, UnitQuaternion};
use rapier3d_f64::prelude::{
    CoefficientCombineRule, ColliderBuilder, ColliderHandle, FrictionModel, LockedAxes, MassProperties,
    Matrix, PhysicsWorld, Pose, RigidBodyBuilder, RigidBodyHandle, SharedShape, Vector,
};

/// Boxes that do not move: middle and half of the extent in m.
#[derive(Debug, Clone, Default)]
pub struct Surroundings(Vec<(Point, Point)>);

/// Substeps in which rapier solves a step: starting from nothing, contacts need more than its usual 4.
const SUBSTEPS: usize = 8;
/// Sweeps over all contacts in each.
const SWEEPS: usize = 8;

impl Surroundings {
    /// Walls of a tank, each `thickness` m thick, and boxes.
    pub fn of<const D: usize>(enclosure: &Enclosure<D>, thickness: f64) -> Self {
        let mut boxes: Vec<[Point; 2]> =
            enclosure.boxes.iter().map(|b| [wide(&b.min, -1.0), wide(&b.max, 1.0)]).collect();
        if let Some(tank) = &enclosure.tank {
            let corners = [wide(&tank.inner.min, -1.0), wide(&tank.inner.max, 1.0)];
            for axis in 0..D {
                for end in (0..2).filter(|end| !tank.open[axis][*end]) {
                    let [mut low, mut high] = corners;
                    for d in 0..D {
                        (low[d], high[d]) = (low[d] - thickness, high[d] + thickness);
                    }
                    match end {
                        0 => high[axis] = corners[0][axis],
                        _ => low[axis] = corners[1][axis],
                    }
                    boxes.push([low, high]);
                }
            }
        }
        Self(boxes.into_iter().map(|[low, high]| (0.5 * (low + high), 0.5 * (high - low))).collect())
    }
}

/// A corner in space: in 2D at half a metre from the plane.
fn wide<const D: usize>(corner: &crate::particles::Vector<D>, side: f64) -> Point {
    Point::from_fn(|d, _| if d < D { corner[d] } else { 0.5 * side })
}

/// As much of `now` as `before` had in its direction.
fn in_common(now: &Point, before: &Point) -> Point {
    let square = now.norm_squared();
    if square > 0.0 { (now.dot(before) / square).clamp(0.0, 1.0) * now } else { Point::zeros() }
}

fn vector(p: &Point) -> Vector {
    Vector::new(p.x, p.y, p.z)
}

fn point(v: Vector) -> Point {
    Point::new(v.x, v.y, v.z)
}

fn pose(position: &Point, turned: &Matrix3) -> Pose {
    let turned = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*turned));
    Isometry3::from_parts(Translation3::from(*position), turned).into()
}

impl<const D: usize> Bodies<D> {
    /// Changes the velocities of free bodies at the end of a step of `dt` s so that solids do not enter each other.
    pub(super) fn keep_apart(&mut self, dt: f64) {
        let is_loose = |body: &Body<D>| !body.freedoms().is_empty();
        self.list.iter_mut().for_each(|body| body.touching = None);
        if !self.list.iter().any(is_loose) {
            return;
        }
        let mut world = PhysicsWorld { gravity: Vector::ZERO, ..PhysicsWorld::default() };
        let parameters = &mut world.integration_parameters;
        parameters.dt = dt;
        // Slop and margins are shares of this length.
        parameters.length_unit = self.spacing;
        parameters.num_solver_iterations = SUBSTEPS;
        parameters.num_internal_pgs_iterations = SWEEPS;
        // One force and one twist for all points of a face: taken point by point, forces at the corners are not opposite to the
        // motion, and a box of 4:2:1 slides 4 % too far.
        parameters.friction_model = FrictionModel::Simplified;
        // As stiff a substep as in rapier's own, which are of 1/240 s: at its fixed frequency short ones would be soft.
        let stiffening = 1.0 / 240.0 / (dt / SUBSTEPS as f64);
        parameters.contact_softness.natural_frequency *= stiffening;
        parameters.static_contact_softness.natural_frequency *= stiffening;
        for (middle, half) in &self.surroundings.0 {
            let wall = ColliderBuilder::cuboid(half.x, half.y, half.z).translation(vector(middle));
            // The coefficient is the body's.
            world
                .insert_collider(wall.friction(0.0).friction_combine_rule(CoefficientCombineRule::Max), None);
        }
        let handles: Vec<Option<(RigidBodyHandle, ColliderHandle)>> =
            self.list.iter().map(|body| body.show(&mut world, is_loose(body), dt)).collect();
        world.step();
        for (body, handle) in self.list.iter_mut().zip(handles) {
            let Some((handle, collider)) = handle.filter(|_| is_loose(body)) else { continue };
            let pairs = world.narrow_phase.contact_pairs_with(collider);
            let impulses = pairs.map(|pair| point(pair.total_impulse()));
            let normals: Vec<Point> = impulses.filter_map(|impulse| impulse.try_normalize(0.0)).collect();
            let found = &world.bodies[handle];
            let after = (point(found.linvel()), point(found.angvel()), (*found.position()).into());
            body.take_contact(Some(after).filter(|_| !normals.is_empty()), &normals, dt);
        }
    }
}

impl<const D: usize> Body<D> {
    /// Its velocity and spin without the contact that its step expected.
    fn free_motion(&self, dt: f64) -> [Point; 2] {
        let State { velocity, spin, expected: [contact, torque], .. } = &self.state;
        [velocity - dt / self.mass * self.free_part(contact, 0), spin - dt * self.spin_by(torque)]
    }

    /// Its solid as rapier has it; nothing for a form that it cannot take.
    fn shape(&self) -> Option<SharedShape> {
        let (form, half) = &self.form;
        let half = if D == 2 { Point::new(half.x, half.y, 0.5) } else { *half };
        match form {
            Form::Box => Some(SharedShape::cuboid(half.x, half.y, half.z)),
            Form::Ellipsoid if D == 2 => Some(SharedShape::cylinder(0.5, half.x)),
            Form::Ellipsoid => Some(SharedShape::ball(half.x)),
            Form::Cylinder { axis } => Some(SharedShape::cylinder(half[*axis], half[(axis + 1) % 3])),
            Form::Mesh(_) => {
                let points: Vec<Vector> = self.surface.points.iter().map(vector).collect();
                SharedShape::convex_hull(&points)
            }
        }
    }

    /// Puts it into the world.
    fn show(
        &self,
        world: &mut PhysicsWorld,
        loose: bool,
        dt: f64,
    ) -> Option<(RigidBodyHandle, ColliderHandle)> {
        let (place, turned) = &self.origin;
        let [velocity, spin] =
            if loose { self.free_motion(dt) } else { [self.state.velocity, self.state.spin] };
        let body = match loose {
            true => RigidBodyBuilder::dynamic(),
            false => RigidBodyBuilder::kinematic_velocity_based(),
        };
        let free = self.freedoms();
        let mut locked = LockedAxes::empty();
        let axes = [
            LockedAxes::TRANSLATION_LOCKED_X,
            LockedAxes::TRANSLATION_LOCKED_Y,
            LockedAxes::TRANSLATION_LOCKED_Z,
            LockedAxes::ROTATION_LOCKED_X,
            LockedAxes::ROTATION_LOCKED_Y,
            LockedAxes::ROTATION_LOCKED_Z,
        ];
        axes.into_iter().enumerate().filter(|(k, _)| !free.contains(k)).for_each(|(_, axis)| locked |= axis);
        let mut inertia = self.inertia;
        if D == 2 {
            // About axes that it cannot turn about.
            (inertia[(0, 0)], inertia[(1, 1)]) = (inertia[(2, 2)], inertia[(2, 2)]);
            (inertia[(0, 1)], inertia[(1, 0)]) = (0.0, 0.0);
        }
        let inertia = Matrix::from_cols_array(&[
            inertia[(0, 0)],
            inertia[(1, 0)],
            inertia[(2, 0)],
            inertia[(0, 1)],
            inertia[(1, 1)],
            inertia[(2, 1)],
            inertia[(0, 2)],
            inertia[(1, 2)],
            inertia[(2, 2)],
        ]);
        let mass = MassProperties::with_inertia_matrix(Vector::ZERO, self.mass, inertia);
        let body = body
            .pose(pose(place, turned))
            .linvel(vector(&velocity))
            .angvel(vector(&spin))
            .additional_mass_properties(mass)
            .locked_axes(if loose { locked } else { LockedAxes::empty() })
            .can_sleep(false)
            // Eq. (1) has them.
            .gyroscopic_forces_enabled(false)
            .build();
        // Cylinders stand along y there.
        let mut offset = Matrix3::identity();
        match self.form.0 {
            Form::Ellipsoid if D == 2 => {
                offset = super::rotation(&(Point::x() * std::f64::consts::FRAC_PI_2))
            }
            Form::Cylinder { axis: 0 } => {
                offset = super::rotation(&(Point::z() * std::f64::consts::FRAC_PI_2))
            }
            Form::Cylinder { axis: 2 } => {
                offset = super::rotation(&(Point::x() * std::f64::consts::FRAC_PI_2))
            }
            _ => {}
        }
        let middle = if matches!(self.form.0, Form::Mesh(_)) { Point::zeros() } else { self.middle };
        let collider = ColliderBuilder::new(self.shape()?)
            .density(0.0)
            .friction(self.contact_friction)
            .position(pose(&middle, &offset));
        Some(world.insert(body, collider))
    }

    /// Takes the velocity, spin and place that contact has made of a step of `dt` s, if there was any, across these normals.
    fn take_contact(&mut self, after: Option<(Point, Point, Isometry3<f64>)>, normals: &[Point], dt: f64) {
        let [free, free_spin] = self.free_motion(dt);
        let (mut velocity, mut spin) = (free, free_spin);
        if let Some((v, w, place)) = after {
            (velocity, spin) = (v, w);
            let found = place.translation.vector;
            let mut along = self.origin.0 + 0.5 * dt * (self.start.0 + v) - found;
            normals.iter().for_each(|normal| along -= along.dot(normal) * normal);
            let turned = *place.rotation.to_rotation_matrix().matrix();
            self.touching = Some((found + self.free_part(&along, 0), turned));
        }
        let contact = self.mass / dt * (velocity - free);
        let torque = self.inertia() * (spin - free_spin) / dt;
        let loads = &mut self.state.loads;
        let expects_nothing = self.state.expected == [Point::zeros(); 2];
        self.state.expected =
            [in_common(&contact, &loads.contact), in_common(&torque, &loads.contact_torque)];
        (loads.contact, loads.contact_torque) = (contact, torque);
        if after.is_none() && expects_nothing {
            return;
        }
        let before = self.start;
        self.state.velocity = velocity;
        self.state.acceleration = (velocity - before.0) / dt;
        self.state.angular_acceleration = (spin - before.1) / dt;
        self.state.spin = spin;
        self.state.angular_momentum = self.inertia() * spin;
    }
}
