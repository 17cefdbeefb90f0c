//! Case files: what a user writes, as plain data in SI units, with every default in one place.
//!
//! [`CaseFile`] is the file as parsed and proven (module [`read`]); module [`build`] turns it into a
//! simulation of one dimension. `run.toml` is this same structure written back with all defaults filled in.
//! Defaults are the `Default` implementations, constants and functions beside the structures they belong to.

pub mod build;
pub mod builtin;
pub mod read;

use crate::bodies::friction::Law;
use crate::form::Mesh;
use clap::ValueEnum;
use serde::Serialize;
use std::sync::Arc;

/// One scene: a closed description of geometry, physics, numerics and output.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CaseFile {
    /// Short name; also the name of the output folder.
    pub name: String,
    /// One line that `sphpetsc cases` prints.
    pub description: String,
    /// Number of space dimensions, 2 or 3.
    pub dimension: usize,
    /// Particle spacing dx in m.
    pub spacing: f64,
    /// Gravitational acceleration in m/s2, `dimension` components; the last axis points up.
    pub gravity: Vec<f64>,
    /// Seed of everything random (only particle jitter uses it).
    pub seed: u64,
    /// The liquid.
    pub fluid: Fluid,
    /// The tank around it, if any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tank: Option<Tank>,
    /// How the tank moves, if it does; the scene is seen from the tank.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub motion: Option<Motion>,
    /// Fixed solid boxes inside the domain.
    #[serde(rename = "box", skip_serializing_if = "Vec::is_empty")]
    pub boxes: Vec<SolidBox>,
    /// Rigid bodies.
    #[serde(rename = "body", skip_serializing_if = "Vec::is_empty")]
    pub bodies: Vec<Body>,
    /// The flow whose solution is known, if it is one: also gives the initial velocity.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exact: Option<ExactSolution>,
    /// Numerical scheme and its parameters.
    pub scheme: SchemeParams,
    /// End time and time step.
    pub time: TimeParams,
    /// What is written, and how often.
    pub output: OutputParams,
    /// Gauges.
    #[serde(rename = "probe", skip_serializing_if = "Vec::is_empty")]
    pub probes: Vec<Probe>,
    /// What the result is measured against.
    #[serde(rename = "reference", skip_serializing_if = "Vec::is_empty")]
    pub references: Vec<Reference>,
    /// Measured surfaces that the result is compared with.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub profile: Option<Profile>,
    /// Events whose time is known.
    #[serde(rename = "arrival", skip_serializing_if = "Vec::is_empty")]
    pub arrivals: Vec<Arrival>,
}

impl CaseFile {
    /// Earth's gravity along the last of `dimension` axes, in m/s2.
    pub fn default_gravity(dimension: usize) -> Vec<f64> {
        let mut gravity = vec![0.0; dimension];
        if let Some(up) = gravity.last_mut() {
            *up = -9.81;
        }
        gravity
    }
}

/// Material and initial shape of the liquid.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Fluid {
    /// Reference density in kg/m3.
    pub density: f64,
    /// Kinematic viscosity in m2/s; 0 leaves the viscous loop out.
    pub kinematic_viscosity: f64,
    /// Axis-aligned boxes filled with liquid at the start; they must not overlap.
    #[serde(rename = "block")]
    pub blocks: Vec<FluidBlock>,
}

impl Fluid {
    /// Density of fresh water in kg/m3.
    pub const DENSITY: f64 = 1000.0;
    /// Kinematic viscosity of water at 20 degrees Celsius in m2/s.
    pub const KINEMATIC_VISCOSITY: f64 = 1e-6;
}

