//! The assembled pressure systems against a dense operator written independently, their symmetric companions,
//! and their solution through PETSc.

use nalgebra::{DMatrix, DVector};
use sphpetsc::boundary::DummyWalls;
use sphpetsc::case::{KernelKind, LaplacianKind, build, read};
use sphpetsc::halo::Halo;
use sphpetsc::kernel::{LatticeSums, Smoothing, WendlandC2};
use sphpetsc::neighbors::{Layout, Neighbors};
use sphpetsc::operators::{Moments, Surroundings};
use sphpetsc::particles::{Matrix, Particles, Vector};
use sphpetsc::ppe::matrix::{Assembler, Inputs, NEAR, NO_ROW};
use sphpetsc::ppe::{Needs, Rows};
use sphpetsc::scheme::Params;
use sphpetsc::terms::surface;

const ALL: Needs = Needs { symmetric: true, sparse: true, uncorrected: true };

/// A scene surveyed as the scheme does it, with a source of no particular shape.
struct Water<const D: usize> {
    params: Params<D>,
    particles: Particles<D>,
    neighbors: Neighbors<D>,
    active: Vec<bool>,
    moments: Vec<Moments<D>>,
    surface: Vec<f64>,
    source: Vec<f64>,
    walls: DummyWalls<D>,
    lattice: LatticeSums,
}

impl<const D: usize> Water<D> {
    /// A tank of cubic cross section with a jittered column of water; `extra` particles are added to it.
    fn new(dx: f64, size: f64, column: Vector<D>, open: &str, extra: &[Vector<D>]) -> Self {
        let text = format!(
            "name = \"water\"\ndimension = {D}\nspacing = {dx}\n\
             [[fluid.block]]\nmin = {zero:?}\nmax = {column:?}\n\
             [tank]\nmin = {zero:?}\nmax = {size:?}\nopen = [{open}]\n\
             [scheme]\njitter = 0.2\n[time]\nuntil = 1.0\n",
            zero = [0.0; D],
            size = [size; D],
            column = column.as_slice(),
        );
        let case = read::read(&text, "test", &[]).unwrap();
        let build::Scene { mut particles, params, .. } = build::scene::<D>(&case);
        assert_eq!(params.kernel, KernelKind::WendlandC2);
        for r in extra {
            particles.push_fluid(*r, Vector::zeros());
        }
        let lattice = params.lattice_sums();
        let smoothing = Smoothing::<D, WendlandC2>::new(params.smoothing_length());
        let (solids, support) = (particles.solids(), params.support());
        let mut neighbors = Neighbors::default();
        let first_layer = |a| if particles.walls().contains(&a) { f64::NEG_INFINITY } else { f64::INFINITY };
        neighbors.update(
            &particles.position[..solids],
            &Layout::without_ghosts(solids, solids),
            &smoothing,
            support,
            first_layer,
        );
        let volume = dx.powi(D as i32);
        let walls =
            DummyWalls::new(&particles, &neighbors, &lattice, volume, params.density * params.gravity);
        let wet = |a| walls.threshold(&particles, a);
        neighbors.update(&particles.position, &Layout::of(&particles), &smoothing, support, wet);
        let mut active = vec![];
        walls.mark_active(&particles, &neighbors, &Halo::default(), &mut active);
        let position = &particles.position;
        let around = Surroundings { position, neighbors: &neighbors, active: &active, volume };
        let moments: Vec<_> = (0..particles.len()).map(|a| around.moments(a)).collect();
        let solved = |a: usize| active[a] && !particles.dummies().contains(&a);
        let weight = |a: usize| if solved(a) { surface::weight(&moments[a]) } else { 0.0 };
        let surface = (0..particles.len()).map(weight).collect();
        let source = (0..particles.len()).map(|a| 40.0 * (a as f64).sin()).collect();
        Self { params, particles, neighbors, active, moments, surface, source, walls, lattice }
    }

    fn assemble(&self, laplacian: LaplacianKind) -> Assembler {
        let mut assembler = Assembler::default();
        let Self { particles, neighbors, active, .. } = self;
        let volume = self.params.spacing.powi(D as i32);
        let inputs = Inputs {
            particles,
            surroundings: Surroundings { position: &particles.position, neighbors, active, volume },
            moments: &self.moments,
            surface: &self.surface,
            source: &self.source,
            walls: &self.walls,
            lattice: &self.lattice,
            density: self.params.density,
            spacing: self.params.spacing,
            laplacian,
            bodies: None,
        };
        assembler.assemble(&inputs, &Halo::default(), ALL);
        assembler
    }

