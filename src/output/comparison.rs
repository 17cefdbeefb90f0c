//! A finished run against what its case refers to: measured series and times of named events.
//!
//! Measures are defined on pairs of series, the run's u(t) and the data d(t), both linearly interpolated to the times t_k
//! of a window: the data's own, or a uniform grid where the case asks for one. A dry gauge counts as 0.
//!
//! - rms and largest difference: of (u(t_k) - d(t_k)) / N. N is named by the case: the mean of |d| over the window,
//!   the largest |d| of all the data, or a number.
//! - best shift: the constant s within +-`shift_max` for which the rms of u(t - s) - d(t) is least, and that rms.
//! - peak: the largest value of a running mean and its time, for both.
//! - noise: the rms of a series minus its running mean, for both.
//!
//! Running means are centred, and narrow symmetrically towards the ends of the window: a straight line is its own.

use std::collections::BTreeMap;
use std::path::Path;

use super::probes::DRY;
use super::table::column_of;
use crate::case::{Arrival, CaseFile, Normalise, Reference};
use crate::{Error, Result};

/// Tables of a run that hold quantities.
const TABLES: [&str; 4] = ["history.csv", "probes.csv", "forces.csv", "bodies.csv"];
/// Columns of the first of these that tell of the flow as a whole.
const HISTORY: [&str; 3] = ["front_m", "kinetic_energy_j", "centre_height_m"];
/// Steps on either side in the search for the best time shift.
const SHIFTS: i32 = 300;

/// A time in s and a value there.
type Point = (f64, f64);

/// What a run is compared with, read and proven before it starts.
#[derive(Debug)]
pub struct References<'a> {
    series: Vec<Series<'a>>,
    arrivals: &'a [Arrival],
    missing: Vec<&'a Reference>,
    /// A particle stands for water up to half a spacing ahead of it and stops half a spacing from a wall.
    reach: f64,
}

/// A measured series in SI units.
#[derive(Debug)]
struct Series<'a> {
    reference: &'a Reference,
    /// Ascending in time.
    data: Vec<Point>,
}

/// How a finished run compares with what its case refers to.
#[derive(Debug, Clone, Default)]
pub struct Comparison {
    /// Differences from measured series, one for each window.
    pub series: Vec<SeriesError>,
    /// Times of named events.
    pub arrivals: Vec<ArrivalTime>,
    /// References whose data were not given, with the usual names of their files.
    pub missing: Vec<(String, Option<String>)>,
}

/// Difference of a run from a reference series in one window; measures are NaN where no value was reached.
#[derive(Debug, Clone)]
pub struct SeriesError {
    /// Name of the reference.
    pub name: String,
    /// First and last time compared in s; the window as far as run and data reach.
    pub window: (f64, f64),
    /// Values compared.
    pub count: usize,
    /// What differences are divided by, in words.
    pub normalised_by: String,
    /// That size in SI units.
    pub size: f64,
    /// Root mean square difference over `size`.
    pub rms: f64,
    /// Largest difference over `size`.
    pub largest: f64,
    /// Time shift in s of the run that makes the rms smallest, and that rms.
    pub best_shift: (f64, f64),
    /// Peaks of the running means, if asked for.
    pub peak: Option<Pair<Point>>,
    /// Noise in SI units, if asked for.
    pub noise: Option<Pair<f64>>,
}

/// The same measure of a run and of its reference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair<T> {
    /// Of the run.
    pub run: T,
    /// Of the reference.
    pub reference: T,
}

/// When a quantity reached a level.
#[derive(Debug, Clone)]
pub struct ArrivalTime {
    /// What was asked.
    pub arrival: Arrival,
    /// When it should, in s: as the case says or as the data tell; `None`: neither does.
    pub expected: Option<f64>,
    /// When it happened, in s; `None`: not within the run.
    pub time: Option<f64>,
}

impl<'a> References<'a> {
    /// Reads `files`, the data of the case's references.
    ///
    /// # Errors
    /// [`Error::Input`] for a file or column that cannot be read.
    pub fn read(case: &'a CaseFile, files: &[(&'a Reference, &'a Path)]) -> Result<Self> {
        let series = files.iter().map(|(reference, file)| Series::read(reference, file));
        let is_given = |reference: &&Reference| files.iter().any(|(given, _)| given.name == reference.name);
        Ok(Self {
            series: series.collect::<Result<_>>()?,
            arrivals: &case.arrivals,
            missing: case.references.iter().filter(|reference| !is_given(reference)).collect(),
            reach: case.spacing,
        })
    }

