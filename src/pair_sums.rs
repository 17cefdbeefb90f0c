//! Sums over pairs of liquid that are listed once ([`Layout::with_liquid_once`](crate::neighbors::Layout::with_liquid_once)): what a pair
//! gives to each of its particles is found in one go.
//!
//! Particle a adds to sums of others, which threads that have other rows add to as well. So rows are dealt out in groups
//! ([`Neighbors::groups`]), each adds to a *window* of its own, of its particles and all that they are paired with, and windows are then
//! added up in one order: the result does not depend on the number of threads. In cell order a window is longer than its group by the
//! cells within a support, and no more.
//!
//! Ghosts get no sums: their originals have rows of their own.

use crate::neighbors::Neighbors;
use rayon::prelude::*;
use std::ops::{AddAssign, Range};

/// Sums that are added up at once.
const BLOCK: usize = 512;

/// A sum for each particle of the liquid, and room to find it.
#[derive(Debug, Clone)]
pub struct PairSums<T> {
    windows: Vec<Window<T>>,
    sums: Vec<T>,
    zero: T,
}

/// The sums that a group of rows adds to.
#[derive(Debug, Clone)]
pub struct Window<T> {
    /// First of the particles that it spans.
    first: usize,
    sums: Vec<T>,
}

impl<T: Copy + AddAssign> Window<T> {
    /// Adds `share` to the sum of particle `a`, unless it is a ghost.
    #[inline]
    pub fn add(&mut self, a: usize, share: T) {
        if let Some(sum) = self.sums.get_mut(a.wrapping_sub(self.first)) {
            *sum += share;
        }
    }

    /// What it has of the particles `some`, and their numbers in `some`.
    fn of(&self, some: &Range<usize>) -> (Range<usize>, &[T]) {
        let start = self.first;
        let (first, end) = (start.max(some.start), (start + self.sums.len()).min(some.end));
        match first < end {
            true => (first - some.start..end - some.start, &self.sums[first - start..end - start]),
            false => (0..0, &[]),
        }
    }
}

impl<T: Copy + AddAssign + Send + Sync> PairSums<T> {
    /// Sums that begin with `zero`.
    pub fn new(zero: T) -> Self {
        Self { windows: vec![], sums: vec![], zero }
    }

    /// Sums for the fluid, in its order: `row(a, window)` adds what the pairs in the row of `a` give to `a` and to the others.
    pub fn collect<const D: usize>(
        &mut self,
        neighbors: &Neighbors<D>,
        row: impl Fn(usize, &mut Window<T>) + Sync,
    ) -> &[T] {
        let groups = neighbors.groups();
        let fluid = groups.first().map_or(0, |group| group.rows.start)
            ..groups.last().map_or(0, |group| group.rows.end);
        let Self { windows, sums, zero } = self;
        windows.resize_with(groups.len(), || Window { first: 0, sums: vec![] });
        windows.par_iter_mut().zip(groups).for_each(|(window, group)| {
            window.first = group.span.start;
            window.sums.clear();
            window.sums.resize(group.span.len(), *zero);
            for a in group.rows.clone() {
                row(a, window);
            }
        });
        sums.resize(fluid.len(), *zero);
        sums.par_chunks_mut(BLOCK).enumerate().for_each(|(k, sums)| {
            sums.fill(*zero);
            let first = fluid.start + k * BLOCK;
            for window in &*windows {
                let (these, shares) = window.of(&(first..first + sums.len()));
                sums[these].iter_mut().zip(shares).for_each(|(sum, share)| *sum += *share);
            }
        });
        sums
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::KernelKind;
    use crate::neighbors::Layout;
    use crate::particles::Vector;

    /// A disordered lattice of 24^3 particles a spacing of 1 apart, so shuffled that partners are anywhere.
    fn scatter() -> Vec<Vector<3>> {
        let count = 24_usize.pow(3);
        let place = |k: usize| {
            let (n, wobble) = ((k * 5003) % count, |seed: usize| (seed * 7919 % 1000) as f64 * 4e-4);
            let cell = [n / 576, n / 24 % 24, n % 24];
            Vector::from_fn(|d, _| cell[d] as f64 + wobble(n * 3 + d))
        };
        (0..count).map(place).collect()
    }

    /// Sums of F_ab and of F_ab (x_b - x_a) as `threads` threads find them.
    fn sums(position: &[Vector<3>], owned: usize, threads: usize) -> (Vec<f64>, Vec<Vector<3>>) {
        let layout = Layout { solids: 0..40, solid_ghosts: owned..owned, ..Layout::default() };
        let layout = layout.with_solids_blind_to_solids().with_liquid_once();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| {
            let mut neighbors = Neighbors::default();
            neighbors.search(KernelKind::WendlandC2, 1.2, position, &layout, |_| f64::NEG_INFINITY);
            let liquid = |a: usize| neighbors.row(a).split().0.iter();
            let (mut even, mut odd) = (PairSums::new(0.0), PairSums::new(Vector::zeros()));
            let even = even.collect(&neighbors, |a, window| {
                for (b, _, f) in liquid(a) {
                    window.add(a, f);
                    window.add(b, f);
                }
            });
            let odd = odd.collect(&neighbors, |a, window| {
                for (b, _, f) in liquid(a) {
                    let share = f * (position[b] - position[a]);
                    window.add(a, share);
                    window.add(b, -share);
                }
            });
            (even.to_vec(), odd.to_vec())
        })
    }

    #[test]
    fn sums_over_pairs_taken_once_are_those_over_all_rows() {
        let position = scatter();
        let owned = position.len() - 1000;
        let (even, odd) = sums(&position, owned, 1);
        let mut rows = Neighbors::default();
        let layout = Layout { solids: 0..40, solid_ghosts: owned..owned, ..Layout::default() };
        rows.search(KernelKind::WendlandC2, 1.2, &position, &layout, |_| f64::NEG_INFINITY);
        for a in 40..owned {
            let row = || rows.row(a).split().0.iter();
            let (all, moved) = (
                row().map(|(.., f)| f).sum::<f64>(),
                row().map(|(b, _, f)| f * (position[b] - position[a])).sum::<Vector<3>>(),
            );
            assert!(all < 0.0 && (even[a - 40] - all).abs() < 1e-12 * all.abs(), "particle {a}");
            assert!((odd[a - 40] - moved).norm() < 1e-12 * all.abs(), "particle {a}");
        }
        assert_eq!(sums(&position, owned, 3), (even, odd), "the same with other threads, to the last bit");
    }
}
