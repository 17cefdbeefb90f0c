//! Studies from outside: many runs, each on its own, none done twice.

use crate::common::{run, stderr};
use std::fs;

#[test]
fn wrong_studies_are_refused_in_one_sentence() {
    for (line, wanted) in [
        ("study nowhere", "there is no case"),
        ("study patch_test", "patch_test has none"),
        ("study --schemes isph_df,patch_test", "patch_test has none"),
        ("study --schemes magic", "isph_df"),
        ("study --spacings 0.02,-1", "give a finite number > 0 in m"),
        ("study --spacings 0.02,10", "spacing"),
        ("study --set spacing=0.02", "use --spacings and --schemes"),
        ("study --until 1 --set fluid.densty=1", "did you mean fluid.density?"),
        ("study --reference nowhere.csv", "there is no such file"),
        ("study --resume", "--resume"),
        ("study paper_comparison --schemes magic", "isph_df"),
        ("study --vary scheme.shifting", "KEY=VALUE"),
        ("study --vary scheme.shiftin=0,1", "did you mean"),
        ("study --tolerances 0", "> 0"),
        (
            "study -ksp_monitor my.toml",
            if cfg!(feature = "petsc") { "put the case first" } else { "no PETSc" },
        ),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let output = run(&folder, line);
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{line}: {said}");
        assert!(output.stdout.is_empty(), "{line}");
        assert!(said.lines().all(|l| l.starts_with("error: ")) && said.contains(wanted), "{line}: {said}");
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 0, "{line} wrote something");
    }
}

#[cfg(feature = "petsc")]
mod runs {
    use std::path::Path;
    use std::process::{Command, Stdio};
    use std::thread;
    use std::time::{Duration, Instant, SystemTime};

    use sphpetsc::output::checkpoint;

    use super::*;
    use crate::common::{command, done, stdout, summary};
    use tempfile::TempDir;

    /// Runs of 50 and 200 particles.
    const STUDY: &str = "study dam_break_2d --spacings 0.02,0.04 --until 0.05 --threads 1";

    /// The table of a study as rows of cells; no cell of these tests holds a comma but the last.
    fn table(folder: &TempDir) -> (Vec<String>, Vec<Vec<String>>) {
        let text = fs::read_to_string(folder.path().join("out/study.csv")).unwrap();
        let mut lines = text.lines();
        let head: Vec<String> = lines.next().unwrap().split(',').map(str::to_owned).collect();
        let columns = head.len();
        (head, lines.map(|line| line.splitn(columns, ',').map(str::to_owned).collect()).collect())
    }

    fn written(path: &Path) -> SystemTime {
        fs::metadata(path).unwrap().modified().unwrap()
    }

    #[test]
    fn the_table_tells_what_the_runs_tell_and_nothing_is_done_twice() {
        let folder = tempfile::tempdir().unwrap();
        let data = "t_n_sqrt_g_over_a_nd,front_z_over_a_nd\n0.2,1.55\n0.4,1.6\n";
        fs::write(folder.path().join("data.csv"), data).unwrap();
        let line = format!("{STUDY} --out out --reference data.csv");
        let said = done(&folder, &line);
        assert!(said.starts_with("study of dam_break_2d: 2 runs until 0.05 s in out\n"), "{said}");
        assert!(said.contains("martin_moyce_rms"), "{said}");

        let (head, rows) = table(&folder);
        let of = |row: &[String], name: &str| -> String {
            row[head.iter().position(|column| column == name).expect(name)].clone()
        };
        assert_eq!(rows.iter().map(|row| of(row, "spacing_m")).collect::<Vec<_>>(), ["0.04", "0.02"]);
        for row in &rows {
            let summary = summary(&folder.path().join("out").join(of(row, "run")));
            for (column, value) in [
                ("steps", &summary["steps"]),
                ("wall_s", &summary["wall_s"]),
                ("particles", &summary["particles"]["fluid"]),
                ("martin_moyce_rms", &summary["references"][0]["rms"]),
                ("martin_moyce_largest", &summary["references"][0]["largest"]),
                ("energy_rise", &summary["energy"]["largest_rise_of_initial"]),
            ] {
                let told: f64 = of(row, column).parse().unwrap();
                assert_eq!(Some(told), value.as_f64(), "{column}");
            }
            assert_eq!((of(row, "scheme").as_str(), of(row, "failure").as_str()), ("isph_df", "none"));
        }
        let number = |row: usize, name: &str| of(&rows[row], name).parse::<f64>().unwrap();
        let order = (number(0, "martin_moyce_rms") / number(1, "martin_moyce_rms")).log2();
        assert!((number(1, "martin_moyce_rms_order") - order).abs() < 1e-12);
        assert_eq!(of(&rows[0], "martin_moyce_rms_order"), "none");
        let picture = fs::read(folder.path().join("out/study.png")).unwrap();
        assert!(picture.starts_with(b"\x89PNG"));

        let files = ["isph_df-0.04", "isph_df-0.02"].map(|run| folder.path().join("out/runs").join(run));
        let before = files.each_ref().map(|run| written(&run.join("summary.json")));
        let said = done(&folder, &format!("{line} --measure energy_rise"));
        assert!(said.contains("2 of them done before") && said.contains("energy_rise"), "{said}");
        assert_eq!(before, files.each_ref().map(|run| written(&run.join("summary.json"))));

        let output = run(&folder, &format!("{line} --measure colour"));
        assert_eq!(output.status.code(), Some(2));
        assert!(stderr(&output).contains("these runs have martin_moyce_rms, "), "{}", stderr(&output));

        // Other arguments: refused, unless asked for.
        let other = line.replace("0.05", "0.04");
        let output = run(&folder, &other);
        assert_eq!(output.status.code(), Some(2));
        assert!(stderr(&output).contains("is a run with other arguments"), "{}", stderr(&output));
        assert_eq!(before, files.each_ref().map(|run| written(&run.join("summary.json"))));
        done(&folder, &format!("{other} --force"));
        assert!(written(&files[0].join("summary.json")) > before[0]);
    }

