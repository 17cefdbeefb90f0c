//! Neighbour search: a cell list with particles sorted by cell, and from it rows of neighbours (CSR) with the
//! kernel factors of each pair: F, and W where it is asked for.
//!
//! A pair (a, b) is listed in row a if 0 < |r_a - r_b| < support, and in row b unless pairs of liquid are asked for once
//! ([`crate::pair_sums`]; ghosts then stand behind the other liquid). Each row holds its liquid neighbours, then its solid ones, both in cell order; the
//! result does not depend on the number of threads.

use crate::kernel::{CubicSpline, Kernel, KernelKind, Quintic, Smoothing, WendlandC2};
use crate::particles::{Particles, Vector};
use crate::simd::{LANES, Lanes, dot, keep_near};
use rayon::prelude::*;
use std::ops::Range;

/// Which of the particles are solids, and which ghosts.
#[derive(Debug, Clone)]
pub struct Layout {
    /// Solids; the fluid follows them.
    pub solids: Range<usize>,
    /// Ghosts of solids; those of the fluid follow them. Ghosts get no rows.
    pub solid_ghosts: Range<usize>,
    /// Whether the rows of solids list solids as well.
    pub solids_see_solids: bool,
    /// Whether pairs of liquid are listed once, in the row of the one that is first in cell order. Ghosts are listed in all rows.
    pub liquid_once: bool,
    /// Whether rows of liquid have W.
    pub liquid_has_kernel: bool,
}

impl Layout {
    /// `solids` solids, then fluid up to `count` particles, and no ghosts.
    pub fn without_ghosts(solids: usize, count: usize) -> Self {
        Self { solids: 0..solids, solid_ghosts: count..count, ..Self::default() }
    }

    /// That of `particles`.
    pub fn of<const D: usize>(particles: &Particles<D>) -> Self {
        let (solids, solid_ghosts) = (0..particles.solids(), particles.solid_ghosts());
        Self { solids, solid_ghosts, ..Self::default() }
    }

    /// The same, with rows of solids that list their liquid neighbours alone.
    pub fn with_solids_blind_to_solids(self) -> Self {
        Self { solids_see_solids: false, ..self }
    }

    /// The same, with pairs of liquid listed once and without W. Pairs are more than caches hold: to find, write and read half of them
    /// takes little more than half the time.
    pub fn with_liquid_once(self) -> Self {
        Self { liquid_once: true, liquid_has_kernel: false, ..self }
    }

    /// The same, with W in the rows of liquid if `wanted`.
    pub fn with_liquid_kernel(self, wanted: bool) -> Self {
        Self { liquid_has_kernel: wanted, ..self }
    }
}

impl Default for Layout {
    /// No particles.
    fn default() -> Self {
        Self {
            solids: 0..0,
            solid_ghosts: 0..0,
            solids_see_solids: true,
            liquid_once: false,
            liquid_has_kernel: true,
        }
    }
}

/// Particles sorted into cubic cells.
#[derive(Debug, Clone, Default)]
pub struct CellList<const D: usize> {
    grid: Grid<D>,
    start: Vec<u32>,
    /// Particle numbers, cell by cell.
    sorted: Vec<u32>,
    /// Their positions in the same order, an axis each.
    position: Axes<D>,
    /// Of each member, in the order of their numbers, its place in `sorted`; while sorting, its cell.
    place: Vec<u32>,
}

/// Positions, an array an axis: distances to a run of them are computed several at a time.
#[derive(Debug, Clone)]
struct Axes<const D: usize>([Vec<f64>; D]);

impl<const D: usize> Default for Axes<D> {
    fn default() -> Self {
        Self(std::array::from_fn(|_| vec![]))
    }
}

/// Lower and upper corner of a box.
type Extent<const D: usize> = (Vector<D>, Vector<D>);

/// The box that holds all `positions`; its upper corner is below the lower one where there are none.
fn extent_of<'a, const D: usize>(positions: impl Iterator<Item = &'a Vector<D>>) -> Extent<D> {
    let nothing = (Vector::repeat(f64::INFINITY), Vector::repeat(f64::NEG_INFINITY));
    positions.fold(nothing, |(min, max), r| (min.inf(r), max.sup(r)))
}

