//! Ghosts: copies of particles seen from beyond a side of this rank's domain.
//!
//! A periodic side is a copy of the opposite one: particles that cross it come back in on the other side, and whatever lies within a
//! kernel support of one side appears as a ghost beyond the other. A ghost is the same particle at another place, so
//! every field of it is that of its original. Fields computed for the originals are copied over by
//! [`Halo::refresh`] before a sum over neighbours reads them.
//!
//! **Ranks** meet in the same way. Each owns a slab of the scene ([`partition`](crate::parallel::partition)); liquid that
//! drifts into another slab moves to its rank, and liquid within reach of another slab (or whose periodic copy is) has a ghost there.
//! Every rank keeps all solids, numbered alike, as geometry, which costs memory but no traffic: bodies move alike on all ranks.
//! Each solid particle is *held* by one rank, the one whose slab it is in, which alone has neighbours, pressure
//! unknowns and fields for it. The others get the fields of those within a support of their slab, and of the wall particles that dummies among
//! them are tied to, by the same [`Halo::refresh`], in place.

use crate::parallel::partition::Slabs;
use crate::parallel::{self, Packed, Ranks};
use crate::particles::{Fluid, Particles, Vector};
use serde::Serialize;

/// A box that repeats itself along some of its axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PeriodicBox<const D: usize> {
    /// Lower corner in m.
    pub min: Vector<D>,
    /// Length of a period in m, along the axes that have one.
    pub period: [Option<f64>; D],
}

impl<const D: usize> PeriodicBox<D> {
    /// The same place inside the box.
    fn wrap(&self, r: &mut Vector<D>) {
        for d in 0..D {
            if let Some(period) = self.period[d] {
                r[d] -= period * ((r[d] - self.min[d]) / period).floor();
            }
        }
    }

    /// Appends how far copies of `a` at `r`, within `reach` of a side, lie from it.
    fn copies(&self, a: u32, r: &Vector<D>, reach: f64, found: &mut Vec<(u32, Vector<D>)>) {
        let first = found.len();
        for d in 0..D {
            let Some(period) = self.period[d] else { continue };
            let from_low = r[d] - self.min[d];
            let shift = |offset: f64, found: &mut Vec<(u32, Vector<D>)>| {
                let mut along = Vector::<D>::zeros();
                along[d] = offset;
                found.push((a, along));
                // Near an edge the ghosts of the axes before have ghosts of their own.
                for k in first..found.len() - 1 {
                    let (_, before) = found[k];
                    if before[d] == 0.0 {
                        found.push((a, before + along));
                    }
                }
            };
            if from_low < reach {
                shift(period, found);
            }
            if period - from_low < reach {
                shift(-period, found);
            }
        }
    }
}

/// Which particles' fields are refreshed: messages between ranks are long enough to leave out what a sum does not read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kinds {
    /// Liquid and solids.
    All,
    /// Liquid alone: solids have the same values on all ranks, or none.
    Liquid,
    /// Solids alone.
    Solids,
}

/// Makes ghosts and keeps their fields up to date.
#[derive(Debug, Clone, Default)]
pub struct Halo<const D: usize> {
    domain: Option<PeriodicBox<D>>,
    /// How far ghosts reach, in m.
    reach: f64,
    /// How far each ghost lies from its original.
    offset: Vec<Vector<D>>,
    found: Vec<(u32, Vector<D>)>,
    ranks: Ranks,
    /// Everything about other ranks; nothing on one rank.
    peers: Option<Peers<D>>,
    /// Whether solids move, and so may change slabs with every renewal.
    solids_move: bool,
}

/// What this rank shares with the others.
#[derive(Debug, Clone)]
struct Peers<const D: usize> {
    slabs: Slabs,
    /// Whether they belong to other liquid, or to none.
    are_of_old: bool,
    /// Renewals since the last look at the balance.
    age: usize,
    /// What this rank has worked since then, in s.
    work: f64,
    /// Which solids this rank holds.
    holds: Vec<bool>,
    /// For each rank: solids held here that it needs, and solids held there that are needed here.
    solids_out: Vec<Vec<u32>>,
    solids_in: Vec<Vec<u32>>,
    /// For each rank: liquid with a ghost there, and how far that lies from it.
    liquid_out: Vec<Vec<(u32, Vector<D>)>>,
    /// For each rank: how many ghosts here are of its liquid.
    liquid_in: Vec<usize>,
    tally: Tally,
}