    #[test]
    fn all_axes_are_combined_and_told() {
        let folder = tempfile::tempdir().unwrap();
        let line = "study dam_break_2d --spacings 0.04 --tolerances 1e-2,1e-8 --vary scheme.laplacian=schwaiger,shao_lo \
                    --until 0.05 --threads 1 --out out";
        let study = || {
            let output =
                command(&folder, line).args(["--solver", "-ksp_type cg -pc_type icc"]).output().unwrap();
            assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
            stdout(&output)
        };
        let said = study();
        assert!(said.contains("4 runs") && said.contains("no other run is better"), "{said}");
        let text = fs::read_to_string(folder.path().join("out/study.csv")).unwrap();
        let mut sheet = csv::Reader::from_reader(text.as_bytes());
        let rows: Vec<std::collections::BTreeMap<String, String>> =
            sheet.deserialize().map(|row| row.unwrap()).collect();
        assert_eq!(rows.len(), 4);
        for row in &rows {
            let case =
                fs::read_to_string(folder.path().join("out").join(&row["run"]).join("run.toml")).unwrap();
            let rtol: f64 = row["rtol"].parse().unwrap();
            assert!(case.contains(&format!("-ksp_type cg -pc_type icc -ksp_rtol {rtol:?}")), "{case}");
            assert!(case.contains(&format!("laplacian = \"{}\"", row["scheme.laplacian"])), "{case}");
            assert_eq!(row["solver"], "-ksp_type cg -pc_type icc");
            let summary = summary(&folder.path().join("out").join(&row["run"]));
            let solve: f64 = row["solve_s"].parse().unwrap();
            assert_eq!(Some(solve), summary["stages_s"]["solve"].as_f64());
            // The tightest of each form is what the others are measured by.
            let is_finest = rtol == 1e-8;
            assert_eq!(row["finest_front_m_rms"] == "none", is_finest, "{row:?}");
        }
        assert!(rows.iter().any(|row| row["pareto"] == "yes"));
        assert!(study().contains("4 of them done before"));
    }

    #[test]
    fn a_study_file_has_groups_and_built_in_ones_run() {
        let folder = tempfile::tempdir().unwrap();
        let text = "description = \"two groups\"\ncase = \"dam_break_2d\"\nuntil = 0.03\nspacings = [0.08, 0.04]\n\
                    [[group]]\nname = \"small steps\"\nset = { \"time.step\" = 1e-3 }\n\
                    [[group]]\nname = \"explicit\"\nschemes = [\"wcsph\"]\ntolerances = [1e-3, 1e-6]\n";
        fs::write(folder.path().join("mine.toml"), text).unwrap();
        let said = done(&folder, "study mine.toml --threads 1 --out out");
        assert!(said.starts_with("two groups\nstudy of mine: 4 runs until 0.03 s"), "{said}");
        let (head, rows) = table(&folder);
        assert!(head.contains(&"group".to_owned()) && !head.contains(&"rtol".to_owned()), "{head:?}");
        assert_eq!(rows.len(), 4);
        fs::write(folder.path().join("mine.toml"), text.replace("spacings", "spacngs")).unwrap();
        let output = run(&folder, "study mine.toml --out other");
        assert_eq!(output.status.code(), Some(2));
        assert!(stderr(&output).contains("unknown field `spacngs`"), "{}", stderr(&output));
        assert!(!folder.path().join("other").exists());
        let said =
            done(&folder, "study paper_comparison --spacings 0.04 --until 0.02 --threads 1 --out paper");
        assert!(said.contains("study of paper_comparison: 6 runs"), "{said}");
        assert!(done(&folder, "study --list").lines().count() >= 9);
    }