/// A flow whose solution is known; module [`exact`](crate::exact) has the formulas.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "solution", rename_all = "snake_case")]
pub enum ExactSolution {
    /// Decaying vortices in a periodic square.
    TaylorGreen {
        /// Largest speed at the start in m/s.
        speed: f64,
    },
    /// A round drop stretched along y.
    StretchingDrop {
        /// Rate of stretching at the start in 1/s.
        rate: f64,
    },
    /// A small wave between two walls, from a flat surface.
    StandingWave {
        /// Largest elevation in m, if it were not damped.
        amplitude: f64,
        /// Number of half waves between the walls.
        mode: u32,
    },
    /// Small waves in a tank that is shaken along x.
    Sloshing {
        /// Number of half waves between the walls of the mode compared: an odd one, shaking excites no other.
        mode: u32,
    },
    /// A dam break over a dry bed in shallow water; the dam is the right end of the first block.
    Ritter,
}

/// Acceleration of the tank: its liquid feels gravity minus this.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Motion {
    /// Rows of a time in s, ascending, and the components of the acceleration in m/s2; linear between them, constant
    /// beyond the ends.
    Acceleration(Vec<Vec<f64>>),
    /// The tank is displaced by amplitude sin(2 pi t / period).
    Sine {
        /// Direction.
        axis: Axis,
        /// Largest displacement in m.
        amplitude: f64,
        /// Period in s.
        period: f64,
    },
}

/// The shape of a block of liquid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum BlockForm {
    /// All of the box.
    #[default]
    Box,
    /// The ellipse or ellipsoid that touches all its sides.
    Ellipsoid,
}

/// An axis-aligned box of liquid, or an ellipsoid in it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FluidBlock {
    /// What of the box is filled.
    pub shape: BlockForm,
    /// Lower corner in m.
    pub min: Vec<f64>,
    /// Upper corner in m.
    pub max: Vec<f64>,
    /// Initial velocity in m/s.
    pub velocity: Vec<f64>,
    /// Angular velocity in rad/s about the block's centre, counterclockwise seen against the last axis (in 2D: in the
    /// plane; in 3D: about the vertical).
    pub rotation: f64,
}

/// A box-shaped tank; `min` and `max` are its inner wall planes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Tank {
    /// Lower inner corner in m.
    pub min: Vec<f64>,
    /// Upper inner corner in m.
    pub max: Vec<f64>,
    /// Sides without a wall.
    pub open: Vec<Side>,
    /// Axes along which the scene repeats itself with the tank's length: those sides have no walls.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub periodic: Vec<Axis>,
    /// How liquid moves along the walls.
    pub slip: Slip,
}

/// A solid box fixed in space.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SolidBox {
    /// What force probes call it; box1, box2, ... where the file gives none.
    pub name: String,
    /// Lower corner in m.
    pub min: Vec<f64>,
    /// Upper corner in m.
    pub max: Vec<f64>,
}

/// A rigid body.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Body {
    /// Name in bodies.csv and forces.csv; body1, body2, ... where the file gives none.
    pub name: String,
    /// What of space it fills at the start.
    #[serde(flatten)]
    pub shape: BodyShape,
    /// Whether liquid that it overlaps at the start makes room for it.
    pub immersed: bool,
    /// Mass in kg; in 2D that of 1 m of width.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mass: Option<f64>,
    /// Density in kg/m3 in place of the mass.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub density: Option<f64>,
    /// What it may do.
    pub motion: BodyMotion,
    /// Axis that it slides along.
    pub axis: Axis,
    /// Axes along or about which a free body does not move.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub locked: Vec<Freedom>,
    /// Velocity at the start in m/s.
    pub velocity: Vec<f64>,
    /// Angular velocity at the start in rad/s: one number in 2D, three in 3D.
    pub spin: Vec<f64>,
    /// A constant force in N that pushes it at its centre.
    pub push: Vec<f64>,
    /// Rows of a time in s, ascending, a velocity in m/s and, if wanted, an angular velocity in rad/s that a prescribed body
    /// has; linear between them, constant beyond the ends.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub path: Vec<Vec<f64>>,
    /// Friction on what it slides along or touches.
    pub friction: BodyFriction,
}

