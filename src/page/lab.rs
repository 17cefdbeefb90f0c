//! The page of a solver laboratory: what to choose, all option sets, and what accuracy costs.

use std::path::Path;

use serde_json::Value;

use super::plots::{Curves, Plot};
use super::sheet::Sheet;
use super::{Page, Part, Section, Table, pictures, read_json};
use crate::Result;

/// Columns of the table, by their names in the file; the rest are in solvers.csv.
const SHOWN: [&str; 14] = [
    "options",
    "system",
    "converged",
    "iterations",
    "inner_iterations",
    "setup_s",
    "solve_s",
    "total_s",
    "complexity",
    "memory_mb",
    "residual",
    "pressure_error",
    "divergence_1_per_s",
    "failure",
];

/// Gathers the page of the laboratory in `folder`.
pub fn page(folder: &Path) -> Result<Page> {
    let sheet = Sheet::read(&folder.join("solvers.csv"))?;
    let file = folder.join("solvers.json");
    let summary = if file.is_file() { read_json(&file)? } else { Value::Null };
    let rows = sheet.values();
    let column = |name: &str| sheet.head.iter().position(|known| known == name);
    let cell = |row: &[Value], name: &str| column(name).map_or(Value::Null, |k| row[k].clone());
    let shown: Vec<&str> = SHOWN.into_iter().filter(|name| column(name).is_some()).collect();
    let table = Table {
        head: shown.iter().map(|name| name.replace('_', " ")).collect(),
        rows: rows.iter().map(|row| shown.iter().map(|name| cell(row, name)).collect()).collect(),
        bars: shown.iter().position(|name| *name == "total_s"),
        links: vec![],
    };
    let failed = rows.iter().filter(|row| cell(row, "converged") == "no").count();
    let chosen = summary["chosen"].as_str().unwrap_or("none");
    let case = summary["case"].as_str().unwrap_or("CASE").to_owned();
    let mut sections = vec![
        Section {
            heading: "Option sets".into(),
            notes: vec![
                "A row for each set and pressure system. The residual is that of the full equation, computed afresh; \
                 the pressure error is the distance from the direct solution; divergence is what the velocity keeps of it."
                    .into(),
            ],
            parts: vec![Part::Table(table)],
        },
        Section {
            heading: "Pressure error over solver time".into(),
            notes: vec![],
            parts: vec![Part::Plots { plots: plots(&sheet, &rows)? }],
        },
    ];
    let picture = folder.join("solvers.png");
    let files: Vec<_> = picture.is_file().then_some(picture).into_iter().collect();
    sections.extend(pictures("Picture", &files)?);
    Ok(Page {
        title: format!("{case}: solvers"),
        description: format!("A solver laboratory: {} solves by sets of PETSc options", rows.len()),
        good: summary["chosen"].is_string(),
        ended: format!("fastest: sphpetsc {case} {}", if chosen == "(none)" { "" } else { chosen }),
        figures: vec![
            ("solves".into(), rows.len().to_string()),
            ("not converged".into(), failed.to_string()),
        ],
        sections,
        written_by: format!("sphpetsc {}", env!("CARGO_PKG_VERSION")),
    })
}

/// A plot a system: each set a point, the Pareto-best joined.
fn plots(sheet: &Sheet, rows: &[Vec<Value>]) -> Result<Vec<Plot>> {
    let column = |name: &str| sheet.head.iter().position(|known| known == name);
    let (times, errors) = (sheet.numbers("total_s")?, sheet.numbers("pressure_error")?);
    let all = (times, errors, column("options"), column("system"), column("converged"), column("pareto"));
    let (Some(times), Some(errors), Some(options), Some(system), Some(converged), Some(pareto)) = all else {
        return Ok(vec![]);
    };
    let mut systems: Vec<&Value> = Vec::new();
    for name in rows.iter().map(|row| &row[system]) {
        if !systems.contains(&name) {
            systems.push(name);
        }
    }
    let plot = |name: &&Value| {
        let point = |best: bool| {
            let is_shown = move |k: &usize| {
                let row = &rows[*k];
                row[system] == **name && row[converged] == "yes" && (row[pareto] == "yes") == best
            };
            let place = |k: usize| {
                // Logarithms take only what is above 0: the direct solution has no error against itself.
                let (x, y) = (times[k].filter(|x| *x > 0.0)?, errors[k]?.max(f64::EPSILON));
                let line = rows[k][options].as_str().unwrap_or_default();
                // Beside the best stands what they are, in a few letters.
                let note = if best {
                    line.replace("-ksp_type ", "").replace("-pc_type ", "")
                } else {
                    String::new()
                };
                Some((x, y, note))
            };
            (0..rows.len()).filter(is_shown).filter_map(place).collect::<Vec<_>>()
        };
        Plot {
            title: name.to_string().trim_matches('"').to_owned(),
            x: "set-up and iteration, s".into(),
            y: "pressure error".into(),
            log: true,
            curves: vec![Curves::noted("best", point(true)), Curves::scattered("other sets", point(false))],
        }
    };
    Ok(systems.iter().map(plot).collect())
}
