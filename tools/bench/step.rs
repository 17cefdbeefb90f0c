//! How long does a whole time step take, at the start of each scene?

mod scenes;

use std::rc::Rc;

use criterion::{Criterion, criterion_group, criterion_main};
use sphpetsc::case::build::{self, Scene};
use sphpetsc::petsc::Session;
use sphpetsc::ppe::solve::PressureSolver;
use sphpetsc::scheme::isph::Isph;
use sphpetsc::simulation::{Simulation, StepControl};
use sphpetsc::terms::implicit_viscosity::VelocitySolver;

fn step<const D: usize>(criterion: &mut Criterion, session: &Rc<Session>, name: &str) {
    let (case, scene) = scenes::scene::<D>(name, &[]);
    let method = build::isph(&case, &scene);
    let Scene { particles, params, enclosure, .. } = scene;
    let solver = PressureSolver::new(Rc::clone(session), particles.fluid().len()).expect("known types");
    let solvers = (Box::new(solver) as _, Box::new(VelocitySolver::new(Rc::clone(session))) as _);
    let scheme = Box::new(Isph::new(params.clone(), method, &particles, solvers));
    let control = StepControl { fixed: None, largest: f64::INFINITY };
    let mut simulation =
        Simulation::new(particles, scheme, control, enclosure, params.gravity, params.support());
    simulation.start().expect("a pressure");
    criterion.bench_function(name, |bencher| bencher.iter(|| simulation.advance().expect("a step")));
}

fn all(criterion: &mut Criterion) {
    let session = Session::start(&[]).expect("PETSc starts");
    step::<2>(criterion, &session, scenes::PLANE);
    step::<3>(criterion, &session, scenes::SPACE);
}

criterion_group! { name = steps; config = Criterion::default().sample_size(20); targets = all }
criterion_main!(steps);