    /// (2 / rho) G of each row.
    fn surface_terms(&self, assembler: &Assembler) -> Vec<f64> {
        let of = |&a: &u32| {
            let is_wall = (a as usize) < self.particles.solids();
            let (moments, weight) =
                (&self.moments[a as usize], if is_wall { 0.0 } else { self.surface[a as usize] });
            2.0 / self.params.density * surface::diagonal(moments, weight, &self.lattice, self.params.spacing)
        };
        assembler.particle_of.iter().map(of).collect()
    }

    /// Eqs. (1) and (2) of `ppe::matrix`, transcribed: every pair is looked at, nothing but positions is taken over.
    fn naive(&self, assembler: &Assembler, laplacian: LaplacianKind) -> (DMatrix<f64>, DVector<f64>) {
        let Self { particles, active, params, .. } = self;
        let (rho, dx, r) = (params.density, params.spacing, &particles.position);
        let (h, volume) = (params.smoothing_ratio * dx, dx.powi(D as i32));
        let sigma = [7.0 / 4.0, 21.0 / 16.0][D - 2] / std::f64::consts::PI;
        let slope = |r: f64| -5.0 * sigma / h.powi(D as i32 + 2) * (1.0 - 0.5 * r / h).max(0.0).powi(3);
        let dummies = particles.dummies();
        let n = assembler.particle_of.len();
        let (mut matrix, mut rhs) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for (row, a) in assembler.particle_of.iter().map(|&a| a as usize).enumerate() {
            let pairs: Vec<(usize, Vector<D>, f64)> = (0..particles.len())
                .filter(|&b| b != a && active[b] && (r[a] - r[b]).norm() < 2.0 * h)
                .map(|b| (b, r[a] - r[b], volume * slope((r[a] - r[b]).norm())))
                .collect();
            rhs[row] -= self.source[a];
            if a < particles.walls().end {
                for (b, r_ab, vf) in pairs.into_iter().filter(|(b, ..)| *b >= particles.solids()) {
                    let k = -2.0 / rho * vf;
                    matrix[(row, row)] += k;
                    matrix[(row, assembler.row_of[b] as usize)] -= k;
                    rhs[row] += k * rho * params.gravity.dot(&r_ab);
                }
                continue;
            }
            let defect: Vector<D> = pairs.iter().map(|(_, r, vf)| *vf * r).sum();
            let moments = Moments {
                defect,
                stiffness: -pairs.iter().map(|(.., vf)| vf).sum::<f64>(),
                matrix: pairs.iter().map(|(_, r, vf)| -*vf * r * r.transpose()).sum::<Matrix<D>>(),
                ..Moments::default()
            };
            let dense = DMatrix::from_column_slice(D, D, moments.matrix.as_slice());
            let s = surface::weight(&moments);
            let good = laplacian == LaplacianKind::Schwaiger && dense.determinant() > 0.3;
            let along = match good.then(|| dense.try_inverse()).flatten() {
                Some(b) => {
                    let along = b.tr_mul(&DVector::from_column_slice(defect.as_slice()));
                    Vector::from_column_slice(along.as_slice())
                }
                None => Vector::zeros(),
            };
            for (b, r_ab, vf) in pairs {
                let k = -2.0 / rho * vf;
                let c = (1.0 - s) * 2.0 / rho * vf * r_ab.dot(&along);
                let (target, step) = match dummies.contains(&b) {
                    true => {
                        let wall = particles.tie[b - dummies.start] as usize;
                        (wall, rho * params.gravity.dot(&(r[b] - r[wall])))
                    }
                    false => (b, 0.0),
                };
                matrix[(row, row)] += k - c;
                matrix[(row, assembler.row_of[target] as usize)] -= k - c;
                rhs[row] += (k - c) * step;
            }
            matrix[(row, row)] += 2.0 / rho * surface::diagonal(&moments, s, &self.lattice, dx);
        }
        (matrix, rhs)
    }
}

/// A column of water in a corner of its tank, with a free side.
fn small<const D: usize>() -> Water<D> {
    Water::new(0.05, 0.5, Vector::from_fn(|d, _| if d == 0 { 0.25 } else { 0.3 }), "\"top\"", &[])
}

