//! From boxes and tanks to particles: one cubic lattice on which every shape is a set of cells.
//!
//! A cell is a particle place; its centre lies half a spacing inside its faces. So a wall plane is half a spacing
//! from the first fluid layer and from the first wall layer alike, and the free surface at rest is half a spacing
//! above the top row. Lengths snap to whole spacings. Normals and ties of solid particles are read off the lattice:
//! nobody has to supply them.
//!
//! A solid's cells that touch open space (edges and corners included) are its *wall* layer; deeper cells, as far as
//! `layers` reach, are *dummies*, each tied to its nearest wall cell, which at a flat wall lies along the normal
//! and at a corner is the corner cell.
//!
//! Bodies ([`crate::bodies`]) are sets of cells too: a box all of its snapped extent, any other form the cells whose centres it
//! contains. Walls are made as if there were no bodies, and a body as if there were nothing else: it may move away.

use crate::form::Form;
use crate::particles::{Particles, Vector, axis_of};
use std::collections::{HashMap, HashSet};

/// An axis-aligned box in m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aabb<const D: usize> {
    /// Lower corner.
    pub min: Vector<D>,
    /// Upper corner.
    pub max: Vector<D>,
}

impl<const D: usize> Aabb<D> {
    /// Its middle.
    pub fn centre(&self) -> Vector<D> {
        0.5 * (self.min + self.max)
    }

    /// Is `r` in the ellipsoid that touches all sides?
    pub(crate) fn ellipsoid_contains(&self, r: &Vector<D>) -> bool {
        (r - self.centre()).component_div(&(0.5 * (self.max - self.min))).norm_squared() < 1.0
    }
}

/// A box-shaped tank: inner wall planes, and which of its sides have no wall.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TankShape<const D: usize> {
    /// Inner wall planes.
    pub inner: Aabb<D>,
    /// `open[axis] = [lower side open, upper side open]`.
    pub open: [[bool; 2]; D],
    /// Axes along which the scene repeats itself: no walls there.
    pub periodic: [bool; D],
}

/// All that liquid must not enter, as snapped.
#[derive(Debug, Clone, PartialEq)]
pub struct Enclosure<const D: usize> {
    /// The tank, if any.
    pub tank: Option<TankShape<D>>,
    /// Solid boxes.
    pub boxes: Vec<Aabb<D>>,
    /// How far, in m, liquid may stray behind a face without having passed it: half a spacing, where the first layer of
    /// solid particles lies.
    pub tolerance: f64,
}

/// Liquid at the start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlockShape<const D: usize> {
    /// Extent.
    pub extent: Aabb<D>,
    /// Whether only the ellipsoid that touches all sides is filled.
    pub ellipsoid: bool,
}

/// Everything that geometry needs to know of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Shapes<const D: usize> {
    /// The tank, if any.
    pub tank: Option<TankShape<D>>,
    /// Fixed solid boxes.
    pub boxes: Vec<Aabb<D>>,
    /// Liquid.
    pub blocks: Vec<BlockShape<D>>,
    /// Bodies.
    pub bodies: Vec<BodyShape<D>>,
}

/// A body at the start: its form, which touches all sides of its extent.
#[derive(Debug, Clone, PartialEq)]
pub struct BodyShape<const D: usize> {
    /// Extent.
    pub extent: Aabb<D>,
    /// What of it is solid.
    pub form: Form,
}

/// The particles of one body.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct BodyCells<const D: usize> {
    /// Solid particle of each wall cell, then of each dummy, in [`Particles`].
    pub members: Vec<u32>,
    /// How many of them are walls.
    pub walls: usize,
    /// Sides of wall cells that no other cell of the body covers: place in `members`, axis, direction of the outward normal.
    pub faces: Vec<(u32, usize, f64)>,
    /// Centres of all cells, in m.
    pub cells: Vec<Vector<D>>,
    /// Lower and upper corner as snapped.
    pub extent: Option<Aabb<D>>,
}

/// What a wall particle belongs to, and which of its cell's faces open space touches.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WallCell<const D: usize> {
    /// The box it is part of; none: the tank.
    pub solid: Option<usize>,
    /// `open[axis] = [towards lower, towards higher coordinates]`; none at all for a cell that fills a corner.
    pub open: [[bool; 2]; D],
    /// For the tank: -1 or 1 along each axis on whose lower or upper side it lies outside, else 0.
    pub outside: [i8; D],
}

