//! From a proven case file to particles and scheme parameters of one dimension.

use super::{
    BlockForm, BodyMotion, CaseFile, Coupling, DiffusionKind, FluidBlock, Probe, SchemeKind, SchemeParams,
    Side, SourceKind, axes,
};
use crate::bodies::contact::Surroundings;
use crate::bodies::friction::Friction;
use crate::bodies::{Bodies, Motion, Plan};
use crate::boundary::repulsion::Repulsion;
use crate::exact;
use crate::form::{Form, Point};
use crate::geometry::{Aabb, BlockShape, BodyShape, Enclosure, Lattice, Shapes, SolidSide, TankShape};
use crate::halo::PeriodicBox;
use crate::parallel::Ranks;
use crate::particles::{Particles, Vector};
use crate::ppe::source::Source;
use crate::scheme::{Params, isph, wcsph};
use crate::terms::collision::Collisions;
use crate::terms::surface::Criterion;

/// A scene ready to run.
#[derive(Debug, Clone)]
pub struct Scene<const D: usize> {
    /// All particles at their start.
    pub particles: Particles<D>,
    /// What all schemes share.
    pub params: Params<D>,
    /// What liquid must not enter.
    pub enclosure: Enclosure<D>,
    /// The lattice they lie on.
    pub lattice: Lattice<D>,
    /// One sentence for each length that did not fit the lattice, and for each gauge that moved along.
    pub snapped: Vec<String>,
}

/// Layers of solid particles: 3 in 2D, 4 in 3D (Jian et al. 2016), more where the kernel reaches further.
fn layers(dimension: usize, support_in_spacings: f64) -> usize {
    (dimension + 1).max(1 + support_in_spacings.floor() as usize)
}

/// Builds the scene of a case whose dimension is `D`.
pub fn scene<const D: usize>(case: &CaseFile) -> Scene<D> {
    let lattice = Lattice::new(&shapes(case), case.spacing);
    let tank = lattice.snapped_tank();
    let mut params = params(case, tank.as_ref());
    let exact = exact::of_case(case, &params);
    let layers = layers(D, params.support() / case.spacing);
    let velocity = |block: usize, r: &Vector<D>| match &exact {
        Some(exact) => exact.initial_velocity(r),
        None => block_velocity(&case.fluid.blocks[block], r),
    };
    let mut particles = lattice.particles(layers, velocity);
    if !case.bodies.is_empty() {
        let strong = case.scheme.coupling == Coupling::Strong;
        let cells = lattice.bodies(layers);
        params.bodies = Bodies::new(body_plans(case), cells, &particles, case.spacing, strong);
        // Thicker than anything gets into them in a step.
        params.bodies.set_surroundings(Surroundings::of(&lattice.enclosure(), 1.0));
        params.bodies.place(&mut particles, true);
    }
    jitter(&mut particles, case.scheme.jitter * case.spacing, case.seed);
    // A scheme that solves for the pressure finds it.
    if let Some(exact) = exact.filter(|_| !case.scheme.kind.solves()) {
        for a in particles.fluid() {
            particles.pressure[a] = exact.initial_pressure(&particles.position[a]);
        }
    }
    let moved = case.probes.iter().flat_map(|probe| moved_gauge(case, &lattice, probe));
    let snapped = lattice.snapped.iter().cloned().chain(moved).collect();
    Scene { particles, params, enclosure: lattice.enclosure(), lattice, snapped }
}

/// Sentences on how a gauge follows the face it is on.
fn moved_gauge<const D: usize>(case: &CaseFile, lattice: &Lattice<D>, probe: &Probe) -> Vec<String> {
    let Some(at) = probe.position().map(vector) else { return vec![] };
    let (to, solid) = match ridden(case, probe) {
        Some(body) => (lattice.follow_body(body, &at), case.bodies[body].name.clone()),
        None => {
            let (to, Some(side)) = lattice.follow(&at) else { return vec![] };
            let solid = side.solid.map_or("the tank", |k| &case.boxes[k].name);
            (to, format!("the {} side of {solid}", side_name::<D>(side)))
        }
    };
    let axes = axes(D).enumerate().filter(|&(d, _)| (to[d] - at[d]).abs() > 1e-6 * case.spacing);
    let name = probe.name();
    axes.map(|(d, axis)| format!("gauge {name} {axis} = {} m follows {solid} to {:.6} m", at[d], to[d]))
        .collect()
}

