//! This rank among many: the one seam through which sums, extrema, row numbers and particles pass.
//!
//! On one rank every operation is the identity and no MPI is needed. Code above this module and [`halo`](crate::halo) never
//! asks how many ranks there are: it calls the same operations on any number, on all ranks in the same order.
//!
//! Messages are doubles: whatever travels is [`Packed`] into them. A particle's fields are a few doubles each, so
//! the numbers cost little more than their own types would, and no type needs an MPI twin.
//!
//! A program that no MPI launcher started never starts MPI for itself ([`start`]); PETSc does, on one rank.
//!
//! **How far it carries.** A step of `isph_df` in 3D takes a rank with n particles of liquid and G ghosts about
//!
//! t = 1.9 us (n + 0.8 G) + 1.4 us n + 125 collective calls + the messages of multigrid                  (1)
//!
//! The first term is everything but the solve; its factor of G is what two ranks take longer than half of one. The second is the solve while
//! the liquid is calm, 2.2 us in a splash. Measured in `dam_break_3d_fixed` on two cores: iterations on 1, 2, 4, 8 ranks 4.8, 4.9, 5.2,
//! 5.4; ghosts of all ranks over the liquid 0.07, 0.19, 0.49 on 2, 4, 8; a rank and step make 26 calls beside PETSc's and 50 reductions in
//! PETSc, send 46 doubles a ghost (those of solids beside the cut among them) and some 20 messages of 24 kB in PETSc's products. With 20 us a call, the share of latency is 2.5 ms.
//!
//! A slab has ghosts 2.4 spacings deep on both sides, G = 5 A with A particles in the cross-section of the liquid. For the same flood
//! with 10^7 particles, spacing 4.1 mm, A is 33 thousand, with 10^8, 1.9 mm, 154 thousand. By (1), against n alone:
//!
//! | liquid | ranks | n | G | step | of the ideal |
//! |---|---|---|---|---|---|
//! | 10^7 | 16 | 625 k | 165 k | 2.3 s | 0.89 |
//! | 10^7 | 64 | 156 k | 165 k | 0.77 s | 0.67 |
//! | 10^8 | 64 | 1.6 M | 0.77 M | 6.3 s | 0.82 |
//! | 10^8 | 256 | 0.39 M | 0.77 M | 2.5 s | 0.52 |
//!
//! The factor of G was measured when ghosts were 5.3 spacings deep. Were the loss still the same, the last column would be 0.79, 0.49, 0.68 and 0.34.
//!
//! So slabs are what gives way first, long before latency: blocks of 390 thousand particles would have G = n / 5 and 0.92 of the ideal.
//! Second come solids, which all ranks keep, 0.2 kB each: 3 million for 10^7 particles, 16 million or 3 GB a rank for 10^8; third the scene gathered
//! on the first rank for particle files, 6 GB there. With 32-bit indices hypre counts the entries of the sparse matrix, 20 a row, up to 10^8 rows, and
//! a rank can hold 37 million rows of the full one; from there on PETSc with 64-bit indices is needed.

pub mod partition;

#[cfg(feature = "mpi")]
mod world;
#[cfg(not(feature = "mpi"))]
#[path = "alone.rs"]
mod world;

pub use world::{Running, abort, launch, start};

use crate::{Error, Result};
use nalgebra::SMatrix;
use std::cell::Cell;
use std::time::{Duration, Instant};

/// What passed between this rank and others since it started. What PETSc passes is not in it.
#[derive(Debug, Clone, Copy, Default)]
pub struct Traffic {
    /// Time spent in calls, for the most part waiting.
    pub waited: Duration,
    /// Calls in which all ranks take part.
    pub calls: usize,
    /// Doubles sent to others.
    pub sent: usize,
}

thread_local! {
    /// Only the main thread calls other ranks.
    static TRAFFIC: Cell<Traffic> = const { Cell::new(Traffic { waited: Duration::ZERO, calls: 0, sent: 0 }) };
}