/// What this rank had to do with others, summed over all renewals.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    /// Liquid particles of its own.
    own: usize,
    /// Ghosts of others' liquid.
    ghosts: usize,
    /// Liquid particles given away.
    handed_over: usize,
    /// How often slabs were cut.
    cuts: usize,
    /// What it has worked, in s.
    work: f64,
}

/// How the liquid was shared out among ranks, since this program started.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Sharing {
    /// Number of ranks.
    pub ranks: usize,
    /// Work of the rank with most over the mean of all ranks, measured.
    pub imbalance: f64,
    /// The same for the number of liquid particles.
    pub fullest: f64,
    /// Ghosts of other ranks' liquid over liquid, on average.
    pub ghosts_per_particle: f64,
    /// Liquid particles that went to another rank.
    pub handed_over: usize,
    /// How often slabs were cut.
    pub cuts: usize,
    /// Calls to all ranks outside PETSc.
    pub calls: usize,
    /// What the ranks sent each other in them, in bytes.
    pub sent_bytes: f64,
    /// What a rank waited in them on average, in s.
    pub waited_s: f64,
}

/// Renewals between two looks at the balance of the ranks.
const BALANCE_EVERY: usize = 20;

impl<const D: usize> Halo<D> {
    /// Ghosts within `reach` m of the sides of `domain`; without one there are none.
    pub fn new(domain: Option<PeriodicBox<D>>, reach: f64) -> Self {
        Self { domain, reach, ..Self::default() }
    }

    /// Spreads particles over `ranks`.
    pub fn over(self, ranks: Ranks) -> Self {
        if !ranks.are_several() {
            return self;
        }
        let nobody = vec![vec![]; ranks.count()];
        let peers = Peers {
            slabs: Slabs::default(),
            are_of_old: true,
            age: BALANCE_EVERY,
            work: 0.0,
            holds: vec![],
            solids_out: nobody.clone(),
            solids_in: nobody,
            liquid_out: vec![vec![]; ranks.count()],
            liquid_in: vec![0; ranks.count()],
            tally: Tally::default(),
        };
        Self { ranks, peers: Some(peers), ..self }
    }

    /// Tells whether solids move, or are tied otherwise, with every step.
    pub fn let_solids_move(&mut self, they_move: bool) {
        self.solids_move = they_move;
    }

    /// The ranks that it spans.
    pub fn ranks(&self) -> &Ranks {
        &self.ranks
    }

    /// How all ranks, which have to ask at once, shared the liquid; nothing on one rank.
    pub fn sharing(&self) -> Option<Sharing> {
        let tally = self.peers.as_ref()?.tally;
        let traffic = parallel::traffic();
        let [own, ghosts, handed_over, sent] =
            [tally.own, tally.ghosts, tally.handed_over, traffic.sent].map(|count| count as f64);
        let locals = [own, ghosts, handed_over, sent, tally.work, traffic.waited.as_secs_f64()];
        let [all, ghosts, handed_over, sent, work, waited] = self.ranks.sums(&locals)[..] else {
            return None;
        };
        let uneven = |local: f64, all: f64| {
            let most = self.ranks.max(local);
            if all > 0.0 { most * self.ranks.count() as f64 / all } else { 1.0 }
        };
        Some(Sharing {
            ranks: self.ranks.count(),
            imbalance: uneven(tally.work, work),
            fullest: uneven(own, all),
            ghosts_per_particle: ghosts / all.max(1.0),
            handed_over: handed_over as usize,
            cuts: tally.cuts,
            calls: traffic.calls,
            sent_bytes: size_of::<f64>() as f64 * sent,
            waited_s: waited / self.ranks.count() as f64,
        })
    }

    /// Books what this rank has worked for its liquid, in s, by which slabs are cut.
    pub fn book(&mut self, work: f64) {
        if let Some(peers) = &mut self.peers {
            peers.work += work;
            peers.tally.work += work;
        }
    }

    /// Has slabs cut anew by particles alone: the liquid is not what it was.
    pub fn forget_slabs(&mut self) {
        if let Some(peers) = &mut self.peers {
            (peers.are_of_old, peers.age, peers.work) = (true, BALANCE_EVERY, 0.0);
        }
    }