/// Where cells lie: shared by all cell lists of one search.
#[derive(Debug, Clone, Copy)]
struct Grid<const D: usize> {
    min: Vector<D>,
    inverse_width: [f64; D],
    extent: [usize; D],
    /// How many cells on each side of a particle's own hold its neighbours.
    reach: [usize; D],
}

/// Cells to a support along the last axis, where they cost nothing: those that a particle looks at are one run in memory.
/// A run is then 2.25 supports long; with 2 to a support it is 2.5, with 8 it is 2.125.
const SLICES: usize = 4;

impl<const D: usize> Default for Grid<D> {
    fn default() -> Self {
        Self { min: Vector::zeros(), inverse_width: [0.0; D], extent: [1; D], reach: [1; D] }
    }
}

impl<const D: usize> Grid<D> {
    /// Covers the box from `min` to `max` of `count` particles, with cells of a `support` across and a slice of it along the last axis.
    /// Narrower ones would leave fewer candidates, but runs so short that starting each costs more than it saves. Cells are doubled
    /// until there are at most four a particle: a few particles far away must not cost memory. Whatever the box, cells begin at
    /// multiples of their width, so that, but for doubled ones, all searches find particles in one order.
    fn covering((mut min, mut max): Extent<D>, count: usize, support: f64) -> Self {
        if (0..D).any(|d| max[d] < min[d]) {
            (min, max) = (Vector::zeros(), Vector::zeros());
        }
        let low = |d: usize, width: f64| width * (min[d] / width).floor();
        let cells = |d: usize, width: f64| ((max[d] - low(d, width)) / width).floor() + 1.0;
        let mut reach = [1; D];
        reach[D - 1] = SLICES;
        let mut width = reach.map(|reach| support / reach as f64);
        while (0..D).map(|d| cells(d, width[d])).product::<f64>() > 4.0 * count as f64 + 64.0 {
            width = width.map(|width| 2.0 * width);
            reach = reach.map(|reach| reach.div_ceil(2));
        }
        Self {
            min: Vector::from_fn(|d, _| low(d, width[d])),
            inverse_width: width.map(f64::recip),
            extent: std::array::from_fn(|d| (cells(d, width[d]) as usize).max(1)),
            reach,
        }
    }

    fn coordinates(&self, r: &Vector<D>) -> [usize; D] {
        std::array::from_fn(|d| {
            (((r[d] - self.min[d]) * self.inverse_width[d]) as usize).min(self.extent[d] - 1)
        })
    }

    fn cell(&self, r: &Vector<D>) -> u32 {
        self.coordinates(r).iter().zip(&self.extent).fold(0, |n, (c, extent)| n * extent + c) as u32
    }
}

impl<const D: usize> CellList<D> {
    /// Sorts the particles with the numbers `members` by cell (counting sort).
    fn sort(&mut self, grid: &Grid<D>, members: impl Iterator<Item = usize> + Clone, position: &[Vector<D>]) {
        self.grid = *grid;
        let cells = grid.extent.iter().product::<usize>();
        self.place.clear();
        self.place.extend(members.clone().map(|a| grid.cell(&position[a])));
        self.start.clear();
        self.start.resize(cells + 1, 0);
        for &c in &self.place {
            self.start[c as usize + 1] += 1;
        }
        for c in 0..cells {
            self.start[c + 1] += self.start[c];
        }
        self.sorted.clear();
        self.sorted.resize(self.place.len() + LANES, 0);
        for (a, place) in members.zip(&mut self.place) {
            // The start of a cell walks through it and ends at the next cell's: shifted back below.
            let start = &mut self.start[*place as usize];
            self.sorted[*start as usize] = a as u32;
            *place = *start;
            *start += 1;
        }
        self.start.copy_within(0..cells, 1);
        self.start[0] = 0;
        for (d, axis) in self.position.0.iter_mut().enumerate() {
            axis.clear();
            axis.extend(self.sorted[..self.place.len()].iter().map(|&a| position[a as usize][d]));
            axis.resize(self.sorted.len(), 0.0);
        }
    }

