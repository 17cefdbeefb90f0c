//! The same physics on any number of ranks: the program on its own under mpiexec.
#![cfg(feature = "mpi")]

use crate::common;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Output;

use sphpetsc::output::checkpoint::{self, Reader};
use tempfile::TempDir;

/// Runs `line` on `ranks` ranks in `folder`; `None` without mpiexec.
fn program(folder: &TempDir, line: &str, ranks: usize) -> Option<Output> {
    let line = format!("{line} --ranks {ranks} --threads 1");
    common::is_installed("mpiexec").then(|| common::run(folder, &line))
}

/// Runs `line` with its output in a folder named by the ranks; false without mpiexec.
fn done(folder: &TempDir, line: &str, ranks: usize) -> bool {
    let Some(output) = program(folder, &format!("{line} --quiet --out {ranks}"), ranks) else { return false };
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{line} on {ranks} ranks: {said}");
    true
}

fn state(folder: &TempDir, ranks: usize) -> Reader {
    let path = folder.path().join(ranks.to_string()).join("checkpoint");
    Reader::load(&checkpoint::latest(&path).unwrap().unwrap()).unwrap()
}

/// The numbers of a field by particle and component.
fn by_id(state: &Reader, field: &str) -> BTreeMap<(u64, usize), f64> {
    let (id, values) = (state.u64("id").unwrap(), state.f64(field).unwrap());
    let components = values.len() / id.len();
    assert_eq!(components * id.len(), values.len());
    let key = |k: usize| (id[k / components], k % components);
    values.iter().enumerate().map(|(k, value)| (key(k), *value)).collect()
}

/// A column of the last row of a table.
fn last(path: &Path, column: &str) -> f64 {
    let text = fs::read_to_string(path).unwrap();
    let place = text.lines().next().unwrap().split(',').position(|name| name == column).unwrap();
    text.lines().last().unwrap().split(',').nth(place).unwrap().parse().unwrap()
}

fn last_of(folder: &TempDir, ranks: usize, table: &str, column: &str) -> f64 {
    last(&folder.path().join(ranks.to_string()).join(table), column)
}

/// Fronts and energies on several ranks within `share` of those on one.
fn flow_is_the_same(line: &str, several: &[usize], share: f64) {
    let folder = tempfile::tempdir().unwrap();
    for ranks in [&[1], several].concat() {
        if !done(&folder, line, ranks) {
            return;
        }
        for column in ["time_s", "front_m", "kinetic_energy_j", "energy_j", "particles"] {
            let [alone, together] = [1, ranks].map(|ranks| last_of(&folder, ranks, "history.csv", column));
            assert!(
                (together - alone).abs() <= share * alone,
                "{column} on {ranks} ranks: {together}, {alone}"
            );
        }
    }
}

/// Largest difference of two fields over the largest value.
fn difference(one: &BTreeMap<(u64, usize), f64>, other: &BTreeMap<(u64, usize), f64>) -> f64 {
    assert!(one.keys().eq(other.keys()), "other particles");
    let largest = one.values().map(|p| p.abs()).fold(0.0, f64::max);
    one.values().zip(other.values()).map(|(p, q)| (p - q).abs()).fold(0.0, f64::max) / largest
}

#[test]
fn wcsph_flows_alike_on_three_ranks() {
    // Sums differ in their order alone, and chaos has no time to show it.
    flow_is_the_same("dam_break_2d --scheme wcsph --spacing 0.04 --until 0.05", &[3], 1e-6);
}

#[test]
fn the_end_tells_how_ranks_shared_the_liquid() {
    let folder = tempfile::tempdir().unwrap();
    let line = "dam_break_2d --scheme wcsph --spacing 0.04 --until 0.2";
    if !done(&folder, line, 1) || !done(&folder, line, 3) {
        return;
    }
    let of = |ranks: usize| common::summary(&folder.path().join(ranks.to_string()))["ranks"].clone();
    assert!(of(1).is_null());
    let found = of(3);
    let number = |name: &str| found[name].as_f64().unwrap();
    assert_eq!(number("ranks"), 3.0);
    // Slabs of liquid 5 to 10 particles wide hold a whole number of columns.
    assert!((1.0..1.5).contains(&number("fullest")), "{found}");
    assert!((1.0..3.0).contains(&number("imbalance")), "{found}");
    // A support of 4 spacings on both sides of both cuts, in liquid 5 to 10 spacings wide.
    assert!((0.5..4.0).contains(&number("ghosts_per_particle")), "{found}");
    assert!(number("handed_over") > 0.0 && number("cuts") >= 1.0, "{found}");
}

