//! How many directed pairs does a step of `wcsph` in 3D take in a second? One is a liquid particle that takes the full contribution of
//! one neighbour: its search and all its sums.

mod scenes;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use sphpetsc::case::build::{self, Scene};
use sphpetsc::neighbors::{Layout, Neighbors};
use sphpetsc::scheme::wcsph::Wcsph;
use sphpetsc::simulation::{Simulation, StepControl};

fn step(criterion: &mut Criterion, smoothing_ratio: f64) {
    let sets = [("scheme.kind", "wcsph".to_owned()), ("scheme.smoothing_ratio", smoothing_ratio.to_string())];
    let (case, scene) = scenes::scene::<3>("dam_break_3d_fixed", &sets);
    let method = build::wcsph(&case, &scene);
    let Scene { particles, params, enclosure, .. } = scene;
    let scheme = Box::new(Wcsph::new(params.clone(), method, &particles));
    let control = StepControl { fixed: None, largest: f64::INFINITY };
    let mut simulation =
        Simulation::new(particles, scheme, control, enclosure, params.gravity, params.support());
    simulation.start().expect("a pressure");
    simulation.advance().expect("a step");
    let particles = &simulation.particles;
    let liquid = |a| if particles.fluid().contains(&a) { f64::NEG_INFINITY } else { f64::INFINITY };
    let (h, mut neighbors) = (params.smoothing_length(), Neighbors::default());
    neighbors.search(params.kernel, h, &particles.position, &Layout::of(particles), liquid);
    let pairs = neighbors.pairs();
    let mut group = criterion.benchmark_group("wcsph");
    group.throughput(Throughput::Elements(pairs as u64));
    group.bench_function(format!("h_over_dx_{smoothing_ratio}"), |bencher| {
        bencher.iter(|| simulation.advance().expect("a step"));
    });
}

fn all(criterion: &mut Criterion) {
    step(criterion, 1.2);
    // As many neighbours, some 170, as are common elsewhere.
    step(criterion, 1.73);
}

criterion_group! { name = wcsph; config = Criterion::default().sample_size(20); targets = all }
criterion_main!(wcsph);