    /// The runs of places in `sorted` that hold the particles in the cells around `r`. Cells adjacent along the last axis are
    /// adjacent in memory, so a run spans all of them.
    fn around(&self, r: &Vector<D>, runs: &mut Vec<Range<usize>>) {
        runs.clear();
        let Grid { extent, reach, .. } = self.grid;
        let at = self.grid.coordinates(r);
        let low: [usize; D] = std::array::from_fn(|d| at[d].saturating_sub(reach[d]));
        let high: [usize; D] = std::array::from_fn(|d| (at[d] + reach[d]).min(extent[d] - 1));
        let last = D - 1;
        let mut cell = low;
        loop {
            let row = cell[..last].iter().zip(&extent).fold(0, |n, (c, extent)| n * extent + c);
            let base = row * extent[last];
            let run = self.start[base + low[last]] as usize..self.start[base + high[last] + 1] as usize;
            if !run.is_empty() {
                runs.push(run);
            }
            // Next row of cells: an odometer over all axes but the last.
            let Some(d) = (0..last).rev().find(|&d| cell[d] < high[d]) else { return };
            cell[d] += 1;
            cell[d + 1..last].copy_from_slice(&low[d + 1..last]);
        }
    }
}

/// Where the particles around one cell are, found once for all that lie in it.
#[derive(Debug, Clone, Default)]
struct Surrounding {
    cell: Option<u32>,
    runs: Vec<Range<usize>>,
}

impl Surrounding {
    /// Looks around `cell`, in which `r` lies.
    #[inline]
    fn find<const D: usize>(&mut self, cells: &CellList<D>, cell: u32, r: &Vector<D>) {
        if self.cell != Some(cell) {
            self.cell = Some(cell);
            cells.around(r, &mut self.runs);
        }
    }
}

/// Rows of neighbours of all particles, with their kernel factors.
#[derive(Debug, Clone, Default)]
pub struct Neighbors<const D: usize> {
    /// The rows, [`CHUNK`] of them each.
    chunks: Vec<Chunk>,
    solid_cells: CellList<D>,
    fluid_cells: CellList<D>,
    /// Ghosts of fluid, where pairs of liquid are listed once.
    ghost_cells: CellList<D>,
    /// Solids that are looked at.
    near: Vec<u32>,
    groups: Vec<Group>,
}

/// Neighbouring rows of fluid, and the fluid but for ghosts that they and their pairs of liquid span.
#[derive(Debug, Clone)]
pub struct Group {
    /// Their particles.
    pub rows: Range<usize>,
    /// Those particles and all that they are paired with.
    pub span: Range<usize>,
}

/// Most groups of rows. What more would span would overlap more.
const GROUPS: usize = 16;
/// Least rows of a group: of fewer the span is mostly others', and a task not worth its start.
const LEAST: usize = 1024;

/// One row: parallel slices over the neighbours b of a particle a.
#[derive(Debug, Clone, Copy)]
pub struct Row<'a> {
    /// Particle number of b.
    pub index: &'a [u32],
    /// W_ab in 1/m^D; nothing where they are not kept.
    pub kernel: &'a [f64],
    /// F_ab = (dW/dr)/r in 1/m^(D+2): grad_a W_ab = F_ab (r_a - r_b).
    pub gradient: &'a [f64],
    /// How many of them are liquid.
    pub liquid: usize,
}

/// Rows found by one task, one behind the other. Pairs are kept where they were found: rows of 3D scenes are too large to
/// be copied together every step.
#[derive(Debug, Clone, Default)]
struct Chunk {
    /// Where each row starts, and where the last one ends.
    start: Vec<usize>,
    /// Liquid neighbours in each row.
    liquid: Vec<u32>,
    pairs: Pairs,
    /// Whether kernel values are kept.
    keeps_kernel: bool,
    /// The fluid that has rows here, and the fluid in them but for ghosts.
    span: Range<usize>,
    near_liquid: Surrounding,
    near_ghosts: Surrounding,
    near_solids: Surrounding,
}

