//! The page of a run.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::plots::{Curves, Plot};
use super::sheet::Sheet;
use super::{Page, Part, Section, Table, movie, pictures, read_json};
use crate::case::CaseFile;
use crate::cli::{self, RunArgs};
use crate::output::comparison::References;
use crate::output::picture::gallery::{ENERGIES, FOLDER, GAUGES, quantity};
use crate::{Error, Result};

/// What a summary says of a run that reached its end.
const AT_THE_END: &str = "at the end";

/// Gathers the page of the run in `folder`.
pub fn page(folder: &Path) -> Result<Page> {
    let summary = read_json(&folder.join("summary.json"))?;
    let path = folder.join("run.toml");
    let text = fs::read_to_string(&path).map_err(|error| Error::unreadable(&path, &error))?;
    let table: toml::Table =
        toml::from_str(&text).map_err(|error| Error::unreadable(&path, &error.message().to_owned()))?;
    let mut args = RunArgs::default();
    args.common.case = Some(path.to_string_lossy().into_owned());
    let case = args.load_case()?;
    let lost = find_references(&mut args, &table)?;
    let files = args.reference_files(&case)?;
    let references = References::read(&case, &files)?;

    let mut sections = vec![];
    sections.extend(verdict(&summary, lost));
    if let Some(movie) = movie::of_run(folder, &case)? {
        let parts = vec![Part::Movie { movie: Box::new(movie) }];
        sections.push(Section { heading: "Flow".into(), notes: vec![], parts });
    }
    sections.extend(plots("Gauges", gauges(folder, &references)?));
    sections.extend(plots("Histories", histories(folder, &references)?));
    sections.extend(stages(&summary));
    sections.extend(pictures("Pictures", &flow_pictures(folder))?);
    sections.extend(own_table(folder, "comparison.csv", "Comparison")?);
    sections.extend(own_table(folder, "profiles.csv", "Distances from measured surfaces")?);
    sections.push(settings(&case, &table, &summary, text));
    let ended = summary["ended"].as_str().unwrap_or(AT_THE_END);
    Ok(Page {
        title: case.name.clone(),
        description: case.description.clone(),
        good: ended == AT_THE_END,
        ended: if ended == AT_THE_END { "reached its end".into() } else { format!("stopped: {ended}") },
        figures: figures(&summary, &case),
        sections,
        written_by: format!("sphpetsc {}", env!("CARGO_PKG_VERSION")),
    })
}

/// Gives `args` the data files that the run was given; sentences about those that are gone.
fn find_references(args: &mut RunArgs, table: &toml::Table) -> Result<Vec<String>> {
    let given = table.get("run").and_then(|run| run.get("references")).and_then(toml::Value::as_array);
    let mut lost = vec![];
    for typed in given.into_iter().flatten().filter_map(toml::Value::as_str) {
        let reference = cli::reference(typed).map_err(Error::Input)?;
        if reference.file.is_file() {
            args.common.references.push(reference);
        } else {
            lost.push(format!("{typed} is not found from here: its data are not drawn."));
        }
    }
    Ok(lost)
}

/// Key figures of any run: those that its summary has.
fn figures(summary: &Value, case: &CaseFile) -> Vec<(String, String)> {
    let number = |keys: &[&str]| keys.iter().fold(summary, |value, key| &value[key]).as_f64();
    let all = [
        ("spacing", Some(format!("{} m", case.spacing))),
        ("flow time", number(&["time_s"]).map(|t| format!("{t:.4} s"))),
        ("steps", number(&["steps"]).map(|n| n.to_string())),
        ("run time", number(&["wall_s"]).map(|t| format!("{t:.1} s"))),
        ("fluid particles", number(&["particles", "fluid"]).map(|n| n.to_string())),
        ("left over open sides", number(&["particles", "left"]).map(|n| n.to_string())),
        ("through walls", number(&["particles", "through_walls"]).map(|n| n.to_string())),
        (
            "iterations, mean and most",
            number(&["solver", "mean_iterations"])
                .zip(number(&["solver", "most_iterations"]))
                .map(|(mean, most)| format!("{mean:.1}, {most}")),
        ),
        ("fallbacks", number(&["solver", "fallbacks"]).map(|n| n.to_string())),
        (
            "largest rise of the energy",
            number(&["energy", "largest_rise_of_initial"]).map(|e| format!("{:.3} %", 100.0 * e)),
        ),
        (
            "roughness of the pressure",
            number(&["pressure_roughness"]).map(|rough| format!("{:.2} %", 100.0 * rough)),
        ),
        (
            "density variation",
            number(&["compressibility", "largest_density_variation"]).map(|d| format!("{:.2} %", 100.0 * d)),
        ),
        ("memory", number(&["memory_mb"]).map(|m| format!("{m:.0} MB"))),
        ("ranks", number(&["ranks", "ranks"]).map(|n| n.to_string())),
        (
            "work of the busiest rank over the mean",
            number(&["ranks", "imbalance"]).map(|n| format!("{n:.2}")),
        ),
    ];
    all.into_iter().filter_map(|(name, value)| Some((name.to_owned(), value?))).collect()
}

