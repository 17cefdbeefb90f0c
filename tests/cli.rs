//! The program from outside: wrong input is exit code 2, one sentence a problem, and nothing written.

use std::fs;
use std::process::{Command, Output, Stdio};

use tempfile::TempDir;

const CASE: &str = "\
name = \"my\"
dimension = 2
spacing = 0.02

[fluid]
kinematic_viscosity = 1e-6
[[fluid.block]]
min = [0.0, 0.0]
max = [0.2, 0.2]

[tank]
min = [0.0, 0.0]
max = [0.4, 0.4]

[time]
until = 0.1
";

fn command(folder: &TempDir, args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sphpetsc"));
    command.current_dir(folder).args(args);
    command
}

fn sphpetsc(folder: &TempDir, args: &[&str]) -> Output {
    command(folder, args).output().unwrap()
}

fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

/// Runs `my.toml` with `args`, expects a refusal, and returns its lines without `error: `.
fn refusal(case: &str, args: &[&str]) -> Vec<String> {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("my.toml"), case).unwrap();
    let output = sphpetsc(&folder, args);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{args:?}: {stderr}");
    assert!(output.stdout.is_empty());
    assert_eq!(fs::read_dir(&folder).unwrap().count(), 1, "{args:?} wrote something");
    let lines = stderr.lines().map(|line| line.strip_prefix("error: ").expect(line).to_owned());
    lines.collect()
}

/// The only line of a refusal.
fn sentence(case: &str, args: &[&str]) -> String {
    let lines = refusal(case, args);
    assert_eq!(lines.len(), 1, "{lines:#?}");
    lines[0].clone()
}

#[test]
fn wrong_files_are_refused_with_line_and_advice() {
    for (from, to, wanted) in [
        ("spacing", "spacng", "my.toml: spacing is missing: give a finite number > 0 in m"),
        ("spacing = 0.02", "spacing = -0.02", "my.toml:3: spacing is -0.02: give a finite number > 0 in m"),
        ("= 1e-6", "= nan", "my.toml:6: fluid.kinematic_viscosity is NaN: give a finite number >= 0 in m2/s"),
        (
            "max = [0.2, 0.2]",
            "max = [0.5, 0.2]",
            "my.toml:9: fluid.block.0.max reaches 0.5, beyond the tank's right side at 0.4: keep it inside",
        ),
        (
            "\"my\"",
            "\"m\ty\"",
            "my.toml:1: name is \"m\\ty\": give a name of letters, digits, - and _ in quotes",
        ),
        ("until = 0.1", "until = 0,1", "my.toml:16: not valid TOML"),
    ] {
        let lines = refusal(&CASE.replacen(from, to, 1), &["my.toml"]);
        assert!(lines[0].starts_with(wanted), "{lines:#?}");
    }
}

#[test]
fn check_refuses_what_a_run_refuses() {
    let case = CASE.replace("0.02", "0");
    assert_eq!(refusal(&case, &["check", "my.toml"]), refusal(&case, &["my.toml"]));
}

#[test]
fn several_problems_come_in_one_answer() {
    let case = CASE.replace("0.02", "-1").replace("1e-6", "nan").replace("0.1", "-5") + "untl = 3\n";
    let lines = refusal(&case, &["my.toml"]);
    let places: Vec<_> = lines.iter().map(|line| line.split(": ").next().unwrap()).collect();
    assert_eq!(places, ["my.toml:3", "my.toml:6", "my.toml:16", "my.toml:17"]);
    assert!(lines[3].ends_with("did you mean time.until?"), "{}", lines[3]);
}