/// The traffic of this rank so far.
pub fn traffic() -> Traffic {
    TRAFFIC.get()
}

/// Runs a call to other ranks, to whom it sends `doubles`.
fn pass<T>(doubles: usize, call: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let result = call();
    let Traffic { waited, calls, sent } = TRAFFIC.get();
    TRAFFIC.set(Traffic { waited: waited + start.elapsed(), calls: calls + 1, sent: sent + doubles });
    result
}

/// The ranks that share a simulation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ranks {
    rank: usize,
    count: usize,
    /// How many of them are on this machine.
    here: usize,
}

impl Default for Ranks {
    /// One rank, this process.
    fn default() -> Self {
        Self { rank: 0, count: 1, here: 1 }
    }
}

impl Ranks {
    /// Whether this is the first rank, the one that speaks and writes for all.
    pub fn is_first(&self) -> bool {
        self.rank == 0
    }

    /// Number of this rank, from 0.
    pub fn rank(&self) -> usize {
        self.rank
    }

    /// Number of ranks.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Threads for this rank where nobody asked for a number: its share of the machine's cores, or on one rank what rayon takes.
    pub fn threads(&self) -> Option<usize> {
        self.are_several().then_some((cores() / self.here).max(1))
    }

    /// Whether others take part.
    pub fn are_several(&self) -> bool {
        self.count > 1
    }

    /// Sum over ranks.
    pub fn sum(&self, local: f64) -> f64 {
        self.sums(&[local])[0]
    }

    /// Sums over ranks, entry by entry.
    pub fn sums(&self, local: &[f64]) -> Vec<f64> {
        if self.are_several() { pass(local.len(), || world::sums(local)) } else { local.to_vec() }
    }

    /// Largest value over ranks.
    pub fn max(&self, local: f64) -> f64 {
        if self.are_several() { pass(1, || world::max(local)) } else { local }
    }

    /// Whether it is so on any rank.
    pub fn any(&self, local: bool) -> bool {
        self.max(f64::from(u8::from(local))) > 0.0
    }

    /// Global number of this rank's first row, given its number of rows: rows are contiguous by rank.
    pub fn first_row(&self, local_rows: usize) -> usize {
        let counts = self.all(&[local_rows as f64]);
        counts[..self.rank].iter().flatten().sum::<f64>() as usize
    }

    /// What each rank has, on every rank.
    pub fn all(&self, local: &[f64]) -> Vec<Vec<f64>> {
        self.exchange(vec![local.to_vec(); self.count])
    }

    /// What each rank has, on the first one; the others get empty lists.
    pub fn gather(&self, local: Vec<f64>) -> Vec<Vec<f64>> {
        let mut parts = vec![vec![]; self.count];
        parts[0] = local;
        self.exchange(parts)
    }

    /// Sends `parts[q]` to rank q, for every q; returns what came from each.
    pub fn exchange(&self, parts: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
        if !self.are_several() {
            return parts;
        }
        pass(self.count_sent(&parts), || {
            let counts = world::counts(&parts);
            world::exchange(parts, &counts)
        })
    }

    /// [`exchange`](Self::exchange) where this rank knows how many doubles come from each.
    pub fn exchange_expected(&self, parts: Vec<Vec<f64>>, counts: Vec<usize>) -> Vec<Vec<f64>> {
        if !self.are_several() {
            return parts;
        }
        pass(self.count_sent(&parts), || world::exchange(parts, &counts))
    }

    /// Doubles in the parts for others.
    fn count_sent(&self, parts: &[Vec<f64>]) -> usize {
        parts.iter().enumerate().filter(|(q, _)| *q != self.rank).map(|(_, part)| part.len()).sum()
    }

    /// The first rank's text, on all ranks.
    pub fn same_text(&self, text: String) -> String {
        if !self.are_several() {
            return text;
        }
        let bytes: Vec<f64> = text.bytes().map(f64::from).collect();
        let mine = if self.is_first() { vec![bytes; self.count] } else { vec![vec![]; self.count] };
        let bytes = self.exchange(mine).swap_remove(0).into_iter().map(|byte| byte as u8).collect();
        String::from_utf8(bytes).expect("a text was sent")
    }