/// What of space a body fills at the start.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "shape", rename_all = "snake_case")]
pub enum BodyShape {
    /// An axis-aligned box.
    Box {
        /// Lower corner in m.
        min: Vec<f64>,
        /// Upper corner in m.
        max: Vec<f64>,
    },
    /// A sphere, in 2D a disc.
    Sphere {
        /// Centre in m.
        centre: Vec<f64>,
        /// Radius in m.
        radius: f64,
    },
    /// A round cylinder (3D).
    Cylinder {
        /// Centre in m.
        centre: Vec<f64>,
        /// Radius in m.
        radius: f64,
        /// Length in m.
        length: f64,
        /// Its axis.
        along: Axis,
    },
    /// A closed triangle mesh (3D).
    Stl {
        /// Name of a file.
        #[serde(skip_serializing_if = "Option::is_none")]
        file: Option<String>,
        /// In place of a file its contents as text.
        #[serde(skip_serializing_if = "Option::is_none")]
        mesh: Option<String>,
        /// Metres per unit of length of the mesh.
        scale: f64,
        /// Where its origin is put, in m.
        offset: Vec<f64>,
        /// As read.
        #[serde(skip)]
        triangles: Option<Arc<Mesh>>,
    },
}

impl BodyShape {
    /// Lower and upper corner of the extent in m; of a mesh that could not be read NaN.
    pub fn extent(&self) -> [Vec<f64>; 2] {
        match self {
            Self::Box { min, max } => [min.clone(), max.clone()],
            Self::Sphere { centre, radius } => {
                [-radius, *radius].map(|r| centre.iter().map(|x| x + r).collect())
            }
            Self::Cylinder { centre, radius, length, along } => [-1.0, 1.0].map(|side| {
                let half = |d: usize| if d == *along as usize { 0.5 * length } else { *radius };
                centre.iter().enumerate().map(|(d, x)| x + side * half(d)).collect()
            }),
            Self::Stl { triangles: None, .. } => [vec![f64::NAN; 3], vec![f64::NAN; 3]],
            Self::Stl { triangles: Some(mesh), .. } => {
                let (low, high) = mesh.extent();
                [low, high].map(|corner| corner.iter().copied().collect())
            }
        }
    }
}

/// What a body may do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum BodyMotion {
    /// Nothing.
    #[default]
    Fixed,
    /// Move as `path` says.
    Prescribed,
    /// Slide along one axis.
    Sliding,
    /// Move and turn, but for `locked` axes.
    Free,
}

/// An axis along or about which a body may be free.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Freedom {
    /// Along x.
    X,
    /// Along y.
    Y,
    /// Along z, 3D only.
    Z,
    /// About x, 3D only.
    RotationX,
    /// About y, 3D only.
    RotationY,
    /// About z, in 2D in the plane.
    RotationZ,
}

/// Friction of a body; module [`friction`](crate::bodies::friction) has the laws.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct BodyFriction {
    /// The law, for sliding bodies; free ones obey Coulomb's.
    pub law: Law,
    /// Coefficient alpha.
    pub coefficient: f64,
    /// Whether liquid that seeps under it lifts a sliding body.
    pub uplift: bool,
}

/// How the motion of bodies and the pressure are coupled in ISPH.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Coupling {
    /// Found together.
    #[default]
    Strong,
    /// The pressure from the last acceleration, and from it the next one.
    Explicit,
}

/// A named side of the tank: x is left to right, y (3D only) front to back, the last axis bottom to top.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Side {
    /// Lowest x.
    Left,
    /// Highest x.
    Right,
    /// Lowest y, 3D only.
    Front,
    /// Highest y, 3D only.
    Back,
    /// Lowest last coordinate.
    Bottom,
    /// Highest last coordinate.
    Top,
}

/// A coordinate axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Axis {
    /// From left to right.
    X,
    /// Up in 2D, from front to back in 3D.
    Y,
    /// Up, 3D only.
    Z,
}

impl Side {
    /// As case files write it.
    pub fn name(self) -> &'static str {
        ["left", "right", "front", "back", "bottom", "top"][self as usize]
    }
}