fn dense(rows: &Rows) -> DMatrix<f64> {
    let mut matrix = DMatrix::zeros(rows.len(), rows.len());
    for k in 0..rows.len() {
        for (c, v) in rows.row(k) {
            matrix[(k, c)] += v;
        }
    }
    matrix
}

macro_rules! in_2d_and_3d {
    ($($name:ident: $test:ident,)*) => {
        mod plane { $(#[test] fn $name() { super::$test::<2>(); })* }
        mod space { $(#[test] fn $name() { super::$test::<3>(); })* }
    };
}

in_2d_and_3d! {
    rows_are_those_of_the_dense_operator: full_rows,
    the_symmetric_part_is_positive_definite: symmetric_part,
    the_sparse_matrix_keeps_row_sums: sparse_matrix,
    a_closed_full_box_floats: closed_box,
    a_lone_particle_has_no_row: lone_particle,
}

fn full_rows<const D: usize>() {
    let water = small::<D>();
    for laplacian in [LaplacianKind::Schwaiger, LaplacianKind::ShaoLo] {
        let assembler = water.assemble(laplacian);
        let (matrix, rhs) = water.naive(&assembler, laplacian);
        let (system, n) = (&assembler.system, rhs.len());
        let solved = |&a: &usize| water.active[a] && !water.particles.dummies().contains(&a);
        assert_eq!(n, (0..water.particles.len()).filter(solved).count());
        let assembled = dense(&system.full);
        for k in 0..n {
            // The same terms in another order: round-off of some fifty of them.
            let largest = matrix.row(k).amax();
            let error = (assembled.row(k) - matrix.row(k)).amax();
            assert!(error <= 1e-12 * largest, "row {k}: {error:e} of {largest:e}");
            let columns: Vec<_> = system.full.row(k).map(|(c, _)| c).collect();
            assert!(columns.is_sorted_by(|a, b| a < b), "row {k} is sorted, each column once");
        }
        // Steps are of order rho g dx, and 1/dx^2 is the size of a coefficient.
        let scale = rhs.amax();
        for (k, b) in system.rhs.iter().enumerate() {
            assert!((b - rhs[k]).abs() <= 1e-12 * scale, "right-hand side {k}: {b:e}, {:e}", rhs[k]);
        }
    }
}

fn symmetric_part<const D: usize>() {
    let assembler = small::<D>().assemble(LaplacianKind::Schwaiger);
    let (full, symmetric) = (&assembler.system.full, &assembler.system.symmetric);
    let matrix = dense(symmetric);
    // The mean of two numbers does not depend on their order.
    assert_eq!((&matrix - matrix.transpose()).amax(), 0.0);
    for k in 0..symmetric.len() {
        let has = |column: usize| symmetric.row(k).any(|(c, _)| c == column);
        assert!(full.row(k).all(|(c, _)| has(c)), "row {k} covers the full one");
        let others: f64 = symmetric.row(k).filter(|(c, _)| *c != k).map(|(_, v)| v.abs()).sum();
        // Round-off of one row sum.
        assert!(symmetric.get(k, k) >= others * (1.0 - 1e-12), "row {k} is diagonally dominant");
    }
    assert!(matrix.cholesky().is_some(), "positive definite");
}

fn sparse_matrix<const D: usize>() {
    let water = small::<D>();
    let assembler = water.assemble(LaplacianKind::Schwaiger);
    let sparse = &assembler.system.sparse;
    let matrix = dense(sparse);
    let asymmetry = (&matrix - matrix.transpose()).amax();
    // W_ab and W_ba are the same number; entries that dummies share are sums in two orders.
    assert!(asymmetry <= 1e-14 * matrix.amax(), "asymmetry {asymmetry:e}");
    for (k, anchor) in water.surface_terms(&assembler).into_iter().enumerate() {
        let sum: f64 = sparse.row(k).map(|(_, v)| v).sum();
        if sparse.row(k).count() == 1 {
            let corner = assembler.particle_of[k] as usize;
            assert!(corner < water.particles.walls().end, "only walls in corners stand alone");
            continue;
        }
        // A row sum cancels its diagonal.
        assert!((sum - anchor).abs() <= 1e-12 * sparse.get(k, k), "row {k}: {sum:e}, {anchor:e}");
    }
    assert!(sparse.column.len() < assembler.system.full.column.len());
    assert!(matrix.cholesky().is_some(), "positive definite");
    let reach = NEAR * water.params.spacing;
    let fluid = water.particles.solids();
    for (k, &a) in assembler.particle_of.iter().enumerate().filter(|(_, a)| **a as usize >= fluid) {
        for (c, _) in sparse.row(k) {
            let b = assembler.particle_of[c] as usize;
            let r = water.particles.position[a as usize] - water.particles.position[b];
            assert!(r.norm() < reach, "liquid keeps near neighbours only");
        }
    }
}

fn closed_box<const D: usize>() {
    let full = Water::<D>::new(0.05, 0.3, Vector::repeat(0.3), "", &[]);
    let assembler = full.assemble(LaplacianKind::Schwaiger);
    let all: Vec<u32> = (0..assembler.particle_of.len() as u32).collect();
    assert_eq!(assembler.system.floating, [all]);
    assert!(small::<D>().assemble(LaplacianKind::Schwaiger).system.floating.is_empty());
}

fn lone_particle<const D: usize>() {
    // In the middle of the air, and a pair beside it that has a surface all around.
    let lone = Vector::repeat(0.425);
    let mut pair = [lone; 2];
    pair[0][0] = 0.8;
    pair[1][0] = 0.85;
    let column = Vector::from_fn(|d, _| if d == 0 { 0.15 } else { 0.2 });
    let water = Water::<D>::new(0.05, 1.0, column, "\"top\"", &[lone, pair[0], pair[1]]);
    let assembler = water.assemble(LaplacianKind::Schwaiger);
    let count = water.particles.len();
    assert_eq!(assembler.row_of[count - 3], NO_ROW);
    assert!(assembler.row_of[count - 2..].iter().all(|&row| row != NO_ROW));
    assert!(assembler.system.floating.is_empty(), "the pair is anchored by its surface");
    let mut particles = water.particles.clone();
    particles.pressure.fill(7.0);
    assembler.scatter(&mut particles);
    assert_eq!(particles.pressure[count - 3], 0.0);
}

/// Recovers a chosen pressure through PETSc, which starts once in a process: cargo-nextest gives each test its own.
#[cfg(feature = "petsc")]
mod solved_by {
    use super::*;
    use sphpetsc::petsc::Session;
    use sphpetsc::ppe::PressureSolve;
    use sphpetsc::ppe::solve::PressureSolver;

    fn recovers(options: &str) {
        let water = Water::<2>::new(0.01, 0.8, Vector::from([0.2, 0.4]), "\"top\"", &[]);
        let assembler = water.assemble(LaplacianKind::Schwaiger);
        let mut system = assembler.system.clone();
        // Hydrostatic, with a wave and with noise from particle to particle.
        let pressure = |&a: &u32| {
            let r = water.particles.position[a as usize];
            9810.0 * (0.4 - r.y) + 500.0 * (9.0 * r.x + 5.0 * r.y).sin() + 100.0 * (a as f64).sin()
        };
        let exact: Vec<f64> = assembler.particle_of.iter().map(pressure).collect();
        system.rhs = system.full.multiply(&exact);
        let options: Vec<String> =
            format!("{options} -ksp_rtol 1e-10").split_whitespace().map(String::from).collect();
        let session = Session::start(&options).unwrap();
        let mut solver = PressureSolver::new(session, exact.len()).unwrap();
        let record = solver.solve(&mut system).unwrap();
        assert_eq!(record.fallback, None);
        let largest = exact.iter().fold(0.0_f64, |m, p| m.max(p.abs()));
        let pairs = system.pressure.iter().zip(&exact);
        let error = pairs.map(|(p, e)| (p - e).abs()).fold(0.0, f64::max);
        // The residual of 1e-10 times a condition number of some 1e4 (the column is 40 spacings high).
        assert!(error < 1e-6 * largest, "error {error:e} Pa of {largest:e}, {record:?}");
    }

    macro_rules! recover {
        ($($name:ident: $options:literal,)*) => { $(#[test] fn $name() { recovers($options); })* };
    }

    recover! {
        bcgs_ilu: "-ksp_type bcgs -pc_type ilu",
        bcgs_hypre: "-ksp_type bcgs -pc_type hypre",
        cg_hypre: "-ksp_type cg -pc_type hypre",
        cg_icc: "-ksp_type cg -pc_type icc",
        cg_jacobi: "-ksp_type cg -pc_type jacobi",
        cg_gamg: "-ksp_type cg -pc_type gamg",
        mumps: "-ksp_type preonly -pc_type lu -pc_factor_mat_solver_type mumps",
    }
}
