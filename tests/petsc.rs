//! The PETSc fence and the pressure solver on small matrices: pick x, form b = A x, recover x.
//!
//! PETSc starts once in a process, hence cargo-nextest, which gives each test its own.
#![cfg(feature = "petsc")]

use std::process::Command;
use std::rc::Rc;
use std::time::Instant;

use sphpetsc::Error;
use sphpetsc::petsc::{Ksp, Matrix, Session, Tolerances, Vector, stage};
use sphpetsc::ppe::solve::PressureSolver;
use sphpetsc::ppe::{Index, PressureSolve, PressureSystem, Rows};

fn start(options: &str) -> Rc<Session> {
    let tokens: Vec<String> = options.split_whitespace().map(String::from).collect();
    Session::start(&tokens).expect("PETSc starts")
}

/// A repeatable number in 0..1 from two others.
fn noise(a: usize, b: usize) -> f64 {
    let mut x =
        (a as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (b as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f);
    x = (x ^ (x >> 31)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    ((x ^ (x >> 29)) >> 11) as f64 / (1u64 << 53) as f64
}

/// How a lattice matrix is made.
#[derive(Clone, Copy)]
struct Lattice {
    cells: [usize; 3],
    /// Neighbours up to this distance in spacings.
    radius: f64,
    /// Relative size of what is added to one triangle only.
    asymmetry: f64,
    /// A Dirichlet surface above the last plane; without it rows sum to zero.
    surface: bool,
}

impl Lattice {
    fn rows(self) -> Rows {
        let [nx, ny, nz] = self.cells;
        let reach = self.radius.ceil() as i64;
        let top_axis = if nz > 1 { 2 } else { 1 };
        let mut rows = Rows { start: vec![0], ..Rows::default() };
        for i in 0..nx * ny * nz {
            let p = [i % nx, i / nx % ny, i / (nx * ny)].map(|v| v as i64);
            let (mut entries, mut diagonal) = (Vec::new(), 0.0);
            for dz in -reach..=reach {
                for dy in -reach..=reach {
                    for dx in -reach..=reach {
                        let d = [dx, dy, dz];
                        let r = ((dx * dx + dy * dy + dz * dz) as f64).sqrt();
                        if r == 0.0 || r > self.radius || (nz == 1 && dz != 0) {
                            continue;
                        }
                        let q: [i64; 3] = std::array::from_fn(|k| p[k] + d[k]);
                        let above = self.surface && q[top_axis] >= self.cells[top_axis] as i64;
                        let inside = (0..3).all(|k| (0..self.cells[k] as i64).contains(&q[k]));
                        let shape = (1.0 - r / (self.radius + 1.0)).powi(3) / (r * r);
                        if inside {
                            let j = (q[0] as usize) + nx * (q[1] as usize + ny * q[2] as usize);
                            let weight = shape * (0.8 + 0.4 * noise(i.min(j), i.max(j)));
                            let weight = weight * (1.0 + self.asymmetry * (noise(i, j) - 0.5));
                            entries.push((j as Index, -weight));
                            diagonal += weight;
                        } else if above {
                            diagonal += shape;
                        }
                    }
                }
            }
            entries.push((i as Index, diagonal));
            entries.sort_by_key(|e| e.0);
            rows.column.extend(entries.iter().map(|e| e.0));
            rows.value.extend(entries.iter().map(|e| e.1));
            rows.start.push(rows.column.len() as Index);
        }
        rows
    }

    /// A system whose solution is smooth plus noise, and that solution.
    fn system(self) -> (PressureSystem, Vec<f64>) {
        let full = self.rows();
        let n = full.start.len() - 1;
        let exact: Vec<f64> = (0..n).map(|i| (i as f64 * 6.0 / n as f64).sin() + 0.3 * noise(i, 7)).collect();
        let rhs = multiply(&full, &exact);
        let symmetric = Self { asymmetry: 0.0, ..self }.rows();
        let scale = diagonal(&symmetric) / diagonal(&Self { asymmetry: 0.0, radius: 1.6, ..self }.rows());
        let mut sparse = Self { asymmetry: 0.0, radius: 1.6, ..self }.rows();
        sparse.value.iter_mut().for_each(|v| *v *= scale);
        (
            PressureSystem {
                full,
                symmetric,
                sparse,
                rhs,
                pressure: vec![0.0; n],
                ..PressureSystem::default()
            },
            exact,
        )
    }
}

fn diagonal(rows: &Rows) -> f64 {
    let middle = (rows.start.len() - 1) / 2;
    (rows.start[middle]..rows.start[middle + 1])
        .map(|k| k as usize)
        .find(|&k| rows.column[k] as usize == middle)
        .map_or(1.0, |k| rows.value[k])
}

fn multiply(rows: &Rows, x: &[f64]) -> Vec<f64> {
    let row = |i: usize| {
        (rows.start[i] as usize..rows.start[i + 1] as usize)
            .map(|k| rows.value[k] * x[rows.column[k] as usize])
            .sum()
    };
    (0..x.len()).map(row).collect()
}

fn error(x: &[f64], exact: &[f64]) -> f64 {
    x.iter().zip(exact).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

const PLANE: Lattice = Lattice { cells: [40, 30, 1], radius: 2.4, asymmetry: 0.2, surface: true };
const SPACE: Lattice = Lattice { cells: [10, 9, 8], radius: 2.0, asymmetry: 0.2, surface: true };

fn recovers(options: &str) {
    let session = start(&format!("{options} -ksp_rtol 1e-10"));
    let mut solver = PressureSolver::new(session, 1000).unwrap();
    for lattice in [PLANE, SPACE] {
        let (mut system, exact) = lattice.system();
        let record = solver.solve(&mut system).unwrap();
        assert_eq!(record.fallback, None, "{options}");
        assert!(record.residual <= 1.1e-8, "{record:?}");
        let wrong = error(&system.pressure, &exact);
        assert!(wrong < 1e-6, "{options}: error {wrong:e}, {record:?}");
    }
}

macro_rules! recover {
    ($($name:ident: $options:literal,)*) => { $(#[test] fn $name() { recovers($options); })* };
}

recover! {
    our_own_choice: "",
    cg_hypre: "-ksp_type cg -pc_type hypre",
    cg_gamg: "-ksp_type cg -pc_type gamg",
    cg_icc: "-ksp_type cg -pc_type icc",
    cg_jacobi: "-ksp_type cg -pc_type jacobi",
    cg_alone: "-ksp_type cg",
    icc_alone: "-pc_type icc",
    minres_jacobi: "-ksp_type minres -pc_type jacobi",
    bcgs_ilu: "-ksp_type bcgs -pc_type ilu",
    bcgsl_ilu: "-ksp_type bcgsl -pc_type ilu",
    gmres_hypre: "-ksp_type gmres -pc_type hypre",
    gmres_left: "-ksp_type gmres -pc_type hypre -ksp_pc_side left",
    gmres_on_the_full_matrix: "-ksp_type gmres -pc_type hypre -ppe_sparse_pmat no",
    right_side_methods: "-ksp_type gcr -pc_type jacobi",
    direct: "-ksp_type preonly -pc_type lu -pc_factor_mat_solver_type mumps",
    block_jacobi: "-ksp_type gmres -pc_type bjacobi -sub_pc_type ilu",
}

#[test]
fn every_krylov_method_that_watches_the_true_residual_can() {
    for ksp in ["gmres", "fgmres", "lgmres", "dgmres", "pgmres", "pipefgmres", "bcgs", "cgs", "tfqmr", "gcr"]
    {
        let output = child("solve_in_child", &format!("-ksp_type {ksp} -pc_type jacobi"));
        assert!(output.contains("fallback: None"), "{ksp}: {output}");
    }
}

#[test]
fn methods_for_symmetric_matrices_are_nested() {
    for ksp in [
        "groppcg", "pipecg", "pipecgrr", "pipelcg", "pipeprcg", "pipecg2", "fcg", "pipefcg", "cr", "pipecr",
        "symmlq", "nash", "stcg", "gltr",
    ] {
        let output = child("solve_in_child", &format!("-ksp_type {ksp} -pc_type jacobi"));
        assert!(output.contains("fallback: None") && output.contains("inside fgmres"), "{ksp}: {output}");
    }
}

/// Runs the ignored test `name` of this file in a process of its own and returns all it printed.
fn child(name: &str, options: &str) -> String {
    let output = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", &format!("petsc::{name}"), "--ignored", "--nocapture"])
        .env("SPHPETSC_TEST_OPTIONS", options)
        .output()
        .unwrap();
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

#[test]
#[ignore = "started by other tests"]
fn solve_in_child() {
    let options = std::env::var("SPHPETSC_TEST_OPTIONS").unwrap_or_default();
    let session = start(&options);
    let outcome = PressureSolver::new(session, 1000).and_then(|mut solver| {
        let (mut system, _) = PLANE.system();
        solver.check(&system)?;
        let record = solver.solve(&mut system)?;
        Ok(format!("{}\n{record:?}", solver.describe()))
    });
    match outcome {
        Ok(text) => println!("{text}"),
        Err(e) => println!("error {e}"),
    }
}

#[test]
fn an_unknown_type_lists_the_valid_ones_and_petsc_is_silent() {
    let output = child("solve_in_child", "-ksp_type gmress");
    assert!(
        output.contains("no Krylov method 'gmress' (did you mean gmres?); valid are bcgs, bcgsl"),
        "{output}"
    );
    assert!(!output.contains("PETSC ERROR"), "{output}");
    let output = child("solve_in_child", "-pc_type hyper");
    assert!(output.contains("no preconditioner 'hyper' (did you mean hypre?)"), "{output}");
}

#[test]
fn unused_options_are_found_with_the_nearest_name() {
    for (options, hint) in [
        ("-ksp_rtoll 1e-6", "did you mean -ksp_rtol?"),
        (
            "-pc_type hypre -pc_hypre_boomeramg_strong_treshold 0.25",
            "did you mean -pc_hypre_boomeramg_strong_threshold?",
        ),
        ("-ksp_type cg -pc_hypre_boomeramg_P_max 4", "cg + icc reads no such option"),
        ("-pc_type gamg -mg_levels_ksp_max_itt 3", "did you mean -mg_levels_ksp_max_it?"),
        ("-ppe_sparse_pmatt no", "did you mean -ppe_sparse_pmat?"),
    ] {
        let output = child("solve_in_child", options);
        assert!(output.contains(hint), "{options}: {output}");
        assert!(!output.contains("PETSC ERROR") && !output.contains("WARNING"), "{output}");
    }
}

#[test]
fn wrong_values_are_input_errors() {
    for options in [
        "-pc_type hypre -pc_hypre_boomeramg_coarsen_type foo",
        "-ksp_rtol abc",
        "-pc_type lu -pc_factor_mat_solver_type foo",
        "-ppe_sparse_pmat 7x",
    ] {
        let output = child("solve_in_child", options);
        assert!(output.contains("error ") && !output.contains("PETSC ERROR"), "{options}: {output}");
    }
}

#[test]
fn petscs_own_reports_keep_working() {
    for (options, expected) in [
        ("-log_view", "PETSc Performance Summary"),
        ("-ksp_view -ksp_type cg -pc_type hypre", "HYPRE BoomerAMG"),
        ("-ksp_monitor", "KSP Residual norm"),
        ("-ksp_monitor -ksp_type cg", "KSP Residual norm"),
        ("-ksp_converged_reason", "solve converged due to"),
        ("-help", "-ksp_rtol"),
        ("-options_left", "PETSc Option Table"),
    ] {
        let output = child("solve_in_child", options);
        assert!(output.contains(expected) && output.contains("fallback: None"), "{options}: {output}");
        assert!(!output.contains("PETSC ERROR"), "{output}");
    }
}

#[test]
fn an_options_file_counts_as_the_users_choice() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("petsc.opts");
    std::fs::write(&file, "-ksp_type gmres\n-pc_type hypre\n-pc_hypre_boomeramg_P_max 3\n").unwrap();
    let output = child("solve_in_child", &format!("-options_file {}", file.display()));
    assert!(output.contains("gmres + hypre") && output.contains("P_max 3"), "{output}");
    let output = child("solve_in_child", "-options_file missing.opts");
    assert!(output.contains("does not accept its options") && !output.contains("PETSC ERROR"), "{output}");
}

#[test]
fn too_few_iterations_are_a_recorded_event() {
    let mut solver = PressureSolver::new(start("-ksp_max_it 1"), 1000).unwrap();
    let (mut system, exact) = PLANE.system();
    let record = solver.solve(&mut system).unwrap();
    let fallback = record.fallback.expect("one iteration is not enough");
    assert!(
        fallback.starts_with("bcgs+ilu, after bcgs+ilu stopped with DIVERGED_ITS (1 iterations"),
        "{fallback}"
    );
    assert!(error(&system.pressure, &exact) < 1e-2);
}

#[test]
fn a_poor_direct_method_falls_back() {
    let mut solver = PressureSolver::new(start("-ksp_type preonly -pc_type jacobi"), 1000).unwrap();
    let (mut system, _) = PLANE.system();
    let record = solver.solve(&mut system).unwrap();
    assert!(record.fallback.is_some() && record.residual <= 1.05e-5, "{record:?}");
}

#[test]
fn when_all_fails_the_error_says_so_and_the_pressure_stays() {
    let mut solver = PressureSolver::new(start("-ksp_max_it 1 -fallback_ksp_max_it 1"), 1000).unwrap();
    let (mut system, _) = PLANE.system();
    system.pressure.fill(3.0);
    let Err(Error::Run(text)) = solver.solve(&mut system) else { panic!("must fail") };
    assert!(
        text.contains("1200 unknowns") && text.contains("limit 1.0e-5") && text.contains("try "),
        "{text}"
    );
    assert!(system.pressure.iter().all(|&p| p == 3.0));
    let dir = tempfile::tempdir().unwrap();
    let path = solver.save(&system, dir.path(), "pressure_system").unwrap();
    assert!(sphpetsc::ppe::saved::read(&path).unwrap() == system, "not what was saved");
    // Other programs read a matrix and a right-hand side, and may stop there.
    let bytes = std::fs::read(&path).unwrap();
    let index = size_of::<sphpetsc::ppe::Index>();
    let two = index * (4 + 1200 + 2) + (index + 8) * system.full.column.len() + 8 * 1200;
    std::fs::write(&path, &bytes[..two]).unwrap();
    let bare = sphpetsc::ppe::saved::read(&path).unwrap();
    assert!(bare.full == system.full && bare.rhs == system.rhs && bare.sparse.is_empty());
    assert!(bare.pressure.iter().all(|&p| p == 0.0));
    for length in [0, 3, 16, 40, two / 2, two - 1] {
        std::fs::write(&path, &bytes[..length]).unwrap();
        assert!(matches!(sphpetsc::ppe::saved::read(&path), Err(Error::Input(_))), "{length} bytes");
    }
}

#[test]
fn a_guess_that_is_not_a_number_is_survived() {
    let mut solver = PressureSolver::new(start(""), 1000).unwrap();
    let (mut system, exact) = PLANE.system();
    system.pressure[5] = f64::NAN;
    let record = solver.solve(&mut system).unwrap();
    assert!(record.fallback.unwrap().starts_with("bcgs+ilu from zero"));
    assert!(error(&system.pressure, &exact) < 1e-2);
    system.rhs[5] = f64::NAN;
    assert!(matches!(solver.solve(&mut system), Err(Error::Run(_))));
}

#[test]
fn nothing_to_solve() {
    let mut solver = PressureSolver::new(start(""), 1000).unwrap();
    let record = solver.solve(&mut PressureSystem::default()).unwrap();
    assert_eq!((record.unknowns, record.iterations), (0, 0));
    let (mut system, _) = PLANE.system();
    system.rhs.fill(0.0);
    system.pressure.fill(1.0);
    solver.solve(&mut system).unwrap();
    assert!(system.pressure.iter().all(|&p| p == 0.0));
}

#[test]
fn sizes_change_from_step_to_step() {
    for options in ["-ksp_type cg -pc_type hypre", "-pc_type gamg", "-pc_type hypre", "-pc_type ilu"] {
        let output = child("sizes_in_child", options);
        assert!(output.contains("all solved"), "{options}: {output}");
    }
}

#[test]
#[ignore = "started by other tests"]
fn sizes_in_child() {
    let mut solver =
        PressureSolver::new(start(&std::env::var("SPHPETSC_TEST_OPTIONS").unwrap_or_default()), 1000)
            .unwrap();
    for nx in [20, 21, 21, 5, 40] {
        let (mut system, exact) = Lattice { cells: [nx, 20, 1], ..PLANE }.system();
        let record = solver.solve(&mut system).unwrap();
        assert_eq!(record.fallback, None);
        assert!(error(&system.pressure, &exact) < 1e-2);
    }
    println!("all solved");
}

/// Two closed boxes: rows sum to zero, the matrix is not symmetric, the right-hand side not solvable.
fn closed() -> PressureSystem {
    let one = Lattice { surface: false, cells: [20, 20, 1], ..PLANE };
    let (a, b) = (one.system().0, Lattice { cells: [15, 12, 1], ..one }.system().0);
    let (na, nb) = (a.rhs.len() as Index, b.rhs.len() as Index);
    let join = |a: Rows, b: Rows| {
        let entries = a.column.len() as Index;
        Rows {
            start: a.start.into_iter().chain(b.start[1..].iter().map(|s| s + entries)).collect(),
            column: a.column.into_iter().chain(b.column.iter().map(|c| c + na)).collect(),
            value: a.value.into_iter().chain(b.value).collect(),
        }
    };
    PressureSystem {
        full: join(a.full, b.full),
        symmetric: join(a.symmetric, b.symmetric),
        sparse: join(a.sparse, b.sparse),
        rhs: a.rhs.iter().chain(&b.rhs).enumerate().map(|(i, r)| r + 0.1 + 0.05 * noise(i, 3)).collect(),
        pressure: vec![2.0; (na + nb) as usize],
        floating: vec![(0..na as u32).collect(), (na as u32..(na + nb) as u32).collect()],
        ..PressureSystem::default()
    }
}

#[test]
fn closed_boxes_have_a_pressure_up_to_a_constant() {
    for options in [
        "",
        "-ksp_type cg -pc_type hypre",
        "-pc_type hypre",
        "-ksp_type gmres -pc_type jacobi",
        "-ksp_type cg -pc_type icc",
    ] {
        let output = child("closed_in_child", &format!("{options} -ksp_rtol 1e-9"));
        assert!(output.contains("closed box solved"), "{options}: {output}");
    }
}

#[test]
#[ignore = "started by other tests"]
fn closed_in_child() {
    let mut solver =
        PressureSolver::new(start(&std::env::var("SPHPETSC_TEST_OPTIONS").unwrap_or_default()), 1000)
            .unwrap();
    let mut system = closed();
    let record = solver.solve(&mut system).unwrap();
    assert_eq!(record.fallback, None, "{record:?}");
    for set in &system.floating {
        let mean = set.iter().map(|&i| system.pressure[i as usize]).sum::<f64>() / set.len() as f64;
        assert!(mean.abs() < 1e-9, "mean {mean:e}");
        // What remains of the right-hand side is a multiple of the left null vector: A^T r = 0.
        let product = multiply(&system.full, &system.pressure);
        let r: Vec<f64> = (0..product.len())
            .map(|i| if set.contains(&(i as u32)) { system.rhs[i] - product[i] } else { 0.0 })
            .collect();
        let mut back = vec![0.0; r.len()];
        for (i, r_i) in r.iter().enumerate() {
            for k in system.full.start[i] as usize..system.full.start[i + 1] as usize {
                back[system.full.column[k] as usize] += system.full.value[k] * r_i;
            }
        }
        let size = r.iter().map(|v| v * v).sum::<f64>().sqrt();
        assert!(size > 0.1 && back.iter().all(|b| b.abs() < 1e-6 * size));
    }
    println!("closed box solved {record:?}");
}

/// A matrix from the entries, (column, value), of its rows.
fn rows_of(lists: Vec<Vec<(usize, f64)>>) -> Rows {
    let mut rows = Rows { start: vec![0], ..Rows::default() };
    for mut list in lists {
        list.sort_by_key(|(column, _)| *column);
        rows.column.extend(list.iter().map(|(column, _)| *column as Index));
        rows.value.extend(list.iter().map(|(_, value)| value));
        rows.start.push(rows.column.len() as Index);
    }
    rows
}

/// Systems as the worst scenes of the stability suite make them.
fn worst() -> Vec<(&'static str, PressureSystem)> {
    let system = |full: Rows, symmetric: Rows| {
        let n = full.len();
        let exact: Vec<f64> = (0..n).map(|i| (i as f64 * 6.0 / n as f64).sin() + 0.3 * noise(i, 7)).collect();
        let (sparse, rhs) = (symmetric.clone(), multiply(&full, &exact));
        PressureSystem { full, symmetric, sparse, rhs, pressure: vec![0.0; n], ..PressureSystem::default() }
    };
    // A film one particle deep, with a surface at one end alone: its condition number is the square of its length.
    let n = 2000_usize;
    let film = rows_of(
        (0..n)
            .map(|i| {
                let near = [i.checked_sub(1), (i + 1 < n).then_some(i + 1)];
                let mut row: Vec<_> = near.into_iter().flatten().map(|j| (j, -1.0)).collect();
                row.push((i, row.len() as f64 + if i == 0 { 1.0 } else { 0.0 }));
                row
            })
            .collect(),
    );
    // A pocket that a thread a hundred millionth as strong ties to the rest.
    let open = Lattice { cells: [20, 20, 1], ..PLANE };
    let (rest, pocket) = (open.rows(), Lattice { surface: false, ..open }.rows());
    let count = rest.len();
    let mut lists: Vec<Vec<(usize, f64)>> = (0..count).map(|k| rest.row(k).collect()).collect();
    lists.extend((0..count).map(|k| pocket.row(k).map(|(c, v)| (count + c, v)).collect::<Vec<_>>()));
    for (a, b) in [(count - 1, count), (count, count - 1)] {
        lists[a].push((b, -1e-8));
        lists[a].iter_mut().filter(|(c, _)| *c == a).for_each(|(_, v)| *v += 1e-8);
    }
    let pocket = rows_of(lists);
    // Rows in other units: eight orders of magnitude between neighbours.
    let plain = open.rows();
    let mut scaled = plain.clone();
    for k in 0..plain.len() {
        let factor = 10_f64.powf(8.0 * noise(k, 5) - 4.0);
        scaled.value[plain.start[k] as usize..plain.start[k + 1] as usize]
            .iter_mut()
            .for_each(|v| *v *= factor);
    }
    let skew = Lattice { asymmetry: 1.9, ..open }.rows();
    // Drops of one particle, each with nearly no weight, beside liquid.
    let mut drops: Vec<Vec<(usize, f64)>> = (0..count).map(|k| plain.row(k).collect()).collect();
    drops.extend((0..50).map(|k| vec![(count + k, 1e-12)]));
    let drops = rows_of(drops);
    vec![
        ("film", system(film.clone(), film)),
        ("pocket", system(pocket.clone(), pocket)),
        ("scaled", system(scaled, plain.clone())),
        ("skew", system(skew, plain)),
        ("drops", system(drops.clone(), drops)),
    ]
}

#[test]
fn the_worst_systems_are_solved_or_the_chain_solves_them() {
    for options in ["", "-pc_type hypre", "-ksp_type bcgs -pc_type ilu", "-ksp_type bcgs -pc_type jacobi"] {
        let output = child("worst_in_child", options);
        assert_eq!(output.matches("within the tolerance").count(), worst().len(), "{options}: {output}");
    }
}

#[test]
#[ignore = "started by other tests"]
fn worst_in_child() {
    let options = std::env::var("SPHPETSC_TEST_OPTIONS").unwrap_or_default();
    let session = start(&options);
    for (name, mut system) in worst() {
        let mut solver = PressureSolver::new(session.clone(), system.rhs.len()).unwrap();
        let record = solver.solve(&mut system).unwrap();
        let product = multiply(&system.full, &system.pressure);
        let size = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
        let residual = size(&mut product.iter().zip(&system.rhs).map(|(a, b)| a - b));
        assert!(residual <= 1.1e-5 * size(&mut system.rhs.iter().copied()), "{options}, {name}: {record:?}");
        println!(
            "{name} within the tolerance: {} iterations, fallback {:?}",
            record.iterations, record.fallback
        );
    }
}

#[test]
fn handles_drop_in_any_order() {
    let session = start("-ksp_type gmres");
    let rows = PLANE.rows();
    let matrix = Matrix::from_rows(&session, &rows.start, &rows.column, &rows.value).unwrap();
    let b = Vector::from_slice(&session, &vec![1.0; 1200]).unwrap();
    let mut x = Vector::zeros(&session, 1200).unwrap();
    let mut ksp = Ksp::new(&session, "").unwrap();
    ksp.set_tolerances(Tolerances { relative: 1e-8, absolute: 1e-50, divergence: 1e5, iterations: 1000 })
        .unwrap();
    ksp.set_from_options().unwrap();
    ksp.set_operators(&matrix, &matrix).unwrap();
    drop(session);
    drop(matrix);
    let report = stage("pressure", || ksp.solve(&b, &mut x)).unwrap();
    assert!(report.converged && report.reason == "CONVERGED_RTOL", "{report:?}");
    drop(b);
    drop(ksp);
    assert!(x.norm().unwrap() > 0.0);
}

#[test]
fn matrices_know_themselves() {
    let session = start("");
    let build = |lattice: Lattice| {
        let rows = lattice.rows();
        Matrix::from_rows(&session, &rows.start, &rows.column, &rows.value).unwrap()
    };
    assert!(build(Lattice { asymmetry: 0.0, ..PLANE }).is_symmetric(1e-14).unwrap());
    let matrix = build(PLANE);
    assert!(!matrix.is_symmetric(1e-6).unwrap());
    assert_eq!(matrix.size().unwrap(), 1200);
    assert_eq!(matrix.nonzeros().unwrap(), PLANE.rows().column.len());
    let norm = PLANE.rows().value.iter().map(|v| v * v).sum::<f64>().sqrt();
    assert!((matrix.norm().unwrap() - norm).abs() < 1e-12 * norm);
    let unsound = Matrix::from_rows(&session, &[0, 1], &[3], &[1.0]);
    assert!(matches!(unsound, Err(Error::Run(_))));
}

/// Set-up and solve of one option set, for the figures in the docs of `ppe::solve`:
/// `SPHPETSC_TEST_OPTIONS=... cargo test --release --test petsc figures -- --ignored --nocapture`.
#[test]
#[ignore = "measures"]
fn figures() {
    let options = std::env::var("SPHPETSC_TEST_OPTIONS").unwrap_or_default();
    let mut solver = PressureSolver::new(start(&options), 1000).unwrap();
    for cells in [[64, 64, 1], [200, 150, 1], [47, 47, 47]] {
        let radius = if cells[2] > 1 { 2.2 } else { 2.4 };
        let (mut system, _) = Lattice { cells, radius, ..PLANE }.system();
        solver.solve(&mut system).unwrap();
        // The next step: nearly the same right-hand side, starting from the last pressure.
        system.rhs.iter_mut().enumerate().for_each(|(i, r)| *r *= 1.0 + 0.02 * noise(i, 9));
        let clock = Instant::now();
        let r = solver.solve(&mut system).unwrap();
        println!(
            "{options} | n {} nnz {} | it {} inner {} | setup {:.4} solve {:.4} all {:.4} | {:?}",
            r.unknowns,
            r.nonzeros / r.unknowns,
            r.iterations,
            r.inner_iterations,
            r.setup_s,
            r.solve_s,
            clock.elapsed().as_secs_f64(),
            r.fallback
        );
    }
}