    /// Names and values over times in s of the measured series that a column of a run's tables is compared with.
    pub fn measured_in(&self, column: &str) -> impl Iterator<Item = (&str, &[(f64, f64)])> {
        let series = self
            .series
            .iter()
            .filter(move |series| column_of(&series.reference.quantity, [column]).is_some());
        series.map(|series| (series.reference.name.as_str(), series.data.as_slice()))
    }

    /// Compares the tables in the folder of a run.
    ///
    /// # Errors
    /// [`Error::Input`] if one cannot be read.
    pub fn compare(&self, folder: &Path) -> Result<Comparison> {
        let missing = self.missing.iter().map(|r| (r.name.clone(), r.file.clone())).collect();
        if self.series.is_empty() && self.arrivals.is_empty() {
            return Ok(Comparison { missing, ..Comparison::default() });
        }
        let files = TABLES.map(|name| folder.join(name)).into_iter().filter(|file| file.exists());
        let tables = files.map(|file| Columns::read(&file, 0.0)).collect::<Result<Vec<_>>>()?;
        let run_of = |quantity: &str| -> Result<Vec<Point>> {
            let found = tables.iter().find_map(|t| Some((t, column_of(quantity, t.names())?)));
            found.map_or(Ok(vec![]), |(table, name)| table.pairs("time_s", name))
        };
        let mut series = vec![];
        for one in &self.series {
            series.extend(one.errors_of(&run_of(&one.reference.quantity)?));
        }
        let arrivals = self.arrivals.iter().map(|arrival| self.arrival(arrival, &run_of(&arrival.quantity)?));
        Ok(Comparison { series, arrivals: arrivals.collect::<Result<_>>()?, missing })
    }

    fn arrival(&self, arrival: &Arrival, run: &[Point]) -> Result<ArrivalTime> {
        let is_front = column_of(&arrival.quantity, ["front_m"]).is_some();
        let reach = if is_front { self.reach } else { 0.0 };
        let named = |name: &String| self.series.iter().find(|series| series.reference.name == *name);
        let told = arrival.reference.as_ref().and_then(named).and_then(|s| reached(&s.data, arrival.level));
        Ok(ArrivalTime {
            arrival: arrival.clone(),
            expected: arrival.expected_time.or(told),
            time: reached(run, arrival.level - reach),
        })
    }
}

/// Relative rms differences of the tables of one run from those of another, by column: of the values at the other's times, as
/// far as both reach, over the largest |value| of the other. Columns that the other has at 0 throughout are left out.
///
/// # Errors
/// [`Error::Input`] for a table that cannot be read.
pub fn differences(run: &Path, other: &Path) -> Result<Vec<(String, f64)>> {
    let mut found = vec![];
    for table in TABLES {
        let files = [run, other].map(|folder| folder.join(table));
        if !files.iter().all(|file| file.exists()) {
            continue;
        }
        let [own, theirs] = [Columns::read(&files[0], 0.0)?, Columns::read(&files[1], 0.0)?];
        let is_wanted = |name: &&str| {
            let known = table != TABLES[0] || HISTORY.contains(name);
            *name != "time_s" && known && own.columns.contains_key(*name)
        };
        for name in theirs.names().filter(is_wanted) {
            let (own, theirs) = (own.pairs("time_s", name)?, theirs.pairs("time_s", name)?);
            let last = own.last().map_or(f64::NEG_INFINITY, |(time, _)| *time);
            let theirs: Vec<_> = theirs.into_iter().filter(|(time, _)| *time <= last).collect();
            let times: Vec<f64> = theirs.iter().map(|(time, _)| *time).collect();
            let size = theirs.iter().map(|(_, value)| value.abs()).fold(0.0, f64::max);
            let values = sampled(&own, &times, 0.0).into_iter().zip(&theirs);
            let error = rms(&values.map(|(a, (_, b))| (a - b) / size).collect::<Vec<_>>());
            found.extend(Some((format!("{name}_rms"), error)).filter(|_| size > 0.0 && error.is_finite()));
        }
    }
    Ok(found)
}

/// The first time at which a series is at a level or above.
fn reached(series: &[Point], level: f64) -> Option<f64> {
    series.iter().find(|(_, value)| *value >= level).map(|(time, _)| *time)
}

