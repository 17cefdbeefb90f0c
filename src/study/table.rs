//! What a study found: table, CSV, picture.

use std::io::Write as _;
use std::path::Path;

use super::outcome::{Outcome, measures, order};
use crate::Result;
use crate::output::picture::curves::{Curve, Mark, loglog_plot};
use crate::output::{Cell, aligned, pareto, write_atomic};

/// Stands in tables where there is no number.
const NONE: &str = "none";

/// study.csv: a row a run; a column for each axis that is in use, for the time of each stage, and for each error measure with
/// its observed order. Pareto-best is said of one measure, once all runs are done.
pub fn write_csv(folder: &Path, outcomes: &[Outcome], measure: Option<&str>) -> Result<()> {
    let names = measures(outcomes);
    let axes = axes(outcomes);
    let stages = stages(outcomes);
    let best = measure.map(|measure| fronts(outcomes, measure));
    let word = |text: &str| Cell::Word(text).to_string();
    let mut head = vec!["scheme".to_owned(), "spacing_m".into()];
    head.extend(axes.iter().map(|axis| word(axis)));
    head.extend(["particles", "steps", "wall_s"].map(String::from));
    head.extend(stages.iter().map(|stage| word(&format!("{stage}_s"))));
    head.extend(names.iter().flat_map(|name| [word(name), word(&format!("{name}_order"))]));
    head.extend(["curve", "pareto", "run", "failure"].map(String::from));
    let mut text = head.join(",") + "\n";
    for (k, outcome) in outcomes.iter().enumerate() {
        let number = |value: Option<f64>| value.map_or(Cell::Word(NONE), Cell::Number).to_string();
        let count = |key: &[&str]| outcome.count(key).map_or(NONE.to_owned(), |count| count.to_string());
        let point = outcome.point;
        let mut cells = vec![point.scheme.clone(), number(Some(point.spacing))];
        cells.extend(axes.iter().map(|axis| word(&on_axis(outcome, axis).unwrap_or_else(|| NONE.into()))));
        cells.extend([count(&["particles", "fluid"]), count(&["steps"]), number(outcome.wall_s())]);
        cells.extend(stages.iter().map(|stage| number(outcome.summary["stages_s"][stage].as_f64())));
        for name in &names {
            cells.extend([number(outcome.error(name)), number(order(outcomes, k, name))]);
        }
        cells.push(word(&point.curve()));
        cells.push(word(best.as_ref().map_or(NONE, |best| if best[k] { "yes" } else { "no" })));
        let run = point.folder.strip_prefix(folder).unwrap_or(&point.folder);
        cells.push(word(&run.to_string_lossy()));
        // A row is a line.
        cells.push(word(&outcome.failure.as_deref().unwrap_or(NONE).replace('\n', " ")));
        text += &(cells.join(",") + "\n");
    }
    write_atomic(&folder.join("study.csv"), |file| file.write_all(text.as_bytes()))
}

/// Axes beside scheme and spacing that any run uses, by their names in the table.
fn axes(outcomes: &[Outcome]) -> Vec<String> {
    let mut axes: Vec<String> = Vec::new();
    let fixed = ["group", "step_s", "rtol", "solver"];
    axes.extend(
        fixed.into_iter().filter(|axis| outcomes.iter().any(|o| on_axis(o, axis).is_some())).map(Into::into),
    );
    for (key, _) in outcomes.iter().flat_map(|outcome| &outcome.point.vary) {
        if !axes.contains(key) {
            axes.push(key.clone());
        }
    }
    axes
}

fn on_axis(outcome: &Outcome, axis: &str) -> Option<String> {
    let point = outcome.point;
    match axis {
        "group" => point.group.clone(),
        "step_s" => point.step.map(|step| format!("{step:?}")),
        "rtol" => point.tolerance.map(|tolerance| format!("{tolerance:?}")),
        "solver" => point.solver.clone(),
        key => point.vary.iter().find(|(known, _)| known == key).map(|(_, value)| value.clone()),
    }
}

