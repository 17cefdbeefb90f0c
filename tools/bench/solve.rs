//! How long does a pressure solve take, by method? From zero, on the first system of each scene.

mod catcher;
mod scenes;

use std::cell::RefCell;
use std::rc::Rc;

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use sphpetsc::case::build::Scene;
use sphpetsc::petsc::Session;
use sphpetsc::ppe::solve::PressureSolver;
use sphpetsc::ppe::{Needs, PressureSolve, PressureSystem};
use sphpetsc::scheme::Scheme;
use sphpetsc::scheme::isph::Isph;

/// Krylov method and preconditioner.
const METHODS: [[&str; 2]; 5] =
    [["bcgs", "ilu"], ["bcgs", "hypre"], ["bcgs", "jacobi"], ["gmres", "ilu"], ["cg", "icc"]];

/// The pressure system of the first step.
fn system<const D: usize>(name: &str) -> PressureSystem {
    let (Scene { mut particles, params, .. }, method) = scenes::scene::<D>(name);
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
    let systems = [(scenes::PLANE, system::<2>(scenes::PLANE)), (scenes::SPACE, system::<3>(scenes::SPACE))];
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
}

criterion_group! { name = solve; config = Criterion::default().sample_size(10); targets = all }
criterion_main!(solve);