#[test]
fn wrong_command_lines_are_refused_in_one_sentence() {
    for (args, wanted) in [
        (&["dam_brek_2d"][..], "did you mean dam_break_2d?"),
        (&["nowhere.toml"], "nowhere.toml: cannot be read"),
        (&["."], "there is no case \".\""),
        (&["cases", "show", "still_water"], "did you mean still_water_"),
        (&["my.toml", "--set", "spacing=-1"], "--set spacing: spacing is -1"),
        (&["my.toml", "--set", "fluid.densty=1"], "did you mean fluid.density?"),
        (&["my.toml", "--set", "new.key=1"], "--set new.key: new is no key"),
        (&["my.toml", "--set", "spacing"], "write KEY=VALUE"),
        (&["my.toml", "--spacing", "-1"], "'--spacing <M>': give a finite number > 0"),
        (&["my.toml", "--until", "nan"], "give a finite number >= 0"),
        (&["my.toml", "--snapshots", "0.05,7"], "7.0 s, after the end at 0.1 s"),
        (&["my.toml", "--seed", "-1"], "'--seed <N>': give a whole number from 0"),
        (&["my.toml", "--threads", "0"], "'--threads <N>': give a whole number > 0"),
        (&["my.toml", "--scheme", "magic"], "isph_df"),
        (&["my.toml", "--outt", "x"], "a similar argument exists: '--out'"),
        (&["my.toml", "--reference", "missing.csv"], "--reference missing.csv: "),
        (&["my.toml", "--force"], "--out"),
        (&["my.toml", "-q", "-v"], "cannot be used with"),
        (&["my.toml", "other.toml"], "'other.toml' cannot be used with '[CASE]'"),
        (&["my.toml", "--resume", "nowhere", "--force", "--out", "x"], "cannot be used with"),
        (&["--resume", "nowhere"], "run.toml: cannot be read"),
        (&["cases", "-ksp_type", "cg"], "-ksp_type is a PETSc option"),
    ] {
        let found = sentence(CASE, args);
        assert!(found.contains(wanted), "{args:?}: {found}");
    }
}

#[test]
fn a_case_is_not_taken_for_the_value_of_a_petsc_option() {
    let found = sentence(CASE, &["-ksp_monitor", "my.toml"]);
    let wanted = if cfg!(feature = "petsc") { "put the case first" } else { "this build has no PETSc" };
    assert!(found.contains(wanted), "{found}");
}

#[test]
fn text_that_is_no_utf8_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("my.toml"), b"name = \"\xff\"").unwrap();
    let output = sphpetsc(&folder, &["my.toml"]);
    assert_eq!(output.status.code(), Some(2));
    assert_eq!(String::from_utf8(output.stderr).unwrap().lines().count(), 1);
}

#[test]
fn built_in_cases_are_listed_shown_and_checked() {
    let folder = tempfile::tempdir().unwrap();
    let list = stdout(&sphpetsc(&folder, &["cases"]));
    assert!(list.starts_with("dam_break_2d "), "{list}");
    for line in list.lines() {
        let name = line.split_whitespace().next().unwrap();
        let shown = sphpetsc(&folder, &["cases", "show", name]);
        assert!(shown.status.success());
        fs::write(folder.path().join("copy.toml"), &shown.stdout).unwrap();
        for case in [name, "copy.toml"] {
            let checked = sphpetsc(&folder, &["check", case]);
            assert!(checked.status.success(), "{}", String::from_utf8_lossy(&checked.stderr));
        }
    }
    assert_eq!(fs::read_dir(&folder).unwrap().count(), 1, "check writes nothing");
}

#[test]
fn tabs_and_windows_line_ends_are_white_space() {
    let folder = tempfile::tempdir().unwrap();
    let case = CASE.replace(" = ", "\t=\t").replace('\n', "\r\n");
    fs::write(folder.path().join("my.toml"), case).unwrap();
    assert!(sphpetsc(&folder, &["check", "my.toml"]).status.success());
}

#[test]
fn help_and_version_answer_on_standard_output() {
    let folder = tempfile::tempdir().unwrap();
    for flag in ["-h", "--help"] {
        let help = stdout(&sphpetsc(&folder, &[flag]));
        for wanted in ["--spacing <M>", "in m", "PETSc options:", "-ksp_type cg", "cases [show NAME]"] {
            assert!(help.contains(wanted), "{flag} lacks {wanted}:\n{help}");
        }
    }
    let version = format!("sphpetsc {}\n", env!("CARGO_PKG_VERSION"));
    assert_eq!(stdout(&sphpetsc(&folder, &["-V"])), version);
    assert_eq!(stdout(&sphpetsc(&folder, &["--version"])), version);
}

#[test]
fn a_reader_that_leaves_early_is_no_error() {
    let folder = tempfile::tempdir().unwrap();
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let output = command(&folder, &["cases"]).stdout(writer).stderr(Stdio::piped()).output().unwrap();
    assert!(output.status.success());
    assert!(output.stderr.is_empty());
}

#[cfg(not(feature = "petsc"))]
#[test]
fn without_petsc_a_flow_is_refused_and_the_rest_works() {
    let found = sentence(CASE, &["my.toml"]);
    assert!(found.contains("leaves PETSc out"), "{found}");
    let folder = tempfile::tempdir().unwrap();
    for args in [&["check", "dam_break_2d"][..], &["patch_test"]] {
        assert!(sphpetsc(&folder, args).status.success(), "{args:?}");
    }
}