    /// Solids that other ranks hold and liquid here may see.
    pub fn borrowed(&self) -> impl Iterator<Item = usize> {
        let solids = self.peers.iter().flat_map(|peers| peers.solids_in.iter().flatten());
        solids.map(|a| *a as usize)
    }

    /// Whether this rank holds particle `a`, no ghost: all liquid that it has, and the solids in its slab.
    #[inline]
    pub fn holds(&self, a: usize) -> bool {
        self.peers.as_ref().is_none_or(|peers| peers.holds.get(a).copied().unwrap_or(true))
    }

    /// Brings particles that left over a periodic side back in, hands those in other slabs over, and makes the ghosts anew.
    pub fn renew(&mut self, particles: &mut Particles<D>) {
        if self.domain.is_none() && self.peers.is_none() {
            return;
        }
        particles.drop_ghosts();
        if let Some(domain) = &self.domain {
            particles.position.iter_mut().for_each(|r| domain.wrap(r));
        }
        self.hand_over(particles);
        self.found.clear();
        if let Some(domain) = &self.domain {
            for (a, r) in particles.position.iter().enumerate() {
                domain.copies(a as u32, r, self.reach, &mut self.found);
            }
        }
        // In the order of all particles: walls and dummies before the fluid.
        particles.append_ghosts(self.found.iter().map(|(a, _)| *a));
        self.offset.clear();
        self.offset.extend(self.found.iter().map(|(_, offset)| *offset));
        self.place_copies(particles);
        self.meet(particles);
    }

    /// Gives liquid to the ranks in whose slabs it is, after cutting new slabs if need be.
    fn hand_over(&mut self, particles: &mut Particles<D>) {
        let Some(peers) = &mut self.peers else { return };
        let mut are_stale = self.solids_move;
        peers.age += 1;
        if peers.age > BALANCE_EVERY {
            peers.age = 0;
            let x = particles.position[particles.fluid()].iter().map(|r| r[0]);
            let (measured, count) = (std::mem::take(&mut peers.work), x.len() as f64);
            let [total, liquid] = self.ranks.sums(&[measured, count])[..] else { return };
            // Before the first step each particle counts the same.
            let (work, total) = if total > 0.0 { (measured, total) } else { (count, liquid) };
            if std::mem::take(&mut peers.are_of_old) || Slabs::are_uneven(&self.ranks, work, total) {
                // Half way to what was measured: clocks are noisy, and the next look is near.
                let each = 0.5 * (work / count.max(1.0) + total / liquid.max(1.0));
                peers.slabs = Slabs::balanced(&self.ranks, x, each, 0.5 * self.reach);
                peers.tally.cuts += 1;
                are_stale = true;
            }
        }
        if are_stale {
            peers.deal_solids(particles, &self.ranks, self.domain.as_ref(), self.reach);
        }
        let owner = |r: &Vector<D>| peers.slabs.owner(r[0]);
        let mut parts = vec![vec![]; self.ranks.count()];
        for a in particles.fluid() {
            let q = owner(&particles.position[a]);
            if q != self.ranks.rank() {
                pack(&particles.fluid_particle(a), &mut parts[q]);
                peers.tally.handed_over += 1;
            }
        }
        if parts.iter().any(|part| !part.is_empty()) {
            let stays: Vec<bool> = particles.position.iter().map(|r| owner(r) == self.ranks.rank()).collect();
            particles.retain_fluid(|a| stays[a]);
        }
        for part in self.ranks.exchange(parts) {
            particles.take_in(part.chunks_exact(2 * D + 2).map(unpack));
        }
    }

