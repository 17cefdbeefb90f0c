//! Assembly of the pressure equation into plain rows.
//!
//! Row a of -L, for liquid a, with K_ab = -(2 / rho) V F_ab > 0 and equal volumes and densities:
//!
//! sum_b (K_ab - C_ab) (p_a - p_b) + (2 / rho) G_a p_a = -source_a                                   (1)
//!
//! - C_ab = (1 - s_a) (2 / rho) V F_ab (B_a r_ab) . S_a is the correction of Eq. (3) of Jian et al. (2016), its
//!   gradient expanded into the same neighbours, so that a row keeps its sparsity; s_a is the surface weight.
//! - G_a is the diagonal term of the free surface, see [`surface`].
//! - A dummy's pressure is its wall's plus a known step (see [`boundary`](crate::boundary)): its coefficient goes
//!   to the wall's column, the step to the right-hand side.
//!
//! The row of a wet wall w carries the Neumann condition, in liquid f alone:
//!
//! sum_f K_wf (p_w - p_f + rho (g - a_w) . r_fw) = -source_w                                         (2)
//!
//! Solids add nothing to its divergence, since they are rigid, and must not to its Laplacian: links between walls, and from
//! walls to dummies, would let pressure even out along a face as in one more layer of liquid. On a lattice the pressure before an
//! accelerated flat wall of wavelength 2 pi / k is then too small by the share 1.0 k dx, with (2) by 0.18 k dx; the added mass of a
//! cylinder in a vessel of six radii (exact 1.05) is 0.19, 0.55, 0.72 at 4, 8, 16 spacings a radius, with (2) 0.82, 0.94, 0.99.
//! A wall at the water line needs no term of the surface: its liquid brings it along.
//!
//! Unknowns are liquid and wet wall particles that have a neighbour; everything else is left out, not padded.
//!
//! Beside this matrix, in general nonsymmetric, there are two symmetric ones. The *symmetric part* takes the pair
//! weights of (1) without the correction, averaged over both directions: a graph Laplacian plus G, so positive
//! definite wherever a surface is near. The *sparse* matrix is that graph cut at 1.6 dx, its weights scaled up by
//! the share of sum K r^2 that the cut removed on a lattice, so that both give the same energy to smooth fields.

use super::{Index, Needs, PressureSystem, Rows};
use crate::bodies::Bodies;
use crate::boundary::DummyWalls;
use crate::case::LaplacianKind;
use crate::form::{Point, point};
use crate::halo::{Halo, Kinds};
use crate::kernel::LatticeSums;
use crate::operators::{Moments, Surroundings};
use crate::parallel::Ranks;
use crate::particles::{Particles, Vector};
use crate::terms::surface;
use rayon::prelude::*;
use std::collections::{BTreeMap, HashMap};

/// Radius of the sparse matrix in spacings: between the diagonal neighbour (1.41 in 2D) and the second (2).
pub const NEAR: f64 = 1.6;

/// Marks a particle without an unknown.
pub const NO_ROW: u32 = u32::MAX;

/// What assembly reads.
#[derive(Debug, Clone, Copy)]
pub struct Inputs<'a, const D: usize> {
    /// Particles; their pressures are the first guess.
    pub particles: &'a Particles<D>,
    /// Neighbours and activity.
    pub surroundings: Surroundings<'a, D>,
    /// Moments of each particle with a row of neighbours.
    pub moments: &'a [Moments<D>],
    /// Surface weight s of each particle.
    pub surface: &'a [f64],
    /// Source of each particle in 1/s2, with the sign of div((1/rho) grad p).
    pub source: &'a [f64],
    /// Walls.
    pub walls: &'a DummyWalls<D>,
    /// Lattice sums.
    pub lattice: &'a LatticeSums,
    /// Liquid density in kg/m3.
    pub density: f64,
    /// Particle spacing in m.
    pub spacing: f64,
    /// Laplacian.
    pub laplacian: LaplacianKind,
    /// Bodies whose accelerations are found together with the pressure, if any.
    pub bodies: Option<&'a Bodies<D>>,
}

impl<const D: usize> Inputs<'_, D> {
    /// Does a solid particle belong to a body whose acceleration is unknown?
    fn moves(&self, solid: usize) -> bool {
        self.bodies.is_some_and(|bodies| bodies.movable(solid).is_some())
    }
}

