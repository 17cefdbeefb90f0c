//! What a run writes of its bodies: bodies.csv, their columns of forces.csv, and their surfaces as VTK polygons.
//!
//! A row tells the state after a step and the forces and accelerations of that step, so that Eq. (1) of [`crate::bodies`] can be
//! checked against it; the viscous part of the liquid's force, where liquid sticks, has columns of its own. In 2D forces, torques and masses are those of 1 m of width.

use super::folder::RunFolder;
use super::observers::{Schedule, open};
use super::table::{Cell, Table};
use super::vtk::{Polygons, Pvd, write_polygons};
use crate::Result;
use crate::bodies::{Bodies, Body};
use crate::case::{CaseFile, Slip, axes};
use crate::form::{Point, point};
use crate::simulation::Simulation;
use std::path::Path;

/// Axes about which bodies turn.
fn turns(dimension: usize) -> impl Iterator<Item = &'static str> {
    ["x", "y", "z"].into_iter().skip(if dimension == 2 { 2 } else { 0 })
}

/// Columns of forces.csv on the bodies of `case`; viscous ones where liquid sticks to them.
pub fn force_columns(case: &CaseFile) -> Vec<String> {
    let dimension = case.dimension;
    let sticks = case.tank.as_ref().is_some_and(|tank| tank.slip == Slip::None);
    let of = |name: &str| {
        let along =
            |what: &str| axes(dimension).map(|axis| format!("{name}_{what}{axis}_n")).collect::<Vec<_>>();
        let about =
            |what: &str| turns(dimension).map(|axis| format!("{name}_{what}_{axis}_nm")).collect::<Vec<_>>();
        let viscous = if sticks { along("viscous_") } else { vec![] };
        [along(""), about("torque"), viscous, along("friction_"), along("contact_"), about("contact_torque")]
            .concat()
    };
    case.bodies.iter().flat_map(|body| of(&body.name)).collect()
}

/// Columns of bodies.csv on the bodies of `case`, after the time.
pub fn columns(case: &CaseFile) -> Vec<String> {
    let dimension = case.dimension;
    let of = |name: &str| {
        let along = |what: &str, unit: &str| {
            axes(dimension).map(|axis| format!("{name}_{what}{axis}_{unit}")).collect::<Vec<_>>()
        };
        let about = |what: &str, unit: &str| {
            turns(dimension).map(|axis| format!("{name}_{what}_{axis}_{unit}")).collect::<Vec<_>>()
        };
        [
            along("", "m"),
            along("v", "m_per_s"),
            along("a", "m_per_s2"),
            about("rotation", "rad"),
            about("spin", "rad_per_s"),
            about("spin_change", "rad_per_s2"),
        ]
        .concat()
    };
    case.bodies.iter().flat_map(|body| of(&body.name)).collect()
}

fn along<const D: usize>(v: &Point) -> Vec<f64> {
    v.iter().copied().take(D).collect()
}

fn about<const D: usize>(v: &Point) -> Vec<f64> {
    v.iter().copied().skip(if D == 2 { 2 } else { 0 }).collect()
}

/// Values of [`force_columns`].
pub fn forces<const D: usize>(bodies: &Bodies<D>, slip: Slip) -> Vec<f64> {
    let of = |body: &Body<D>| {
        let loads = &body.state.loads;
        [
            along::<D>(&loads.liquid),
            about::<D>(&loads.torque),
            if slip == Slip::None { along::<D>(&loads.viscous) } else { vec![] },
            along::<D>(&loads.friction),
            along::<D>(&loads.contact),
            about::<D>(&loads.contact_torque),
        ]
        .concat()
    };
    bodies.list.iter().flat_map(of).collect()
}

/// Values of [`columns`].
fn states<const D: usize>(bodies: &Bodies<D>) -> Vec<f64> {
    let of = |body: &Body<D>| {
        let state = &body.state;
        let rotation = nalgebra::Rotation3::from_matrix_unchecked(state.rotation).scaled_axis();
        [
            along::<D>(&state.position),
            along::<D>(&state.velocity),
            along::<D>(&state.acceleration),
            about::<D>(&rotation),
            about::<D>(&state.spin),
            about::<D>(&state.angular_acceleration),
        ]
        .concat()
    };
    bodies.list.iter().flat_map(of).collect()
}

/// bodies.csv, and bodies.pvd with its files.
pub struct BodyLog {
    table: Table,
    samples: Schedule,
    pvd: Pvd,
    snapshots: Schedule,
}

impl BodyLog {
    /// Opens the files of a run, or those of a run resumed at time `since`; none in a case without bodies.
    pub fn new(folder: &RunFolder, case: &CaseFile, since: Option<f64>) -> Result<Option<Self>> {
        if case.bodies.is_empty() {
            return Ok(None);
        }
        let table = open(folder, "bodies.csv", columns(case), since)?;
        let path = folder.join("bodies.pvd");
        let pvd = match since {
            None => Pvd::create(&path),
            Some(time) => Pvd::resume(&path, time)?,
        };
        let (output, served) = (&case.output, since.unwrap_or(0.0));
        Ok(Some(Self {
            table,
            samples: Schedule::sampling(output.gauges, since),
            pvd,
            snapshots: Schedule::new(output.particles, output.snapshots.clone(), served),
        }))
    }

    /// A row of the present state.
    pub fn sample<const D: usize>(&mut self, simulation: &Simulation<D>) -> Result<()> {
        let values = states(simulation.scheme.bodies());
        self.table.row(&std::iter::once(simulation.time).chain(values).map(Cell::Number).collect::<Vec<_>>())
    }

    /// Writes the present surfaces into the collection.
    pub fn write<const D: usize>(&mut self, simulation: &Simulation<D>) -> Result<()> {
        self.pvd.snapshot(simulation.time, |path| write_surfaces(path, simulation.scheme.bodies()))
    }

    /// Rows and surfaces that are due.
    pub fn observe<const D: usize>(&mut self, simulation: &Simulation<D>) -> Result<()> {
        if self.samples.due(simulation.time) {
            self.sample(simulation)?;
        }
        match self.snapshots.due(simulation.time) {
            true => self.write(simulation),
            false => Ok(()),
        }
    }

    /// Whether it would write anything at `time` in s.
    pub fn is_due(&self, time: f64) -> bool {
        self.samples.is_due(time) || self.snapshots.is_due(time)
    }

    /// Writes out what is pending.
    pub fn flush(&mut self) -> Result<()> {
        self.table.flush()
    }
}

fn write_surfaces<const D: usize>(path: &Path, bodies: &Bodies<D>) -> Result<()> {
    let mut all = Polygons::default();
    for (number, body) in bodies.list.iter().enumerate() {
        let first = (all.points.len() / 3) as u64;
        let centre = body.state.position;
        for corner in body.corners() {
            all.points.extend(corner.iter());
            let velocity = body.velocity_at(&crate::bodies::restrict::<D>(&(corner - centre)));
            all.velocity.extend(point(&velocity).iter());
        }
        for polygon in &body.surface.polygons {
            all.connectivity.extend(polygon.iter().map(|corner| first + u64::from(*corner)));
            all.offsets.push(all.connectivity.len() as u64);
            all.body.push(number as u64);
            all.force.extend(body.state.loads.liquid.iter());
        }
    }
    write_polygons(path, all)
}
