//! Whole runs from outside: repeatable, resumable, and loud about every failure.
#![cfg(feature = "petsc")]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use serde_json::Value;
use sphpetsc::output::checkpoint::{self, Reader};
use tempfile::TempDir;

/// A dam break of 200 particles, with schedules that do not depend on its end.
const DAM: &str = "dam_break_2d --spacing 0.02 --set output.particles=0.05 --set output.checkpoint=0.1";

fn folder() -> TempDir {
    tempfile::tempdir().unwrap()
}

fn command(folder: &TempDir, line: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sphpetsc"));
    command.current_dir(folder).args(line.split_whitespace());
    command
}

fn run(folder: &TempDir, line: &str) -> Output {
    command(folder, line).output().unwrap()
}

fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Runs to the end and returns what was printed.
fn done(folder: &TempDir, line: &str) -> String {
    let output = run(folder, line);
    assert_eq!(output.status.code(), Some(0), "{line}: {}", stderr(&output));
    stdout(&output)
}

/// Expects this exit code and one error sentence, which is returned.
fn failed(folder: &TempDir, line: &str, code: i32) -> String {
    sentence(&run(folder, line), code)
}

fn sentence(output: &Output, code: i32) -> String {
    let stderr = stderr(output);
    assert_eq!(output.status.code(), Some(code), "{stderr}");
    for text in [&stderr, &stdout(output)] {
        assert!(!text.contains("PETSC ERROR") && !text.contains("panicked"), "{text}");
    }
    let errors: Vec<_> = stderr.lines().filter_map(|line| line.strip_prefix("error: ")).collect();
    assert_eq!(errors.len(), 1, "{stderr}");
    errors[0].to_owned()
}

/// Expects a refusal before anything is written.
fn refused(line: &str) -> String {
    let folder = folder();
    let sentence = failed(&folder, line, 2);
    assert_eq!(fs::read_dir(&folder).unwrap().count(), 0, "{line} wrote something");
    sentence
}

/// All files below a folder, relative to it, with their contents.
fn contents(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for path in fs::read_dir(next).unwrap().map(|entry| entry.unwrap().path()) {
            if path.is_dir() {
                folders.push(path);
            } else {
                found.insert(path.strip_prefix(folder).unwrap().to_owned(), fs::read(&path).unwrap());
            }
        }
    }
    found
}

fn newest_state(folder: &Path) -> Reader {
    let newest = checkpoint::latest(&folder.join("checkpoint")).unwrap().expect("a checkpoint");
    Reader::load(&newest).unwrap()
}

/// Everything in a state, bit by bit.
fn bits(state: &Reader) -> BTreeMap<String, Vec<u64>> {
    let section = |name: &str| match state.f64(name) {
        Ok(numbers) => numbers.iter().map(|x| x.to_bits()).collect(),
        Err(_) => state.u64(name).unwrap().to_vec(),
    };
    state.names().map(|name| (name.to_owned(), section(name))).collect()
}

/// Particle files by the time that the collection gives them.
fn snapshots(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let text = fs::read_to_string(folder.join("particles.pvd")).unwrap();
    let between = |line: &str, name: &str| {
        line.split_once(&format!("{name}=\"")).map(|(_, rest)| rest.split('"').next().unwrap().to_owned())
    };
    let entry = |line: &str| {
        let file = folder.join(between(line, "file")?);
        Some((between(line, "timestep")?, fs::read(file).unwrap()))
    };
    text.lines().filter_map(entry).collect()
}

/// Same end, same history, and every snapshot of `whole` in `resumed` too (which may have one more for each pause).
fn assert_same_run(whole: &Path, resumed: &Path) {
    assert_eq!(bits(&newest_state(whole)), bits(&newest_state(resumed)));
    assert!(
        fs::read(whole.join("history.csv")).unwrap() == fs::read(resumed.join("history.csv")).unwrap(),
        "history.csv differs"
    );
    let others = snapshots(resumed);
    for (time, file) in snapshots(whole) {
        assert!(others.get(&time) == Some(&file), "the particles at {time} s differ");
    }
    let energy = |folder: &Path| summary(folder)["energy"].clone();
    assert_eq!(energy(whole), energy(resumed));
}

fn summary(folder: &Path) -> Value {
    serde_json::from_slice(&fs::read(folder.join("summary.json")).unwrap()).unwrap()
}

/// A column of a table as text.
fn column(table: &Path, name: &str) -> Vec<String> {
    let text = fs::read_to_string(table).unwrap();
    let mut lines = text.lines();
    let index = lines.next().unwrap().split(',').position(|column| column == name).expect(name);
    lines.map(|line| line.split(',').nth(index).unwrap().to_owned()).collect()
}