/// Assembles pressure systems; owns the system and every buffer.
#[derive(Debug, Clone, Default)]
pub struct Assembler {
    /// The system of the last [`assemble`](Self::assemble).
    pub system: PressureSystem,
    /// Local row of each particle, or [`NO_ROW`].
    pub row_of: Vec<u32>,
    /// Particle of each local row.
    pub particle_of: Vec<u32>,
    /// Global row of each particle, those of other ranks included, or -1.
    column_of: Vec<Index>,
    /// How rows hang on the motion of bodies.
    links: Vec<Link>,
    blocks: Vec<Block>,
    groups: Groups,
}

/// Rows assembled by one task.
#[derive(Debug, Clone, Default)]
struct Block {
    full: Partial,
    plain: Partial,
    sparse: Partial,
    rhs: Vec<f64>,
    plain_rhs: Vec<f64>,
    links: Vec<Link>,
}

/// A row's share in the motion of a body: an acceleration a of the body at `at` adds -rho a . `moment` to its right-hand side.
#[derive(Debug, Clone)]
pub struct Link {
    row: u32,
    /// A solid particle of the body.
    pub solid: u32,
    /// Where the acceleration counts, in m.
    pub at: Point,
    /// Coefficients times distances, in m3/kg / m.
    pub moment: Point,
}

#[derive(Debug, Clone, Default)]
struct Partial {
    count: Vec<Index>,
    entries: Vec<(Index, f64)>,
    /// Where the open row begins, and where in it the columns of walls.
    open: usize,
    walls: usize,
}

impl Partial {
    fn clear(&mut self, room: usize) {
        self.count.clear();
        self.entries.clear();
        self.entries.reserve_exact(room);
        self.begin();
    }

    fn begin(&mut self) {
        self.open = self.entries.len();
        self.walls = usize::MAX;
    }

    fn push(&mut self, column: Index, value: f64) {
        self.entries.push((column, value));
    }

    /// Adds to an entry that the row may already hold: only wall columns, which dummies share.
    fn add(&mut self, column: Index, value: f64) {
        self.walls = self.walls.min(self.entries.len());
        match self.entries[self.walls..].iter_mut().find(|(c, _)| *c == column) {
            Some((_, v)) => *v += value,
            None => self.entries.push((column, value)),
        }
    }

    /// Columns of walls come before those of liquid, and both are nearly in order already, since neighbours and unknowns are numbered
    /// cell by cell.
    fn end(&mut self) {
        let liquid = self.walls.min(self.entries.len()) - self.open;
        let row = &mut self.entries[self.open..];
        row.rotate_left(liquid);
        for k in 1..row.len() {
            let entry = row[k];
            let mut place = k;
            while place > 0 && row[place - 1].0 > entry.0 {
                row[place] = row[place - 1];
                place -= 1;
            }
            row[place] = entry;
        }
        self.count.push(row.len() as Index);
    }
}

const BLOCK: usize = 512;

impl Assembler {
    /// Fills [`system`](Self::system) from particles.
    pub fn assemble<const D: usize>(&mut self, inputs: &Inputs<'_, D>, halo: &Halo<D>, needs: Needs) {
        self.number(inputs, halo);
        self.blocks.resize_with(self.particle_of.len().div_ceil(BLOCK), Block::default);
        let (column_of, particle_of) = (&self.column_of, &self.particle_of);
        self.blocks.par_iter_mut().enumerate().for_each(|(k, block)| {
            let rows = &particle_of[k * BLOCK..((k + 1) * BLOCK).min(particle_of.len())];
            let neighbors = inputs.surroundings.neighbors;
            block.clear(rows.iter().map(|a| neighbors.row(*a as usize).index.len() + 1).sum(), needs);
            for &a in rows {
                match (a as usize) < inputs.particles.walls().end {
                    true => block.assemble_wall_row(inputs, column_of, a as usize, needs),
                    false => block.assemble_row(inputs, column_of, a as usize, needs),
                }
            }
        });
        join(&mut self.system.full, &self.blocks, |block| &block.full);
        if needs.symmetric {
            let mut plain = Rows::default();
            join(&mut plain, &self.blocks, |block| &block.plain);
            self.system.symmetric = symmetric_mean(&plain, self.system.first_row, halo.ranks());
        }
        if needs.uncorrected {
            join(&mut self.system.uncorrected, &self.blocks, |block| &block.plain);
            self.system.uncorrected_rhs =
                self.blocks.iter().flat_map(|block| &block.plain_rhs).copied().collect();
        }
        if needs.sparse {
            join(&mut self.system.sparse, &self.blocks, |block| &block.sparse);
        }
        self.system.rhs.clear();
        for block in &self.blocks {
            self.system.rhs.extend_from_slice(&block.rhs);
        }
        self.links.clear();
        for (k, block) in self.blocks.iter().enumerate() {
            let numbered = |link: &Link| Link { row: (k * BLOCK) as u32 + link.row, ..link.clone() };
            self.links.extend(block.links.iter().map(numbered));
        }
        self.find_floating(inputs, halo);
    }