/// Buffers that only grow: what lies behind the last row is left over from other steps.
#[derive(Debug, Clone, Default)]
struct Pairs {
    index: Vec<u32>,
    kernel: Vec<f64>,
    gradient: Vec<f64>,
}

impl Pairs {
    /// Room for a row of `count` pairs from `end` on, of kernel values too if they are kept.
    fn reserve(&mut self, end: usize, count: usize, keeps_kernel: bool) {
        if self.index.len() < end + count {
            // By a quarter: of large scenes pairs are most of the memory, and doubling would leave half of it idle.
            let room = (end + end / 4).max(end + count);
            grow(&mut self.index, room);
            grow(&mut self.gradient, room);
        }
        if keeps_kernel && self.kernel.len() < self.index.len() {
            grow(&mut self.kernel, self.index.len());
        }
    }

    /// Appends the particles of `cells` around `a`, from place `after` on, that are nearer than a support, with their kernel
    /// factors, to the row that ends at `end`; returns the new end. `a` lies in `cell`.
    #[inline]
    fn find<const D: usize, K: Kernel>(
        &mut self,
        end: usize,
        (a, r_a, cell): (usize, &Vector<D>, u32),
        (cells, surrounding, after): (&CellList<D>, &mut Surrounding, usize),
        search: &Search<'_, D, K>,
        keeps_kernel: bool,
    ) -> usize {
        surrounding.find(cells, cell, r_a);
        let runs = surrounding.runs.iter().map(|run| run.start.max(after)..run.end);
        let next = self.gather(end, (a, r_a), (cells, runs), (search.limit, keeps_kernel));
        self.weigh(end..next, search.smoothing, keeps_kernel);
        next
    }

    /// Writes the particles of `cells` in `runs` that are nearer to `a` than the root of `limit` from `end` on, and the squares of
    /// their distances in place of a kernel factor; returns the new end.
    #[inline]
    fn gather<const D: usize>(
        &mut self,
        end: usize,
        (a, r_a): (usize, &Vector<D>),
        (cells, runs): (&CellList<D>, impl Iterator<Item = Range<usize>> + Clone),
        (limit, keeps_kernel): (f64, bool),
    ) -> usize {
        let r_a: [Lanes; D] = std::array::from_fn(|d| Lanes::splat(r_a[d]));
        let whole = |run: &Range<usize>| run.start..run.start + run.len().next_multiple_of(LANES);
        let room = runs.clone().map(|run| whole(&run).len()).sum();
        self.reserve(end, room, keeps_kernel);
        let squares = if keeps_kernel { &mut self.kernel } else { &mut self.gradient };
        let (index, squares) = (&mut self.index[end..end + room], &mut squares[end..end + room]);
        let mut kept = 0;
        for run in runs.filter(|run| !run.is_empty()) {
            let numbers = cells.sorted[whole(&run)].as_chunks::<LANES>().0;
            let axes = cells.position.0.each_ref().map(|axis| axis[whole(&run)].as_chunks::<LANES>().0);
            for (k, number) in numbers.iter().enumerate() {
                let away: [Lanes; D] = std::array::from_fn(|d| r_a[d] - Lanes::new(axes[d][k]));
                let block = (number, dot(&away, &away), run.len() - k * LANES);
                let room = (index[kept..].first_chunk_mut(), squares[kept..].first_chunk_mut());
                let (Some(index), Some(squares)) = room else { unreachable!("there is room for all runs") };
                kept += keep_near(block, (limit, a as u32), index, squares);
            }
        }
        end + kept
    }

    /// Kernel factors in place of the squares of distances.
    #[inline]
    fn weigh<const D: usize, K: Kernel>(
        &mut self,
        pairs: Range<usize>,
        smoothing: &Smoothing<D, K>,
        keeps_kernel: bool,
    ) {
        if keeps_kernel {
            for (w, f) in self.kernel[pairs.clone()].iter_mut().zip(&mut self.gradient[pairs]) {
                (*w, *f) = smoothing.pair(w.sqrt());
            }
        } else {
            self.gradient[pairs].iter_mut().for_each(|f| *f = smoothing.pair(f.sqrt()).1);
        }
    }
}