/// Tangential condition at walls.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Slip {
    /// Liquid slides without friction.
    #[default]
    Free,
    /// Liquid sticks to the wall through the viscous term.
    None,
}

/// Which method, and its parameters.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SchemeParams {
    /// The method.
    pub kind: SchemeKind,
    /// Smoothing kernel.
    pub kernel: KernelKind,
    /// Smoothing length over particle spacing, h / dx: 1.2; in 2D 2 for `wcsph`, and for `isph_di` without gravity, where errors of the
    /// kernel sum are taken back as fast as the liquid moves and nothing but a wide support keeps them small: at 1.2 `rotating_square`
    /// runs out of control. With gravity the surface is the worse for it: waves at 0.025 m die three times as fast as at 1.2. In 3D 1.5
    /// for `wcsph_monaghan`, for its smoothed velocities: at 1.2 particles clump.
    pub smoothing_ratio: f64,
    /// Discrete Laplacian of the pressure equation.
    pub laplacian: LaplacianKind,
    /// Artificial speed of sound in m/s (WCSPH); absent: ten times the greatest speed to be expected, 7.1 times for `wcsph_monaghan` in 3D,
    /// which makes the sqrt(200 g H) of Monaghan (1994).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sound_speed: Option<f64>,
    /// Coefficient alpha of the artificial viscosity (WCSPH). `wcsph`: 0.02, enough beside the density diffusion, and less
    /// by what the laminar viscosity does already.
    /// `wcsph_monaghan`: 0.1, since at the 0.01 of Monaghan (1994), who smooths velocities as well, the density strays by
    /// 30 % in the 2D dam break at a spacing of 0.01 m, and at 0.1 by 8 %; 0.03 in 3D, where it smooths them.
    pub artificial_viscosity: f64,
    /// epsilon, how much of the velocity of those around it moves a particle beside its own (WCSPH; XSPH of Monaghan 1989); 0 leaves it out,
    /// 0.25 is the default of `wcsph_monaghan` in 3D: see [`wcsph`](crate::scheme::wcsph).
    pub velocity_smoothing: f64,
    /// Form of the density diffusion (`wcsph`).
    pub density_diffusion: DiffusionKind,
    /// Coefficient delta of the density diffusion (`wcsph`).
    pub density_diffusion_coefficient: f64,
    /// Coefficient chi of the acoustic damper (`wcsph`); 0 leaves it out.
    pub acoustic_damper: f64,
    /// How a time step is composed (`wcsph`).
    pub stepping: Stepping,
    /// Right-hand side of the pressure equation (ISPH).
    pub source: SourceKind,
    /// Share of the density error corrected per step by the source `blended`, gamma of Asai et al. (2012).
    pub density_relaxation: f64,
    /// Shifting coefficient A of Skillen et al. (2013); 0, the default of `wcsph`, leaves shifting out.
    pub shifting: f64,
    /// Negative pressures are set to zero (for splashing scenes).
    pub clip_negative_pressure: bool,
    /// Approaching pairs closer than this many spacings collide; 0 leaves collisions out.
    pub collision_distance: f64,
    /// Coefficient of restitution of those collisions.
    pub collision_restitution: f64,
    /// Coupling of bodies and pressure (ISPH).
    pub coupling: Coupling,
    /// Random displacement of the initial lattice, uniform in +-jitter spacings along each axis.
    pub jitter: f64,
}

impl Default for SchemeParams {
    fn default() -> Self {
        Self::of(SchemeKind::IsphDf, 2, false)
    }
}