/// Number of the body that a gauge rides on.
fn ridden(case: &CaseFile, probe: &Probe) -> Option<usize> {
    let name = probe.rides_on()?;
    case.bodies.iter().position(|body| body.name == name)
}

fn side_name<const D: usize>(side: SolidSide) -> &'static str {
    let sides = [Side::Left, Side::Right, Side::Bottom, Side::Top, Side::Front, Side::Back];
    let is_it = |name: &Side| D > 2 || !matches!(name, Side::Front | Side::Back);
    let found = sides.into_iter().filter(is_it).find(|name| side_of::<D>(*name) == (side.axis, side.end));
    found.map_or("", Side::name)
}

fn params<const D: usize>(case: &CaseFile, tank: Option<&TankShape<D>>) -> Params<D> {
    let period =
        |tank: &TankShape<D>, d: usize| tank.periodic[d].then(|| tank.inner.max[d] - tank.inner.min[d]);
    Params {
        spacing: case.spacing,
        gravity: vector(&case.gravity),
        density: case.fluid.density,
        kinematic_viscosity: case.fluid.kinematic_viscosity,
        slip: case.tank.as_ref().map(|tank| tank.slip).unwrap_or_default(),
        kernel: case.scheme.kernel,
        smoothing_ratio: case.scheme.smoothing_ratio,
        periodic: tank.filter(|tank| tank.periodic.contains(&true)).map(|tank| PeriodicBox {
            min: tank.inner.min,
            period: std::array::from_fn(|d| period(tank, d)),
        }),
        ranks: Ranks::default(),
        bodies: Bodies::default(),
    }
}

/// The ISPH method of a case.
pub fn isph<const D: usize>(case: &CaseFile, scene: &Scene<D>) -> isph::Method {
    let SchemeParams { collision_distance, collision_restitution, .. } = case.scheme;
    // At the start: of waves on its surface, or of liquid that is fast already. Where nothing moves or falls none is too long.
    let longest_step = match case.time.step {
        Some(_) => 0.0,
        None => {
            let of_waves = isph::longest_step(&scene.params);
            let longest = of_waves.min(case.time.courant * case.spacing / scene.particles.fastest_liquid());
            if longest.is_finite() { longest } else { 0.0 }
        }
    };
    isph::Method {
        laplacian: case.scheme.laplacian,
        source: match case.scheme.source {
            SourceKind::Blended => {
                Source::Blended { gamma: case.scheme.density_relaxation, tau: 0.1 * longest_step }
            }
            SourceKind::DensityInvariant => Source::DensityInvariant { tau: longest_step },
            SourceKind::ErrorCompensating => Source::ErrorCompensating,
        },
        surface: match case.scheme.kind {
            SchemeKind::IsphDi => Criterion::Density,
            _ => Criterion::PositionDivergence,
        },
        shifting: case.scheme.shifting,
        clip_negative_pressure: case.scheme.clip_negative_pressure,
        collisions: (collision_distance > 0.0).then_some(Collisions {
            distance: collision_distance * case.spacing,
            restitution: collision_restitution,
            mass: case.fluid.density * case.spacing.powi(case.dimension as i32),
        }),
        courant: case.time.courant,
    }
}

/// Speed of sound over the greatest speed to be expected: the density then varies by about its inverse square.
const SOUND_RATIO: f64 = 10.0;
/// The same for schemes that smooth velocities: c_0 = sqrt(200 g H) in liquid of depth H, as Monaghan (1994) has it. The artificial
/// viscosity grows with it: at 10 the flood of the 3D dam break (unsmoothed) comes 7 ms later, at half of it the density would vary by 8 %.
const SMOOTHED_SOUND_RATIO: f64 = 7.071;

