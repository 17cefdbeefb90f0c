//! profiles.csv: how far measured points of the free surface are from that of the liquid (2D).
//!
//! The surface of a run is the set of its surface particles (surface weight above one half), and the liquid ends about half a
//! spacing outside of them: the distance of a measured point is that to the nearest one, less half a spacing, and not below 0.
//! Nearest and not vertical distances, because an overturning front has several heights at one x, and a steep one none that is
//! well defined. That is lenient where spray or enclosed air brings surface particles near: a small distance does not prove that
//! shapes agree, a large one proves that they do not.
//!
//! Each time of the data, less the delay that the case allows for a gate, is compared at the first step that reaches it; errors
//! are over the length that the case names.

use std::path::{Path, PathBuf};

use super::comparison::Columns;
use super::folder::RunFolder;
use super::table::{Cell, Table};
use crate::case::Profile;
use crate::exact::ErrorMeasure;
use crate::scheme::StepReport;
use crate::simulation::{Observer, Simulation};
use crate::{Error, Result};

const COLUMNS: [&str; 5] = ["time_s", "measured_at_s", "points", "rms_m", "largest_m"];

/// Measured points (x, height) in m by their time in s, ascending.
pub type Measured = Vec<(f64, Vec<[f64; 2]>)>;

/// Compares with the measured surfaces as their times come.
pub struct Profiles {
    name: String,
    size: f64,
    spacing: f64,
    delay: f64,
    path: PathBuf,
    table: Table,
    /// Still to come, the next one last.
    ahead: Measured,
}

/// Reads the points of `profile` from `file`.
///
/// # Errors
/// [`Error::Input`] for a file or column that cannot be read.
pub fn read(profile: &Profile, file: &Path) -> Result<Measured> {
    let columns = Columns::read(file, f64::NAN)?;
    let [time, x, height] =
        [&profile.time_column, &profile.x_column, &profile.height_column].map(|name| columns.column(name));
    let mut measured: Measured = vec![];
    for ((time, x), height) in time?.iter().zip(x?).zip(height?) {
        if !(time.is_finite() && x.is_finite() && height.is_finite()) {
            continue;
        }
        match measured.iter_mut().find(|(known, _)| known == time) {
            Some((_, points)) => points.push([*x, *height]),
            None => measured.push((*time, vec![[*x, *height]])),
        }
    }
    if measured.is_empty() {
        return Err(Error::Input(format!(
            "{}: no row has numbers under {}, {} and {}: correct the file",
            file.display(),
            profile.time_column,
            profile.x_column,
            profile.height_column
        )));
    }
    measured.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(measured)
}

impl Profiles {
    /// Opens the table of a run at this particle spacing in m, or that of a run resumed at time `since`.
    pub fn new(
        folder: &RunFolder,
        profile: &Profile,
        measured: Measured,
        spacing: f64,
        since: Option<f64>,
    ) -> Result<Self> {
        let path = folder.join("profiles.csv");
        let table = match since {
            None => Table::create(&path, &COLUMNS)?,
            Some(time) => Table::resume(&path, &COLUMNS, time)?,
        };
        let mut ahead = measured;
        ahead.retain(|(time, _)| since.is_none_or(|since| *time - profile.delay > since));
        ahead.reverse();
        Ok(Self {
            name: profile.name.clone(),
            size: profile.size,
            delay: profile.delay,
            spacing,
            path,
            table,
            ahead,
        })
    }

    /// Writes out what is pending.
    pub fn flush(&mut self) -> Result<()> {
        self.table.flush()
    }

    /// One error for each time compared, and their rms.
    pub fn errors(&mut self) -> Result<Vec<ErrorMeasure>> {
        self.flush()?;
        let columns = Columns::read(&self.path, f64::NAN)?;
        let [time, points, rms, largest] =
            ["measured_at_s", "points", "rms_m", "largest_m"].map(|name| columns.column(name));
        let (time, points, rms, largest) = (time?, points?, rms?, largest?);
        let measure = |name: String, rms: f64, max: f64| ErrorMeasure {
            name,
            rms: rms / self.size,
            max: max / self.size,
            of: format!("{} m", self.size),
        };
        if time.is_empty() {
            return Ok(vec![]);
        }
        let squares: f64 = points.iter().zip(rms).map(|(count, rms)| count * rms * rms).sum();
        let all = (squares / points.iter().sum::<f64>()).sqrt();
        let mut errors = vec![measure(self.name.clone(), all, largest.iter().copied().fold(0.0, f64::max))];
        for ((time, rms), largest) in time.iter().zip(rms).zip(largest) {
            errors.push(measure(format!("{} at {time} s", self.name), *rms, *largest));
        }
        Ok(errors)
    }
}

/// Distances in m of `points` from the surface that `particles` at a `spacing` make.
fn distances(points: &[[f64; 2]], particles: &[[f64; 2]], spacing: f64) -> Vec<f64> {
    let nearest = |p: &[f64; 2]| {
        let distance = |q: &[f64; 2]| (p[0] - q[0]).hypot(p[1] - q[1]);
        particles.iter().map(distance).fold(f64::INFINITY, f64::min)
    };
    points.iter().map(|point| (nearest(point) - 0.5 * spacing).max(0.0)).collect()
}

impl<const D: usize> Observer<D> for Profiles {
    fn observe(&mut self, simulation: &Simulation<D>, _: &StepReport) -> Result<()> {
        while let Some((time, points)) = self.ahead.pop_if(|(time, _)| *time - self.delay <= simulation.time)
        {
            let (particles, fields) = (&simulation.particles, simulation.scheme.fields());
            let on_surface = |a: &usize| fields.surface.get(*a).is_some_and(|s| *s > 0.5);
            let surface: Vec<_> = particles
                .fluid()
                .filter(on_surface)
                .map(|a| [particles.position[a][0], particles.position[a][D - 1]])
                .collect();
            let distances = distances(&points, &surface, self.spacing);
            let squares: f64 = distances.iter().map(|d| d * d).sum();
            let count = distances.len() as f64;
            let largest = distances.iter().copied().fold(0.0, f64::max);
            let row = [simulation.time, time, count, (squares / count).sqrt(), largest];
            self.table.row(&row.map(Cell::Number))?;
        }
        Ok(())
    }

    fn is_due(&self, now: f64) -> bool {
        self.ahead.last().is_some_and(|(time, _)| *time - self.delay <= now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_those_from_half_a_spacing_outside() {
        let row: Vec<_> = (0..10).map(|k| [0.1 * f64::from(k), 0.95]).collect();
        let found = distances(&[[0.3, 1.0], [0.3, 1.2], [0.3, 0.93], [1.2, 0.95]], &row, 0.1);
        for (found, wanted) in found.iter().zip([0.0, 0.2, 0.0, 0.25]) {
            assert!((found - wanted).abs() < 1e-12, "{found} {wanted}");
        }
    }
}
