//! What is written while a run goes on: histories and gauges, solver log, particle files.

use std::path::{Path, PathBuf};

use super::bodies;
use super::checkpoint;
use super::folder::RunFolder;
use super::forces::Forces;
use super::probes::Gauges;
use super::quantities::{self, Scene};
use super::table::{Cell, Table};
use super::vtk::{Field, FieldData, Pvd, write_vtp};
use crate::Result;
use crate::case::build::Scene as Start;
use crate::case::{CaseFile, Probe};
use crate::particles::Vector;
use crate::scheme::Params;
use crate::scheme::StepReport;
use crate::simulation::{Observer, Simulation};

/// Times at which something is due: every `interval`, and listed instants.
#[derive(Debug, Clone)]
pub(super) struct Schedule {
    interval: f64,
    next: f64,
    instants: Vec<f64>,
}

impl Schedule {
    /// `interval` 0: only `instants`. The time `since` has been served already.
    pub fn new(interval: f64, mut instants: Vec<f64>, since: f64) -> Self {
        instants.retain(|t| *t > since);
        instants.sort_by(|a, b| b.total_cmp(a));
        let next = if interval > 0.0 { interval * ((since / interval).floor() + 1.0) } else { f64::INFINITY };
        Self { interval, next, instants }
    }

    /// Is anything due at `time`?
    pub fn is_due(&self, time: f64) -> bool {
        time >= self.next || self.instants.last().is_some_and(|t| *t <= time)
    }

    /// Is anything due at `time`? Serves it.
    pub fn due(&mut self, time: f64) -> bool {
        let mut due = false;
        while time >= self.next {
            self.next += self.interval;
            due = true;
        }
        while self.instants.pop_if(|t| *t <= time).is_some() {
            due = true;
        }
        due
    }
}

/// A table that starts with the time, opened for a new run or for one resumed at time `since`.
pub(super) fn open(
    folder: &RunFolder,
    name: &str,
    columns: Vec<String>,
    since: Option<f64>,
) -> Result<Table> {
    let columns = [vec!["time_s".to_owned()], columns].concat();
    match since {
        None => Table::create(&folder.join(name), &columns),
        Some(time) => Table::resume(&folder.join(name), &columns, time),
    }
}

/// history.csv.
pub struct History<const D: usize> {
    table: Table,
    every_step: bool,
    schedule: Schedule,
    params: Params<D>,
}

impl<const D: usize> History<D> {
    /// Opens the tables of a run, or those of a run resumed at time `since`.
    pub fn new(folder: &RunFolder, case: &CaseFile, params: &Params<D>, since: Option<f64>) -> Result<Self> {
        let columns = quantities::history::<D>().map(|(name, _)| name.to_owned());
        Ok(Self {
            table: open(folder, "history.csv", columns.to_vec(), since)?,
            every_step: case.output.samples == 0.0,
            schedule: Schedule::new(case.output.samples, vec![], since.unwrap_or(0.0)),
            params: params.clone(),
        })
    }

    /// Adds a row.
    pub fn sample(&mut self, simulation: &Simulation<D>) -> Result<()> {
        let scene = Scene::of(simulation, &self.params);
        let time = Cell::Number(simulation.time);
        let values = quantities::history::<D>().map(|(_, value)| Cell::Number(value(&scene)));
        self.table.row(&[&[time], &values[..]].concat())
    }

    /// Writes out what is pending.
    pub fn flush(&mut self) -> Result<()> {
        self.table.flush()
    }
}

impl<const D: usize> Observer<D> for History<D> {
    fn observe(&mut self, simulation: &Simulation<D>, _: &StepReport) -> Result<()> {
        match self.every_step || self.schedule.due(simulation.time) {
            true => self.sample(simulation),
            false => Ok(()),
        }
    }

    fn is_due(&self, time: f64) -> bool {
        self.every_step || self.schedule.is_due(time)
    }
}

/// probes.csv and forces.csv, each where the case has such probes.
pub struct Probes<const D: usize> {
    gauges: Option<(Table, Gauges<D>)>,
    forces: Option<(Table, Forces<D>)>,
    /// Whether forces.csv has columns of bodies.
    bodies: bool,
    every_step: bool,
    schedule: Schedule,
}