/// Reach, in spacings, of the repulsion that backs walls with a pressure. A row of liquid at a wall is 1 away from it and
/// feels nothing; one that slips through the pressure is stopped 0.19 in front of the wall's face between two wall
/// particles (0.35 in front of one). At half of it the face lies open; twice it would bear water at rest.
const GUARD: f64 = 0.85;

/// The WCSPH method of a case, for the liquid as it starts.
pub fn wcsph<const D: usize>(case: &CaseFile, scene: &Scene<D>) -> wcsph::Method {
    let Scene { particles, params, .. } = scene;
    let scheme = &case.scheme;
    let gravity = params.gravity.norm();
    let (mut lowest, mut highest) = (0.0, f64::NEG_INFINITY);
    for a in particles.fluid() {
        // Potential energy per mass, divided by g below: height along gravity, whatever its direction.
        let height = -params.gravity.dot(&particles.position[a]);
        (lowest, highest) = if highest == f64::NEG_INFINITY {
            (height, height)
        } else {
            (height.min(lowest), height.max(highest))
        };
    }
    let depth = if gravity > 0.0 { (highest - lowest) / gravity + params.spacing } else { 0.0 };
    // 2 sqrt(g H): the front of a dam break (Ritter 1892).
    let speed = particles.fastest_liquid();
    let expected = 2.0 * (gravity * depth).sqrt() + speed;
    let plain = scheme.kind == SchemeKind::WcsphMonaghan;
    let ratio = if scheme.kind.smooths_velocities(D) { SMOOTHED_SOUND_RATIO } else { SOUND_RATIO };
    let sound_speed = scheme.sound_speed.unwrap_or(ratio * expected);
    // The laminar viscosity as an alpha: both terms have the same shape.
    let laminar =
        2.0 * (D + 2) as f64 * params.kinematic_viscosity / (sound_speed * params.smoothing_length());
    let what_is_lacking = (scheme.artificial_viscosity - laminar).max(0.0);
    wcsph::Method {
        sound_speed,
        artificial_viscosity: if plain { scheme.artificial_viscosity } else { what_is_lacking },
        velocity_smoothing: scheme.velocity_smoothing,
        wall_pressure: !plain,
        repulsion: Repulsion::new(gravity, depth, speed, params.spacing, if plain { 1.0 } else { GUARD }),
        density_diffusion: if plain { DiffusionKind::None } else { scheme.density_diffusion },
        density_diffusion_coefficient: scheme.density_diffusion_coefficient,
        acoustic_damper: if plain { 0.0 } else { scheme.acoustic_damper },
        differences_in_closed_liquid: !plain,
        corrected: !plain && D == 2,
        shifting: if plain { 0.0 } else { scheme.shifting },
        stepping: if plain { super::Stepping::PredictorCorrector } else { scheme.stepping },
        courant: case.time.courant,
    }
}

fn shapes<const D: usize>(case: &CaseFile) -> Shapes<D> {
    let extent = |min: &[f64], max: &[f64]| Aabb { min: vector(min), max: vector(max) };
    Shapes {
        tank: case.tank.as_ref().map(|tank| {
            let mut open = [[false; 2]; D];
            for side in &tank.open {
                let (axis, end) = side_of::<D>(*side);
                open[axis][end] = true;
            }
            let mut periodic = [false; D];
            for axis in &tank.periodic {
                periodic[*axis as usize] = true;
            }
            TankShape { inner: extent(&tank.min, &tank.max), open, periodic }
        }),
        boxes: case.boxes.iter().map(|b| extent(&b.min, &b.max)).collect(),
        blocks: case
            .fluid
            .blocks
            .iter()
            .map(|b| BlockShape {
                extent: extent(&b.min, &b.max),
                ellipsoid: b.shape == BlockForm::Ellipsoid,
            })
            .collect(),
        bodies: case
            .bodies
            .iter()
            .map(|body| {
                let [min, max] = body.shape.extent();
                BodyShape { extent: extent(&min, &max), form: form(&body.shape) }
            })
            .collect(),
    }
}