    /// Makes a failure of any rank that of all: its own on the first rank, which says it, and an error of the same kind
    /// with an empty message on the others.
    pub fn agree<T>(&self, outcome: Result<T>) -> Result<T> {
        if !self.are_several() {
            return outcome;
        }
        let failed = if outcome.is_err() { self.rank as f64 } else { f64::INFINITY };
        let first = -self.max(-failed);
        if first.is_infinite() {
            return outcome;
        }
        // Kind and sentence of the first rank that failed, told to all.
        let mine = outcome.err().filter(|_| self.rank as f64 == first);
        let words = mine.map_or_else(Vec::new, |error| {
            let kind = match &error {
                Error::Input(_) => 0_u8,
                Error::Interrupted(_) => 1,
                _ => 2,
            };
            std::iter::once(kind).chain(error.to_string().into_bytes()).map(f64::from).collect()
        });
        let said: Vec<u8> = self.all(&words).concat().into_iter().map(|byte| byte as u8).collect();
        let sentence =
            if self.is_first() { String::from_utf8_lossy(&said[1..]).into_owned() } else { String::new() };
        Err(match said[0] {
            0 => Error::Input(sentence),
            1 => Error::Interrupted(sentence),
            _ => Error::Run(sentence),
        })
    }
}

/// What travels between ranks, as doubles.
pub trait Packed: Copy {
    /// Number of doubles.
    const WIDTH: usize;
    /// Appends it to a message.
    fn pack(&self, message: &mut Vec<f64>);
    /// From its doubles.
    fn unpack(words: &[f64]) -> Self;
}

/// Plain numbers that a double holds exactly: numbers of particles stay below 2^53.
macro_rules! packed_numbers {
    ($($number:ty),*) => {$(
        impl Packed for $number {
            const WIDTH: usize = 1;
            fn pack(&self, message: &mut Vec<f64>) {
                message.push(*self as f64);
            }
            fn unpack(words: &[f64]) -> Self {
                words[0] as $number
            }
        }
    )*};
}
packed_numbers!(f64, i32, i64, u32, u64);

impl Packed for bool {
    const WIDTH: usize = 1;
    fn pack(&self, message: &mut Vec<f64>) {
        message.push(f64::from(u8::from(*self)));
    }
    fn unpack(words: &[f64]) -> Self {
        words[0] != 0.0
    }
}

impl<const R: usize, const C: usize> Packed for SMatrix<f64, R, C> {
    const WIDTH: usize = R * C;
    fn pack(&self, message: &mut Vec<f64>) {
        message.extend(self.iter());
    }
    fn unpack(words: &[f64]) -> Self {
        Self::from_column_slice(words)
    }
}

/// Cores that this process may use.
fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::particles::Vector;

    fn round_trip<T: Packed + PartialEq + std::fmt::Debug>(value: T) {
        let mut message = vec![];
        value.pack(&mut message);
        assert_eq!(message.len(), T::WIDTH);
        assert_eq!(T::unpack(&message), value);
    }

    #[test]
    fn what_is_packed_comes_back() {
        round_trip(0.1);
        round_trip(-7);
        round_trip(u32::MAX);
        round_trip(1_u64 << 52);
        round_trip(true);
        round_trip(Vector::<3>::new(1.0, 2.0, 3.0));
    }

    #[test]
    fn one_rank_is_all_there_is() {
        let ranks = Ranks::default();
        assert_eq!((ranks.sum(2.0), ranks.max(3.0), ranks.first_row(7)), (2.0, 3.0, 0));
        assert_eq!(ranks.gather(vec![1.0, 2.0]), [[1.0, 2.0]]);
        assert_eq!(ranks.same_text("out".into()), "out");
        assert!(ranks.agree(Ok(())).is_ok() && ranks.any(true) && !ranks.any(false));
    }
}