/// What was found beside what was expected.
fn verdict(summary: &Value, mut notes: Vec<String>) -> Option<Section> {
    let list = |key: &str| summary[key].as_array().map(Vec::as_slice).unwrap_or_default();
    let percent = |value: &Value| json!(value.as_f64().map(|share| 100.0 * share));
    let mut parts = vec![];
    let mut add = |head: &[&str], mut rows: Vec<Vec<Value>>| {
        // A column that no row fills would only push the others out of sight.
        let kept: Vec<bool> = (0..head.len()).map(|k| rows.iter().any(|row| !row[k].is_null())).collect();
        for row in &mut rows {
            let mut is_kept = kept.iter();
            row.retain(|_| is_kept.next() == Some(&true));
        }
        if !rows.is_empty() {
            let head = head.iter().zip(&kept).filter(|(_, kept)| **kept);
            let head = head.map(|(name, _)| (*name).to_owned()).collect();
            parts.push(Part::Table(Table { head, rows, bars: None, links: vec![] }));
        }
    };
    let arrivals = list("arrivals").iter().map(|a| {
        let times = a["time_s"].as_f64().zip(a["expected_time_s"].as_f64());
        let off = times.map(|(found, expected)| 100.0 * (found / expected - 1.0));
        let what = format!("{} reaches {}", a["quantity"].as_str().unwrap_or_default(), a["level"]);
        vec![what.into(), a["time_s"].clone(), a["expected_time_s"].clone(), json!(off), a["source"].clone()]
    });
    add(&["arrival", "found, s", "expected, s", "off, %", "source"], arrivals.collect());
    let exact = list("errors")
        .iter()
        .map(|e| vec![e["name"].clone(), percent(&e["rms"]), percent(&e["max"]), e["of"].clone()]);
    add(&["known solution", "rms, %", "largest, %", "of"], exact.collect());
    let series = list("references").iter().filter(|s| s["values"].as_u64() > Some(0)).map(|s| {
        let window =
            format!("{:.2}-{:.2}", s["from_s"].as_f64().unwrap_or(0.0), s["until_s"].as_f64().unwrap_or(0.0));
        let (peak, noise) = (&s["peak"], &s["noise"]);
        vec![
            s["name"].clone(),
            window.into(),
            percent(&s["rms"]),
            percent(&s["largest"]),
            json!(s["best_shift_s"].as_f64().map(|shift| 1e3 * shift)),
            percent(&s["rms_after_shift"]),
            peak["value"].clone(),
            peak["reference_value"].clone(),
            noise["value"].clone(),
            noise["reference_value"].clone(),
            s["normalised_by"].clone(),
        ]
    });
    let head = [
        "measured series",
        "window, s",
        "rms, %",
        "largest, %",
        "shift, ms",
        "rms after it, %",
        "peak found",
        "peak measured",
        "noise found",
        "noise measured",
        "% of",
    ];
    add(&head, series.collect());
    let missing: Vec<_> = list("references_not_given").iter().filter_map(Value::as_str).collect();
    if !missing.is_empty() {
        notes.push(format!("Not compared, their data were not given: {}.", missing.join(", ")));
    }
    let some = !(parts.is_empty() && notes.is_empty());
    some.then(|| Section { heading: "Found beside expected".into(), notes, parts })
}

fn plots(heading: &str, plots: Vec<Plot>) -> Option<Section> {
    let parts = vec![Part::Plots { plots }];
    let some = matches!(&parts[0], Part::Plots { plots } if !plots.is_empty());
    some.then(|| Section { heading: heading.into(), notes: vec![], parts })
}

/// Columns of a table as one plot, with what was measured of the first; none if there is none of them.
fn plot(sheet: &Sheet, title: &str, columns: &[&str], references: &References) -> Result<Option<Plot>> {
    let Some(times) = sheet.numbers("time_s")? else { return Ok(None) };
    let mut lines = vec![];
    for name in columns {
        if let Some(numbers) = sheet.numbers(name)? {
            lines.push((quantity(name).0, numbers));
        }
    }
    if lines.is_empty() || times.is_empty() {
        return Ok(None);
    }
    let unit = quantity(columns[0]).1;
    let measured = references
        .measured_in(columns[0])
        .map(|(name, data)| Curves::dots(&format!("{name}, measured"), data));
    let measured: Vec<_> = measured.collect();
    let curves = std::iter::once(Curves::lines(&times, lines)).chain(measured).collect();
    let y = if unit == "1" { title.to_owned() } else { format!("{title}, {unit}") };
    Ok(Some(Plot { title: title.into(), x: "time, s".into(), y, log: false, curves }))
}