/// A flat side of a solid, by its axis and its end (0 lower, 1 upper) there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SolidSide {
    /// The box; none: the tank.
    pub solid: Option<usize>,
    /// Axis that the side is normal to.
    pub axis: usize,
    /// 0: the side at the lowest, 1: at the highest coordinate.
    pub end: usize,
}

impl<const D: usize> Aabb<D> {
    fn end(&self, end: usize) -> &Vector<D> {
        [&self.min, &self.max][end]
    }

    /// Does the straight line from `from` to `to` pass through the inside? Touching a face is not passing.
    fn blocks(&self, from: &Vector<D>, to: &Vector<D>, tolerance: f64) -> bool {
        // The part of the line, as shares of its length, that is between the planes of every axis.
        let (mut enters, mut leaves) = (0.0_f64, 1.0_f64);
        for d in 0..D {
            let (low, high) = (self.min[d] + tolerance, self.max[d] - tolerance);
            let along = to[d] - from[d];
            if along.abs() < tolerance {
                if from[d] <= low || from[d] >= high {
                    return false;
                }
                continue;
            }
            let (a, b) = ((low - from[d]) / along, (high - from[d]) / along);
            enters = enters.max(a.min(b));
            leaves = leaves.min(a.max(b));
        }
        enters < leaves
    }
}

type Cell<const D: usize> = [i64; D];

/// Half-open range of cells.
#[derive(Debug, Clone, Copy)]
struct CellBox<const D: usize> {
    min: Cell<D>,
    max: Cell<D>,
}

impl<const D: usize> CellBox<D> {
    fn contains(&self, cell: &Cell<D>) -> bool {
        (0..D).all(|d| self.min[d] <= cell[d] && cell[d] < self.max[d])
    }

    /// All cells, first axis slowest.
    fn cells(self) -> impl Iterator<Item = Cell<D>> {
        let extent: [i64; D] = std::array::from_fn(|d| (self.max[d] - self.min[d]).max(0));
        (0..extent.iter().product()).map(move |mut n: i64| {
            let mut cell = self.min;
            for d in (0..D).rev() {
                cell[d] += n % extent[d];
                n /= extent[d];
            }
            cell
        })
    }
}

/// The lattice of one scene.
#[derive(Debug, Clone)]
pub struct Lattice<const D: usize> {
    spacing: f64,
    origin: Vector<D>,
    shapes: Shapes<D>,
    tank: Option<(CellBox<D>, TankShape<D>)>,
    boxes: Vec<CellBox<D>>,
    blocks: Vec<(CellBox<D>, BlockShape<D>)>,
    bodies: Vec<(Aabb<D>, Vec<Cell<D>>)>,
    /// One sentence for each length that had to be snapped.
    pub snapped: Vec<String>,
}

impl<const D: usize> Lattice<D> {
    /// Snaps all shapes to a lattice of `spacing` m whose origin is the tank's (or the first block's) lower corner.
    pub fn new(shapes: &Shapes<D>, spacing: f64) -> Self {
        let origin = match (&shapes.tank, shapes.blocks.first()) {
            (Some(tank), _) => tank.inner.min,
            (None, Some(block)) => block.extent.min,
            (None, None) => Vector::zeros(),
        };
        let mut lattice = Self {
            spacing,
            origin,
            shapes: shapes.clone(),
            tank: None,
            boxes: vec![],
            blocks: vec![],
            bodies: vec![],
            snapped: vec![],
        };
        lattice.tank = shapes.tank.map(|t| (lattice.snap("tank", &t.inner), t));
        lattice.boxes = shapes.boxes.iter().map(|b| lattice.snap("box", b)).collect();
        lattice.blocks = shapes.blocks.iter().map(|b| (lattice.snap("fluid block", &b.extent), *b)).collect();
        lattice.bodies = shapes.bodies.iter().map(|body| lattice.cells_of(body)).collect();
        lattice
    }

    fn snap(&mut self, what: &str, extent: &Aabb<D>) -> CellBox<D> {
        let mut corner = |which: &str, point: &Vector<D>| -> Cell<D> {
            std::array::from_fn(|d| {
                let cells = (point[d] - self.origin[d]) / self.spacing;
                let snapped = cells.round();
                if (cells - snapped).abs() > 1e-6 {
                    let axis = ["x", "y", "z"][d];
                    let to = self.origin[d] + snapped * self.spacing;
                    self.snapped.push(format!("{what} {which} {axis} = {} m becomes {to:.6} m", point[d]));
                }
                snapped as i64
            })
        };
        CellBox { min: corner("min", &extent.min), max: corner("max", &extent.max) }
    }