    fn number<const D: usize>(&mut self, inputs: &Inputs<'_, D>, halo: &Halo<D>) {
        let Inputs { particles, surroundings, .. } = inputs;
        self.row_of.clear();
        self.row_of.resize(particles.len(), NO_ROW);
        self.particle_of.clear();
        self.system.pressure.clear();
        for a in particles.walls().chain(particles.fluid()) {
            if surroundings.active[a] && surroundings.active(a).next().is_some() {
                self.row_of[a] = self.particle_of.len() as u32;
                self.particle_of.push(a as u32);
                self.system.pressure.push(particles.pressure[a]);
            }
        }
        let first = halo.ranks().first_row(self.particle_of.len());
        self.system.first_row = first;
        let column = |&row: &u32| if row == NO_ROW { -1 } else { first as Index + row as Index };
        self.column_of.clear();
        self.column_of.extend(self.row_of.iter().map(column));
        halo.refresh(Kinds::All, particles.originals(), &mut self.column_of);
    }

    /// Groups of unknowns that are linked with each other but with no surface. Each group goes by its smallest global row, groups
    /// at a surface by -1.
    fn find_floating<const D: usize>(&mut self, inputs: &Inputs<'_, D>, halo: &Halo<D>) {
        let Self { system, groups, column_of, particle_of, .. } = self;
        let (ranks, first, particles) = (halo.ranks(), system.first_row, inputs.particles);
        let is_anchored = |row: usize| {
            let a = particle_of[row] as usize;
            a >= particles.solids() && inputs.surface[a] > 0.0
        };
        groups.unite(&system.full, first);
        let mut marks = groups.marks(first, is_anchored);
        if ranks.are_several() {
            groups.pass_on(&mut marks, system, column_of, particle_of, particles, halo);
        }
        let mut members: BTreeMap<Index, Vec<u32>> = BTreeMap::new();
        for k in 0..particle_of.len() as u32 {
            let mark = marks[groups.root(k) as usize];
            if mark >= 0 {
                members.entry(mark).or_default().push(k);
            }
        }
        // All ranks list all groups, also those without a member here.
        let names: Vec<f64> = members.keys().map(|&mark| mark as f64).collect();
        for name in ranks.all(&names).concat() {
            members.entry(name as Index).or_default();
        }
        system.floating = members.into_values().collect();
    }

    /// Fills `rhs` with what each link of a row to the motion of bodies adds to its right-hand side, in 1/s2.
    pub fn right_hand_side(&self, of: impl Fn(&Link) -> f64, rhs: &mut Vec<f64>) {
        rhs.clear();
        rhs.resize(self.particle_of.len(), 0.0);
        for link in &self.links {
            rhs[link.row as usize] += of(link);
        }
    }

    /// Writes the solved pressures back to the particles; particles without an unknown get zero.
    pub fn scatter<const D: usize>(&self, particles: &mut Particles<D>) {
        let pressure = &self.system.pressure;
        particles.pressure.par_iter_mut().zip(&self.row_of).with_min_len(1024).for_each(|(p, &row)| {
            *p = if row == NO_ROW { 0.0 } else { pressure[row as usize] };
        });
    }
}

impl Block {
    /// Empty, with room for `entries` in each matrix: to grow by doubling would leave half of the memory idle.
    fn clear(&mut self, entries: usize, needs: Needs) {
        self.full.clear(entries);
        self.plain.clear(if needs.symmetric || needs.uncorrected { entries } else { 0 });
        self.sparse.clear(if needs.sparse { entries / 2 } else { 0 });
        self.rhs.clear();
        self.plain_rhs.clear();
        self.links.clear();
    }