/// What all rows of a search share.
struct Search<'a, const D: usize, K: Kernel> {
    smoothing: &'a Smoothing<D, K>,
    /// Square of the support in m2.
    limit: f64,
}

/// To `length` and no more.
fn grow<T: Copy + Default>(buffer: &mut Vec<T>, length: usize) {
    buffer.reserve_exact(length - buffer.len());
    buffer.resize(length, T::default());
}

const CHUNK: usize = 512;

impl<const D: usize> Neighbors<D> {
    /// [`update`](Self::update) with the kernel of a kind and smoothing length `h` in m: the choice is made once a search.
    pub fn search(
        &mut self,
        kernel: KernelKind,
        h: f64,
        position: &[Vector<D>],
        layout: &Layout,
        threshold: impl Fn(usize) -> f64 + Sync,
    ) {
        let support = kernel.support() * h;
        match kernel {
            KernelKind::WendlandC2 => {
                self.update(position, layout, &Smoothing::<D, WendlandC2>::new(h), support, threshold);
            }
            KernelKind::CubicSpline => {
                self.update(position, layout, &Smoothing::<D, CubicSpline>::new(h), support, threshold);
            }
            KernelKind::Quintic => {
                self.update(position, layout, &Smoothing::<D, Quintic>::new(h), support, threshold);
            }
        }
    }

    /// Rows for the particles `a` whose kernel sum over fluid neighbours, sum_b W_ab in 1/m^D, is at least
    /// `threshold(a)`, positive only where W is kept; the others get empty rows. An infinite threshold skips the particle altogether.
    /// Solids have a cell list of their own, so that walls far from the liquid cost next to nothing.
    pub fn update<K: Kernel>(
        &mut self,
        position: &[Vector<D>],
        layout: &Layout,
        smoothing: &Smoothing<D, K>,
        support: f64,
        threshold: impl Fn(usize) -> f64 + Sync,
    ) {
        let Layout { solids, solid_ghosts, solids_see_solids, liquid_once, liquid_has_kernel } =
            layout.clone();
        let (count, first_fluid) = (solid_ghosts.start, solids.end);
        let (fluid, ghosts) = (first_fluid..count, solid_ghosts.end..position.len());
        // Where solids see liquid alone, those beyond a support of it need not be looked at.
        let (min, max) = match solids_see_solids {
            true => extent_of(position.iter()),
            false => {
                let (min, max) = extent_of(fluid.clone().chain(ghosts.clone()).map(|a| &position[a]));
                (min.add_scalar(-support), max.add_scalar(support))
            }
        };
        let is_inside = |r: &Vector<D>| (0..D).all(|d| min[d] <= r[d] && r[d] <= max[d]);
        let near = solids.chain(solid_ghosts).filter(|&a| solids_see_solids || is_inside(&position[a]));
        self.near.clear();
        self.near.extend(near.map(|a| a as u32));
        let grid = Grid::covering((min, max), position.len(), support);
        self.solid_cells.sort(&grid, self.near.iter().map(|a| *a as usize), position);
        let (with_fluid, apart) = if liquid_once { (0..0, ghosts) } else { (ghosts, 0..0) };
        self.fluid_cells.sort(&grid, fluid.chain(with_fluid), position);
        self.ghost_cells.sort(&grid, apart, position);
        self.chunks.resize_with(count.div_ceil(CHUNK), Chunk::default);
        let Self { chunks, solid_cells, fluid_cells, ghost_cells, .. } = self;
        let search = Search { smoothing, limit: support * support };
        chunks.par_iter_mut().enumerate().for_each(|(c, chunk)| {
            let Chunk { start, liquid, pairs, keeps_kernel, span, near_liquid, near_ghosts, near_solids } =
                chunk;
            start.clear();
            start.push(0);
            liquid.clear();
            [&mut *near_liquid, near_ghosts, near_solids].into_iter().for_each(|near| near.cell = None);
            let mut end = 0;
            let rows = c * CHUNK..((c + 1) * CHUNK).min(count);
            let keeps = liquid_has_kernel || rows.start < first_fluid;
            (*keeps_kernel, *span) = (keeps, rows.start.max(first_fluid)..rows.end.max(first_fluid));
            for (a, r_a) in rows.clone().zip(&position[rows]) {
                let (least, before) = (threshold(a), end);
                let mut own_liquid = 0;
                if least < f64::INFINITY && is_inside(r_a) {
                    let (is_liquid, at) = (a >= first_fluid, (a, r_a, grid.cell(r_a)));
                    let after = match liquid_once && is_liquid {
                        true => fluid_cells.place[a - first_fluid] as usize + 1,
                        false => 0,
                    };
                    end = pairs.find(end, at, (fluid_cells, near_liquid, after), &search, keeps);
                    if liquid_once && is_liquid {
                        let own = pairs.index[before..end].iter();
                        let (first, last) =
                            own.fold((u32::MAX, 0), |(first, last), &b| (first.min(b), last.max(b)));
                        *span = span.start.min(first as usize)..span.end.max(last as usize + 1);
                    }
                    end = pairs.find(end, at, (ghost_cells, near_ghosts, 0), &search, keeps);
                    own_liquid = end - before;
                    if least > 0.0 && pairs.kernel[before..end].iter().sum::<f64>() < least {
                        (end, own_liquid) = (before, 0);
                    } else if solids_see_solids || is_liquid {
                        end = pairs.find(end, at, (solid_cells, near_solids, 0), &search, keeps);
                    }
                }
                start.push(end);
                liquid.push(own_liquid as u32);
            }
        });
        match liquid_once {
            true => self.deal(&(first_fluid..count)),
            false => self.groups.clear(),
        }
    }