/// Names of the stages of all runs, in the order of a step.
fn stages(outcomes: &[Outcome]) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for stages in outcomes.iter().filter_map(|outcome| outcome.summary["stages_s"].as_object()) {
        names.extend(stages.keys().filter(|name| !names.contains(name)).cloned().collect::<Vec<_>>());
    }
    names
}

fn fronts(outcomes: &[Outcome], measure: &str) -> Vec<bool> {
    pareto::front(&outcomes.iter().map(|outcome| outcome.place(measure)).collect::<Vec<_>>())
}

/// study.png: error over run time, a line a curve, with orders; and the Pareto front.
pub fn write_picture(path: &Path, name: &str, outcomes: &[Outcome], measure: &str) -> Result<()> {
    let mut curves: Vec<Curve> = Vec::new();
    for (k, outcome) in outcomes.iter().enumerate() {
        let label = outcome.point.curve();
        if curves.last().is_none_or(|curve| curve.label != label) {
            curves.push(Curve { label, marks: Vec::new(), joined: true });
        }
        let place = outcome.point.note();
        let note = match (order(outcomes, k, measure), &outcome.failure) {
            (_, Some(_)) => format!("{place}, failed"),
            (Some(order), _) => format!("{place}, order {order:.1}"),
            (None, _) => place,
        };
        let (Some(curve), Some(x)) = (curves.last_mut(), outcome.wall_s()) else { continue };
        let y = outcome.error(measure);
        if y.is_some() || outcome.failure.is_some() {
            curve.marks.push(Mark { x, y, note });
        }
    }
    let best = outcomes.iter().zip(fronts(outcomes, measure)).filter(|(_, best)| *best);
    let mut front: Vec<Mark> = best
        .filter_map(|(outcome, _)| outcome.place(measure))
        .map(|(x, y)| Mark { x, y: Some(y), note: String::new() })
        .collect();
    front.sort_by(|a, b| a.x.total_cmp(&b.x));
    if curves.len() > 1 && front.len() > 1 {
        curves.push(Curve { label: "Pareto front".into(), marks: front, joined: true });
    }
    let title = format!("{name}: {} over run time", measure.replace('_', " "));
    loglog_plot(path, &title, "run time, s", &measure.replace('_', " "), &curves)
}

/// The table on the terminal.
pub fn text(outcomes: &[Outcome], measure: &str) -> String {
    let heads = ["run", "", "", "particles", "steps", "run time, s", "solve, s", measure, "order"];
    let mut rows = vec![heads.map(str::to_owned).to_vec()];
    for (k, (outcome, best)) in outcomes.iter().zip(fronts(outcomes, measure)).enumerate() {
        let text = |value: Option<String>| value.unwrap_or_else(|| "-".into());
        let seconds = |value: Option<f64>| text(value.map(|s| format!("{s:.1}")));
        rows.push(vec![
            outcome.point.curve(),
            outcome.point.note(),
            if best { "*" } else { "" }.into(),
            text(outcome.count(&["particles", "fluid"]).map(|n| n.to_string())),
            text(outcome.count(&["steps"]).map(|n| n.to_string())),
            seconds(outcome.wall_s()),
            seconds(outcome.summary["stages_s"]["solve"].as_f64()),
            text(outcome.error(measure).map(|e| format!("{e:.3e}"))),
            text(order(outcomes, k, measure).map(|order| format!("{order:.2}"))),
        ]);
    }
    let failures = std::iter::once(None).chain(outcomes.iter().map(|outcome| outcome.failure.as_ref()));
    let told = |why: &String| format!("  failed: {}", why.replace('\n', " "));
    let lines = aligned::lines(&rows, 3).into_iter().zip(failures);
    let mut text: String = lines.map(|(line, why)| line + &why.map_or(String::new(), told) + "\n").collect();
    text += "* no other run is better in both run time and error\n";
    text
}