impl SchemeParams {
    /// Defaults of one method in a dimension, for a scene with or without gravity.
    pub fn of(kind: SchemeKind, dimension: usize, weightless: bool) -> Self {
        let wide = kind == SchemeKind::Wcsph || (kind == SchemeKind::IsphDi && weightless);
        let (plain, smooths) = (kind == SchemeKind::WcsphMonaghan, kind.smooths_velocities(dimension));
        Self {
            kind,
            kernel: KernelKind::WendlandC2,
            smoothing_ratio: match dimension {
                2 if wide => 2.0,
                _ if smooths => 1.5,
                _ => 1.2,
            },
            laplacian: LaplacianKind::Schwaiger,
            sound_speed: None,
            artificial_viscosity: match plain {
                true if smooths => 0.03,
                true => 0.1,
                false => 0.02,
            },
            velocity_smoothing: if smooths { 0.25 } else { 0.0 },
            density_diffusion: DiffusionKind::Fourtakas,
            density_diffusion_coefficient: 0.1,
            acoustic_damper: 0.5,
            stepping: Stepping::Symplectic,
            source: match kind {
                SchemeKind::IsphDi => SourceKind::DensityInvariant,
                _ => SourceKind::Blended,
            },
            density_relaxation: 0.02,
            shifting: if kind == SchemeKind::Wcsph { 0.0 } else { 2.0 },
            clip_negative_pressure: false,
            collision_distance: 0.0,
            collision_restitution: 0.2,
            coupling: Coupling::Strong,
            jitter: 0.0,
        }
    }
}

/// The numerical methods this build knows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum SchemeKind {
    /// Divergence-free incompressible SPH (ISPH_DF).
    IsphDf,
    /// Density-invariant incompressible SPH (ISPH_DI): another source, and the surface is told by the density.
    IsphDi,
    /// Weakly compressible SPH with density diffusion and extrapolated wall pressures.
    Wcsph,
    /// Weakly compressible SPH of Monaghan (1994): no corrections, repulsive walls.
    WcsphMonaghan,
    /// No flow: the discrete operators on given fields (Schwaiger's patch test).
    PatchTest,
}

impl SchemeKind {
    /// Whether it solves a pressure equation.
    pub fn solves(self) -> bool {
        matches!(self, Self::IsphDf | Self::IsphDi)
    }

    /// Whether its particles move with smoothed velocities by default, and its other defaults go with that: see
    /// [`wcsph`](crate::scheme::wcsph). In 2D the flood of the plain scheme is in time without.
    pub fn smooths_velocities(self, dimension: usize) -> bool {
        self == Self::WcsphMonaghan && dimension == 3
    }

    /// The name that a case file or `--scheme` gives it.
    pub fn name(self) -> String {
        self.to_possible_value().map(|value| value.get_name().to_owned()).unwrap_or_default()
    }
}

/// Right-hand sides of the pressure equation; module [`source`](crate::ppe::source) has the formulas.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum SourceKind {
    /// Divergence, and a share `density_relaxation` of the density error (Asai et al. 2012).
    Blended,
    /// Density error (Shao & Lo 2003).
    DensityInvariant,
    /// Divergence, and errors in proportion to themselves (Khayyer & Gotoh 2011).
    ErrorCompensating,
}

/// Forms of the density diffusion of weakly compressible SPH.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum DiffusionKind {
    /// No diffusion.
    None,
    /// Molteni & Colagrossi (2009): disturbs water at rest.
    MolteniColagrossi,
    /// Antuono et al. (2012): without the part that is linear in space.
    Antuono,
    /// Fourtakas et al. (2019): without the hydrostatic part.
    Fourtakas,
}

/// How weakly compressible SPH composes a time step; both are of second order with one neighbour search.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Stepping {
    /// Position Verlet: drift, kick, drift; forces once a step (Parshikov et al. 2000).
    Symplectic,
    /// Predictor and corrector at half the step; forces twice (Monaghan 1994).
    PredictorCorrector,
}

/// Smoothing kernels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum KernelKind {
    /// Wendland (1995) C2.
    WendlandC2,
    /// Cubic spline (Monaghan 1992).
    CubicSpline,
    /// Quintic spline (Morris et al. 1997).
    Quintic,
}

/// Discrete Laplacians.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum LaplacianKind {
    /// Eq. (3) of Jian et al. (2016), after Schwaiger (2008): exact for linear fields.
    Schwaiger,
    /// Shao & Lo (2003): without the correction.
    ShaoLo,
}