    /// Deals the rows of `fluid`, whose pairs are listed once, out in groups.
    fn deal(&mut self, fluid: &Range<usize>) {
        let least = fluid.len().div_ceil((fluid.len() / LEAST).clamp(1, GROUPS));
        self.groups.clear();
        for (c, chunk) in self.chunks.iter().enumerate() {
            let rows = fluid.start.max(c * CHUNK)..c * CHUNK + chunk.liquid.len();
            match self.groups.last_mut() {
                _ if rows.is_empty() => {}
                Some(group) if group.rows.len() < least => {
                    group.rows.end = rows.end;
                    group.span = group.span.start.min(chunk.span.start)..group.span.end.max(chunk.span.end);
                }
                _ => self.groups.push(Group { rows, span: chunk.span.clone() }),
            }
        }
    }

    /// The rows of the fluid in groups; none unless pairs of liquid are listed once.
    pub fn groups(&self) -> &[Group] {
        &self.groups
    }

    /// Neighbours of particle `a`.
    #[inline]
    pub fn row(&self, a: usize) -> Row<'_> {
        let (chunk, k) = (&self.chunks[a / CHUNK], a % CHUNK);
        let range = chunk.start[k]..chunk.start[k + 1];
        Row {
            index: &chunk.pairs.index[range.clone()],
            kernel: if chunk.keeps_kernel { &chunk.pairs.kernel[range.clone()] } else { &[] },
            gradient: &chunk.pairs.gradient[range],
            liquid: chunk.liquid[k] as usize,
        }
    }

    /// Whether particle `a` has solid neighbours.
    #[inline]
    pub fn has_solids(&self, a: usize) -> bool {
        let (chunk, k) = (&self.chunks[a / CHUNK], a % CHUNK);
        chunk.start[k] + (chunk.liquid[k] as usize) < chunk.start[k + 1]
    }

    /// Those of the particles below number `end` that have neighbours, in order. Whole chunks of solids far from the liquid have none, and
    /// cost nothing.
    pub fn with_neighbors(&self, end: usize) -> impl Iterator<Item = usize> + '_ {
        let chunks = self.chunks.iter().enumerate().take(end.div_ceil(CHUNK));
        let with_any = chunks.filter(|(_, chunk)| chunk.start.last() > Some(&0));
        let rows = with_any.flat_map(|(c, chunk)| (c * CHUNK..).zip(chunk.start.windows(2)));
        rows.filter(|(_, row)| row[0] < row[1]).map(|(a, _)| a).take_while(move |a| *a < end)
    }

    /// Number of listed pairs: each direction counts, where it is listed.
    pub fn pairs(&self) -> usize {
        self.chunks.iter().filter_map(|chunk| chunk.start.last()).sum()
    }

    /// The particles from number `first` on in cell order, by their numbers from there: the order that makes neighbours close in memory,
    /// and that in which rows list them. Uses this list's buffers and so forgets its cells.
    pub fn cell_order(&mut self, position: &[Vector<D>], first: usize, support: f64) -> &[u32] {
        let count = position.len();
        let position = &position[first..];
        let grid = Grid::covering(extent_of(position.iter()), count, support);
        self.fluid_cells.sort(&grid, 0..position.len(), position);
        &self.fluid_cells.sorted[..position.len()]
    }
}

