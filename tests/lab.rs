//! The solver laboratory from outside: a row for every option set, whatever becomes of it.
#![cfg(feature = "petsc")]

use std::fs;
use std::path::Path;

use crate::common::{done, refused, run, stderr};
use serde_json::Value;

/// Systems of 200 particles.
const SMALL: &str = "solvers dam_break_2d --spacing 0.02 --at 0.05,0.35 --threads 1 --out out";

/// Rows of solvers.csv by column name.
fn rows(folder: &Path) -> Vec<std::collections::BTreeMap<String, String>> {
    let mut table = csv::Reader::from_path(folder.join("out/solvers.csv")).unwrap();
    table.deserialize().map(|row| row.unwrap()).collect()
}

fn number(cell: &str) -> f64 {
    cell.parse().unwrap()
}

#[test]
fn wrong_laboratories_are_refused_in_one_sentence() {
    for (line, wanted) in [
        ("solvers nowhere", "there is no case"),
        ("solvers --scheme wcsph", "solves no pressure system"),
        ("solvers patch_test", "solves no pressure system"),
        ("solvers --at 9", "after the end"),
        ("solvers --sets nowhere.txt", "cannot be read"),
        ("solvers --limit 0", "> 0"),
        ("solvers nowhere.petsc", "cannot be read"),
        ("solvers --try icc", "is no option"),
        ("solvers --try --set=x", "is no option"),
    ] {
        let said = refused(line);
        assert!(said.contains(wanted), "{line}: {said}");
    }
}

#[test]
fn the_whole_catalogue_is_a_table_whatever_becomes_of_its_sets() {
    let folder = tempfile::tempdir().unwrap();
    let said = done(&folder, SMALL);
    let rows = rows(folder.path());
    let sets = done(&folder, "solvers --list");
    let sets: Vec<_> = sets.lines().filter(|line| !line.is_empty() && !line.starts_with('#')).collect();
    assert!(sets.len() >= 25 && rows.len() == 2 * sets.len(), "{} sets, {} rows", sets.len(), rows.len());
    for row in &rows {
        assert!(sets.contains(&row["options"].as_str()), "{row:?}");
        let is_good = row["converged"] == "yes" && row["failure"] == "none";
        assert!(is_good || row["reason"] != "none" || row["failure"] != "none", "no word on why: {row:?}");
        if is_good {
            assert!(number(&row["residual"]) <= 1.05e-2 && number(&row["pressure_error"]) < 0.1, "{row:?}");
            assert!(
                number(&row["total_s"]) > 0.0 && number(&row["divergence_1_per_s"]).is_finite(),
                "{row:?}"
            );
        }
    }
    let of = |options: &str| rows.iter().filter(|row| row["options"] == options).collect::<Vec<_>>();
    for row in of("-ksp_type preonly -pc_type lu -pc_factor_mat_solver_type mumps") {
        assert!(number(&row["pressure_error"]) < 1e-12 && number(&row["complexity"]) > 1.0, "{row:?}");
    }
    // A smaller tolerance makes a smaller error.
    let [loose, tight] = ["1e-3", "1e-8"].map(|rtol| {
        let options = format!("-ksp_type gmres -pc_type hypre -ksp_rtol {rtol}");
        of(&options).into_iter().map(|row| number(&row["pressure_error"])).fold(0.0, f64::max)
    });
    assert!(tight < 1e-2 * loose, "{tight} {loose}");
    assert!(of("-ksp_type gmres -pc_type hypre").into_iter().all(|row| number(&row["complexity"]) > 1.0));
    // The line to paste runs.
    let line = said.lines().find_map(|line| line.strip_prefix("fastest        sphpetsc ")).expect("a choice");
    done(&folder, &format!("{line} --spacing 0.02 --until 0.02 --threads 1 -q"));
    let json: Value =
        serde_json::from_slice(&fs::read(folder.path().join("out/solvers.json")).unwrap()).unwrap();
    assert_eq!(json["sets"].as_u64(), Some(sets.len() as u64));
    assert!(fs::read(folder.path().join("out/solvers.png")).unwrap().starts_with(b"\x89PNG"));
}