    /// Extent and cells of a body.
    fn cells_of(&mut self, body: &BodyShape<D>) -> (Aabb<D>, Vec<Cell<D>>) {
        if body.form == Form::Box {
            let cells = self.snap("body", &body.extent);
            return (self.extent(&cells), cells.cells().collect());
        }
        let corner = |point: &Vector<D>, grow: f64| -> Cell<D> {
            std::array::from_fn(|d| ((point[d] - self.origin[d]) / self.spacing + grow).floor() as i64)
        };
        let around = CellBox { min: corner(&body.extent.min, -1.0), max: corner(&body.extent.max, 2.0) };
        let inside = body.form.filter(&body.extent);
        (body.extent, around.cells().filter(|cell| inside(&self.centre(cell))).collect())
    }

    /// Lower and upper corner of box `k` as snapped.
    pub fn snapped_box(&self, k: usize) -> Aabb<D> {
        self.extent(&self.boxes[k])
    }

    /// The tank as snapped.
    pub fn snapped_tank(&self) -> Option<TankShape<D>> {
        self.tank.as_ref().map(|(cells, shape)| TankShape { inner: self.extent(cells), ..*shape })
    }

    fn extent(&self, cells: &CellBox<D>) -> Aabb<D> {
        let corner = |cell: Cell<D>| self.origin + Vector::from_fn(|d, _| cell[d] as f64 * self.spacing);
        Aabb { min: corner(cells.min), max: corner(cells.max) }
    }

    /// What liquid must not enter.
    pub fn enclosure(&self) -> Enclosure<D> {
        let boxes = self.boxes.iter().map(|cells| self.extent(cells)).collect();
        Enclosure { tank: self.snapped_tank(), boxes, tolerance: 0.5 * self.spacing }
    }

    /// The cell of the tank that a cell beyond a periodic side repeats.
    fn wrapped(&self, cell: &Cell<D>) -> Cell<D> {
        let Some((tank, shape)) = &self.tank else { return *cell };
        std::array::from_fn(|d| match shape.periodic[d] {
            true => tank.min[d] + (cell[d] - tank.min[d]).rem_euclid(tank.max[d] - tank.min[d]),
            false => cell[d],
        })
    }

    /// Where a point given in the unsnapped scene lies on the lattice: a point within half a spacing of a side of a box
    /// or of a tank wall goes with that side (the nearest one), every other point stays.
    pub fn follow(&self, point: &Vector<D>) -> (Vector<D>, Option<SolidSide>) {
        let Shapes { tank, boxes, .. } = &self.shapes;
        let boxes = boxes.iter().enumerate();
        let solids = boxes.map(|(k, solid)| (Some(k), *solid, self.snapped_box(k), [[true; 2]; D]));
        let tank = tank.zip(self.tank).map(|(shape, (cells, _))| {
            let is_wall = |d: usize, end: usize| !shape.open[d][end] && !shape.periodic[d];
            let walls = std::array::from_fn(|d| [0, 1].map(|end| is_wall(d, end)));
            (None, shape.inner, self.extent(&cells), walls)
        });
        self.moved_with_side(point, solids.chain(tank))
    }

    /// Where a point on a body lies on the lattice at the start, likewise.
    pub fn follow_body(&self, body: usize, point: &Vector<D>) -> Vector<D> {
        let solid = (None, self.shapes.bodies[body].extent, self.bodies[body].0, [[true; 2]; D]);
        self.moved_with_side(point, std::iter::once(solid)).0
    }

    /// Of `solids` each as its number, its extent as given and as snapped, and which of its sides count.
    fn moved_with_side(
        &self,
        point: &Vector<D>,
        solids: impl Iterator<Item = (Option<usize>, Aabb<D>, Aabb<D>, [[bool; 2]; D])>,
    ) -> (Vector<D>, Option<SolidSide>) {
        let reach = (0.5 + 1e-6) * self.spacing;
        let mut nearest: Option<(f64, SolidSide, Aabb<D>)> = None;
        for (solid, given, snapped, walls) in solids {
            let inside = (0..D).all(|d| given.min[d] - reach <= point[d] && point[d] <= given.max[d] + reach);
            for (axis, end) in (0..D).flat_map(|axis| [(axis, 0), (axis, 1)]).filter(|_| inside) {
                let away = (point[axis] - given.end(end)[axis]).abs();
                if walls[axis][end] && away <= reach && nearest.is_none_or(|(least, ..)| away < least) {
                    nearest = Some((away, SolidSide { solid, axis, end }, snapped));
                }
            }
        }
        let Some((_, side, snapped)) = nearest else { return (*point, None) };
        // Along the side too it stays on what has become of it.
        let mut moved = point.sup(&snapped.min).inf(&snapped.max);
        moved[side.axis] = snapped.end(side.end)[side.axis];
        (moved, Some(side))
    }