/// End time and time step control.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TimeParams {
    /// Flow time to reach, in s.
    pub until: f64,
    /// Fixed step in s; adaptive when absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub step: Option<f64>,
    /// Courant number: dt <= courant dx / |v|max, and in WCSPH courant dx / (c_0 + |v|max).
    pub courant: f64,
    /// Largest adaptive step in s; absent: only the stability limits act.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub step_max: Option<f64>,
}

impl TimeParams {
    /// Courant number of adaptive steps of one method.
    ///
    /// `wcsph`: proportional to h, as its limit is, 0.7 at h / dx = 1.2 and at most 1. There the 2D dam break at a spacing of
    /// 0.01 m runs its 4 s alike at 0.6, 0.8 and 1 (front at the wall at 0.314 to
    /// 0.316 s, no energy gained beyond 0.3 %); the density strays by 3.8 % at 0.6 and by 6.1 % at 1. With predictor and
    /// corrector instead of position Verlet water at rest without density diffusion stays calm at 0.5 and does not at 0.7.
    /// `wcsph_monaghan`, which steps so: at 0.6 nothing leaves that tank, at 0.8 a particle does, and at 1 the run fails. Where smoothed velocities
    /// move its particles 0.3 h / (1.2 dx), since at 0.5 they gain energy.
    pub fn courant_of(scheme: &SchemeParams) -> f64 {
        match (scheme.kind, scheme.stepping) {
            (SchemeKind::Wcsph, Stepping::Symplectic) => (0.7 * (scheme.smoothing_ratio / 1.2)).min(1.0),
            (SchemeKind::WcsphMonaghan, _) if scheme.velocity_smoothing > 0.0 => {
                0.3 * (scheme.smoothing_ratio / 1.2)
            }
            (SchemeKind::Wcsph | SchemeKind::WcsphMonaghan, _) => 0.5,
            _ => 0.35,
        }
    }
}

/// What is written, and how often, in s of flow.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OutputParams {
    /// Interval of particle files in s; 0 writes none but the first and the last.
    pub particles: f64,
    /// Extra instants of particle files in s.
    pub snapshots: Vec<f64>,
    /// Interval of the history rows in s; 0 writes every step.
    pub samples: f64,
    /// Interval of the rows of gauges and forces in s; 0 writes every step.
    pub gauges: f64,
    /// Interval of checkpoints in s of flow; 0 keeps only the one at the end or on failure.
    pub checkpoint: f64,
}

impl OutputParams {
    /// Intervals that suit a run of `until` seconds, without extra snapshots.
    pub fn for_run(until: f64) -> Self {
        Self {
            particles: until / 80.0,
            snapshots: Vec::new(),
            samples: until / 2000.0,
            gauges: (until / 2000.0).min(1e-3),
            checkpoint: until / 8.0,
        }
    }
}

/// One gauge.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Probe {
    /// Pressure at a point, in Pa.
    Pressure {
        /// Column name.
        name: String,
        /// Position in m.
        position: Vec<f64>,
        /// Window in s of a running mean over the past; absent: every reading as it is.
        #[serde(skip_serializing_if = "Option::is_none")]
        filter: Option<f64>,
        /// Name of the body that it rides on, with its position at the start.
        #[serde(skip_serializing_if = "Option::is_none")]
        body: Option<String>,
    },
    /// Water height on a vertical line, in m above its lowest point.
    Height {
        /// Column name.
        name: String,
        /// Foot of the line in m.
        position: Vec<f64>,
    },
    /// Force of the liquid on a solid, in N (in 2D for 1 m of width).
    Force {
        /// Column name, before the axis.
        name: String,
        /// Name of a box or of a side of the tank, or [`Probe::ALL_WALLS`].
        on: String,
    },
}

impl Probe {
    /// What a force probe on the whole tank is `on`.
    pub const ALL_WALLS: &str = "walls";

