//! How long does a pressure solve take, by method? From zero, on the first system of each scene. And how near to the bandwidth of memory does
//! PETSc multiply by its matrix: bytes a second of both, the bandwidth as the triad a = b + s c of STREAM (McCalpin 1995) has it.

mod catcher;
mod scenes;

use std::cell::RefCell;
use std::rc::Rc;

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use sphpetsc::case::build::{self, Scene};
use sphpetsc::petsc::{Matrix, Session, Vector};
use sphpetsc::ppe::solve::PressureSolver;
use sphpetsc::ppe::{Index, Needs, PressureSolve, PressureSystem};
use sphpetsc::scheme::Scheme;
use sphpetsc::scheme::isph::Isph;

/// Krylov method and preconditioner.
const METHODS: [[&str; 2]; 5] =
    [["bcgs", "ilu"], ["bcgs", "hypre"], ["bcgs", "jacobi"], ["gmres", "ilu"], ["cg", "icc"]];

/// Spacing in m at which the matrix of the 3D scene is beyond all caches: 140,000 rows, 80 MB.
const FINE: f64 = 0.004;

/// The pressure system of the first step.
fn system<const D: usize>(name: &str, sets: &[(&str, String)]) -> PressureSystem {
    let (case, scene) = scenes::scene::<D>(name, sets);
    let method = build::isph(&case, &scene);
    let Scene { mut particles, params, .. } = scene;
    let caught = Rc::new(RefCell::default());
    let needs = Needs { symmetric: true, sparse: true, uncorrected: false };
    let catcher = catcher::Catcher { needs, system: Rc::clone(&caught) };
    let mut scheme = Isph::new(params, method, &particles, (Box::new(catcher), Box::new(catcher::Inviscid)));
    let dt = scheme.max_dt(&particles);
    scheme.step(&mut particles, dt).expect("nothing to fail");
    caught.take()
}

/// PETSc starts once in a process, so all methods are options from the start and take their turn by name.
fn session() -> Rc<Session> {
    let options = METHODS.iter().enumerate().flat_map(|(k, [ksp, pc])| {
        [format!("-method{k}_ksp_type"), (*ksp).into(), format!("-method{k}_pc_type"), (*pc).into()]
    });
    Session::start(&options.collect::<Vec<_>>()).expect("PETSc starts")
}

fn all(criterion: &mut Criterion) {
    let session = session();
    let systems =
        [(scenes::PLANE, system::<2>(scenes::PLANE, &[])), (scenes::SPACE, system::<3>(scenes::SPACE, &[]))];
    for (k, [ksp, pc]) in METHODS.iter().enumerate() {
        for part in ["ksp_type", "pc_type"] {
            session.options().rename(&format!("method{k}_{part}"), part).expect("an option of ours");
        }
        for (name, system) in &systems {
            let mut solver = PressureSolver::new(Rc::clone(&session), system.rhs.len()).expect("known types");
            criterion.bench_function(&format!("{name}/{ksp}+{pc}"), |bencher| {
                let fresh = || system.clone();
                bencher.iter_batched(
                    fresh,
                    |mut system| solver.solve(&mut system).expect("convergence"),
                    BatchSize::LargeInput,
                );
            });
        }
    }
    multiply(criterion, &session, &system::<3>(scenes::SPACE, &[("spacing", FINE.to_string())]));
    triad(criterion);
}

/// y = A x; all of A, x and y are read or written once.
fn multiply(criterion: &mut Criterion, session: &Rc<Session>, system: &PressureSystem) {
    let rows = &system.full;
    let matrix = Matrix::from_rows(session, &rows.start, &rows.column, &rows.value).expect("sound rows");
    let x = Vector::from_slice(session, &system.rhs).expect("a vector");
    let mut y = Vector::zeros(session, system.rhs.len()).expect("a vector");
    let entry = size_of::<f64>() + size_of::<Index>();
    let bytes = rows.value.len() * entry + rows.len() * (entry + size_of::<f64>());
    let mut group = criterion.benchmark_group("bandwidth");
    group.throughput(Throughput::Bytes(bytes as u64));
    group.bench_function("MatMult", |bencher| {
        bencher.iter(|| matrix.multiply(&x, &mut y).expect("a product"))
    });
}

/// On three arrays of 128 MiB, beyond all caches.
fn triad(criterion: &mut Criterion) {
    const LENGTH: usize = 1 << 24;
    let (mut a, b, c) = (vec![0.0; LENGTH], vec![1.0; LENGTH], vec![2.0; LENGTH]);
    let mut group = criterion.benchmark_group("bandwidth");
    group.throughput(Throughput::Bytes((3 * LENGTH * size_of::<f64>()) as u64));
    group.bench_function("triad", |bencher| {
        bencher.iter(|| {
            let all = a.iter_mut().zip(std::hint::black_box(&b)).zip(&c);
            all.for_each(|((a, b), c): ((&mut f64, &f64), &f64)| *a = c.mul_add(3.0, *b));
        });
    });
}

criterion_group! { name = solve; config = Criterion::default().sample_size(10); targets = all }
criterion_main!(solve);