    /// The boxes as obstacles to sight: one that stands on a tank wall goes on behind it.
    pub fn obstacles(&self) -> Obstacles<D> {
        let extended = |cells: &CellBox<D>| {
            let mut solid = self.extent(cells);
            if let Some((tank, _)) = &self.tank {
                for d in 0..D {
                    if cells.min[d] == tank.min[d] {
                        solid.min[d] = f64::NEG_INFINITY;
                    }
                    if cells.max[d] == tank.max[d] {
                        solid.max[d] = f64::INFINITY;
                    }
                }
            }
            solid
        };
        Obstacles { boxes: self.boxes.iter().map(extended).collect(), tolerance: 1e-6 * self.spacing }
    }

    /// What each wall particle of [`particles`](Self::particles) is, in their order.
    pub fn wall_cells(&self) -> Vec<WallCell<D>> {
        let touching = stencil::<D>(1);
        // Regions keep their order whatever the number of layers: wall cells lie in the first.
        let cells = self.solid_regions(1).into_iter();
        let walls = cells.filter(|cell| touching.iter().any(|o| self.is_open(&shifted(cell, o))));
        let wall = |cell: Cell<D>| WallCell {
            solid: self.boxes.iter().position(|b| b.contains(&cell)),
            open: std::array::from_fn(|d| {
                [-1, 1].map(|step| self.is_open(&std::array::from_fn(|k| cell[k] + i64::from(k == d) * step)))
            }),
            outside: std::array::from_fn(|d| {
                self.tank
                    .map_or(0, |(tank, _)| i8::from(cell[d] >= tank.max[d]) - i8::from(cell[d] < tank.min[d]))
            }),
        };
        walls.map(wall).collect()
    }

    fn centre(&self, cell: &Cell<D>) -> Vector<D> {
        self.origin + Vector::from_fn(|d, _| (cell[d] as f64 + 0.5) * self.spacing)
    }

    /// Space that liquid can enter.
    fn is_open(&self, cell: &Cell<D>) -> bool {
        let cell = &self.wrapped(cell);
        self.tank.is_none_or(|(tank, _)| tank.contains(cell)) && !self.boxes.iter().any(|b| b.contains(cell))
    }

    fn is_solid(&self, cell: &Cell<D>) -> bool {
        if self.boxes.iter().any(|b| b.contains(cell)) {
            return true;
        }
        let Some((tank, TankShape { open, .. })) = &self.tank else { return false };
        let mut outside = false;
        for d in 0..D {
            let (below, above) = (cell[d] < tank.min[d], cell[d] >= tank.max[d]);
            if (below && open[d][0]) || (above && open[d][1]) {
                return false;
            }
            outside |= below || above;
        }
        outside
    }

    /// Solid and fluid particles, at rest; `layers` counts the wall layer and the dummies behind it. `velocity` in m/s is
    /// that of the liquid of a block (by number) at a place.
    pub fn particles(
        &self,
        layers: usize,
        velocity: impl Fn(usize, &Vector<D>) -> Vector<D>,
    ) -> Particles<D> {
        let (mut particles, _) = self.solid_particles(layers as i64);
        let bodies: HashSet<Cell<D>> = self.bodies.iter().flat_map(|(_, cells)| cells).copied().collect();
        for (k, (cells, shape)) in self.blocks.iter().enumerate() {
            for cell in cells.cells().filter(|cell| self.is_open(cell) && !bodies.contains(cell)) {
                let r = self.centre(&cell);
                if !shape.ellipsoid || shape.extent.ellipsoid_contains(&r) {
                    particles.push_fluid(r, velocity(k, &r));
                }
            }
        }
        particles
    }

    /// The particles of each body among those of [`particles`](Self::particles) with as many `layers`.
    pub fn bodies(&self, layers: usize) -> Vec<BodyCells<D>> {
        self.solid_particles(layers as i64).1
    }