fn mean_of_last_half(table: &Path, name: &str) -> f64 {
    let values: Vec<f64> = column(table, name).iter().map(|value| value.parse().unwrap()).collect();
    let half = &values[values.len() / 2..];
    half.iter().sum::<f64>() / half.len() as f64
}

#[test]
fn a_resumed_run_is_the_uninterrupted_run() {
    let folder = folder();
    done(&folder, &format!("{DAM} --until 0.3 --out whole"));
    done(&folder, &format!("{DAM} --until 0.15 --out parts"));
    done(&folder, "--resume parts --until 0.3");
    assert_same_run(&folder.path().join("whole"), &folder.path().join("parts"));
    let case = fs::read_to_string(folder.path().join("parts/run.toml")).unwrap();
    assert!(case.contains("until = 0.3"), "run.toml is the case as run");
}

/// Starts a run, waits for its first checkpoint, and sends it a signal.
fn interrupted(folder: &TempDir, line: &str, signal: &str) -> Output {
    let mut child: Child =
        command(folder, line).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let begun = Instant::now();
    while checkpoint::latest(&folder.path().join("parts/checkpoint")).unwrap().is_none() {
        assert!(child.try_wait().unwrap().is_none(), "the run ended too soon");
        assert!(begun.elapsed() < Duration::from_secs(60), "no checkpoint appeared");
        thread::sleep(Duration::from_millis(5));
    }
    let sent = Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap();
    assert!(sent.success());
    child.wait_with_output().unwrap()
}

#[test]
fn a_signal_saves_the_state_and_resume_goes_on() {
    let folder = folder();
    let case =
        "dam_break_2d --spacing 0.01 --set output.particles=0.05 --set output.checkpoint=0.02 --until 0.4";
    done(&folder, &format!("{case} --out whole"));
    for signal in ["-INT", "-TERM"] {
        let output = interrupted(&folder, &format!("{case} --out parts"), signal);
        let said = sentence(&output, 130);
        assert!(said.contains("--resume parts"), "{said}");
        let time = newest_state(&folder.path().join("parts")).f64("time").unwrap()[0];
        assert!(time > 0.0 && time < 0.4, "stopped at {time} s");
        done(&folder, "--resume parts");
        assert_same_run(&folder.path().join("whole"), &folder.path().join("parts"));
        fs::remove_dir_all(folder.path().join("parts")).unwrap();
    }
}

#[test]
fn a_damaged_checkpoint_is_refused_and_nothing_changes() {
    let folder = folder();
    done(&folder, &format!("{DAM} --until 0.02 --out out"));
    let out = folder.path().join("out");
    let newest = checkpoint::latest(&out.join("checkpoint")).unwrap().unwrap();
    let mut bytes = fs::read(&newest).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&newest, bytes).unwrap();
    let before = contents(&out);
    for line in ["--resume out --until 0.04", "dam_break_2d --spacing 0.02 --resume out"] {
        let said = failed(&folder, line, 2);
        assert!(said.contains("damaged"), "{said}");
    }
    assert!(contents(&out) == before, "the folder changed");
}

#[test]
fn a_state_of_another_case_is_refused_and_nothing_changes() {
    let folder = folder();
    done(&folder, &format!("{DAM} --until 0.02 --out out"));
    let before = contents(&folder.path().join("out"));
    let said = failed(&folder, "still_water_2d --spacing 0.02 --resume out", 2);
    assert!(said.contains("another case"), "{said}");
    assert!(contents(&folder.path().join("out")) == before, "the folder changed");
}

/// A failed run: the last good state, the failing one, its pressure system, and a summary that says so.
fn assert_failure_is_documented(out: &Path, said: &str) {
    assert!(said.starts_with("step ") && said.contains(" at t = "), "{said}");
    newest_state(out);
    for file in ["particles/failed.vtp", "systems/failed.petsc", "history.csv", "run.toml"] {
        assert!(out.join(file).is_file(), "{file} is missing");
    }
    assert_eq!(summary(out)["ended"].as_str(), Some(said));
}

#[test]
fn a_solver_that_does_not_converge_is_never_silent() {
    let folder = folder();
    done(&folder, &format!("{DAM} --until 0.05 --out fallback -ksp_max_it 1"));
    let table = fs::read_to_string(folder.path().join("fallback/solver.csv")).unwrap();
    let used = table.lines().filter(|row| row.contains(",\"bcgs+ilu, after ") && row.ends_with('"')).count();
    assert!(used > 0, "{table}");
    assert_eq!(summary(&folder.path().join("fallback"))["solver"]["fallbacks"], used);

    let said =
        failed(&folder, &format!("{DAM} --until 0.05 --out lost -ksp_max_it 1 -fallback_ksp_max_it 1"), 1);
    assert!(said.contains("did not converge"), "{said}");
    assert_failure_is_documented(&folder.path().join("lost"), &said);
}