    /// Ghosts of liquid on other ranks.
    fn meet(&mut self, particles: &mut Particles<D>) {
        let Some(peers) = &mut self.peers else { return };
        peers.liquid_out.iter_mut().for_each(Vec::clear);
        let mut send = |a: usize, offset: Vector<D>| {
            let x = particles.position[a][0] + offset[0];
            for q in peers.slabs.near(x, self.reach).filter(|q| *q != self.ranks.rank()) {
                peers.liquid_out[q].push((a as u32, offset));
            }
        };
        particles.fluid().for_each(|a| send(a, Vector::zeros()));
        let solids = particles.solids() as u32;
        self.found.iter().filter(|(a, _)| *a >= solids).for_each(|(a, offset)| send(*a as usize, *offset));
        let parts = peers.liquid_out.iter().map(|ghosts| {
            let mut part = Vec::with_capacity(ghosts.len() * (2 * D + 2));
            for &(a, offset) in ghosts {
                let (r, v, p, id) = particles.fluid_particle(a as usize);
                pack(&(r + offset, v, p, id), &mut part);
            }
            part
        });
        let came = self.ranks.exchange(parts.collect());
        peers.liquid_in = came.iter().map(|part| part.len() / (2 * D + 2)).collect();
        peers.tally.own += particles.fluid().len();
        peers.tally.ghosts += peers.liquid_in.iter().sum::<usize>();
        for part in came {
            particles.append_foreign_ghosts(part.chunks_exact(2 * D + 2).map(unpack));
        }
    }

    /// Puts the ghosts where their originals are now.
    pub fn place(&self, particles: &mut Particles<D>) {
        self.place_copies(particles);
        let Some(peers) = &self.peers else { return };
        let parts = peers.liquid_out.iter().map(|ghosts| {
            let mut part = Vec::with_capacity(ghosts.len() * D);
            ghosts.iter().for_each(|(a, offset)| (particles.position[*a as usize] + offset).pack(&mut part));
            part
        });
        let counts = peers.liquid_in.iter().map(|count| count * D).collect();
        let came = self.ranks.exchange_expected(parts.collect(), counts).concat();
        let first = particles.owned() + self.offset.len();
        let ghosts = &mut particles.position[first..];
        for (ghost, words) in ghosts.iter_mut().zip(came.chunks_exact(D)) {
            *ghost = Vector::unpack(words);
        }
    }

    /// Puts the ghosts of this rank's own particles where their originals are now.
    fn place_copies(&self, particles: &mut Particles<D>) {
        let first = particles.owned();
        for (k, offset) in self.offset.iter().enumerate() {
            let original = particles.original(first + k);
            particles.position[first + k] = particles.position[original] + offset;
        }
    }

    /// Gives the ghosts the values of their originals, and solids held elsewhere those that they have there, of `kinds` that have
    /// changed or matter; `field` has one entry a particle, ghosts included.
    pub fn refresh<T: Packed>(&self, kinds: Kinds, originals: &[u32], field: &mut [T]) {
        if let Some(peers) = &self.peers {
            let owned = field.len() - originals.len();
            peers.refresh(kinds, &self.ranks, owned + self.offset.len(), field);
        }
        self.copy(originals, field);
    }

    /// Gives the ghosts of this rank's own particles the values of their originals.
    pub fn copy<T: Copy>(&self, originals: &[u32], field: &mut [T]) {
        let (own, ghosts) = field.split_at_mut(field.len() - originals.len());
        for (ghost, &original) in ghosts[..self.offset.len()].iter_mut().zip(originals) {
            *ghost = own[original as usize];
        }
    }

    /// [`refresh`](Self::refresh) of a field of the particles themselves.
    pub fn share<T: Packed>(
        &self,
        kinds: Kinds,
        particles: &mut Particles<D>,
        field: fn(&mut Particles<D>) -> &mut Vec<T>,
    ) {
        let mut values = std::mem::take(field(particles));
        self.refresh(kinds, particles.originals(), &mut values);
        *field(particles) = values;
    }
}

impl<const D: usize> Peers<D> {
    /// Who holds which solid, and who needs which of them. Every rank finds the same answer from the same cuts.
    fn deal_solids(
        &mut self,
        particles: &Particles<D>,
        ranks: &Ranks,
        domain: Option<&PeriodicBox<D>>,
        reach: f64,
    ) {
        let walls = particles.walls().len();
        self.holds.clear();
        self.solids_out.iter_mut().chain(&mut self.solids_in).for_each(Vec::clear);
        let mut copies = vec![];
        // Solids, and the ranks that need them.
        let mut needed: Vec<(u32, usize)> = vec![];
        let holder = |a: u32| self.slabs.owner(particles.position[a as usize][0]);
        for a in 0..particles.solids() as u32 {
            let r = &particles.position[a as usize];
            self.holds.push(holder(a) == ranks.rank());
            copies.clear();
            copies.push((a, Vector::zeros()));
            if let Some(domain) = domain {
                domain.copies(a, r, reach, &mut copies);
            }
            let tie = (a as usize).checked_sub(walls).map(|dummy| particles.tie[dummy]);
            for (_, offset) in &copies {
                for q in self.slabs.near(r[0] + offset[0], reach) {
                    let others = std::iter::once(a).chain(tie).filter(|a| holder(*a) != q);
                    needed.extend(others.map(|a| (a, q)));
                }
            }
        }
        needed.sort_unstable();
        needed.dedup();
        for (a, q) in needed {
            match holder(a) {
                holder if holder == ranks.rank() => self.solids_out[q].push(a),
                holder if q == ranks.rank() => self.solids_in[holder].push(a),
                _ => {}
            }
        }
    }

