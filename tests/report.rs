//! Pages of runs and studies: whole, safe against what files say, and never made of damaged ones.

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::common::{done, is_installed, run, stderr, stdout};
use serde_json::Value;
use tempfile::TempDir;

/// A run of 50 particles, which needs no PETSc.
fn sample() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    done(folder.path(), "dam_break_2d --scheme wcsph --spacing 0.04 --until 0.1 --threads 1 --out run -q");
    folder
}

/// The page of a folder, and what it shows.
fn page(folder: &Path, name: &str) -> (String, Value) {
    done(folder, &format!("report {name} -q"));
    let html = fs::read_to_string(folder.join(name).join("report.html")).unwrap();
    let (_, data) = html.split_once(r#"id="data">"#).unwrap();
    let (data, _) = data.split_once("</script>").unwrap();
    let data = serde_json::from_str(data).unwrap();
    (html, data)
}

fn headings(page: &Value) -> Vec<&str> {
    page["sections"].as_array().unwrap().iter().map(|s| s["heading"].as_str().unwrap()).collect()
}

#[test]
fn a_page_shows_the_run_and_loads_nothing() {
    let folder = sample();
    let (html, data) = page(folder.path(), "run");
    assert!(html.len() < 5_000_000 && html.contains("default-src 'none'"));
    assert_eq!((&data["title"], &data["good"]), (&"dam_break_2d".into(), &true.into()));
    let wanted = ["Found beside expected", "Flow", "Histories", "Time by stage", "Pictures", "What was run"];
    assert_eq!(headings(&data), wanted);
    let movie = &data["sections"][1]["parts"][0]["movie"];
    assert_eq!((movie["dimension"].as_u64(), movie["fluid"].as_u64()), (Some(2), Some(50)));
    assert!(movie["times"].as_array().unwrap().len() > 5);
    // A second page replaces the first, but not a file of somebody else.
    page(folder.path(), "run");
    fs::write(folder.path().join("run/report.html"), "mine").unwrap();
    refused(folder.path(), "report run", "no page of this program");
    assert_eq!(fs::read_to_string(folder.path().join("run/report.html")).unwrap(), "mine");
}

#[test]
fn texts_cannot_break_the_page() {
    let folder = sample();
    let path = folder.path().join("run/run.toml");
    let text = fs::read_to_string(&path).unwrap();
    let evil = "</script><script>alert(1)</script>&<b>";
    // Names are proven, descriptions are free.
    let described = |line: &str| match line.starts_with("description") {
        true => format!("description = {evil:?}\n"),
        false => format!("{line}\n"),
    };
    fs::write(&path, text.lines().map(described).collect::<String>()).unwrap();
    let (html, data) = page(folder.path(), "run");
    assert_eq!(data["description"], evil);
    assert!(!html.contains("<script>alert") && html.matches("</script>").count() == 5);
}

fn refused(folder: &Path, line: &str, wanted: &str) {
    let output = run(folder, line);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{line}: {said}");
    assert!(said.lines().count() == 1 && said.contains(wanted), "{line}: {said}");
}

#[test]
fn wrong_folders_and_damaged_files_are_named_in_one_sentence() {
    let folder = sample();
    let at = |name: &str| folder.path().join(name);
    refused(folder.path(), "report nowhere", "there is no folder nowhere");
    refused(folder.path(), "report run -ksp_type cg", "PETSc");
    fs::create_dir(at("empty")).unwrap();
    refused(folder.path(), "report empty", "none of summary.json, study.csv and solvers.csv");
    let frame = "run/particles/particles-000003.vtp";
    for name in ["run/history.csv", frame, "run/summary.json"] {
        let whole = fs::read(at(name)).unwrap();
        fs::write(at(name), &whole[..whole.len() * 2 / 3 - 7]).unwrap();
        refused(folder.path(), "report run", name);
        fs::write(at(name), &whole).unwrap();
    }
    let whole = fs::read_to_string(at(frame)).unwrap();
    // The count of blocks in front of an array.
    fs::write(at(frame), whole.replace("AQAAAAAAAAAA", "/////////wAA")).unwrap();
    refused(folder.path(), "report run", frame);
    fs::remove_file(at(frame)).unwrap();
    refused(folder.path(), "report run", frame);
    assert!(!at("run/report.html").exists(), "nothing was written");
}

#[test]
fn a_study_has_a_page_with_its_table() {
    let folder = tempfile::tempdir().unwrap();
    done(
        folder.path(),
        "study still_water_2d --schemes wcsph --spacings 0.08,0.04 --until 0.05 --threads 1 --out st -q",
    );
    page(&folder.path().join("st/runs"), "wcsph-0.04");
    let (_, data) = page(folder.path(), "st");
    let wanted = ["Runs", "Error over run time", "Gauges and bodies", "How the runs ended", "Picture"];
    assert_eq!(headings(&data), wanted);
    let plot = &data["sections"][2]["parts"][0]["plots"][0];
    let labels = plot["curves"].as_array().unwrap().iter().map(|curves| &curves["labels"][0]);
    assert_eq!(labels.collect::<Vec<_>>(), ["wcsph-0.08", "wcsph-0.04"]);
    let table = &data["sections"][0]["parts"][0];
    assert_eq!(table["rows"].as_array().unwrap().len(), 2);
    assert_eq!(table["links"][1], "runs/wcsph-0.04/report.html");
}

/// The way a user goes: open the page, press Play, pull the slider, sort a table.
fn look_at(page: &Path) -> String {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tools/page_check.py");
    let output = Command::new("python3").arg(script).arg(page).output().unwrap();
    let said = stdout(&output) + &stderr(&output);
    assert!(output.status.success(), "{said}");
    said
}

#[test]
fn chromium_shows_plays_and_sorts_the_page_of_a_run() {
    if !is_installed("chromium") || !is_installed("python3") {
        return;
    }
    let folder = sample();
    page(folder.path(), "run");
    let said = look_at(&folder.path().join("run/report.html"));
    for wanted in ["player:", "played:", "scrubbed:", "sorted:"] {
        assert!(said.contains(wanted), "{wanted} {said}");
    }
}

#[test]
fn chromium_shows_and_sorts_the_page_of_a_study() {
    if !is_installed("chromium") || !is_installed("python3") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let line = "study dam_break_2d --schemes wcsph,wcsph_monaghan --spacings 0.08,0.04 --until 0.05 --threads 1 --out st -q";
    done(folder.path(), line);
    page(folder.path(), "st");
    let said = look_at(&folder.path().join("st/report.html"));
    assert!(said.contains("sorted:"), "{said}");
}

#[cfg(feature = "petsc")]
#[test]
fn a_laboratory_has_a_page_with_its_choice() {
    let folder = tempfile::tempdir().unwrap();
    let sets = folder.path().join("sets.txt");
    fs::write(&sets, "-ksp_type bcgs -pc_type ilu\n-ksp_type bcgs -pc_type none -ksp_max_it 1\n").unwrap();
    done(
        folder.path(),
        "solvers dam_break_2d --spacing 0.02 --at 0.05,0.1 --sets sets.txt --threads 1 --out so -q",
    );
    let (html, data) = page(folder.path(), "so");
    assert!(html.len() < 5_000_000);
    assert_eq!(headings(&data), ["Option sets", "Pressure error over solver time", "Picture"]);
    assert!(data["ended"].as_str().unwrap().contains("-ksp_type bcgs -pc_type ilu"), "{}", data["ended"]);
    let table = &data["sections"][0]["parts"][0];
    assert_eq!(table["rows"].as_array().unwrap().len(), 4);
    if is_installed("chromium") && is_installed("python3") {
        let said = look_at(&folder.path().join("so/report.html"));
        assert!(said.contains("sorted:"), "{said}");
    }
}