#[test]
fn a_run_out_of_control_stops_with_step_and_particle() {
    for step in ["0.05", "1e300"] {
        let folder = folder();
        let said = failed(&folder, &format!("{DAM} --set time.step={step} --out out"), 1);
        assert!(said.contains(": particle "), "{said}");
        let out = folder.path().join("out");
        assert_failure_is_documented(&out, &said);
        let state = newest_state(&out);
        assert!(state.f64("position").unwrap().iter().all(|x| x.is_finite()), "the last good state is good");
    }
}

#[test]
fn wrong_petsc_options_are_refused_with_advice() {
    for (options, wanted) in [
        ("-ksp_type magic", "valid are bcgs,"),
        ("-ksp_type gmre", "did you mean gmres?"),
        ("-pc_type magic", "valid are asm,"),
        ("-ksp_rtoll 1e-6", "did you mean -ksp_rtol?"),
        ("-ksp_rtol tiny", "tiny"),
        ("-options_file missing", "missing"),
    ] {
        let said = refused(&format!("{DAM} {options}"));
        assert!(said.contains(wanted), "{options}: {said}");
    }
    let said = refused("check dam_break_2d -ksp_type magic");
    assert!(said.contains("valid are bcgs,"), "{said}");
}

#[test]
fn petsc_reports_what_it_is_asked_for() {
    let folder = folder();
    fs::write(folder.path().join("options"), "-ksp_type gmres\n").unwrap();
    for (options, wanted) in [
        ("-ksp_view", "KSP Object"),
        ("-log_view", "PETSc Performance Summary"),
        ("-ksp_monitor", "KSP Residual norm"),
        ("-options_file options", "gmres + "),
        ("-help", "-ksp_rtol"),
    ] {
        let said = done(&folder, &format!("{DAM} --until 0.002 {options}"));
        assert!(said.contains(wanted), "{options} does not print {wanted}");
    }
}

#[test]
fn several_ranks_are_refused_in_one_sentence() {
    if Command::new("mpiexec").arg("--version").output().is_err() {
        eprintln!("skipped: no mpiexec");
        return;
    }
    let folder = folder();
    let output = Command::new("mpiexec")
        .current_dir(&folder)
        .args(["-n", "2", env!("CARGO_BIN_EXE_sphpetsc"), "dam_break_2d"])
        .env("OMPI_ALLOW_RUN_AS_ROOT", "1")
        .env("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1")
        .env("OMPI_MCA_rmaps_base_oversubscribe", "1")
        .output()
        .unwrap();
    let said = sentence(&output, 2);
    assert!(said.contains("one rank, and 2 were started"), "{said}");
    assert_eq!(fs::read_dir(&folder).unwrap().count(), 0);
}

#[test]
fn an_output_folder_is_free_or_an_earlier_run() {
    let folder = folder();
    let short = format!("{DAM} --until 0.002");
    fs::write(folder.path().join("file"), "").unwrap();
    assert!(failed(&folder, &format!("{short} --out file/run"), 2).contains("choose another --out"));

    let foreign = folder.path().join("thesis");
    fs::create_dir(&foreign).unwrap();
    fs::write(foreign.join("thesis.tex"), "years of work").unwrap();
    assert!(failed(&folder, &format!("{short} --out thesis"), 2).contains("is not empty"));
    assert!(failed(&folder, &format!("{short} --out thesis --force"), 2).contains("does not empty"));
    assert_eq!(contents(&foreign).len(), 1);

    done(&folder, &format!("{short} --out run"));
    assert!(failed(&folder, &format!("{short} --out run"), 2).contains("--force"));
    fs::write(folder.path().join("run/comparison.csv"), "of the earlier run").unwrap();
    done(&folder, &format!("{short} --out run --force"));
    assert!(!folder.path().join("run/comparison.csv").exists());

    done(&folder, &short);
    done(&folder, &short);
    assert!(folder.path().join("out/dam_break_2d-2/summary.json").exists());
}

