//! exact.csv: found and exact values of a case with a known solution.

use std::path::PathBuf;

use super::comparison::Columns;
use super::folder::RunFolder;
use super::observers::Schedule;
use super::quantities::Scene;
use super::table::{Cell, Table};
use crate::Result;
use crate::exact::{self, ErrorMeasure, Exact};
use crate::scheme::StepReport;
use crate::simulation::{Observer, Simulation};

/// Writes exact.csv, at the same times as history.csv.
pub struct ExactLog<const D: usize> {
    exact: Box<dyn Exact<D>>,
    path: PathBuf,
    table: Table,
    schedule: Schedule,
}

impl<const D: usize> ExactLog<D> {
    /// Opens the table of a run, or that of a run resumed at time `since`; `interval` in s, 0 for every step.
    pub fn new(
        folder: &RunFolder,
        exact: Box<dyn Exact<D>>,
        interval: f64,
        since: Option<f64>,
    ) -> Result<Self> {
        let path = folder.join("exact.csv");
        let mut columns = vec!["time_s".to_owned()];
        for quantity in exact.quantities() {
            columns.extend([quantity.column.to_owned(), exact_column(quantity.column)]);
        }
        let table = match since {
            None => Table::create(&path, &columns)?,
            Some(time) => Table::resume(&path, &columns, time)?,
        };
        Ok(Self { exact, path, table, schedule: Schedule::sampling(interval, since) })
    }

    /// Adds the row of the present state.
    pub fn sample(&mut self, simulation: &Simulation<D>) -> Result<()> {
        let scene = Scene::of(simulation);
        let mut row = vec![Cell::Number(simulation.time)];
        for (found, exact) in self.exact.compare(&scene, simulation.time) {
            row.extend([Cell::Number(found), Cell::Number(exact)]);
        }
        self.table.row(&row)
    }

    /// Writes out what is pending.
    pub fn flush(&mut self) -> Result<()> {
        self.table.flush()
    }

    /// Errors of all that the table holds, a resumed run's earlier part included.
    pub fn errors(&mut self) -> Result<Vec<ErrorMeasure>> {
        self.flush()?;
        let columns = Columns::read(&self.path, f64::NAN)?;
        let pairs = |column: &str| -> Result<Vec<(f64, f64)>> {
            let (found, exact) = (columns.column(column)?, columns.column(&exact_column(column))?);
            Ok(found.iter().copied().zip(exact.iter().copied()).collect())
        };
        let quantities = self.exact.quantities();
        let series = quantities.iter().map(|quantity| pairs(quantity.column));
        Ok(exact::errors(
            self.exact.as_ref(),
            columns.column("time_s")?,
            &series.collect::<Result<Vec<_>>>()?,
        ))
    }
}

fn exact_column(column: &str) -> String {
    format!("exact_{column}")
}

impl<const D: usize> Observer<D> for ExactLog<D> {
    fn observe(&mut self, simulation: &Simulation<D>, _: &StepReport) -> Result<()> {
        match self.schedule.due(simulation.time) {
            true => self.sample(simulation),
            false => Ok(()),
        }
    }

    fn is_due(&self, time: f64) -> bool {
        self.schedule.is_due(time)
    }
}