    #[test]
    fn a_run_that_fails_is_told_with_its_cause() {
        let folder = tempfile::tempdir().unwrap();
        // A fixed step that the coarse run bears and the fine one does not.
        let line = "study dam_break_2d --spacings 0.04,0.01 --until 0.1 --threads 1 --out out";
        let said = done(&folder, &format!("{line} --set time.step=0.05"));
        assert!(said.contains("  failed: step 1 at"), "{said}");
        let (head, rows) = table(&folder);
        let energy = head.iter().position(|column| column == "energy_rise").unwrap();
        assert_eq!((rows.len(), head.last().unwrap().as_str()), (2, "failure"));
        assert!(rows[0].last().unwrap() == "none" && rows[0][energy].parse::<f64>().is_ok(), "{rows:?}");
        assert!(rows[1].last().unwrap().contains("out of control") && rows[1][energy] == "none", "{rows:?}");
        assert!(folder.path().join("out/study.png").is_file());

        let output = run(&folder, &format!("{STUDY} --set time.step=1 --out none"));
        assert_eq!(output.status.code(), Some(1), "no run reaches its end: {}", stderr(&output));
    }

    #[test]
    fn a_wrong_petsc_option_ends_a_study_before_it_begins() {
        let folder = tempfile::tempdir().unwrap();
        let output = run(&folder, &format!("{STUDY} --out out -ksp_tpye cg"));
        assert_eq!(output.status.code(), Some(2));
        assert!(stderr(&output).contains("did you mean -ksp_type?"), "{}", stderr(&output));
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 0);
        done(&folder, &format!("{STUDY} --out out -ksp_type cg -pc_type jacobi"));
        let case = fs::read_to_string(folder.path().join("out/runs/isph_df-0.04/run.toml")).unwrap();
        assert!(case.contains("-ksp_type cg -pc_type jacobi"), "{case}");
    }

    #[test]
    fn an_interrupted_study_goes_on_where_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let line = "study dam_break_2d --spacings 0.04,0.01 --until 0.4 --threads 1 --out out \
                    --set output.checkpoint=0.02";
        let mut study = command(&folder, line).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let runs = folder.path().join("out/runs");
        let begun = Instant::now();
        while checkpoint::latest(&runs.join("isph_df-0.01/checkpoint")).unwrap().is_none() {
            assert!(study.try_wait().unwrap().is_none(), "the study ended too soon");
            assert!(begun.elapsed() < Duration::from_secs(60), "no checkpoint appeared");
            thread::sleep(Duration::from_millis(5));
        }
        // To the study alone: it tells its run.
        let sent = Command::new("kill").args(["-INT", &study.id().to_string()]).status().unwrap();
        assert!(sent.success());
        let output = study.wait_with_output().unwrap();
        assert_eq!(output.status.code(), Some(130), "{}", stderr(&output));
        assert!(stderr(&output).contains("the same command goes on"), "{}", stderr(&output));
        let half = summary(&runs.join("isph_df-0.01"));
        assert!(half["ended"].as_str().unwrap().contains("interrupted"), "{half}");
        let first = written(&runs.join("isph_df-0.04/summary.json"));

        let output = command(&folder, line).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        assert!(stderr(&output).contains("resumed at t = "), "{}", stderr(&output));
        assert_eq!(first, written(&runs.join("isph_df-0.04/summary.json")), "the finished run is left alone");
        let whole = summary(&runs.join("isph_df-0.01"));
        assert_eq!(whole["ended"], "at the end");
        assert!(whole["wall_s"].as_f64() > half["wall_s"].as_f64(), "the times of both parts count");
        assert_eq!(table(&folder).1.len(), 2);
    }
}