    /// Eq. (2). In the sparse matrix a wall without near liquid, as in the corner of a tank, stands alone.
    fn assemble_wall_row<const D: usize>(
        &mut self,
        inputs: &Inputs<'_, D>,
        column_of: &[Index],
        w: usize,
        needs: Needs,
    ) {
        let particles = inputs.particles;
        let near = (NEAR * inputs.spacing).powi(2);
        let near_scale = 1.0 / inputs.lattice.near_share;
        let wants_plain = needs.symmetric || needs.uncorrected;
        let (mut diagonal, mut near_diagonal, mut moment) = (0.0, 0.0, Vector::zeros());
        self.full.begin();
        self.plain.begin();
        self.sparse.begin();
        for (f, r_wf, vf) in inputs.surroundings.active(w) {
            let f = particles.original(f);
            if f < particles.solids() {
                continue;
            }
            let coefficient = -2.0 / inputs.density * vf;
            diagonal += coefficient;
            moment += coefficient * r_wf;
            self.full.push(column_of[f], -coefficient);
            if wants_plain {
                self.plain.push(column_of[f], -coefficient);
            }
            if needs.sparse && r_wf.norm_squared() < near {
                near_diagonal += near_scale * coefficient;
                self.sparse.push(column_of[f], -near_scale * coefficient);
            }
        }
        let own = column_of[w];
        self.full.push(own, diagonal);
        self.full.end();
        if wants_plain {
            self.plain.push(own, diagonal);
            self.plain.end();
        }
        if needs.sparse {
            self.sparse.push(own, if near_diagonal > 0.0 { near_diagonal } else { diagonal });
            self.sparse.end();
        }
        if inputs.moves(w) {
            let at = point(&particles.position[w]);
            self.links.push(Link { row: self.rhs.len() as u32, solid: w as u32, at, moment: point(&moment) });
        }
        let rhs = inputs.walls.pressure_gradient(w).dot(&moment) - inputs.source[w];
        self.rhs.push(rhs);
        if needs.uncorrected {
            self.plain_rhs.push(rhs);
        }
    }

    /// Eq. (1).
    fn assemble_row<const D: usize>(
        &mut self,
        inputs: &Inputs<'_, D>,
        column_of: &[Index],
        a: usize,
        needs: Needs,
    ) {
        let Inputs { particles, surroundings, walls, lattice, .. } = *inputs;
        let factor = 2.0 / inputs.density;
        let moments = &inputs.moments[a];
        let weight = inputs.surface[a];
        let corrected = inputs.laplacian == LaplacianKind::Schwaiger && weight < 1.0;
        // (B r) . S = r . (B^T S)
        let correction = if corrected { moments.correction() } else { None }
            .map(|b| (1.0 - weight) * factor * b.tr_mul(&moments.defect));
        let anchor = factor * surface::diagonal(moments, weight, lattice, inputs.spacing);
        let near = (NEAR * inputs.spacing).powi(2);
        let near_scale = 1.0 / lattice.near_share;
        let (walls_end, own) = (particles.walls().end, column_of[a]);

        let (mut diagonal, mut near_diagonal, mut rhs) = (anchor, anchor, -inputs.source[a]);
        let (mut plain_diagonal, mut plain_rhs) = (anchor, rhs);
        let wants_plain = needs.symmetric || needs.uncorrected;
        self.full.begin();
        self.plain.begin();
        self.sparse.begin();
        for (b, r_ab, vf) in surroundings.active(a) {
            let plain = -factor * vf;
            let coefficient = match &correction {
                Some(c) => plain - vf * r_ab.dot(c),
                None => plain,
            };
            let b = particles.original(b);
            let behind = b >= walls_end && b < particles.solids();
            let target = if behind { particles.tie[b - walls_end] as usize } else { b };
            if behind {
                let step = walls.pressure_step(particles, b);
                rhs += coefficient * step;
                plain_rhs += plain * step;
                if inputs.moves(b) {
                    let (r_d, r_w) = (particles.position[b], particles.position[target]);
                    self.links.push(Link {
                        row: self.rhs.len() as u32,
                        solid: b as u32,
                        at: point(&(0.5 * (r_d + r_w))),
                        moment: point(&(coefficient * (r_d - r_w))),
                    });
                }
            }
            let column = column_of[target];
            diagonal += coefficient;
            let is_wall = target < walls_end;
            let put = |rows: &mut Partial, value: f64| match is_wall {
                true => rows.add(column, value),
                false => rows.push(column, value),
            };
            put(&mut self.full, -coefficient);
            if wants_plain {
                put(&mut self.plain, -plain);
                plain_diagonal += plain;
            }
            if needs.sparse && r_ab.norm_squared() < near {
                put(&mut self.sparse, -near_scale * plain);
                near_diagonal += near_scale * plain;
            }
        }
        self.full.push(own, diagonal);
        self.full.end();
        if wants_plain {
            self.plain.push(own, plain_diagonal);
            self.plain.end();
        }
        if needs.sparse {
            self.sparse.push(own, near_diagonal);
            self.sparse.end();
        }
        self.rhs.push(rhs);
        if needs.uncorrected {
            self.plain_rhs.push(plain_rhs);
        }
    }
}