impl<'a> Row<'a> {
    /// sum_b W_ab in 1/m^D; not a number where W is not kept.
    pub fn kernel_sum(self) -> f64 {
        if self.kernel.len() == self.index.len() { self.kernel.iter().sum() } else { f64::NAN }
    }

    /// The liquid neighbours, which come first, and the solid ones.
    #[inline]
    pub fn split(self) -> (Self, Self) {
        let part = |range: Range<usize>, liquid: usize| Self {
            index: &self.index[range.clone()],
            kernel: self.kernel.get(range.clone()).unwrap_or(&[]),
            gradient: &self.gradient[range],
            liquid,
        };
        (part(0..self.liquid, self.liquid), part(self.liquid..self.index.len(), 0))
    }

    /// The neighbours by blocks of [`LANES`], as (b, F_ab). The last block is filled up with its first neighbour and F = 0.
    #[inline]
    pub fn blocks(self) -> Blocks<'a> {
        Blocks { index: self.index, gradient: self.gradient }
    }

    /// (b, W_ab, F_ab) of each neighbour; W is not a number where it is not kept.
    #[inline]
    pub fn iter(self) -> impl Iterator<Item = (usize, f64, f64)> + 'a {
        // One loop for both: what is not kept is made of F.
        let (kernel, known) = match self.kernel {
            [] => (self.gradient, f64::NAN),
            kernel => (kernel, 1.0),
        };
        let pairs = self.index.iter().zip(kernel).zip(self.gradient);
        pairs.map(move |((&b, &w), &f)| (b as usize, known * w, f))
    }
}

/// What [`Row::blocks`] gives. Whole blocks and the last one leave at the same place, so that the body of a loop over them is compiled
/// once and into it.
#[derive(Debug, Clone)]
pub struct Blocks<'a> {
    index: &'a [u32],
    gradient: &'a [f64],
}