    fn solid_particles(&self, layers: i64) -> (Particles<D>, Vec<BodyCells<D>>) {
        let mut solid = Layered::new(self.solid_regions(layers), |cell| self.is_open(cell), layers);
        let mut bodies = vec![];
        for (extent, cells) in &self.bodies {
            let all: HashSet<Cell<D>> = cells.iter().copied().collect();
            let is_open = |cell: &Cell<D>| !all.contains(cell);
            let body = Layered::new(cells.clone(), is_open, layers);
            let [walls, dummies] = [solid.walls.len() as u32, solid.dummies.len() as u32];
            let faces = body.walls.iter().enumerate().flat_map(|(k, wall)| {
                let sides = (0..D).flat_map(|axis| [(axis, -1), (axis, 1)]);
                sides.filter_map(move |(axis, end)| {
                    let next: Cell<D> = std::array::from_fn(|d| wall.cell[d] + i64::from(d == axis) * end);
                    is_open(&next).then_some((k as u32, axis, end as f64))
                })
            });
            bodies.push(BodyCells {
                faces: faces.collect(),
                walls: body.walls.len(),
                // Dummies are numbered behind the walls of all solids, which are not all known yet.
                members: (walls..walls + body.walls.len() as u32)
                    .chain(dummies..dummies + body.dummies.len() as u32)
                    .collect(),
                cells: cells.iter().map(|cell| self.centre(cell)).collect(),
                extent: Some(*extent),
            });
            solid.walls.extend(body.walls);
            solid
                .dummies
                .extend(body.dummies.into_iter().map(|dummy| Dummy { tie: dummy.tie + walls, ..dummy }));
        }
        let count = solid.walls.len() as u32;
        for body in &mut bodies {
            body.members[body.walls..].iter_mut().for_each(|dummy| *dummy += count);
        }
        let walls = solid.walls.iter().map(|wall| (wall.cell, wall.normal));
        let behind = solid.dummies.iter().map(|dummy| (dummy.cell, solid.walls[dummy.tie as usize].normal));
        let (cells, normal): (Vec<_>, Vec<_>) = walls.chain(behind).unzip();
        let depth =
            solid.walls.iter().map(|_| 0.5).chain(solid.dummies.iter().map(|dummy| 0.5 + dummy.behind));
        let particles = Particles::from_solid(
            cells.iter().map(|cell| self.centre(cell)).collect(),
            (normal, solid.walls.iter().map(|wall| wall.flat).collect()),
            depth.map(|cells| cells * self.spacing).collect(),
            solid.dummies.iter().map(|dummy| dummy.tie).collect(),
        );
        (particles, bodies)
    }

    /// All solid cells that can lie within `layers` of open space, each once.
    fn solid_regions(&self, layers: i64) -> Vec<Cell<D>> {
        let mut cells = vec![];
        if let Some((tank, shape)) = &self.tank {
            let grow = |d: usize| if shape.periodic[d] { 0 } else { layers };
            let grown = CellBox {
                min: std::array::from_fn(|d| tank.min[d] - grow(d)),
                max: std::array::from_fn(|d| tank.max[d] + grow(d)),
            };
            cells.extend(grown.cells().filter(|c| !tank.contains(c) && self.is_solid(c)));
        }
        for (k, solid) in self.boxes.iter().enumerate() {
            let earlier = &self.boxes[..k];
            cells.extend(solid.cells().filter(|c| {
                !earlier.iter().any(|b| b.contains(c)) && self.tank.is_none_or(|(tank, _)| tank.contains(c))
            }));
        }
        cells
    }
}

/// The cells of one solid by layer.
struct Layered<const D: usize> {
    /// Those that touch open space.
    walls: Vec<Wall<D>>,
    dummies: Vec<Dummy<D>>,
}

/// A cell that touches open space.
#[derive(Clone, Copy)]
struct Wall<const D: usize> {
    cell: Cell<D>,
    normal: Vector<D>,
    /// Whether the face goes on in its plane to all sides. Beside the end of a step it does not, though the normal is straight:
    /// what leaves the step crosses that plane from behind.
    flat: bool,
}

/// A deeper cell.
struct Dummy<const D: usize> {
    cell: Cell<D>,
    /// The wall cell it is tied to.
    tie: u32,
    /// How far it lies behind that one along the normal, in cells.
    behind: f64,
}

impl<const D: usize> Wall<D> {
    /// `open` are the offsets of all open cells around it.
    fn new(cell: Cell<D>, open: &[&Cell<D>]) -> Self {
        let normal = wall_normal(open);
        let flat = axis_of(&normal).is_some_and(|axis| open.iter().all(|o| o[axis] != 0));
        Self { cell, normal, flat }
    }
}

