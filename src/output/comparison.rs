//! A finished run against what its case refers to: measured series and times of named events.

use std::collections::BTreeMap;
use std::path::Path;

use super::quantities;
use crate::case::{Arrival, CaseFile, Reference};
use crate::{Error, Result};

/// What a run is compared with, read and proven before it starts.
#[derive(Debug)]
pub struct References<'a> {
    series: Vec<Series<'a>>,
    arrivals: &'a [Arrival],
    /// A particle stands for water up to half a spacing ahead of it and stops half a spacing from a wall.
    reach: f64,
}

/// A measured series in SI units.
#[derive(Debug)]
struct Series<'a> {
    reference: &'a Reference,
    /// Times and values, ascending in time.
    data: Vec<(f64, f64)>,
}

/// How a finished run compares with what its case refers to.
#[derive(Debug, Clone, Default)]
pub struct Comparison {
    /// Differences from measured series.
    pub series: Vec<SeriesError>,
    /// Times of named events.
    pub arrivals: Vec<ArrivalTime>,
}

/// Difference of a history column from a reference series; the measures are NaN where no value was reached.
#[derive(Debug, Clone)]
pub struct SeriesError {
    /// Name of the reference.
    pub name: String,
    /// Values compared.
    pub count: usize,
    /// Root mean square difference over the mean of the reference values.
    pub rms: f64,
    /// Largest difference over the mean of the reference values.
    pub largest: f64,
    /// Time shift in s of the run that makes the rms smallest, and that rms.
    pub best_shift: (f64, f64),
}

/// When a quantity reached a level.
#[derive(Debug, Clone)]
pub struct ArrivalTime {
    /// What was expected.
    pub expected: Arrival,
    /// When it happened, in s; `None`: not within the run.
    pub time: Option<f64>,
}

impl<'a> References<'a> {
    /// Reads `files`, the data of the case's references.
    ///
    /// # Errors
    /// [`Error::Input`] for a file or column that cannot be read and for a quantity that no run records.
    pub fn read(case: &'a CaseFile, files: &[(&'a Reference, &'a Path)]) -> Result<Self> {
        let references = case.references.iter().map(|reference| ("reference", &reference.quantity));
        let arrivals = case.arrivals.iter().map(|arrival| ("arrival", &arrival.quantity));
        for (what, quantity) in references.chain(arrivals) {
            let columns = quantities::history::<2>().map(|(name, _)| name);
            if column_of(quantity, columns).is_none() {
                return Err(Error::Input(format!(
                    "{what}: history.csv has no column {quantity}: choose among {}",
                    columns.join(", ")
                )));
            }
        }
        let series = files.iter().map(|(reference, file)| Series::read(reference, file));
        Ok(Self { series: series.collect::<Result<_>>()?, arrivals: &case.arrivals, reach: case.spacing })
    }

    /// Names and values over times in s of the measured series that a column of a run's tables is compared with.
    pub fn measured_in(&self, column: &str) -> impl Iterator<Item = (&str, &[(f64, f64)])> {
        let series =
            self.series.iter().filter(move |series| column_of(series.quantity(), [column]).is_some());
        series.map(|series| (series.reference.name.as_str(), series.data.as_slice()))
    }

    /// Compares the table `history` of a run.
    ///
    /// # Errors
    /// [`Error::Input`] if it cannot be read.
    pub fn compare(&self, history: &Path) -> Result<Comparison> {
        if self.series.is_empty() && self.arrivals.is_empty() {
            return Ok(Comparison::default());
        }
        let columns = Columns::read(history)?;
        let run_of = |quantity: &str| -> Result<Vec<(f64, f64)>> {
            let name = column_of(quantity, columns.names()).unwrap_or(quantity);
            columns.pairs("time_s", name)
        };
        let series = self.series.iter().map(|series| Ok(series.errors_of(&run_of(series.quantity())?)));
        let arrivals = self.arrivals.iter().map(|expected| {
            let run = run_of(&expected.quantity)?;
            let reached = run.iter().find(|(_, value)| *value >= expected.level - self.reach);
            Ok(ArrivalTime { expected: expected.clone(), time: reached.map(|(time, _)| *time) })
        });
        Ok(Comparison { series: series.collect::<Result<_>>()?, arrivals: arrivals.collect::<Result<_>>()? })
    }
}

impl<'a> Series<'a> {
    fn read(reference: &'a Reference, file: &Path) -> Result<Self> {
        let pairs = Columns::read(file)?.pairs(&reference.time_column, &reference.value_column)?;
        let mut data: Vec<_> = pairs
            .into_iter()
            .filter(|(_, value)| reference.value_min.is_none_or(|least| *value >= least))
            .map(|(time, value)| (time * reference.time_unit, value * reference.value_unit))
            .collect();
        if data.is_empty() {
            return Err(Error::Input(format!(
                "{}: no row has numbers under {} and {}: correct the file",
                file.display(),
                reference.time_column,
                reference.value_column
            )));
        }
        data.sort_by(|a, b| a.0.total_cmp(&b.0));
        Ok(Self { reference, data })
    }

    fn quantity(&self) -> &str {
        &self.reference.quantity
    }

