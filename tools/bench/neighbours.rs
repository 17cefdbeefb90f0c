//! How long does a neighbour search take, with kernel values?

mod scenes;

use criterion::{Criterion, criterion_group, criterion_main};
use sphpetsc::case::build::Scene;
use sphpetsc::kernel::{Smoothing, WendlandC2};
use sphpetsc::neighbors::{Layout, Neighbors};

fn search<const D: usize>(criterion: &mut Criterion, name: &str) {
    let (_, Scene { particles, params, .. }) = scenes::scene::<D>(name, &[]);
    let layout = Layout::of(&particles);
    let smoothing = Smoothing::<D, WendlandC2>::new(params.smoothing_length());
    let mut neighbors = Neighbors::default();
    criterion.bench_function(name, |bencher| {
        bencher.iter(|| {
            neighbors.update(&particles.position, &layout, &smoothing, params.support(), |_| 0.0);
        });
    });
}

fn all(criterion: &mut Criterion) {
    search::<2>(criterion, scenes::PLANE);
    search::<3>(criterion, scenes::SPACE);
}

criterion_group! { name = neighbours; config = Criterion::default().sample_size(20); targets = all }
criterion_main!(neighbours);