    /// Fields of solids and of foreign ghosts, which begin at `first`.
    fn refresh<T: Packed>(&self, kinds: Kinds, ranks: &Ranks, first: usize, field: &mut [T]) {
        let (with_solids, with_liquid) = (kinds != Kinds::Liquid, kinds != Kinds::Solids);
        let parts = self.solids_out.iter().zip(&self.liquid_out).map(|(solids, liquid)| {
            let solids = if with_solids { &solids[..] } else { &[] };
            let liquid = if with_liquid { &liquid[..] } else { &[] };
            let mut part = Vec::with_capacity((solids.len() + liquid.len()) * T::WIDTH);
            let members = solids.iter().copied().chain(liquid.iter().map(|(a, _)| *a));
            members.for_each(|a| field[a as usize].pack(&mut part));
            part
        });
        let solids = self.solids_in.iter().map(|solids| if with_solids { &solids[..] } else { &[] });
        let liquid = self.liquid_in.iter().map(|liquid| if with_liquid { *liquid } else { 0 });
        let counts = solids.clone().zip(liquid.clone());
        let counts = counts.map(|(solids, liquid)| (solids.len() + liquid) * T::WIDTH).collect();
        let came = ranks.exchange_expected(parts.collect(), counts);
        let mut ghost = first;
        for ((part, solids), liquid) in came.iter().zip(solids).zip(liquid) {
            let mut values = part.chunks_exact(T::WIDTH).map(T::unpack);
            for (&a, value) in solids.iter().zip(&mut values) {
                field[a as usize] = value;
            }
            for (place, value) in field[ghost..ghost + liquid].iter_mut().zip(values) {
                *place = value;
            }
            ghost += liquid;
        }
    }
}

fn pack<const D: usize>((position, velocity, pressure, id): &Fluid<D>, message: &mut Vec<f64>) {
    position.pack(message);
    velocity.pack(message);
    message.extend([*pressure, *id as f64]);
}

fn unpack<const D: usize>(words: &[f64]) -> Fluid<D> {
    let velocity = Vector::unpack(&words[D..2 * D]);
    (Vector::unpack(&words[..D]), velocity, words[2 * D], words[2 * D + 1] as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_particle_in_a_corner_has_three_ghosts() {
        let domain = PeriodicBox { min: Vector::<2>::zeros(), period: [Some(1.0), Some(2.0)] };
        let mut particles = Particles::default();
        particles.push_fluid(Vector::<2>::new(1.05, 1.95), Vector::<2>::new(1.0, 2.0));
        particles.push_fluid(Vector::<2>::new(0.5, 1.0), Vector::zeros());
        let mut halo = Halo::new(Some(domain), 0.1);
        for _ in 0..2 {
            halo.renew(&mut particles);
            assert_eq!((particles.owned(), particles.len()), (2, 5));
            let mut found: Vec<_> = particles.position[2..].iter().map(|r| (r.x, r.y)).collect();
            found.sort_by(|a, b| a.partial_cmp(b).unwrap());
            for (r, expected) in found.iter().zip([(0.05, -0.05), (1.05, -0.05), (1.05, 1.95)]) {
                assert!((r.0 - expected.0).abs() < 1e-14 && (r.1 - expected.1).abs() < 1e-14, "{found:?}");
            }
            assert!(particles.velocity[2..].iter().all(|v| *v == Vector::<2>::new(1.0, 2.0)));
        }
        let mut field = vec![3.0, 4.0, 0.0, 0.0, 0.0];
        halo.refresh(Kinds::All, particles.originals(), &mut field);
        assert_eq!(field, [3.0, 4.0, 3.0, 3.0, 3.0]);
    }
}