impl<const D: usize> Probes<D> {
    /// Opens the tables of a run that begins as `start`, or those of a run resumed at time `since`.
    pub fn new(folder: &RunFolder, case: &CaseFile, start: &Start<D>, since: Option<f64>) -> Result<Self> {
        let Start { lattice, particles, params, .. } = start;
        let columns_of = |forces: bool| -> Vec<String> {
            let kind = case.probes.iter().filter(|probe| matches!(probe, Probe::Force { .. }) == forces);
            kind.flat_map(|probe| probe.columns(D)).collect()
        };
        let (mut gauges, mut forces) = (None, None);
        let columns = columns_of(false);
        if !columns.is_empty() {
            let all = Gauges::new(&case.probes, lattice, particles, params);
            gauges = Some((open(folder, "probes.csv", columns, since)?, all));
        }
        let names = case.bodies.iter().map(|body| body.name.as_str());
        let columns = [columns_of(true), bodies::force_columns(names, D)].concat();
        if !columns.is_empty() {
            forces = Some((open(folder, "forces.csv", columns, since)?, Forces::new(case, lattice, params)));
        }
        let schedule = Schedule::new(case.output.gauges, vec![], since.unwrap_or(0.0));
        Ok(Self {
            gauges,
            forces,
            bodies: !case.bodies.is_empty(),
            every_step: case.output.gauges == 0.0,
            schedule,
        })
    }

    /// Rows of the present state.
    pub fn sample(&mut self, simulation: &Simulation<D>) -> Result<()> {
        let (particles, fields) = (&simulation.particles, simulation.scheme.fields());
        let (time, body_force) = (simulation.time, &simulation.body_force);
        if let Some((table, gauges)) = &mut self.gauges {
            table.row(
                &[vec![Cell::Number(time)], gauges.read(particles, &fields, body_force, time)].concat(),
            )?;
        }
        if let Some((table, forces)) = &mut self.forces {
            let forces = forces.read(particles, &fields, body_force);
            let on_bodies = if self.bodies { bodies::forces(simulation.scheme.bodies()) } else { vec![] };
            let components = forces.iter().flat_map(|force| force.iter().copied()).chain(on_bodies);
            table.row(&std::iter::once(time).chain(components).map(Cell::Number).collect::<Vec<_>>())?;
        }
        Ok(())
    }

    /// What filters remember.
    pub fn save(&self, writer: &mut checkpoint::Writer) {
        if let Some((_, gauges)) = &self.gauges {
            gauges.save(writer);
        }
    }

    /// Goes on from a saved state.
    pub fn restore(&mut self, reader: &checkpoint::Reader) -> Result<()> {
        self.gauges.as_mut().map_or(Ok(()), |(_, gauges)| gauges.restore(reader))
    }

    /// Writes out what is pending.
    pub fn flush(&mut self) -> Result<()> {
        let gauges = self.gauges.as_mut().map(|(table, _)| table);
        let forces = self.forces.as_mut().map(|(table, _)| table);
        gauges.into_iter().chain(forces).try_for_each(Table::flush)
    }
}

impl<const D: usize> Observer<D> for Probes<D> {
    fn observe(&mut self, simulation: &Simulation<D>, _: &StepReport) -> Result<()> {
        match self.every_step || self.schedule.due(simulation.time) {
            true => self.sample(simulation),
            false => Ok(()),
        }
    }

    fn is_due(&self, time: f64) -> bool {
        self.every_step || self.schedule.is_due(time)
    }
}

/// solver.csv: a row a pressure solve.
pub struct SolverLog {
    table: Table,
}

/// Pressure systems saved on demand; all ranks save together.
pub struct Systems {
    schedule: Schedule,
    folder: PathBuf,
}

impl Systems {
    /// Saves into `folder` at the instants `times` in s after `since`.
    pub fn new(folder: PathBuf, times: &[f64], since: Option<f64>) -> Self {
        Self { schedule: Schedule::new(0.0, times.to_vec(), since.unwrap_or(0.0)), folder }
    }

    /// Saves the last system if it is time.
    pub fn save_due<const D: usize>(&mut self, simulation: &Simulation<D>) -> Result<()> {
        match self.schedule.due(simulation.time) {
            true => simulation.scheme.save_system(&self.folder, &format!("t{:.6}", simulation.time)),
            false => Ok(()),
        }
    }
}

const SOLVER_COLUMNS: [&str; 12] = [
    "time_s",
    "step",
    "dt_s",
    "unknowns",
    "nonzeros",
    "iterations",
    "inner_iterations",
    "residual",
    "reason",
    "setup_s",
    "solve_s",
    "fallback",
];