    /// Name of its columns.
    pub fn name(&self) -> &str {
        let (Self::Pressure { name, .. } | Self::Height { name, .. } | Self::Force { name, .. }) = self;
        name
    }

    /// Where it is in m, if it is at a place.
    pub fn position(&self) -> Option<&[f64]> {
        match self {
            Self::Pressure { position, .. } | Self::Height { position, .. } => Some(position),
            Self::Force { .. } => None,
        }
    }

    /// Body that it rides on, by name.
    pub fn rides_on(&self) -> Option<&str> {
        match self {
            Self::Pressure { body, .. } => body.as_deref(),
            _ => None,
        }
    }

    /// Its columns with their units.
    pub fn columns(&self, dimension: usize) -> Vec<String> {
        match self {
            Self::Pressure { name, .. } => vec![format!("{name}_pa")],
            Self::Height { name, .. } => vec![format!("{name}_m")],
            Self::Force { name, .. } => axes(dimension).map(|axis| format!("{name}_{axis}_n")).collect(),
        }
    }
}

/// Names of the axes in 2 or 3 dimensions.
pub fn axes(dimension: usize) -> impl Iterator<Item = &'static str> {
    ["x", "y", "z"].into_iter().take(dimension)
}

/// A measured or exact series that a column of history.csv, probes.csv or forces.csv is compared with.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Reference {
    /// Name in the end table; `--reference NAME=FILE` gives its data.
    pub name: String,
    /// Citation of the source.
    pub source: String,
    /// Usual name of its data file: `--reference FILE` serves all references if they name the same one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    /// Column of the run that is compared, with or without its unit. A dry gauge counts as 0.
    pub quantity: String,
    /// Column of the reference file that holds times.
    pub time_column: String,
    /// Seconds per unit of that column.
    pub time_unit: f64,
    /// Column of the reference file that holds values.
    pub value_column: String,
    /// SI value per unit of that column.
    pub value_unit: f64,
    /// Only reference values of at least this (in the file's unit) are compared.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub value_min: Option<f64>,
    /// What differences are divided by.
    pub normalise: Normalise,
    /// Spans of time `[from, until]` in s, each compared by itself; none: all the data.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub windows: Vec<Vec<f64>>,
    /// Step in s of the uniform times at which both are compared, linearly interpolated; absent: the data's own times.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub grid: Option<f64>,
    /// The best constant time shift is sought up to this, in s; absent: a tenth of the last time compared.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shift_max: Option<f64>,
    /// Window in s of the running mean whose largest value is the peak; absent: no peak is looked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mean: Option<f64>,
    /// Window in s of the running mean around which the rest is noise; absent: noise is not measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub noise: Option<f64>,
}

/// Measured points of the free surface at one or more times (2D); module [`profiles`](crate::output::profiles) compares.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Profile {
    /// Name in the end table; `--reference NAME=FILE` gives its data.
    pub name: String,
    /// Citation of the source.
    pub source: String,
    /// Usual name of its data file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    /// Column of the file that holds times in s.
    pub time_column: String,
    /// Column that holds x in m.
    pub x_column: String,
    /// Column that holds heights in m.
    pub height_column: String,
    /// Time in s by which the measured motion lags behind one without a gate: points of time t are compared at t - delay.
    pub delay: f64,
    /// Length in m that distances are divided by.
    pub size: f64,
}

/// What the differences from a reference are divided by.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Normalise {
    /// Mean size of the reference values compared.
    #[default]
    Mean,
    /// Largest size of all reference values.
    Max,
    /// A size in the quantity's SI unit.
    #[serde(untagged)]
    By(f64),
}

/// An event whose time is known: a quantity first reaches a level.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Arrival {
    /// Column of history.csv, probes.csv or forces.csv that is watched.
    pub quantity: String,
    /// Value to be reached, in the column's SI unit.
    pub level: f64,
    /// When the source says so, in s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub expected_time: Option<f64>,
    /// The reference whose data tell when, by the same level.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reference: Option<String>,
    /// Citation of the source.
    pub source: String,
}
