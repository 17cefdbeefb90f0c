//! How the runs of a study ended, and their errors.

use std::process::ExitStatus;

use serde_json::Value;

use super::axes::{Along, Point};
use crate::output::comparison;
use crate::{Result, run};

/// How a run ended.
pub struct Outcome<'a> {
    /// What was run.
    pub point: &'a Point,
    /// Its summary.json.
    pub summary: Value,
    /// Error measures by name, in the order of the summary.
    pub errors: Vec<(String, f64)>,
    /// Why it did not reach its end.
    pub failure: Option<String>,
}

impl<'a> Outcome<'a> {
    /// Reads what a run left; `ended` is the end of its program, if that ran just now.
    pub fn of(point: &'a Point, ended: Option<ExitStatus>) -> Self {
        let summary = run::summary(&point.folder);
        let told = summary["ended"].as_str();
        let failure = match ended {
            Some(status) if !status.success() && told == Some(run::AT_THE_END) => Some(status.to_string()),
            Some(status) if !status.success() => Some(told.map_or(status.to_string(), str::to_owned)),
            _ => None,
        };
        // What a failed run came to is no error of a result.
        let errors = if failure.is_none() { errors(&summary) } else { Vec::new() };
        Self { point, summary, errors, failure }
    }

    /// One of its errors.
    pub fn error(&self, name: &str) -> Option<f64> {
        self.errors.iter().find(|(known, _)| known == name).map(|(_, value)| *value)
    }

    /// Wall-clock time of the run in s.
    pub fn wall_s(&self) -> Option<f64> {
        self.summary["wall_s"].as_f64()
    }

    /// A whole number of the summary.
    pub fn count(&self, keys: &[&str]) -> Option<u64> {
        keys.iter().fold(&self.summary, |value, key| &value[key]).as_u64()
    }

    /// Run time and error, of a run that has both.
    pub fn place(&self, measure: &str) -> Option<(f64, f64)> {
        self.wall_s().zip(self.error(measure))
    }
}

/// Every error measure of a summary: differences from exact solutions (`NAME_rms`, `NAME_max`) and from measured series
/// (`NAME_rms`, `NAME_largest`), relative errors of arrival times, and what every run has: the roughness of its pressures and the
/// largest rise of the energy.
fn errors(summary: &Value) -> Vec<(String, f64)> {
    let list = |key: &str| summary[key].as_array().map(Vec::as_slice).unwrap_or_default();
    let mut found = Vec::new();
    let mut add = |name: String, value: Option<f64>| {
        found.extend(value.filter(|value| value.is_finite()).map(|value| (name, value)));
    };
    for (key, measures) in [
        ("errors", [("rms", "rms"), ("max", "max")]),
        ("references", [("rms", "rms"), ("largest", "largest")]),
    ] {
        for entry in list(key) {
            let is_same = |other: &&Value| other["name"] == entry["name"];
            let several = list(key).iter().filter(is_same).count() > 1;
            let mut name = entry["name"].as_str().unwrap_or(key).to_owned();
            if several {
                // One reference over several windows of time, whose ends differ by a step from run to run.
                let end = |key: &str| (100.0 * entry[key].as_f64().unwrap_or(f64::NAN)).round() / 100.0;
                name += &format!("_{}-{}s", end("from_s"), end("until_s"));
            }
            for (field, end) in measures {
                add(format!("{name}_{end}"), entry[field].as_f64());
            }
        }
    }
    for entry in list("arrivals") {
        let late = |time: f64, expected: f64| (time - expected).abs() / expected;
        let error = entry["time_s"].as_f64().zip(entry["expected_time_s"].as_f64());
        let quantity = entry["quantity"].as_str().unwrap_or("quantity");
        add(format!("{quantity}_arrival"), error.map(|(time, expected)| late(time, expected)));
    }
    add("pressure_roughness".into(), summary["pressure_roughness"].as_f64());
    add("energy_rise".into(), summary["energy"]["largest_rise_of_initial"].as_f64());
    found
}