impl SolverLog {
    /// Opens the table.
    pub fn new(folder: &RunFolder, since: Option<f64>) -> Result<Self> {
        let path = folder.join("solver.csv");
        let table = match since {
            None => Table::create(&path, &SOLVER_COLUMNS)?,
            Some(time) => Table::resume(&path, &SOLVER_COLUMNS, time)?,
        };
        Ok(Self { table })
    }

    /// Writes out what is pending.
    pub fn flush(&mut self) -> Result<()> {
        self.table.flush()
    }
}

impl<const D: usize> Observer<D> for SolverLog {
    fn observe(&mut self, simulation: &Simulation<D>, report: &StepReport) -> Result<()> {
        let Some(solve) = &report.solve else { return Ok(()) };
        if let Some(fallback) = &solve.fallback {
            log::warn!("step {} at t = {:.6} s: {fallback}", simulation.step, simulation.time);
        }
        self.table.row(&[
            simulation.time.into(),
            simulation.step.into(),
            simulation.dt.into(),
            solve.unknowns.into(),
            solve.nonzeros.into(),
            solve.iterations.into(),
            solve.inner_iterations.into(),
            solve.residual.into(),
            solve.reason.as_str().into(),
            solve.setup_s.into(),
            solve.solve_s.into(),
            solve.fallback.as_deref().unwrap_or("none").into(),
        ])
    }

    fn is_due(&self, _: f64) -> bool {
        false
    }
}

/// Particle files and their collection.
pub struct Snapshots<const D: usize> {
    pvd: Pvd,
    schedule: Schedule,
}

impl<const D: usize> Snapshots<D> {
    /// Collection of a run, or that of a run resumed at time `since`.
    pub fn new(folder: &RunFolder, case: &CaseFile, since: Option<f64>) -> Result<Self> {
        let path = folder.join("particles.pvd");
        let pvd = match since {
            None => Pvd::create(&path),
            Some(time) => Pvd::resume(&path, time)?,
        };
        let instants = case.output.snapshots.clone();
        Ok(Self { pvd, schedule: Schedule::new(case.output.particles, instants, since.unwrap_or(0.0)) })
    }

    /// Writes the present state into the collection.
    pub fn write(&mut self, simulation: &Simulation<D>) -> Result<()> {
        self.pvd.snapshot(simulation.time, |path| write_particles(path, simulation))
    }

    /// Writes a failing state beside the collection.
    pub fn write_failed(&self, folder: &RunFolder, simulation: &Simulation<D>) -> Result<()> {
        write_particles(&folder.join("particles").join("failed.vtp"), simulation)
    }
}

impl<const D: usize> Observer<D> for Snapshots<D> {
    fn observe(&mut self, simulation: &Simulation<D>, _: &StepReport) -> Result<()> {
        match self.schedule.due(simulation.time) {
            true => self.write(simulation),
            false => Ok(()),
        }
    }

    fn is_due(&self, time: f64) -> bool {
        self.schedule.is_due(time)
    }
}

/// Liquid and wall particles (dummies carry nothing of their own) as a VTP file.
fn write_particles<const D: usize>(path: &Path, simulation: &Simulation<D>) -> Result<()> {
    let (particles, fields) = (&simulation.particles, simulation.scheme.fields());
    let shown: Vec<usize> = particles.fluid().chain(particles.walls()).collect();
    let flat = |values: &[Vector<D>]| -> Vec<f64> {
        shown.iter().flat_map(|&a| values[a].iter().copied()).collect()
    };
    // Before the first step a scheme has no fields, and a failing state may have outgrown them.
    let scalar = |values: &[f64], missing: f64| -> Vec<f64> {
        shown.iter().map(|&a| values.get(a).copied().unwrap_or(missing)).collect()
    };
    let pressure = scalar(&particles.pressure, 0.0);
    let (crowding, surface) = (scalar(fields.crowding, 1.0), scalar(fields.surface, 0.0));
    let velocity = flat(&particles.velocity);
    let kind: Vec<u8> = shown.iter().map(|&a| particles.kind(a) as u8).collect();
    let id: Vec<u64> = shown.iter().map(|&a| particles.id[a]).collect();
    write_vtp(
        path,
        D,
        &flat(&particles.position),
        &[
            Field { name: "velocity", data: FieldData::Vector(&velocity, D) },
            Field { name: "pressure", data: FieldData::Scalar(&pressure) },
            Field { name: "crowding", data: FieldData::Scalar(&crowding) },
            Field { name: "surface", data: FieldData::Scalar(&surface) },
            Field { name: "kind", data: FieldData::Byte(&kind) },
            Field { name: "id", data: FieldData::Id(&id) },
        ],
    )
}