/// A plot of each gauge and force.
fn gauges(folder: &Path, references: &References) -> Result<Vec<Plot>> {
    let mut plots = vec![];
    for path in GAUGES.map(|name| folder.join(name)).iter().filter(|path| path.is_file()) {
        let sheet = Sheet::read(path)?;
        for name in sheet.head.iter().filter(|name| *name != "time_s") {
            plots.extend(plot(&sheet, &quantity(name).0, &[name], references)?);
        }
    }
    Ok(plots)
}

/// Energies, volume, front, ...; found beside exact values; iterations and time steps.
fn histories(folder: &Path, references: &References) -> Result<Vec<Plot>> {
    let all: [(&str, &str, &[&str]); 8] = [
        ("history.csv", "energy", &ENERGIES),
        ("history.csv", "kernel volume (lattice: 1)", &["kernel_volume"]),
        ("history.csv", "front", &["front_m"]),
        ("history.csv", "fastest particle", &["fastest_m_per_s"]),
        ("history.csv", "largest pressure", &["pressure_max_pa"]),
        ("solver.csv", "iterations of a solve", &["iterations"]),
        ("solver.csv", "time step", &["dt_s"]),
        ("solver.csv", "time of a solve", &["solve_s", "setup_s"]),
    ];
    let mut plots = vec![];
    let exact = folder.join("exact.csv");
    if exact.is_file() {
        let sheet = Sheet::read(&exact)?;
        for name in sheet.head.iter().filter(|name| *name != "time_s" && !name.starts_with("exact_")) {
            let exact = format!("exact_{name}");
            plots.extend(plot(&sheet, &quantity(name).0, &[name, &exact], references)?);
        }
    }
    for file in ["history.csv", "solver.csv"] {
        let path = folder.join(file);
        if path.is_file() {
            let sheet = Sheet::read(&path)?;
            for (_, title, columns) in all.iter().filter(|one| one.0 == file) {
                plots.extend(plot(&sheet, title, columns, references)?);
            }
        }
    }
    Ok(plots)
}

fn stages(summary: &Value) -> Option<Section> {
    let stages = summary["stages_s"].as_object()?;
    let total: f64 = stages.values().filter_map(Value::as_f64).sum();
    let row = |(name, spent): (&String, &Value)| {
        vec![name.as_str().into(), spent.clone(), json!(spent.as_f64().map(|s| 100.0 * s / total))]
    };
    let mut rows: Vec<_> = stages.iter().map(row).collect();
    rows.sort_by(|a, b| b[1].as_f64().unwrap_or(0.0).total_cmp(&a[1].as_f64().unwrap_or(0.0)));
    let head = ["stage", "time, s", "share, %"].map(Into::into).into();
    let parts = vec![Part::Table(Table { head, rows, bars: Some(2), links: vec![] })];
    Some(Section { heading: "Time by stage".into(), notes: vec![], parts })
}

/// Pictures of the particles in the order of their times; curves are drawn by the page itself.
fn flow_pictures(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder.join(FOLDER)).into_iter().flatten().flatten();
    let timed = |path: PathBuf| {
        let time: f64 = path.file_name()?.to_str()?.strip_prefix('t')?.strip_suffix(".png")?.parse().ok()?;
        Some((time, path))
    };
    let mut found: Vec<_> = entries.filter_map(|entry| timed(entry.path())).collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    found.into_iter().map(|(_, path)| path).collect()
}

/// A table of the run as it is.
fn own_table(folder: &Path, file: &str, heading: &str) -> Result<Option<Section>> {
    let path = folder.join(file);
    if !path.is_file() {
        return Ok(None);
    }
    let sheet = Sheet::read(&path)?;
    let head = sheet.head.iter().map(|name| name.replace('_', " ")).collect();
    let parts = vec![Part::Table(Table { head, rows: sheet.values(), bars: None, links: vec![] })];
    Ok(Some(Section { heading: heading.into(), notes: vec![], parts }))
}

/// Options, versions and machine, and the case as run.
fn settings(case: &CaseFile, table: &toml::Table, summary: &Value, text: String) -> Section {
    let scheme = table.get("scheme").and_then(toml::Value::as_table);
    let run = table.get("run").and_then(toml::Value::as_table);
    let entries = |table: Option<&toml::Table>, section: &str| -> Vec<Vec<Value>> {
        let row = |(key, value): (&String, &toml::Value)| {
            let text = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
            vec![format!("{section}{key}").into(), text.into()]
        };
        table.into_iter().flatten().map(row).collect()
    };
    let mut rows: Vec<Vec<Value>> = vec![vec!["dimension".into(), case.dimension.into()]];
    rows.push(vec!["seed".into(), case.seed.into()]);
    rows.push(vec!["solver in force".into(), summary["solver"]["in_force"].clone()]);
    rows.extend(entries(run, ""));
    rows.extend(entries(scheme, "scheme."));
    let head = ["setting", "value"].map(Into::into).into();
    let table = Part::Table(Table { head, rows, bars: None, links: vec![] });
    let whole = Part::Text { summary: "run.toml, which repeats this run".into(), text };
    Section { heading: "What was run".into(), notes: vec![], parts: vec![table, whole] }
}