impl Iterator for Blocks<'_> {
    type Item = ([u32; LANES], Lanes);

    #[inline]
    fn next(&mut self) -> Option<Self::Item> {
        let whole = self.index.split_first_chunk().zip(self.gradient.split_first_chunk());
        let block = if let Some(((index, indices), (gradient, gradients))) = whole {
            (self.index, self.gradient) = (indices, gradients);
            (*index, Lanes::new(*gradient))
        } else {
            let (index, gradient) = (std::mem::take(&mut self.index), std::mem::take(&mut self.gradient));
            let first = index.first()?;
            let filled = std::array::from_fn(|k| *index.get(k).unwrap_or(first));
            (filled, Lanes::new(std::array::from_fn(|k| *gradient.get(k).unwrap_or(&0.0))))
        };
        Some(block)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A deterministic scatter in [0, 1)^D (splitmix64).
    fn scatter<const D: usize>(count: usize) -> Vec<Vector<D>> {
        let mut state = 7_u64;
        let mut next = || {
            state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut z = (state ^ (state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
        };
        (0..count).map(|_| Vector::from_fn(|_, _| next())).collect()
    }

    fn naive<const D: usize>(position: &[Vector<D>], a: usize, support: f64) -> Vec<u32> {
        (0..position.len())
            .filter(|&b| b != a && (position[a] - position[b]).norm_squared() < support * support)
            .map(|b| b as u32)
            .collect()
    }

    fn agrees_with_naive<const D: usize>(position: &[Vector<D>], support: f64) {
        let smoothing = Smoothing::<D, WendlandC2>::new(support / 2.0);
        let mut neighbors = Neighbors::default();
        // Twice with different splits: buffers of the first search must not leak into the second.
        for solids in [0, position.len() / 3] {
            let threshold = |a| if a % 5 == 3 { f64::INFINITY } else { 0.0 };
            let layout = Layout::without_ghosts(solids, position.len());
            neighbors.update(position, &layout, &smoothing, support, threshold);
            for a in 0..position.len() {
                assert_eq!(neighbors.row(a).kernel.len(), neighbors.row(a).index.len());
                let mut found = neighbors.row(a).index.to_vec();
                found.sort_unstable();
                let expected = if a % 5 == 3 { vec![] } else { naive(position, a, support) };
                assert_eq!(found, expected, "row {a}");
            }
        }
    }

    #[test]
    fn finds_what_brute_force_finds() {
        agrees_with_naive(&scatter::<2>(700), 0.11);
        agrees_with_naive(&scatter::<3>(1200), 0.21);
        agrees_with_naive::<2>(&[], 0.1);
        agrees_with_naive(&[Vector::<2>::new(3.0, 4.0)], 0.1);
    }

    #[test]
    fn pairs_of_liquid_listed_once_are_all_pairs() {
        let (position, support) = (scatter::<3>(1500), 0.21);
        let smoothing = Smoothing::<3, WendlandC2>::new(support / 2.0);
        // Solids, liquid, ghosts of solids and of liquid.
        let (first, owned) = (300, 1200);
        let layout = Layout { solids: 0..first, solid_ghosts: owned..1300, ..Layout::default() }
            .with_solids_blind_to_solids();
        let [full, once] = [layout.clone(), layout.with_liquid_once()].map(|layout| {
            let mut neighbors = Neighbors::default();
            // Over the buffers of another search.
            let other = Layout::without_ghosts(0, position.len());
            neighbors.update(&position, &other, &smoothing, support, |_| 0.0);
            neighbors.update(&position, &layout, &smoothing, support, |_| 0.0);
            neighbors
        });
        let pairs = |row: Row<'_>| -> Vec<_> {
            let mut pairs: Vec<_> = row.index.iter().copied().zip(row.gradient.iter().copied()).collect();
            pairs.sort_by_key(|(b, _)| *b);
            pairs
        };
        let mut liquid = vec![vec![]; position.len()];
        for a in first..owned {
            let (full, once) = (full.row(a).split(), once.row(a).split());
            assert_eq!(pairs(full.1), pairs(once.1));
            assert!(a < CHUNK || once.0.iter().all(|(_, w, _)| w.is_nan()));
            for (b, f) in pairs(once.0) {
                liquid[a].push((b, f));
                liquid[b as usize].push((a as u32, f));
            }
        }
        for (a, liquid) in liquid.iter_mut().enumerate().take(owned) {
            liquid.sort_by_key(|(b, _)| *b);
            match a < first {
                true => assert_eq!(pairs(full.row(a)), pairs(once.row(a)), "solids see all"),
                false => assert_eq!(pairs(full.row(a).split().0), *liquid),
            }
        }
    }

    #[test]
    fn pairs_exactly_on_the_radius_are_outside() {
        let position: Vec<_> = (0..30).map(|k| Vector::<2>::new(0.25 * k as f64, 0.0)).collect();
        agrees_with_naive(&position, 0.5);
    }

    #[test]
    fn a_particle_far_away_costs_no_memory() {
        let mut position = scatter::<3>(300);
        position.push(Vector::repeat(1e6));
        agrees_with_naive(&position, 0.2);
    }
}