/// Strings the rows of all blocks together.
fn join(rows: &mut Rows, blocks: &[Block], part: impl Fn(&Block) -> &Partial + Copy + Sync) {
    let lengths = blocks.iter().map(|block| (part(block).count.len(), part(block).entries.len()));
    let (count, entries) = lengths.fold((0, 0), |(n, m), (rows, entries)| (n + rows, m + entries));
    rows.start.resize(count + 1, 0);
    rows.start[0] = 0;
    rows.column.resize(entries, 0);
    rows.value.resize(entries, 0.0);
    let places = (&mut rows.start[1..], &mut rows.column[..], &mut rows.value[..]);
    copy(blocks, part, 0, places);
}

/// Copies the rows of `blocks`, whose first entry is number `first`, to their places: ends of rows, columns, values.
fn copy(
    blocks: &[Block],
    part: impl Fn(&Block) -> &Partial + Copy + Sync,
    first: Index,
    (ends, column, value): (&mut [Index], &mut [Index], &mut [f64]),
) {
    let (left, right) = blocks.split_at(blocks.len() / 2);
    if !left.is_empty() {
        let rows = left.iter().map(|block| part(block).count.len()).sum();
        let entries = left.iter().map(|block| part(block).entries.len()).sum();
        let (left_ends, ends) = ends.split_at_mut(rows);
        let (left_column, column) = column.split_at_mut(entries);
        let (left_value, value) = value.split_at_mut(entries);
        rayon::join(
            || copy(left, part, first, (left_ends, left_column, left_value)),
            || copy(right, part, first + entries as Index, (ends, column, value)),
        );
    } else if let [block] = right {
        let Partial { count, entries, .. } = part(block);
        let mut end = first;
        for (place, n) in ends.iter_mut().zip(count) {
            end += n;
            *place = end;
        }
        column.iter_mut().zip(entries).for_each(|(place, (c, _))| *place = *c);
        value.iter_mut().zip(entries).for_each(|(place, (_, v))| *place = *v);
    }
}

/// The transposed matrix, of which each rank has the rows from `first` on.
fn transposed(rows: &Rows, first: usize, ranks: &Ranks) -> Rows {
    if !ranks.are_several() {
        return rows.transpose();
    }
    let ends: Vec<usize> = ranks
        .all(&[rows.len() as f64])
        .into_iter()
        .flatten()
        .scan(0, |end, count| {
            *end += count as usize;
            Some(*end)
        })
        .collect();
    let mut parts = vec![vec![]; ranks.count()];
    for k in 0..rows.len() {
        for (column, value) in rows.row(k) {
            let owner = ends.partition_point(|end| *end <= column);
            parts[owner].extend([column as f64, (first + k) as f64, value]);
        }
    }
    let mut entries: Vec<(usize, usize, f64)> = ranks
        .exchange(parts)
        .concat()
        .chunks_exact(3)
        .map(|entry| (entry[0] as usize - first, entry[1] as usize, entry[2]))
        .collect();
    entries.sort_unstable_by_key(|&(row, column, _)| (row, column));
    let start = (0..=rows.len()).map(|k| entries.partition_point(|(row, ..)| *row < k) as Index).collect();
    let column = entries.iter().map(|(_, column, _)| *column as Index).collect();
    Rows { start, column, value: entries.iter().map(|(.., value)| *value).collect() }
}