#[test]
#[cfg(feature = "petsc")]
fn isph_flows_alike_on_four_ranks() {
    // Steps of one length end at one time: the kinetic energy grows with its square.
    flow_is_the_same(
        "dam_break_2d --spacing 0.02 --until 0.1 --set time.step=2e-3 -ksp_rtol 1e-8",
        &[4],
        5e-3,
    );
}

/// Places of bodies on two ranks within 1e-4 m of those on one.
fn bodies_move_alike(line: &str, columns: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    if !done(&folder, line, 1) || !done(&folder, line, 2) {
        return;
    }
    for column in columns {
        let [alone, together] = [1, 2].map(|ranks| last_of(&folder, ranks, "bodies.csv", column));
        assert!((alone - together).abs() < 1e-4, "{column}: {alone}, {together}");
    }
}

#[test]
fn bodies_in_wcsph_move_alike_on_two_ranks() {
    let columns = ["box1_x_m", "box1_y_m", "box1_rotation_z_rad", "box5_x_m"];
    bodies_move_alike("debris --scheme wcsph --spacing 0.02 --until 0.162", &columns);
}

#[test]
#[cfg(feature = "petsc")]
fn bodies_in_isph_move_alike_on_two_ranks() {
    // Just after the flood has hit the first box.
    let columns = ["box1_x_m", "box1_y_m"];
    bodies_move_alike("debris --spacing 0.02 --until 0.145 -ksp_rtol 1e-9", &columns);
}

#[test]
#[cfg(feature = "petsc")]
fn pressures_do_not_depend_on_the_ranks() {
    let folder = tempfile::tempdir().unwrap();
    let line = "dam_break_3d_fixed --spacing 0.06 --until 1e-6 -ksp_rtol 1e-12";
    for ranks in 1..=4 {
        if !done(&folder, line, ranks) {
            return;
        }
        let [alone, together] = [1, ranks].map(|ranks| state(&folder, ranks));
        let difference = difference(&by_id(&alone, "pressure"), &by_id(&together, "pressure"));
        assert!(difference < 1e-9, "{ranks} ranks: {difference:e} of the largest pressure");
        let [alone, together] = [1, ranks].map(|ranks| last_of(&folder, ranks, "solver.csv", "unknowns"));
        assert_eq!(alone, together);
    }
}

#[test]
#[cfg(feature = "petsc")]
fn still_water_stays_still_on_four_ranks() {
    let folder = tempfile::tempdir().unwrap();
    if done(&folder, "still_water_2d --until 0.1 --spacing 0.05 -ksp_rtol 1e-10", 4) {
        // A solver's residual is all that moves it.
        let share = last_of(&folder, 4, "history.csv", "kinetic_energy_j")
            / last_of(&folder, 4, "history.csv", "potential_energy_j");
        assert!(share < 1e-6, "{share:e}");
    }
}

/// Fields of a run on one rank, and of one begun on two and gone on with by three, differ by less than `tolerance`.
fn goes_on_with_other_ranks(line: &str, [middle, end]: [f64; 2], tolerance: f64) {
    let folder = tempfile::tempdir().unwrap();
    if !done(&folder, &format!("{line} --until {end}"), 1)
        || !done(&folder, &format!("{line} --until {middle}"), 2)
    {
        return;
    }
    let output = program(&folder, &format!("{line} --until {end} --quiet --resume 2"), 3).unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let [whole, resumed] = [1, 2].map(|ranks| state(&folder, ranks));
    for field in ["position", "velocity", "pressure"] {
        let difference = difference(&by_id(&whole, field), &by_id(&resumed, field));
        assert!(difference < tolerance, "{field}: {difference:e}");
    }
}

#[test]
fn a_run_goes_on_with_other_ranks() {
    goes_on_with_other_ranks("dam_break_2d --scheme wcsph --spacing 0.04", [0.01, 0.02], 1e-6);
}

#[test]
#[cfg(feature = "petsc")]
fn a_run_of_isph_goes_on_with_other_ranks() {
    goes_on_with_other_ranks(
        "dam_break_2d --spacing 0.02 --set time.step=2e-3 -ksp_rtol 1e-10",
        [0.02, 0.04],
        1e-6,
    );
    goes_on_with_other_ranks(
        "dam_break_3d_sliding --spacing 0.08 --set time.step=2e-3 -ksp_rtol 1e-10",
        [0.02, 0.04],
        1e-6,
    );
}

#[test]
fn wrong_input_is_said_once() {
    let folder = tempfile::tempdir().unwrap();
    let Some(output) = program(&folder, "dam_break_2d --spacing -1", 2) else { return };
    assert_eq!(output.status.code(), Some(2));
    fs::write(folder.path().join("file"), "").unwrap();
    let line = "dam_break_2d --scheme wcsph --spacing 0.04 --until 0.001 --out file/run";
    let output = program(&folder, line, 2).unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert_eq!(said.matches("choose another --out").count(), 1, "{said}");
}