fn form(shape: &super::BodyShape) -> Form {
    match shape {
        super::BodyShape::Box { .. } | super::BodyShape::Stl { triangles: None, .. } => Form::Box,
        super::BodyShape::Sphere { .. } => Form::Ellipsoid,
        super::BodyShape::Cylinder { along, .. } => Form::Cylinder { axis: *along as usize },
        super::BodyShape::Stl { triangles: Some(mesh), .. } => Form::Mesh(mesh.clone()),
    }
}

/// Bodies as the case has them.
fn body_plans<const D: usize>(case: &CaseFile) -> Vec<Plan<D>> {
    let plan = |body: &super::Body| {
        let friction = Friction {
            law: body.friction.law,
            coefficient: body.friction.coefficient,
            uplift: body.friction.uplift,
        };
        let all = if D == 2 { vec![0, 1, 5] } else { (0..6).collect::<Vec<usize>>() };
        let row = |row: &Vec<f64>| {
            let mut rates = [0.0; 6];
            rates[..D].copy_from_slice(&row[1..=D]);
            let spin = &row[D + 1..];
            rates[6 - spin.len()..].copy_from_slice(spin);
            (row[0], rates)
        };
        let spin = |values: &[f64]| match values {
            [z] => Point::new(0.0, 0.0, *z),
            _ => Point::from_fn(|k, _| values.get(k).copied().unwrap_or(0.0)),
        };
        Plan {
            name: body.name.clone(),
            mass: body.mass.ok_or(body.density.unwrap_or(case.fluid.density)),
            motion: match body.motion {
                BodyMotion::Fixed => Motion::Fixed,
                BodyMotion::Prescribed => Motion::Prescribed(body.path.iter().map(row).collect()),
                BodyMotion::Sliding => {
                    Motion::Free { freedoms: vec![body.axis as usize], friction: Some(friction) }
                }
                BodyMotion::Free => {
                    let locked = |k: &usize| body.locked.iter().any(|axis| *axis as usize == *k);
                    let freedoms = all.into_iter().filter(|k| !locked(k)).collect();
                    Motion::Free { freedoms, friction: None }
                }
            },
            push: vector(&body.push),
            velocity: vector(&body.velocity),
            spin: spin(&body.spin),
            form: form(&body.shape),
            contact_friction: body.friction.coefficient,
        }
    };
    case.bodies.iter().map(plan).collect()
}

/// Axis of a side, and 0 for its lower or 1 for its upper end.
pub fn side_of<const D: usize>(side: Side) -> (usize, usize) {
    match side {
        Side::Left => (0, 0),
        Side::Right => (0, 1),
        Side::Front => (1, 0),
        Side::Back => (1, 1),
        Side::Bottom => (D - 1, 0),
        Side::Top => (D - 1, 1),
    }
}

/// Translation and rotation of a block's liquid at `r`.
fn block_velocity<const D: usize>(block: &FluidBlock, r: &Vector<D>) -> Vector<D> {
    let arm = r - 0.5 * (vector::<D>(&block.min) + vector(&block.max));
    let mut v: Vector<D> = vector(&block.velocity);
    v[0] -= block.rotation * arm[1];
    v[1] += block.rotation * arm[0];
    v
}

/// First `D` components of a proven list.
pub fn vector<const D: usize>(values: &[f64]) -> Vector<D> {
    Vector::from_fn(|d, _| values[d])
}

/// Moves each fluid particle by up to `amplitude` m along each axis; the same seed gives the same moves.
fn jitter<const D: usize>(particles: &mut Particles<D>, amplitude: f64, seed: u64) {
    if amplitude == 0.0 {
        return;
    }
    // splitmix64 (Steele, Lea & Flood 2014): a generator this small needs no crate and never changes.
    let mut state = seed;
    let mut uniform = || {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = (state ^ (state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    };
    for a in particles.fluid() {
        particles.position[a] += Vector::from_fn(|_, _| amplitude * uniform());
    }
}
