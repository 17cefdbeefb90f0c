//! Which pictures a run leaves: particles at the listed instants and at the end, gauges and energies over time.

use std::path::PathBuf;

use clap::ValueEnum;

use super::curves::{Series, Style, series_plot};
use super::particles::{Scene, particle_picture};
use crate::Result;
use crate::case::{CaseFile, build::vector};
use crate::output::comparison::{Columns, References};
use crate::output::folder::{RunFolder, make_subfolder};
use crate::particles::Vector;
use crate::scheme::StepReport;
use crate::simulation::{Observer, Simulation};

/// Subfolder of a run that holds its pictures.
pub(crate) const FOLDER: &str = "pictures";
/// Tables whose columns are gauges, each worth a picture.
pub(crate) const GAUGES: [&str; 2] = ["probes.csv", "forces.csv"];
/// Columns of history.csv that share the picture of the energies.
pub(crate) const ENERGIES: [&str; 3] = ["kinetic_energy_j", "potential_energy_j", "energy_j"];

/// Particle pictures of a run, `pictures/t0.400000.png`: at the snapshots of the case, and the last state.
pub struct Pictures<const D: usize> {
    folder: PathBuf,
    name: String,
    spacing: f64,
    tank: Option<(Vector<D>, Vector<D>)>,
    /// Instants still to come in s, the next one last.
    snapshots: Vec<f64>,
}

impl<const D: usize> Pictures<D> {
    /// Pictures of a run, or of a run resumed at time `since`.
    pub fn new(folder: &RunFolder, case: &CaseFile, since: Option<f64>) -> Self {
        let mut snapshots = case.output.snapshots.clone();
        snapshots.retain(|t| since.is_none_or(|since| *t > since));
        snapshots.sort_by(|a, b| b.total_cmp(a));
        Self {
            folder: folder.join(FOLDER),
            name: title(case),
            spacing: case.spacing,
            tank: case.tank.as_ref().map(|tank| (vector(&tank.min), vector(&tank.max))),
            snapshots,
        }
    }

    /// Draws the snapshots that the present state serves, each under the time it was asked for: scripts know that name,
    /// and the title tells the time of the state.
    pub fn draw_due(&mut self, simulation: &Simulation<D>) -> Result<()> {
        while let Some(instant) = self.snapshots.pop_if(|instant| *instant <= simulation.time) {
            self.draw(simulation, instant)?;
        }
        Ok(())
    }

    /// Draws the present state under its own time.
    pub fn draw_last(&self, simulation: &Simulation<D>) -> Result<()> {
        self.draw(simulation, simulation.time)
    }

    fn draw(&self, simulation: &Simulation<D>, name: f64) -> Result<()> {
        make_subfolder(&self.folder)?;
        let particles = &simulation.particles;
        let scene = Scene {
            title: &format!("{}, t = {:.4} s", self.name, simulation.time),
            fluid: &particles.position[particles.fluid()],
            pressure: &particles.pressure[particles.fluid()],
            walls: &particles.position[particles.walls()],
            spacing: self.spacing,
            tank: self.tank,
        };
        particle_picture(&self.folder.join(format!("t{name:.6}.png")), &scene)
    }
}

impl<const D: usize> Observer<D> for Pictures<D> {
    fn observe(&mut self, simulation: &Simulation<D>, _: &StepReport) -> Result<()> {
        self.draw_due(simulation)
    }

    fn is_due(&self, time: f64) -> bool {
        self.snapshots.last().is_some_and(|instant| *instant <= time)
    }
}

/// Draws what the tables of a run hold: a picture a gauge, one of each history column with a measured series, and one of
/// the energies.
///
/// Where a gauge is dry its curve has a gap: a zero would be a measurement.
pub fn write_curves(folder: &RunFolder, case: &CaseFile, references: &References) -> Result<()> {
    make_subfolder(&folder.join(FOLDER))?;
    let history = Columns::read(&folder.join("history.csv"), f64::NAN)?;
    let energies = ENERGIES.map(|column| {
        let label = column.trim_end_matches("_j").replace('_', " ");
        Ok(Series { label, points: history.rows("time_s", column)?, style: Style::Line })
    });
    let energies = energies.into_iter().collect::<Result<Vec<_>>>()?;
    let path = |name: &str| folder.join(FOLDER).join(format!("{name}.png"));
    series_plot(&path("energy"), &format!("{}: energy", title(case)), "time, s", "energy, J", &energies)?;

    let measured = |column: &str| -> Vec<Series> {
        let found = references.measured_in(column);
        let series = found.map(|(name, data)| Series {
            label: name.replace('_', " "),
            points: data.to_vec(),
            style: Style::Points,
        });
        series.collect()
    };
    let draw = |table: &Columns, column: &str, measured: Vec<Series>| {
        let (name, unit) = quantity(column);
        let points = table.rows("time_s", column)?;
        let run = Series { label: "computed".into(), points, style: Style::Line };
        let title = format!("{}: {name}", title(case));
        series_plot(
            &path(column),
            &title,
            "time, s",
            &format!("{name}, {unit}"),
            &[vec![run], measured].concat(),
        )
    };
    for column in history.names().filter(|name| *name != "time_s") {
        let measured = measured(column);
        if !measured.is_empty() {
            draw(&history, column, measured)?;
        }
    }
    for table in GAUGES.map(|name| folder.join(name)).iter().filter(|table| table.is_file()) {
        let table = Columns::read(table, f64::NAN)?;
        for column in table.names().filter(|name| *name != "time_s") {
            draw(&table, column, measured(column))?;
        }
    }
    Ok(())
}

/// What stands above every picture of a run.
fn title(case: &CaseFile) -> String {
    let scheme = case.scheme.kind.to_possible_value();
    let scheme = scheme.map(|kind| kind.get_name().to_uppercase()).unwrap_or_default();
    format!("{}, {scheme}", case.name)
}

/// Name and unit of a column such as `p1_pa`.
pub(crate) fn quantity(column: &str) -> (String, &'static str) {
    let units = [("_pa", "Pa"), ("_m", "m"), ("_n", "N"), ("_j", "J"), ("_m_per_s", "m/s"), ("_kg", "kg")];
    // The longest: `_m_per_s` ends in `_s`, not in `_m`.
    let found = units.iter().filter_map(|(end, unit)| Some((column.strip_suffix(end)?, *unit)));
    let (name, unit) = found.min_by_key(|(name, _)| name.len()).unwrap_or((column, "1"));
    (name.replace('_', " "), unit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_name_their_units() {
        assert_eq!(quantity("p_bottom_pa"), ("p bottom".into(), "Pa"));
        assert_eq!(quantity("h1_m"), ("h1".into(), "m"));
        assert_eq!(quantity("fastest_m_per_s"), ("fastest".into(), "m/s"));
        assert_eq!(quantity("kernel_volume"), ("kernel volume".into(), "1"));
    }
}