impl<'a> Series<'a> {
    fn read(reference: &'a Reference, file: &Path) -> Result<Self> {
        let pairs = Columns::read(file, 0.0)?.pairs(&reference.time_column, &reference.value_column)?;
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

    fn errors_of(&self, run: &[Point]) -> Vec<SeriesError> {
        match self.reference.windows.is_empty() {
            true => vec![self.error_within(run, 0.0, f64::INFINITY)],
            false => self.reference.windows.iter().map(|w| self.error_within(run, w[0], w[1])).collect(),
        }
    }

    /// Times of comparison from `from` to `until`, as far as both series reach.
    fn times(&self, run: &[Point], from: f64, until: f64) -> Vec<f64> {
        let last = |series: &[Point]| series.last().map_or(f64::NEG_INFINITY, |(time, _)| *time);
        let end = until.min(last(run)).min(last(&self.data));
        let Some(grid) = self.reference.grid else {
            let times = self.data.iter().map(|(time, _)| *time);
            return times.filter(|time| (from..=end).contains(time)).collect();
        };
        let start = from.max(self.data[0].0);
        let steps = ((end - start) / grid + 1e-6).floor();
        (0..).map(f64::from).take_while(|k: &f64| *k <= steps).map(|k| start + k * grid).collect()
    }

    fn error_within(&self, run: &[Point], from: f64, until: f64) -> SeriesError {
        let reference = self.reference;
        let times = self.times(run, from, until);
        let data = sampled(&self.data, &times, 0.0);
        let count = times.len() as f64;
        let (size, normalised_by) = match reference.normalise {
            Normalise::Mean => {
                (data.iter().map(|d| d.abs()).sum::<f64>() / count, "mean of the data compared")
            }
            Normalise::Max => {
                (self.data.iter().map(|(_, d)| d.abs()).fold(0.0, f64::max), "largest of all the data")
            }
            Normalise::By(size) => (size, "given size"),
        };
        let differences =
            |run: &[f64]| -> Vec<f64> { run.iter().zip(&data).map(|(u, d)| (u - d) / size).collect() };
        let values = sampled(run, &times, 0.0);
        let raw = differences(&values);
        // Without a limit a tenth of the time compared, either way.
        let limit = reference.shift_max.unwrap_or(0.1 * times.last().copied().unwrap_or(0.0));
        let best_shift = (-SHIFTS..=SHIFTS)
            .map(|k| limit * f64::from(k) / f64::from(SHIFTS))
            .map(|shift| (shift, rms(&differences(&sampled(run, &times, shift)))))
            .min_by(|a, b| a.1.total_cmp(&b.1).then(a.0.abs().total_cmp(&b.0.abs())));
        let both = |window: Option<f64>| window.filter(|_| !times.is_empty()).zip(reference.grid);
        let peak = both(reference.mean).map(|(window, grid)| {
            let of = |values: &[f64]| {
                let means = times.iter().copied().zip(running_mean(values, window / grid));
                // Of equal ones the earliest.
                means.rev().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((f64::NAN, f64::NAN))
            };
            Pair { run: of(&values), reference: of(&data) }
        });
        let noise = both(reference.noise).map(|(window, grid)| {
            let of = |values: &[f64]| {
                let means = running_mean(values, window / grid);
                rms(&values.iter().zip(means).map(|(value, mean)| value - mean).collect::<Vec<_>>())
            };
            Pair { run: of(&values), reference: of(&data) }
        });
        let end = |time: Option<&f64>| time.copied().unwrap_or(f64::NAN);
        SeriesError {
            name: reference.name.clone(),
            window: (end(times.first()), end(times.last())),
            count: times.len(),
            normalised_by: normalised_by.to_owned(),
            size,
            rms: rms(&raw),
            largest: raw.iter().map(|e| e.abs()).reduce(f64::max).unwrap_or(f64::NAN),
            best_shift: best_shift.unwrap_or_default(),
            peak,
            noise,
        }
    }
}

/// Root mean square; NaN of nothing.
fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|e| e * e).sum::<f64>() / values.len() as f64).sqrt()
}

/// A series shifted by `shift` s towards later times, linearly interpolated to ascending `times`; constant beyond its ends.
fn sampled(series: &[Point], times: &[f64], shift: f64) -> Vec<f64> {
    let mut after = 0;
    let value = |time: &f64| {
        let time = time - shift;
        while series.get(after).is_some_and(|(t, _)| *t < time) {
            after += 1;
        }
        match (after.checked_sub(1).map(|k| series[k]), series.get(after)) {
            (Some((t0, v0)), Some(&(t1, v1))) => v0 + (v1 - v0) * (time - t0) / (t1 - t0),
            (Some((_, v)), None) | (None, Some(&(_, v))) => v,
            (None, None) => f64::NAN,
        }
    };
    times.iter().map(value).collect()
}