    fn errors_of(&self, run: &[(f64, f64)]) -> SeriesError {
        let end = run.last().map_or(0.0, |(time, _)| *time);
        let reached = &self.data[..self.data.partition_point(|(time, _)| *time <= end)];
        let count = reached.len() as f64;
        let mean = reached.iter().map(|(_, v)| v.abs()).sum::<f64>() / count;
        let errors = |shift: f64| reached.iter().map(move |(t, v)| (interpolate(run, t - shift) - v) / mean);
        let rms = |shift: f64| (errors(shift).map(|e| e * e).sum::<f64>() / count).sqrt();
        // A tenth of the compared span either way, in five hundred steps: finer than the samples.
        let span = reached.last().map_or(0.0, |(t, _)| 0.1 * t);
        let best = (-500..=500)
            .map(|k| span * f64::from(k) / 500.0)
            .map(|shift| (shift, rms(shift)))
            .min_by(|a, b| a.1.total_cmp(&b.1));
        SeriesError {
            name: self.reference.name.clone(),
            count: reached.len(),
            rms: rms(0.0),
            largest: errors(0.0).map(f64::abs).reduce(f64::max).unwrap_or(f64::NAN),
            best_shift: best.unwrap_or_default(),
        }
    }
}

/// The column that records a quantity: of its name, or of its name and a unit.
fn column_of<'a>(quantity: &str, columns: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let names = |column: &&str| {
        column.strip_prefix(quantity).is_some_and(|unit| unit.is_empty() || unit.starts_with('_'))
    };
    columns.into_iter().find(names)
}

/// Linear interpolation in a series with ascending times; constant beyond its ends.
fn interpolate(series: &[(f64, f64)], time: f64) -> f64 {
    let after = series.partition_point(|(t, _)| *t < time);
    match (after.checked_sub(1).map(|k| series[k]), series.get(after)) {
        (Some((t0, v0)), Some(&(t1, v1))) => v0 + (v1 - v0) * (time - t0) / (t1 - t0),
        (Some((_, v)), None) | (None, Some(&(_, v))) => v,
        (None, None) => f64::NAN,
    }
}

/// A CSV file by columns; words count as NaN.
pub(super) struct Columns {
    file: String,
    columns: BTreeMap<String, Vec<f64>>,
}

impl Columns {
    pub(super) fn read(path: &Path) -> Result<Self> {
        let file = path.display().to_string();
        let text = std::fs::read_to_string(path).map_err(|error| {
            Error::Input(format!("{file}: cannot be read ({error}): check its path and contents"))
        })?;
        let mut lines = text.lines().filter(|line| !line.trim().is_empty() && !line.starts_with('#'));
        let names: Vec<&str> = lines.next().unwrap_or_default().split(',').map(str::trim).collect();
        let mut columns: BTreeMap<String, Vec<f64>> =
            names.iter().map(|name| ((*name).to_owned(), vec![])).collect();
        for line in lines {
            let mut cells = line.split(',').map(|cell| cell.trim().parse().unwrap_or(f64::NAN));
            for name in &names {
                // A short line lacks its last values: it must not shift those of the next.
                columns.entry((*name).to_owned()).or_default().push(cells.next().unwrap_or(f64::NAN));
            }
        }
        Ok(Self { file, columns })
    }

    pub(super) fn names(&self) -> impl Iterator<Item = &str> {
        self.columns.keys().map(String::as_str)
    }

    fn column(&self, name: &str) -> Result<&[f64]> {
        self.columns.get(name).map(Vec::as_slice).ok_or_else(|| {
            let known = self.names().collect::<Vec<_>>().join(", ");
            Error::Input(format!("{} has no column {name}: it has {known}", self.file))
        })
    }

    /// All rows of two columns.
    pub(super) fn rows(&self, first: &str, second: &str) -> Result<Vec<(f64, f64)>> {
        Ok(self.column(first)?.iter().copied().zip(self.column(second)?.iter().copied()).collect())
    }

    /// Rows that have numbers in both columns.
    fn pairs(&self, first: &str, second: &str) -> Result<Vec<(f64, f64)>> {
        let rows = self.rows(first, second)?.into_iter();
        Ok(rows.filter(|(a, b)| a.is_finite() && b.is_finite()).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantities_are_found_with_and_without_unit() {
        let columns = ["front_m", "kinetic_energy_j", "particles"];
        assert_eq!(column_of("front", columns), Some("front_m"));
        assert_eq!(column_of("front_m", columns), Some("front_m"));
        assert_eq!(column_of("particles", columns), Some("particles"));
        assert_eq!(column_of("fro", columns), None);
    }

    #[test]
    fn a_late_run_is_found_by_its_shift() {
        let reference = Reference {
            name: "ramp".into(),
            source: String::new(),
            quantity: "front".into(),
            time_column: "t".into(),
            time_unit: 1.0,
            value_column: "x".into(),
            value_unit: 1.0,
            value_min: None,
        };
        let series = Series { reference: &reference, data: (0..=10).map(|k| (k.into(), k.into())).collect() };
        let run: Vec<(f64, f64)> =
            (-20..=30).map(|k| (0.5 * f64::from(k), 0.5 * f64::from(k) - 0.5)).collect();
        let found = series.errors_of(&run);
        assert_eq!(found.count, 11);
        assert!((found.rms - 0.1).abs() < 1e-12 && (found.largest - 0.1).abs() < 1e-12, "{found:?}");
        assert!((found.best_shift.0 + 0.5).abs() < 1e-12 && found.best_shift.1 < 1e-12, "{found:?}");
        let early = series.errors_of(&[(-1.0, 0.0)]);
        assert!(early.count == 0 && early.rms.is_nan(), "no values, no figures");
    }
}
