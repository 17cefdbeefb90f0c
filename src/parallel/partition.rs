//! Which rank owns which place: slabs across the first axis, cut so that all ranks have equally much to do.
//!
//! Floods run along the first axis, which is the longest of nearly every scene; slabs then have two neighbours each. The
//! surface between slabs does not shrink with more ranks as that of blocks would: a slab should stay several kernel supports
//! wide. Cuts are quantiles of a histogram of work that all ranks add up, so every rank finds the same ones: each rank spreads what it
//! was measured to do over its liquid evenly, as walls and spray make some of it dearer than other.

use super::Ranks;
use std::ops::Range;

/// Largest work of one rank over the mean that is left alone: more is lost in waiting. At half that excess the noise of clocks
/// moves cuts for nothing, at twice it two ranks may differ by a fifth.
const BALANCED: f64 = 1.05;
/// Bins of the histogram at most.
const BINS: f64 = 4096.0;

/// Slabs of all ranks.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Slabs {
    /// Between rank q and q + 1, in m, ascending; ranks - 1 of them.
    cuts: Vec<f64>,
}

impl Slabs {
    /// Slabs with equal work on all ranks, of which each particle of this rank, with first coordinates `x`, makes `each`; bins `width`
    /// m wide.
    pub fn balanced(ranks: &Ranks, x: impl Iterator<Item = f64> + Clone, each: f64, width: f64) -> Self {
        let low = -ranks.max(-x.clone().fold(f64::INFINITY, f64::min));
        let high = ranks.max(x.clone().fold(f64::NEG_INFINITY, f64::max));
        if high < low {
            return Self { cuts: vec![0.0; ranks.count() - 1] };
        }
        let bins = ((high - low) / width).ceil().clamp(1.0, BINS);
        let width = (high - low) / bins;
        let mut local = vec![0.0; bins as usize];
        for x in x {
            local[(((x - low) / width) as usize).min(bins as usize - 1)] += each;
        }
        let histogram = ranks.sums(&local);
        let share = histogram.iter().sum::<f64>() / ranks.count() as f64;
        let (mut cuts, mut below) = (vec![], 0.0);
        for (bin, work) in histogram.into_iter().enumerate() {
            while cuts.len() + 1 < ranks.count() && below + work >= share * (cuts.len() + 1) as f64 {
                let part = (share * (cuts.len() + 1) as f64 - below) / work;
                cuts.push(low + (bin as f64 + part) * width);
            }
            below += work;
        }
        cuts.resize(ranks.count() - 1, high);
        Self { cuts }
    }

    /// Whether `local`, the work of this rank of `total`, is too far above the mean on any rank.
    pub fn are_uneven(ranks: &Ranks, local: f64, total: f64) -> bool {
        ranks.max(local) * ranks.count() as f64 > BALANCED * total
    }

    /// Rank that owns the place with first coordinate `x` in m.
    pub fn owner(&self, x: f64) -> usize {
        self.cuts.partition_point(|cut| *cut <= x)
    }

    /// Ranks within `reach` m of that place.
    pub fn near(&self, x: f64, reach: f64) -> Range<usize> {
        self.cuts.partition_point(|cut| *cut <= x - reach)
            ..self.cuts.partition_point(|cut| *cut <= x + reach) + 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_has_one_owner() {
        let slabs = Slabs { cuts: vec![1.0, 2.0, 2.5] };
        assert_eq!([0.0, 1.0, 2.2, 9.0].map(|x| slabs.owner(x)), [0, 1, 2, 3]);
        assert_eq!((slabs.near(1.9, 0.2), slabs.near(2.2, 1.0)), (1..3, 1..4));
        assert_eq!(Slabs::default().near(3.0, 1.0), 0..1);
        let alone = Slabs::balanced(&Ranks::default(), [0.0, 1.0].into_iter(), 1.0, 0.1);
        assert_eq!(alone, Slabs::default());
    }
}
