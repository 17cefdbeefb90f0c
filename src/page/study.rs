//! The page of a study: its table, errors over run times, and how each run ended.

use std::path::Path;

use serde_json::Value;

use super::plots::{Curves, Plot};
use super::sheet::Sheet;
use super::{FILE, Page, Part, Section, Table, pictures, read_json};
use crate::Result;

/// Gathers the page of the study in `folder`.
pub fn page(folder: &Path) -> Result<Page> {
    let sheet = Sheet::read(&folder.join("study.csv"))?;
    let rows = sheet.values();
    let column = |name: &str| sheet.head.iter().position(|known| known == name);
    let cell = |row: &[Value], name: &str| column(name).map_or(Value::Null, |k| row[k].clone());
    let failed = rows.iter().filter(|row| !cell(row, "failure").is_null()).count();
    let linked = |row: &Vec<Value>| -> Option<String> {
        let page = format!("{}/{FILE}", cell(row, "run").as_str()?);
        folder.join(&page).is_file().then_some(page)
    };
    let table = Table {
        head: sheet.head.iter().map(|name| name.replace('_', " ")).collect(),
        links: rows.iter().map(linked).collect(),
        rows: rows.clone(),
        bars: None,
    };
    let mut sections = vec![
        Section {
            heading: "Runs".into(),
            notes: vec![
                "A run that has a page of its own leads to it; `sphpetsc report` of its folder writes it."
                    .into(),
            ],
            parts: vec![Part::Table(table)],
        },
        Section {
            heading: "Error over run time".into(),
            notes: vec![],
            parts: vec![Part::Plots { plots: measures(&sheet)? }],
        },
    ];
    if let Some(ends) = ends(folder, &rows, column("run")) {
        sections.push(ends);
    }
    let picture = folder.join("study.png");
    sections
        .extend(pictures("Picture", &picture.is_file().then_some(picture).into_iter().collect::<Vec<_>>())?);
    let name =
        folder.canonicalize().ok().and_then(|path| Some(path.file_name()?.to_string_lossy().into_owned()));
    let count = rows.len();
    Ok(Page {
        title: name.unwrap_or_else(|| "study".into()),
        description:
            "A study: errors and run times of one case with several schemes, spacings, time steps or solvers"
                .into(),
        good: failed == 0,
        ended: format!("{count} runs, {failed} of them failed"),
        figures: vec![],
        sections,
        written_by: format!("sphpetsc {}", env!("CARGO_PKG_VERSION")),
    })
}

/// A plot of each error measure: what the points of a curve differ in stands beside each.
fn measures(sheet: &Sheet) -> Result<Vec<Plot>> {
    let is_measure = |name: &&String| sheet.head.contains(&format!("{name}_order"));
    let (times, spacings) = (sheet.numbers("wall_s")?, sheet.numbers("spacing_m")?);
    let (Some(times), Some(spacings)) = (times, spacings) else { return Ok(vec![]) };
    let steps = sheet.numbers("step_s")?.unwrap_or(vec![None; times.len()]);
    let tolerances = sheet.numbers("rtol")?.unwrap_or(vec![None; times.len()]);
    // Tables of older versions have no curves: there it is the scheme.
    let column = sheet.head.iter().position(|known| known == "curve").unwrap_or(0);
    let name = |row: &Vec<Value>| row[column].as_str().unwrap_or("").to_owned();
    let names: Vec<String> = sheet.values().iter().map(name).collect();
    let mut unique = names.clone();
    unique.dedup();
    let mut plots = vec![];
    for name in sheet.head.iter().filter(is_measure) {
        let errors = sheet.numbers(name)?.unwrap_or_default();
        let point = |k: usize| {
            // Logarithms take only what is above 0.
            let (x, y) = (times[k].filter(|x| *x > 0.0)?, errors[k].filter(|y| *y > 0.0)?);
            let spacing = spacings[k].map(|spacing| format!("{spacing} m"));
            let step = steps[k].map(|step| format!("dt {step} s"));
            let tolerance = tolerances[k].map(|tolerance| format!("rtol {tolerance:e}"));
            let note = [spacing, step, tolerance].into_iter().flatten().collect::<Vec<_>>().join(", ");
            Some((x, y, note))
        };
        let curve = |name: &String| {
            let points = (0..names.len()).filter(|&k| names[k] == *name).filter_map(point);
            Curves::noted(name, points.collect())
        };
        plots.push(Plot {
            title: name.replace('_', " "),
            x: "run time, s".into(),
            y: "error".into(),
            log: true,
            curves: unique.iter().map(curve).collect(),
        });
    }
    Ok(plots)
}

/// What the summaries of the runs say.
fn ends(folder: &Path, rows: &[Vec<Value>], run: Option<usize>) -> Option<Section> {
    let head =
        ["run", "ended", "flow time, s", "mean iterations", "most", "memory, MB", "left", "through walls"];
    let row = |row: &Vec<Value>| {
        let name = row[run?].as_str()?;
        let summary = read_json(&folder.join(name).join("summary.json")).ok()?;
        let (solver, particles) = (&summary["solver"], &summary["particles"]);
        let cells = [
            &name.into(),
            &summary["ended"],
            &summary["time_s"],
            &solver["mean_iterations"],
            &solver["most_iterations"],
            &summary["memory_mb"],
            &particles["left"],
            &particles["through_walls"],
        ];
        Some(cells.map(Value::clone).to_vec())
    };
    let rows: Vec<_> = rows.iter().filter_map(row).collect();
    let table = Table { head: head.map(Into::into).into(), rows, bars: None, links: vec![] };
    let parts = vec![Part::Table(table)];
    Some(Section { heading: "How the runs ended".into(), notes: vec![], parts })
}
