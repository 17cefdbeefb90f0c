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
use crate::scheme::StepReport;
use crate::simulation::{Observer, Simulation};

/// Times at which something is due: every `interval`, and listed instants.
#[derive(Debug, Clone)]
pub(super) struct Schedule {
    every_step: bool,
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
        Self { every_step: false, interval, next, instants }
    }

    /// `interval` 0: after every step.
    pub fn sampling(interval: f64, since: Option<f64>) -> Self {
        Self { every_step: interval == 0.0, ..Self::new(interval, vec![], since.unwrap_or(0.0)) }
    }

    /// Is anything due at `time`?
    pub fn is_due(&self, time: f64) -> bool {
        self.every_step || time >= self.next || self.instants.last().is_some_and(|t| *t <= time)
    }

    /// Is anything due at `time`? Serves it.
    pub fn due(&mut self, time: f64) -> bool {
        let mut due = self.every_step;
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

/// What the rows of the tables tell of the whole scene at one moment.
pub struct Readings<const D: usize> {
    /// Of [`quantities::history`].
    history: Vec<f64>,
    /// Of gauges, in the order of the probes.
    gauges: Vec<Cell<'static>>,
    /// In N, likewise.
    forces: Vec<Vector<D>>,
}

/// What all ranks read together, so that no rank needs to see more than its share of the scene.
pub struct Meters<const D: usize> {
    gauges: Gauges<D>,
    forces: Forces<D>,
}

impl<const D: usize> Meters<D> {
    /// Those of a case that begins as `start`.
    pub fn new(case: &CaseFile, start: &Start<D>) -> Self {
        let Start { lattice, particles, params, .. } = start;
        Self {
            gauges: Gauges::new(&case.probes, lattice, particles, params),
            forces: Forces::new(case, lattice, params),
        }
    }

    /// The present state; all ranks call this.
    pub fn read(&mut self, simulation: &Simulation<D>) -> Readings<D> {
        let Simulation { particles, scheme, body_force, time, .. } = simulation;
        let (fields, holds) = (scheme.fields(), |a: usize| scheme.halo().holds(a));
        let scene = Scene::of(simulation);
        Readings {
            history: quantities::history::<D>().map(|(_, value)| value(&scene)).to_vec(),
            gauges: self.gauges.read(particles, scheme.bodies(), &fields, holds, body_force, *time),
            forces: self.forces.read(particles, &fields, holds, body_force),
        }
    }

    /// What filters remember.
    pub fn save(&self, writer: &mut checkpoint::Writer) {
        self.gauges.save(writer);
    }

    /// Goes on from a saved state.
    ///
    /// # Errors
    /// [`Error::Input`](crate::Error::Input) if it has other filters.
    pub fn restore(&mut self, reader: &checkpoint::Reader) -> Result<()> {
        self.gauges.restore(reader)
    }
}

/// history.csv.
pub struct History {
    table: Table,
    schedule: Schedule,
}

impl History {
    /// Opens the table of a run, or that of a run resumed at time `since`.
    pub fn new<const D: usize>(folder: &RunFolder, case: &CaseFile, since: Option<f64>) -> Result<Self> {
        let columns = quantities::history::<D>().map(|(name, _)| name.to_owned());
        Ok(Self {
            table: open(folder, "history.csv", columns.to_vec(), since)?,
            schedule: Schedule::sampling(case.output.samples, since),
        })
    }

    /// Adds a row.
    pub fn sample<const D: usize>(&mut self, time: f64, readings: &Readings<D>) -> Result<()> {
        let values = std::iter::once(&time).chain(&readings.history);
        self.table.row(&values.copied().map(Cell::Number).collect::<Vec<_>>())
    }

    /// Adds the row that is due.
    pub fn observe<const D: usize>(&mut self, time: f64, readings: &Readings<D>) -> Result<()> {
        match self.schedule.due(time) {
            true => self.sample(time, readings),
            false => Ok(()),
        }
    }

    /// Whether it would add a row at `time` in s.
    pub fn is_due(&self, time: f64) -> bool {
        self.schedule.is_due(time)
    }

    /// Writes out what is pending.
    pub fn flush(&mut self) -> Result<()> {
        self.table.flush()
    }
}

/// probes.csv and forces.csv, each where the case has such probes.
pub struct Probes {
    gauges: Option<Table>,
    forces: Option<Table>,
    schedule: Schedule,
}

impl Probes {
    /// Opens the tables of a run, or those of a run resumed at time `since`.
    pub fn new(folder: &RunFolder, case: &CaseFile, since: Option<f64>) -> Result<Self> {
        let columns_of = |forces: bool| -> Vec<String> {
            let kind = case.probes.iter().filter(|probe| matches!(probe, Probe::Force { .. }) == forces);
            kind.flat_map(|probe| probe.columns(case.dimension)).collect()
        };
        let table = |name: &str, columns: Vec<String>| {
            (!columns.is_empty()).then(|| open(folder, name, columns, since)).transpose()
        };
        let on_bodies = bodies::force_columns(case);
        Ok(Self {
            gauges: table("probes.csv", columns_of(false))?,
            forces: table("forces.csv", [columns_of(true), on_bodies].concat())?,
            schedule: Schedule::sampling(case.output.gauges, since),
        })
    }

    /// Adds rows, with the forces on the bodies of `simulation`.
    pub fn sample<const D: usize>(
        &mut self,
        simulation: &Simulation<D>,
        readings: &Readings<D>,
    ) -> Result<()> {
        let time = [Cell::Number(simulation.time)];
        if let Some(table) = &mut self.gauges {
            table.row(&[&time[..], &readings.gauges].concat())?;
        }
        if let Some(table) = &mut self.forces {
            let on_walls = readings.forces.iter().flat_map(|force| force.iter().copied());
            let (all, slip) = (simulation.scheme.bodies(), simulation.scheme.params().slip);
            let all = on_walls.chain(bodies::forces(all, slip));
            table.row(&time.into_iter().chain(all.map(Cell::Number)).collect::<Vec<_>>())?;
        }
        Ok(())
    }

    /// Adds the rows that are due.
    pub fn observe<const D: usize>(
        &mut self,
        simulation: &Simulation<D>,
        readings: &Readings<D>,
    ) -> Result<()> {
        match self.schedule.due(simulation.time) {
            true => self.sample(simulation, readings),
            false => Ok(()),
        }
    }

    /// Whether it would add rows at `time` in s.
    pub fn is_due(&self, time: f64) -> bool {
        let has_tables = self.gauges.is_some() || self.forces.is_some();
        has_tables && self.schedule.is_due(time)
    }

    /// Writes out what is pending.
    pub fn flush(&mut self) -> Result<()> {
        self.gauges.iter_mut().chain(&mut self.forces).try_for_each(Table::flush)
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

    /// Adds the row of a step.
    pub fn observe<const D: usize>(&mut self, simulation: &Simulation<D>, report: &StepReport) -> Result<()> {
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