#[test]
fn a_run_leaves_all_its_files_and_repeats_from_them() {
    let folder = folder();
    let gauges = "--set probe=[{kind=\"pressure\",name=\"p_wall\",position=[0.8,0.1]},\
                  {kind=\"height\",name=\"h_wall\",position=[0.79,0.0]}]";
    let table = done(&folder, &format!("{DAM} --until 0.1 --save-systems 0.05 --out one {gauges}"));
    for line in ["case", "solver", "iterations", "stages, s", "memory", "files"] {
        assert!(table.lines().any(|l| l.starts_with(line)), "the end table lacks {line}:\n{table}");
    }
    let one = folder.path().join("one");
    let files = contents(&one);
    for file in ["run.toml", "particles.pvd", "history.csv", "probes.csv", "solver.csv", "summary.json"] {
        assert!(files.contains_key(Path::new(file)), "{file} is missing");
    }
    for part in ["particles/particles-000000.vtp", "checkpoint/step-", "systems/t0.05"] {
        assert!(files.keys().any(|file| file.to_string_lossy().starts_with(part)), "no {part}");
    }
    let temporary: Vec<_> = files.keys().filter(|file| file.to_string_lossy().ends_with(".tmp")).collect();
    assert!(temporary.is_empty(), "{temporary:?}");
    for gauge in ["p_wall_pa", "h_wall_m"] {
        assert!(column(&one.join("probes.csv"), gauge).iter().all(|cell| cell == "dry"), "{gauge}");
    }
    let summary = summary(&one);
    let steps = summary["steps"].as_u64().unwrap();
    assert_eq!(column(&one.join("solver.csv"), "step").len() as u64, steps, "a row a step");
    for key in ["case", "version", "ended", "time_s", "wall_s", "stages_s", "particles", "solver", "arrivals"]
    {
        assert!(!summary[key].is_null(), "summary.json lacks {key}");
    }
    assert!(summary["time_s"].as_f64().unwrap() >= 0.1);

    done(&folder, "one/run.toml --out two");
    let history = |name: &str| fs::read(folder.path().join(name).join("history.csv")).unwrap();
    assert!(history("one") == history("two"), "run.toml does not repeat the run");
}

#[test]
fn gauges_in_still_water_read_the_hydrostatic_values() {
    let folder = folder();
    done(&folder, "still_water_2d --until 0.3 --out out");
    let probes = folder.path().join("out/probes.csv");
    let pressure = mean_of_last_half(&probes, "p_bottom_pa");
    assert!((pressure / 3924.0 - 1.0).abs() < 0.002, "{pressure} Pa");
    let height = mean_of_last_half(&probes, "h_middle_m");
    assert!((height / 0.4 - 1.0).abs() < 0.01, "{height} m");
}

#[test]
fn every_shipped_case_runs() {
    let folder = folder();
    let list = done(&folder, "cases");
    for name in list.lines().filter_map(|line| line.split_whitespace().next()) {
        let short = match name {
            "patch_test" => "",
            name if name.contains("3d") => "--spacing 0.02 --until 0.01 --set output.snapshots=[]",
            _ => "--until 0.01 --set output.snapshots=[]",
        };
        done(&folder, &format!("{name} {short}"));
        assert!(folder.path().join("out").join(name).join("run.toml").is_file());
    }
}

#[test]
fn references_are_read_before_the_run_and_compared_after_it() {
    let folder = folder();
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    write("columns.csv", "t,x\n1,2\n");
    write("words.csv", "t_n_sqrt_g_over_a_nd,front_z_over_a_nd\nsoon,far\n");
    let before = fs::read_dir(&folder).unwrap().count();
    for (options, wanted) in [
        ("--reference columns.csv", "columns.csv has no column t_n_sqrt_g_over_a_nd"),
        ("--reference words.csv", "words.csv: no row has numbers"),
        ("--set arrival.0.quantity=\"frnt\"", "history.csv has no column frnt"),
        ("--set reference.0.quantity=\"frnt\"", "history.csv has no column frnt"),
    ] {
        for task in ["", "check "] {
            let said = failed(&folder, &format!("{task}dam_break_2d --spacing 0.02 {options}"), 2);
            assert!(said.contains(wanted), "{options}: {said}");
        }
    }
    assert_eq!(fs::read_dir(&folder).unwrap().count(), before, "something was written");

    let measured = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../shared/reference/martin_moyce1952/front_n2eq2_table2.csv");
    if !measured.is_file() {
        eprintln!("skipped: no {}", measured.display());
        return;
    }
    done(&folder, &format!("{DAM} --until 0.3 --out out --reference {}", measured.display()));
    let summary = summary(&folder.path().join("out"));
    let reference = &summary["references"][0];
    assert_eq!(reference["name"], "martin_moyce");
    assert!(reference["values"].as_u64().unwrap() > 3);
    assert!(reference["rms_of_mean"].as_f64().unwrap() < 0.3, "{reference}");
}