/// Adds to each run its differences from the finest run of the same method, before the measures that every run has.
///
/// # Errors
/// [`crate::Error::Input`] for a table of a run that cannot be read.
pub fn compare_with_finest(outcomes: &mut [Outcome]) -> Result<()> {
    let finer = |a: &&Outcome, b: &&Outcome| a.point.fineness().partial_cmp(&b.point.fineness());
    let mut found = Vec::new();
    for outcome in outcomes.iter() {
        let kin =
            outcomes.iter().filter(|other| other.failure.is_none() && other.point.is_kin(outcome.point));
        let finest = kin.min_by(|a, b| finer(a, b).unwrap_or(std::cmp::Ordering::Equal));
        found.push(match finest {
            Some(finest) if outcome.failure.is_none() && finest.point.folder != outcome.point.folder => {
                comparison::differences(&outcome.point.folder, &finest.point.folder)?
            }
            _ => vec![],
        });
    }
    for (outcome, found) in outcomes.iter_mut().zip(found) {
        let at = outcome.errors.len().saturating_sub(2);
        outcome
            .errors
            .splice(at..at, found.into_iter().map(|(name, value)| (format!("finest_{name}"), value)));
    }
    Ok(())
}

/// Names of all measures, in the order of their first appearance: a run too coarse for one does not hide it.
pub fn measures(outcomes: &[Outcome]) -> Vec<String> {
    // The longest list gives the order.
    let fullest = outcomes.iter().rev().max_by_key(|outcome| outcome.errors.len());
    let all = fullest.into_iter().chain(outcomes).flat_map(|outcome| &outcome.errors);
    let mut names: Vec<String> = Vec::new();
    for (name, _) in all {
        if !names.contains(name) {
            names.push(name.clone());
        }
    }
    names
}

/// Observed order of a run, by the next coarser one of its curve; tolerances have none.
pub fn order(outcomes: &[Outcome], k: usize, measure: &str) -> Option<f64> {
    let (coarse, fine) = (outcomes.get(k.checked_sub(1)?)?, &outcomes[k]);
    let (e1, e2) = (coarse.error(measure)?, fine.error(measure)?);
    let order = (e1 / e2).ln() / (coarse.point.place() / fine.point.place()).ln();
    let is_one = coarse.point.curve() == fine.point.curve() && fine.point.along != Along::Tolerance;
    Some(order).filter(|order| order.is_finite() && is_one)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn every_measure_of_a_summary_is_found_by_name() {
        let summary = json!({
            "errors": [{"name": "height", "rms": 0.1, "max": 0.3}, {"name": "pressure", "rms": 0.2, "max": null}],
            "references": [
                {"name": "mm", "rms": 0.4, "largest": 0.5, "values": 3},
                {"name": "p1", "rms": 0.6, "from_s": 2.19e-5, "until_s": 4.9990219},
                {"name": "p1", "rms": 0.7, "from_s": 0.35, "until_s": 2.0},
            ],
            "arrivals": [{"quantity": "front", "time_s": 0.3, "expected_time_s": 0.4}, {"time_s": null}],
            "pressure_roughness": 0.03,
            "energy": {"largest_rise_of_initial": 0.002},
        });
        let found = errors(&summary);
        let names: Vec<_> = found.iter().map(|(name, _)| name.as_str()).collect();
        let wanted = [
            "height_rms",
            "height_max",
            "pressure_rms",
            "mm_rms",
            "mm_largest",
            "p1_0-5s_rms",
            "p1_0.35-2s_rms",
            "front_arrival",
            "pressure_roughness",
            "energy_rise",
        ];
        assert_eq!(names, wanted);
        assert!((found[7].1 - 0.25).abs() < 1e-12);
        assert!(errors(&Value::Null).is_empty());
    }

    fn point(scheme: &str, spacing: f64) -> Point {
        Point {
            group: None,
            scheme: scheme.into(),
            spacing,
            step: None,
            tolerance: None,
            solver: None,
            vary: vec![],
            along: Along::Spacing,
            folder: format!("{scheme}-{spacing}").into(),
            args: crate::cli::RunArgs::default(),
            start: None,
        }
    }

    #[test]
    fn orders_compare_neighbours_of_one_curve() {
        let points = [("a", 0.4), ("a", 0.2), ("a", 0.1), ("b", 0.05)].map(|(scheme, dx)| point(scheme, dx));
        let errors = [("e", 0.16), ("e", 0.04), ("f", 1.0), ("f", 0.5)];
        let outcome = |(point, (name, value)): (_, (&str, f64))| Outcome {
            point,
            summary: Value::Null,
            errors: vec![(name.into(), value)],
            failure: None,
        };
        let runs: Vec<_> = points.iter().zip(errors).map(outcome).collect();
        assert_eq!(order(&runs, 0, "e"), None);
        assert!((order(&runs, 1, "e").unwrap() - 2.0).abs() < 1e-12);
        assert_eq!(order(&runs, 2, "e"), None);
        assert_eq!(order(&runs, 3, "f"), None, "of another scheme");
        assert_eq!(measures(&runs), ["e", "f"].map(String::from));
    }
}