/// Means over `window` steps centred on each value by the trapezoidal rule, over fewer near the ends.
fn running_mean(values: &[f64], window: f64) -> Vec<f64> {
    // Integral from the first value to each.
    let mut integral = vec![0.0];
    for pair in values.windows(2) {
        integral.push(integral[integral.len() - 1] + 0.5 * (pair[0] + pair[1]));
    }
    let half = (0.5 * window).round() as usize;
    let mean = |(k, value): (usize, &f64)| match half.min(k).min(values.len() - 1 - k) {
        0 => *value,
        reach => (integral[k + reach] - integral[k - reach]) / (2 * reach) as f64,
    };
    values.iter().enumerate().map(mean).collect()
}

/// A CSV file by columns; words are NaN.
pub(super) struct Columns {
    file: String,
    columns: BTreeMap<String, Vec<f64>>,
}

impl Columns {
    /// Reads `path`, with the number `dry` where a gauge was: 0 to compare with, NaN for a gap in a curve.
    pub fn read(path: &Path, dry: f64) -> Result<Self> {
        let file = path.display().to_string();
        let text = std::fs::read_to_string(path).map_err(|error| {
            Error::Input(format!("{file}: cannot be read ({error}): check its path and contents"))
        })?;
        let mut lines = text.lines().filter(|line| !line.trim().is_empty() && !line.starts_with('#'));
        let names: Vec<&str> = lines.next().unwrap_or_default().split(',').map(str::trim).collect();
        let mut columns: Vec<Vec<f64>> = vec![vec![]; names.len()];
        let number = |cell: &str| match cell.trim() {
            DRY => dry,
            cell => cell.parse().unwrap_or(f64::NAN),
        };
        for line in lines {
            let mut cells = line.split(',').map(number);
            for column in &mut columns {
                // A short line lacks its last values: it must not shift those of the next.
                column.push(cells.next().unwrap_or(f64::NAN));
            }
        }
        Ok(Self { file, columns: names.into_iter().map(str::to_owned).zip(columns).collect() })
    }

    pub(super) fn names(&self) -> impl Iterator<Item = &str> {
        self.columns.keys().map(String::as_str)
    }