impl<const D: usize> Layered<D> {
    fn new(cells: Vec<Cell<D>>, is_open: impl Fn(&Cell<D>) -> bool, layers: i64) -> Self {
        let touching = stencil::<D>(1);
        let (mut walls, mut inner) = (vec![], vec![]);
        for cell in cells {
            let open: Vec<_> = touching.iter().filter(|o| is_open(&shifted(&cell, o))).collect();
            match open.is_empty() {
                true => inner.push(cell),
                false => walls.push(Wall::new(cell, &open)),
            }
        }
        let wall_of: HashMap<Cell<D>, u32> =
            walls.iter().enumerate().map(|(k, wall)| (wall.cell, k as u32)).collect();
        let near = stencil::<D>(layers - 1);
        let dummy = |cell: Cell<D>| {
            let (tie, offset) = near.iter().find_map(|o| wall_of.get(&shifted(&cell, o)).map(|&w| (w, o)))?;
            let normal = walls[tie as usize].normal;
            Some(Dummy { cell, tie, behind: (0..D).map(|d| offset[d] as f64 * normal[d]).sum() })
        };
        let dummies = inner.into_iter().filter_map(dummy).collect();
        Self { walls, dummies }
    }
}

/// What stands between two points.
#[derive(Debug, Clone, PartialEq)]
pub struct Obstacles<const D: usize> {
    boxes: Vec<Aabb<D>>,
    tolerance: f64,
}

impl<const D: usize> Obstacles<D> {
    /// Is the straight line between two points free of solid boxes? It may run along their faces.
    pub fn leave_free(&self, from: &Vector<D>, to: &Vector<D>) -> bool {
        !self.boxes.iter().any(|solid| solid.blocks(from, to, self.tolerance))
    }
}

/// Offsets up to `reach` cells along each axis, nearest first; the zero offset is left out.
fn stencil<const D: usize>(reach: i64) -> Vec<Cell<D>> {
    let cube = CellBox { min: [-reach; D], max: [reach + 1; D] };
    let square = |o: &Cell<D>| o.iter().map(|c| c * c).sum::<i64>();
    let mut offsets: Vec<Cell<D>> = cube.cells().filter(|o| square(o) > 0).collect();
    offsets.sort_by_key(|o| (square(o), *o));
    offsets
}

fn shifted<const D: usize>(cell: &Cell<D>, offset: &Cell<D>) -> Cell<D> {
    std::array::from_fn(|d| cell[d] + offset[d])
}

