//! The page of a study: its table, errors over run times, and how each run ended.

use std::path::Path;

use serde_json::Value;

use super::plots::{Curves, INTERVALS, Plot};
use super::sheet::Sheet;
use super::{FILE, Page, Part, Section, Table, pictures, read_json};
use crate::Result;
use crate::output::picture::gallery::{GAUGES, quantity};

/// Runs whose curves share a plot; of more each scheme has plots of its own.
const TOGETHER: usize = 8;
/// Intervals of all curves of a page that runs recorded, some 50 bytes each.
const ROOM: usize = 60_000;

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
    let recorded = recorded(folder, &rows, column("run"), column("scheme"))?;
    if !recorded.is_empty() {
        let parts = vec![Part::Plots { plots: recorded }];
        sections.push(Section { heading: "Gauges and bodies".into(), notes: vec![], parts });
    }
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

/// Columns of the tables of one run.
struct Recorded {
    scheme: String,
    /// Its name in the study.
    run: String,
    times: Vec<Option<f64>>,
    columns: Vec<(String, Vec<Option<f64>>)>,
}

/// A plot of each gauge, force and velocity of a body, the runs beside each other; quantities that nothing changes are left out.
fn recorded(
    folder: &Path,
    rows: &[Vec<Value>],
    run: Option<usize>,
    scheme: Option<usize>,
) -> Result<Vec<Plot>> {
    let word = |row: &[Value], column: usize| row[column].as_str().unwrap_or_default().to_owned();
    let mut tables = vec![];
    for (row, (run, scheme)) in rows.iter().zip(std::iter::repeat(run.zip(scheme)).flatten()) {
        let (place, scheme) = (word(row, run), word(row, scheme));
        for name in GAUGES.into_iter().chain(["bodies.csv"]) {
            let path = folder.join(&place).join(name);
            if path.is_file() {
                let sheet = Sheet::read(&path)?;
                let Some(times) = sheet.numbers("time_s")? else { continue };
                let mut columns = vec![];
                for head in sheet.head.iter().filter(|head| *head != "time_s") {
                    if name != "bodies.csv" || quantity(head).1 == "m/s" {
                        columns.push((head.clone(), sheet.numbers(head)?.unwrap_or_default()));
                    }
                }
                let run = place.trim_start_matches("runs/").to_owned();
                tables.push(Recorded { scheme: scheme.clone(), run, times, columns });
            }
        }
    }
    let intervals = ROOM / tables.iter().map(|table| table.columns.len()).sum::<usize>().max(1);
    let intervals = intervals.clamp(INTERVALS / 8, INTERVALS);
    // Each with the column that it shows, and whether anything changes that.
    let mut plots: Vec<(String, Plot, bool)> = vec![];
    for Recorded { scheme, run, times, columns } in tables {
        for (name, numbers) in columns {
            let (title, unit) = quantity(&name);
            let title = if rows.len() > TOGETHER { format!("{title}, {scheme}") } else { title };
            let at = plots.iter().position(|(known, plot, _)| *known == name && plot.title == title);
            let at = at.unwrap_or_else(|| {
                let y = if unit == "1" { title.clone() } else { format!("{title}, {unit}") };
                let plot = Plot { title, x: "time, s".into(), y, log: false, curves: vec![] };
                plots.push((name, plot, false));
                plots.len() - 1
            });
            let (_, plot, moves) = &mut plots[at];
            let mut values = numbers.iter().flatten();
            let first = values.next();
            *moves |= values.any(|value| Some(value) != first);
            plot.curves.push(Curves::thinned(&times, vec![(run.clone(), numbers)], intervals));
        }
    }
    Ok(plots.into_iter().filter_map(|(_, plot, moves)| moves.then_some(plot)).collect())
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