    pub fn column(&self, name: &str) -> Result<&[f64]> {
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
    use std::f64::consts::PI;

    fn reference() -> Reference {
        Reference {
            name: "ramp".into(),
            source: String::new(),
            file: None,
            quantity: "front".into(),
            time_column: "t".into(),
            time_unit: 1.0,
            value_column: "x".into(),
            value_unit: 1.0,
            value_min: None,
            normalise: Normalise::Mean,
            windows: vec![],
            grid: None,
            shift_max: None,
            mean: None,
            noise: None,
        }
    }

    /// `value` at `count` + 1 times from 0 to `end` s.
    fn series(end: f64, count: i32, value: impl Fn(f64) -> f64) -> Vec<Point> {
        (0..=count).map(|k| end * f64::from(k) / f64::from(count)).map(|t| (t, value(t))).collect()
    }

    fn near(a: f64, b: f64) -> bool {
        (a - b).abs() < 1e-9
    }

    #[test]
    fn a_late_run_is_found_by_its_shift() {
        let reference = reference();
        let data = Series { reference: &reference, data: series(10.0, 10, |t| t) };
        let run: Vec<Point> = (-20..=30).map(|k| (0.5 * f64::from(k), 0.5 * f64::from(k) - 0.5)).collect();
        let found = &data.errors_of(&run)[0];
        assert_eq!((found.count, found.size), (11, 5.0));
        assert!(near(found.rms, 0.1) && near(found.largest, 0.1), "{found:?}");
        assert!(near(found.best_shift.0, -0.5) && found.best_shift.1 < 1e-12, "{found:?}");
        let early = &data.errors_of(&[(-1.0, 0.0)])[0];
        assert!(early.count == 0 && early.rms.is_nan(), "no values, no figures");
    }

    #[test]
    fn windows_grids_and_sizes_are_as_named() {
        let mut reference = Reference { grid: Some(0.5), shift_max: Some(0.03), ..reference() };
        reference.windows = vec![vec![2.0, 4.0], vec![0.0, 100.0]];
        // The data say 4 throughout but -8 at the end; the run says 5 until 3 s and 4 after.
        let mut measured = series(10.0, 10, |_| 4.0);
        measured[10].1 = -8.0;
        let run = series(6.0, 6000, |t| if t <= 3.0 { 5.0 } else { 4.0 });
        for (normalise, size) in [(Normalise::Mean, 4.0), (Normalise::Max, 8.0), (Normalise::By(0.5), 0.5)] {
            reference.normalise = normalise;
            let found = Series { reference: &reference, data: measured.clone() }.errors_of(&run);
            assert_eq!((found[0].count, found[0].window), (5, (2.0, 4.0)));
            assert_eq!((found[1].count, found[1].window), (13, (0.0, 6.0)), "as far as the run reaches");
            for (error, share) in found.iter().zip([3.0 / 5.0, 7.0 / 13.0_f64]) {
                assert!(near(error.size, size) && near(error.largest, 1.0 / size), "{error:?}");
                assert!(near(error.rms, share.sqrt() / size), "{error:?}");
                assert!(error.best_shift.0.abs() <= 0.03 && error.best_shift.1 <= error.rms);
            }
        }
    }

    #[test]
    fn peaks_are_those_of_the_running_mean() {
        let reference = Reference { grid: Some(0.001), mean: Some(0.01), ..reference() };
        // A spike of one sample at 0.2 s, and a hat 0.04 s wide at its foot at 0.5 s.
        let hat = |at: f64, t: f64| (1.0 - (t - at).abs() / 0.02).max(0.0);
        let spiked = |t: f64| hat(0.5, t) + if (t - 0.2).abs() < 1e-9 { 3.0 } else { 0.0 };
        let data = Series { reference: &reference, data: series(1.0, 1000, spiked) };
        let peak = data.errors_of(&series(1.0, 1000, |t| 2.0 * hat(0.51, t)))[0].peak.unwrap();
        // The mean of the hat over +-5 ms: 1 - 2.5 / 20.
        assert!(near(peak.reference.0, 0.5) && near(peak.reference.1, 0.875), "{peak:?}");
        assert!(near(peak.run.0, 0.51) && near(peak.run.1, 1.75), "{peak:?}");
    }

    #[test]
    fn noise_is_what_is_left_of_the_running_mean() {
        let reference = Reference { grid: Some(0.001), noise: Some(0.02), ..reference() };
        let data = Series { reference: &reference, data: series(1.0, 1000, |t| 7.0 * t) };
        let run = series(1.0, 1000, |t| 100.0 * t + 3.0 * (2.0 * PI * t / 0.02).sin());
        let noise = data.errors_of(&run)[0].noise.unwrap();
        // The mean of a sine over its period is none; the first and last 10 ms are cut short.
        assert!((noise.run - 3.0 / 2.0_f64.sqrt()).abs() < 0.03, "{noise:?}");
        assert!(noise.reference < 1e-9, "a ramp has none: {noise:?}");
    }

    #[test]
    fn arrivals_take_the_level_of_run_and_data_alike() {
        let reference = reference();
        let arrival = |quantity: &str, level| Arrival {
            quantity: quantity.into(),
            level,
            expected_time: None,
            reference: Some("ramp".into()),
            source: String::new(),
        };
        let all = References {
            series: vec![Series { reference: &reference, data: series(10.0, 10, |t| t) }],
            arrivals: &[],
            missing: vec![],
            reach: 1.0,
        };
        let run = series(10.0, 20, |t| 0.5 * t);
        let found = all.arrival(&arrival("h2", 3.5), &run).unwrap();
        assert_eq!((found.expected, found.time), (Some(4.0), Some(7.0)));
        let front = all.arrival(&arrival("front", 3.5), &run).unwrap();
        assert_eq!(front.time, Some(5.0), "a particle stands for water ahead of it");
    }

    #[test]
    fn dry_gauges_count_as_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("probes.csv");
        std::fs::write(&file, "time_s,h_m\n0.0,dry\n1.0,0.5\n2.0,?\n").unwrap();
        let columns = Columns::read(&file, 0.0).unwrap();
        assert_eq!(columns.pairs("time_s", "h_m").unwrap(), [(0.0, 0.0), (1.0, 0.5)]);
        let curve = Columns::read(&file, f64::NAN).unwrap().rows("time_s", "h_m").unwrap();
        assert!(curve[0].1.is_nan() && curve[1] == (1.0, 0.5), "a gap, not a zero: {curve:?}");
    }
}