/// Unit normal into open space: from the open faces of a cell, else from its nearest open corners.
fn wall_normal<const D: usize>(open: &[&Cell<D>]) -> Vector<D> {
    let faces_crossed = |o: &Cell<D>| o.iter().filter(|c| **c != 0).count();
    let fewest = open.iter().map(|o| faces_crossed(o)).min().unwrap_or(0);
    let sum: Vector<D> =
        open.iter().filter(|o| faces_crossed(o) == fewest).map(|o| Vector::from_fn(|d, _| o[d] as f64)).sum();
    // A plate one cell thick is open on both sides: its sum vanishes and it has no normal.
    sum.try_normalize(0.5).unwrap_or_else(Vector::zeros)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::particles::Kind;

    fn tank2(open_top: bool) -> Shapes<2> {
        let inner = Aabb { min: Vector::zeros(), max: Vector::<2>::new(0.8, 0.8) };
        Shapes {
            tank: Some(TankShape { inner, open: [[false, false], [false, open_top]], periodic: [false; 2] }),
            boxes: vec![],
            blocks: vec![BlockShape {
                extent: Aabb { min: Vector::zeros(), max: Vector::<2>::new(0.2, 0.4) },
                ellipsoid: false,
            }],
            bodies: vec![],
        }
    }

    #[test]
    fn the_paper_s_dam_break_has_its_particle_counts() {
        let lattice = Lattice::new(&tank2(true), 0.005);
        let particles = lattice.particles(3, |_, _| Vector::zeros());
        assert!(lattice.snapped.is_empty());
        assert_eq!(particles.fluid().len(), 40 * 80);
        assert_eq!(particles.walls().len(), 160 * 3 + 2);
        assert_eq!(particles.dummies().len(), 2 * (160 * 3) + 2 * (9 - 1));
        let lowest = particles.position[particles.solids()];
        assert!((lowest - Vector::<2>::new(0.0025, 0.0025)).norm() < 1e-15);
    }

    #[test]
    fn normals_are_straight_at_flat_walls_and_diagonal_in_corners() {
        let particles = Lattice::new(&tank2(true), 0.1).particles(3, |_, _| Vector::zeros());
        for a in particles.walls() {
            let r = particles.position[a];
            let expected = match (r.x < 0.0, r.x > 0.8, r.y < 0.0) {
                (true, _, true) => Vector::<2>::new(1.0, 1.0).normalize(),
                (_, true, true) => Vector::<2>::new(-1.0, 1.0).normalize(),
                (true, _, false) => Vector::<2>::new(1.0, 0.0),
                (_, true, false) => Vector::<2>::new(-1.0, 0.0),
                _ => Vector::<2>::new(0.0, 1.0),
            };
            assert!((particles.normal[a] - expected).norm() < 1e-12, "{r}");
        }
    }

    #[test]
    fn dummies_are_tied_along_the_normal() {
        let particles = Lattice::new(&tank2(false), 0.1).particles(3, |_, _| Vector::zeros());
        for a in particles.dummies() {
            assert_eq!(particles.kind(a), Kind::Dummy);
            let wall = particles.tie[a - particles.walls().len()] as usize;
            let behind = particles.position[wall] - particles.position[a];
            let at_corner = particles.normal[wall].iter().all(|n| n.abs() > 0.1);
            if !at_corner {
                let along = behind.dot(&particles.normal[wall]);
                assert!((behind - along * particles.normal[wall]).norm() < 1e-12 && along > 0.05);
                assert!((particles.depth[a] - along - 0.05).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn a_box_on_the_floor_displaces_its_cells_and_is_hollow_only_when_thick() {
        let inner = Aabb { min: Vector::zeros(), max: Vector::<3>::new(2.0, 1.0, 1.0) };
        let shapes = Shapes::<3> {
            tank: Some(TankShape {
                inner,
                open: [[false; 2], [false; 2], [false, true]],
                periodic: [false; 3],
            }),
            boxes: vec![Aabb { min: Vector::<3>::new(1.0, 0.3, 0.0), max: Vector::<3>::new(1.4, 0.7, 0.4) }],
            blocks: vec![],
            bodies: vec![],
        };
        let particles = Lattice::new(&shapes, 0.1).particles(4, |_, _| Vector::zeros());
        let in_box =
            |r: &Vector<3>| r.x > 1.0 && r.x < 1.4 && r.y > 0.3 && r.y < 0.7 && r.z > 0.0 && r.z < 0.4;
        let solid: Vec<_> = (0..particles.len()).filter(|&a| in_box(&particles.position[a])).collect();
        assert_eq!(solid.len(), 64, "a box of 4 x 4 x 4 cells is full of particles");
        let walls = solid.iter().filter(|&&a| particles.kind(a) == Kind::Wall).count();
        assert_eq!(walls, 64 - 2 * 2 * 3, "all but the cells that touch no open cell");
    }

    #[test]
    fn a_gable_is_not_flat_at_the_inner_corner_of_a_step() {
        let solid = |cell: &Cell<3>| {
            let height = if cell[0] < 4 { 8 } else { 4 };
            (0..8).contains(&cell[0]) && (0..3).contains(&cell[1]) && (0..height).contains(&cell[2])
        };
        let all = CellBox { min: [0; 3], max: [8, 3, 8] };
        let stair = Layered::new(all.cells().filter(solid).collect(), |cell| !solid(cell), 1);
        let gable = |x, z| stair.walls.iter().find(|wall| wall.cell == [x, 0, z]).expect("a wall");
        for (x, z) in [(3, 3), (2, 3), (3, 2), (5, 2), (2, 6)] {
            let wall = gable(x, z);
            assert_eq!(wall.normal, Vector::<3>::new(0.0, -1.0, 0.0));
            assert_eq!(wall.flat, (x, z) != (3, 3), "{x}, {z}");
        }
        assert!(!gable(3, 4).flat && !gable(4, 3).flat, "edges");
    }

    #[test]
    fn lengths_snap_and_say_so() {
        let mut shapes = tank2(true);
        shapes.blocks[0].extent.max.y = 0.4021;
        let lattice = Lattice::new(&shapes, 0.005);
        assert_eq!(lattice.snapped, ["fluid block max y = 0.4021 m becomes 0.400000 m"]);
    }

    /// A 0.161 m box on the floor of a 3.22 m tank, as measured by Kleefsman et al. (2005), at a spacing of 0.0183 m.
    fn kleefsman() -> Lattice<3> {
        let inner = Aabb { min: Vector::zeros(), max: Vector::<3>::new(3.22, 1.0, 1.0) };
        let solid =
            Aabb { min: Vector::<3>::new(2.3955, 0.2985, 0.0), max: Vector::<3>::new(2.5565, 0.7015, 0.161) };
        let open = [[false; 2], [false; 2], [false, true]];
        let shapes = Shapes {
            tank: Some(TankShape { inner, open, periodic: [false; 3] }),
            boxes: vec![solid],
            blocks: vec![],
            bodies: vec![],
        };
        Lattice::new(&shapes, 0.0183)
    }

    #[test]
    fn points_on_a_face_follow_it_and_others_stay() {
        let lattice = kleefsman();
        let at = |x: f64, y: f64, z: f64| lattice.follow(&Vector::<3>::new(x, y, z));
        let snapped = lattice.snapped_box(0);
        assert!((snapped.max.z - 0.1647).abs() < 1e-9, "0.161 m becomes 0.1647 m");
        let (front, side) = at(2.3955, 0.5255, 0.021);
        assert_eq!(side, Some(SolidSide { solid: Some(0), axis: 0, end: 0 }));
        assert!((front - Vector::<3>::new(131.0 * 0.0183, 0.5255, 0.021)).norm() < 1e-9, "{front}");
        let (top, _) = at(2.4165, 0.4745, 0.161);
        assert!((top - Vector::<3>::new(2.4165, 0.4745, 0.1647)).norm() < 1e-9, "{top}");
        let (wall, side) = at(3.22, 0.5, 0.2);
        assert_eq!(side, Some(SolidSide { solid: None, axis: 0, end: 1 }));
        assert!((wall.x - 3.2208).abs() < 1e-9);
        assert_eq!(at(2.38, 0.5, 0.1), (Vector::<3>::new(2.38, 0.5, 0.1), None), "15 mm before the box");
        assert_eq!(at(1.0, 0.5, 1.0).1, None, "an open side is no wall");
    }

    #[test]
    fn nothing_is_seen_through_a_box_or_under_it() {
        let lattice = kleefsman();
        let obstacles = lattice.obstacles();
        let solid = lattice.snapped_box(0);
        let before = |z: f64| Vector::<3>::new(solid.min.x, 0.5, z);
        let free = |from: Vector<3>, to: Vector<3>| obstacles.leave_free(&from, &to);
        assert!(free(before(0.02), before(0.1)), "along the face");
        assert!(free(before(0.02), before(0.02) - Vector::<3>::new(0.01, 0.0, 0.0)), "away from it");
        assert!(!free(before(0.02), Vector::<3>::new(solid.max.x, 0.5, 0.02)), "through");
        assert!(!free(before(0.0), Vector::<3>::new(solid.max.x, 0.5, -0.009)), "under");
        assert!(!free(before(0.15), Vector::<3>::new(solid.min.x + 0.01, 0.5, solid.max.z)), "over the edge");
    }

    #[test]
    fn wall_cells_are_the_wall_particles_and_their_faces_the_area_of_the_solids() {
        let lattice = kleefsman();
        let (cells, particles) = (lattice.wall_cells(), lattice.particles(4, |_, _| Vector::zeros()));
        assert_eq!(cells.len(), particles.walls().len());
        let face = |cells: &[WallCell<3>], solid, axis: usize, end: usize| {
            cells.iter().filter(|c| c.solid == solid && c.open[axis][end]).count()
        };
        let counts = lattice.boxes[0].max.iter().zip(lattice.boxes[0].min).map(|(b, a)| (b - a) as usize);
        let [x, y, z]: [usize; 3] = counts.collect::<Vec<_>>().try_into().unwrap();
        assert_eq!(face(&cells, Some(0), 0, 0), y * z);
        assert_eq!(face(&cells, Some(0), 2, 1), x * y);
        assert_eq!(face(&cells, Some(0), 2, 0), 0, "it stands on the floor");
        assert_eq!(face(&cells, None, 2, 1), 176 * 55 - x * y, "the floor but for the box");
        for (cell, position) in cells.iter().zip(&particles.position) {
            let in_box = cell.solid.is_some();
            assert_eq!(
                in_box,
                position.x > 0.0
                    && position.x < 3.22
                    && position.z > 0.0
                    && position.y > 0.0
                    && position.y < 1.0
            );
            assert_eq!(cell.outside[2], -i8::from(position.z < 0.0));
        }
    }
}