/// (U + U^T) / 2 off the diagonal, with U's row sums kept: symmetric, and as diagonally dominant as U.
pub(crate) fn symmetric_mean(plain: &Rows, first: usize, ranks: &Ranks) -> Rows {
    let transposed = transposed(plain, first, ranks);
    let mut mean = Rows { start: vec![0], ..Rows::default() };
    for k in 0..plain.len() {
        let excess: f64 = plain.row(k).map(|(_, v)| v).sum();
        let (mut left, mut right) = (plain.row(k).peekable(), transposed.row(k).peekable());
        let (mut diagonal, mut at) = (excess, mean.column.len());
        loop {
            let column = match (left.peek(), right.peek()) {
                (None, None) => break,
                (l, r) => l.map_or(usize::MAX, |e| e.0).min(r.map_or(usize::MAX, |e| e.0)),
            };
            let here = |entry: &(usize, f64)| entry.0 == column;
            let sides = [left.next_if(here), right.next_if(here)];
            let value = 0.5 * sides.iter().flatten().map(|(_, v)| v).sum::<f64>();
            if column == first + k {
                at = mean.column.len();
            } else {
                diagonal -= value;
            }
            mean.column.push(column as Index);
            mean.value.push(value);
        }
        mean.value[at] = diagonal;
        mean.start.push(mean.column.len() as Index);
    }
    mean
}

/// Connected components by union-find.
#[derive(Debug, Clone, Default)]
struct Groups {
    parent: Vec<u32>,
}

impl Groups {
    fn root(&mut self, mut k: u32) -> u32 {
        while self.parent[k as usize] != k {
            let up = self.parent[self.parent[k as usize] as usize];
            self.parent[k as usize] = up;
            k = up;
        }
        k
    }

    /// Groups of the rows of this rank, which begin at the global row `first`.
    fn unite(&mut self, rows: &Rows, first: usize) {
        self.parent.clear();
        self.parent.extend(0..rows.len() as u32);
        let local = |column: Index| (column as usize).wrapping_sub(first);
        for k in 0..rows.len() {
            // Columns ascend, and links are mutual: those before the diagonal tell all.
            let mut a = k as u32;
            let columns = rows.columns(k).iter().map(|&c| local(c));
            for c in columns.skip_while(|&c| c >= rows.len()).take_while(|&c| c < k) {
                if self.parent[c] != a {
                    let b = self.root(c as u32);
                    self.parent[a.max(b) as usize] = a.min(b);
                    a = a.min(b);
                }
            }
        }
    }

    /// Passes the marks of groups on between ranks until the smallest has reached every member.
    fn pass_on<const D: usize>(
        &mut self,
        marks: &mut [Index],
        system: &PressureSystem,
        column_of: &[Index],
        particle_of: &[u32],
        particles: &Particles<D>,
        halo: &Halo<D>,
    ) {
        let (ranks, first) = (halo.ranks(), system.first_row);
        let foreign: HashMap<Index, usize> = (0..particles.len())
            .filter(|&a| column_of[a] >= 0 && (particles.is_foreign(a) || !halo.holds(a)))
            .map(|a| (column_of[a], a))
            .collect();
        let mine = first as Index..(first + particle_of.len()) as Index;
        let mut links = vec![];
        for k in 0..particle_of.len() {
            // Columns ascend: those of other ranks lie before and behind.
            let row = system.full.columns(k);
            let [from, to] = [mine.start, mine.end].map(|end| row.partition_point(|c| *c < end));
            let others = row[..from].iter().chain(&row[to..]);
            links.extend(others.filter_map(|column| Some((k, *foreign.get(column)?))));
        }
        let mut mark_of = vec![Index::MAX; particles.len()];
        let mut changed = true;
        while ranks.any(changed) {
            for (k, &a) in particle_of.iter().enumerate() {
                mark_of[a as usize] = marks[self.root(k as u32) as usize];
            }
            halo.refresh(Kinds::All, particles.originals(), &mut mark_of);
            changed = false;
            for &(k, a) in &links {
                let mark = &mut marks[self.root(k as u32) as usize];
                changed |= mark_of[a] < *mark;
                *mark = mark_of[a].min(*mark);
            }
        }
    }

    /// For the root of each group its global row, or -1 if a member is anchored.
    fn marks(&mut self, first: usize, is_anchored: impl Fn(usize) -> bool) -> Vec<Index> {
        let count = self.parent.len();
        let mut marks: Vec<Index> = (first as Index..).take(count).collect();
        for k in (0..count).filter(|&k| is_anchored(k)) {
            marks[self.root(k as u32) as usize] = -1;
        }
        marks
    }
}