#[test]
fn sets_that_diverge_break_or_are_misspelt_are_rows_with_their_causes() {
    let folder = tempfile::tempdir().unwrap();
    let sets = "-ksp_type bcgs -pc_type ilu\n\
                -ksp_type richardson -pc_type none -ksp_max_it 20\n\
                -ksp_type gmres -pc_type jacobi -ksp_max_it 2\n\
                -ksp_type gmres -pc_type magic\n\
                -ksp_type gmres -pc_type jacobi -ksp_rtoll 1e-3\n";
    fs::write(folder.path().join("sets.txt"), sets).unwrap();
    let said = done(&folder, &format!("{SMALL} --sets sets.txt"));
    let rows = rows(folder.path());
    let cause = |k: usize| -> String {
        let set = sets.lines().nth(k).unwrap();
        let row = rows.iter().find(|row| row["options"] == set).unwrap();
        assert_eq!(row["converged"], "no", "{row:?}");
        format!("{} {}", row["reason"], row["failure"])
    };
    assert!(cause(1).contains("DIVERGED"), "{}", cause(1));
    assert!(cause(2).contains("DIVERGED_ITS"), "{}", cause(2));
    assert!(cause(3).contains("no preconditioner 'magic'"), "{}", cause(3));
    assert!(cause(4).contains("did you mean -ksp_rtol?"), "{}", cause(4));
    assert!(said.contains("fastest        sphpetsc dam_break_2d -ksp_type bcgs -pc_type ilu"), "{said}");
    // The run is there already; what is typed after the case is one more set, and --try takes another.
    let summary = folder.path().join("out/run/summary.json");
    let before = fs::metadata(&summary).unwrap().modified().unwrap();
    let output = crate::common::command(&folder, SMALL)
        .args(["--try", "-ksp_type cg -pc_type icc", "-ksp_type", "cgs"])
        .output();
    let output = output.unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(self::rows(folder.path()).len(), 4);
    assert_eq!(before, fs::metadata(&summary).unwrap().modified().unwrap());
    // No set solves all: said, with exit code 1, and the table is there.
    let output = run(&folder, &format!("{SMALL} -ksp_type gmres -pc_type none -ksp_max_it 1"));
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    assert!(stderr(&output).contains("no option set reaches"), "{}", stderr(&output));
}

#[test]
fn a_set_that_takes_too_long_is_stopped_and_files_of_a_run_will_do() {
    let folder = tempfile::tempdir().unwrap();
    done(
        &folder,
        "dam_break_2d --spacing 0.02 --until 0.02 --save-systems 0.01,0.02 --threads 1 --out saved -q",
    );
    // Never below the tolerance: thousands of millions of iterations.
    let slow = "-ksp_type richardson -pc_type jacobi -ksp_richardson_scale 1e-9 -ksp_max_it 2000000000 -ksp_rtol 1e-14";
    fs::write(folder.path().join("sets.txt"), format!("{slow}\n-ksp_type cg -pc_type icc\n")).unwrap();
    let said = done(&folder, "solvers saved/systems --sets sets.txt --limit 5 --out out");
    let rows = rows(folder.path());
    assert_eq!(rows.len(), 4);
    let stopped = rows.iter().filter(|row| row["options"] == slow);
    assert!(
        stopped.clone().count() == 2 && stopped.clone().all(|row| row["failure"] == "stopped after 5.0 s"),
        "{rows:?}"
    );
    assert!(said.contains("sphpetsc CASE -ksp_type cg -pc_type icc"), "{said}");
    let file = fs::read_dir(folder.path().join("saved/systems")).unwrap().next().unwrap().unwrap().path();
    let line = format!("solvers {} --sets sets.txt --limit 2 --out one -q", file.display());
    done(&folder, &line);
}
