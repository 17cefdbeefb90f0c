//! How long does the assembly of a pressure system take, alone and with the extra matrices solvers ask for?

mod catcher;
mod scenes;

use std::rc::Rc;
use std::time::Duration;

use criterion::{Criterion, criterion_group, criterion_main};
use sphpetsc::case::build::{self, Scene};
use sphpetsc::ppe::Needs;
use sphpetsc::scheme::Scheme;
use sphpetsc::scheme::isph::Isph;

const MATRICES: [(&str, Needs); 3] = [
    ("full", Needs { symmetric: false, sparse: false, uncorrected: false }),
    ("full + sparse", Needs { symmetric: false, sparse: true, uncorrected: false }),
    ("full + symmetric", Needs { symmetric: true, sparse: false, uncorrected: false }),
];

/// Time that a scheme has spent in assembly.
fn assembly<const D: usize>(scheme: &Isph<D>) -> Duration {
    scheme.stages().iter().filter(|(stage, _)| *stage == "assemble").map(|(_, spent)| spent).sum()
}

fn assemble<const D: usize>(criterion: &mut Criterion, name: &str) {
    let (case, scene) = scenes::scene::<D>(name, &[]);
    let method = build::isph(&case, &scene);
    let Scene { particles, params, .. } = scene;
    let mut group = criterion.benchmark_group(name);
    group.sample_size(10);
    for (matrices, needs) in MATRICES {
        let catcher = catcher::Catcher { needs, system: Rc::default() };
        let mut scheme = Isph::new(
            params.clone(),
            method.clone(),
            &particles,
            (Box::new(catcher), Box::new(catcher::Inviscid)),
        );
        let dt = scheme.max_dt(&particles);
        group.bench_function(matrices, |bencher| {
            // Whole steps from the same state, of which only this stage counts.
            bencher.iter_custom(|steps| {
                let before = assembly(&scheme);
                for _ in 0..steps {
                    scheme.step(&mut particles.clone(), dt).expect("nothing to fail");
                }
                assembly(&scheme) - before
            });
        });
    }
}

fn all(criterion: &mut Criterion) {
    assemble::<2>(criterion, scenes::PLANE);
    assemble::<3>(criterion, scenes::SPACE);
}

criterion_group!(benches, all);
criterion_main!(benches);
