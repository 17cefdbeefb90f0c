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

use crate::particles::{Particles, Vector};
use std::collections::HashMap;

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
    fn ellipsoid_contains(&self, r: &Vector<D>) -> bool {
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
    tank: Option<(CellBox<D>, TankShape<D>)>,
    boxes: Vec<CellBox<D>>,
    blocks: Vec<(CellBox<D>, BlockShape<D>)>,
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
        let mut lattice =
            Self { spacing, origin, tank: None, boxes: vec![], blocks: vec![], snapped: vec![] };
        lattice.tank = shapes.tank.map(|t| (lattice.snap("tank", &t.inner), t));
        lattice.boxes = shapes.boxes.iter().map(|b| lattice.snap("box", b)).collect();
        lattice.blocks = shapes.blocks.iter().map(|b| (lattice.snap("fluid block", &b.extent), *b)).collect();
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

    /// The cell of the tank that a cell beyond a periodic side repeats.
    fn wrapped(&self, cell: &Cell<D>) -> Cell<D> {
        let Some((tank, shape)) = &self.tank else { return *cell };
        std::array::from_fn(|d| match shape.periodic[d] {
            true => tank.min[d] + (cell[d] - tank.min[d]).rem_euclid(tank.max[d] - tank.min[d]),
            false => cell[d],
        })
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
        let mut particles = self.solid_particles(layers as i64);
        for (k, (cells, shape)) in self.blocks.iter().enumerate() {
            for cell in cells.cells().filter(|cell| self.is_open(cell)) {
                let r = self.centre(&cell);
                if !shape.ellipsoid || shape.extent.ellipsoid_contains(&r) {
                    particles.push_fluid(r, velocity(k, &r));
                }
            }
        }
        particles
    }

    fn solid_particles(&self, layers: i64) -> Particles<D> {
        let touching = stencil::<D>(1);
        let mut cells: Vec<(Cell<D>, Vector<D>)> = vec![];
        let mut inner: Vec<Cell<D>> = vec![];
        for cell in self.solid_regions(layers) {
            let open: Vec<_> = touching.iter().filter(|o| self.is_open(&shifted(&cell, o))).collect();
            match open.is_empty() {
                true => inner.push(cell),
                false => cells.push((cell, wall_normal(&open))),
            }
        }
        let wall_of: HashMap<Cell<D>, u32> =
            cells.iter().enumerate().map(|(k, (cell, _))| (*cell, k as u32)).collect();
        let near = stencil::<D>(layers - 1);
        let mut depth = vec![0.5 * self.spacing; cells.len()];
        let mut tie = vec![];
        for cell in inner {
            let found = near.iter().find_map(|o| wall_of.get(&shifted(&cell, o)).map(|&w| (w, o)));
            if let Some((wall, offset)) = found {
                let normal = cells[wall as usize].1;
                let behind: f64 = (0..D).map(|d| offset[d] as f64 * normal[d]).sum();
                cells.push((cell, normal));
                depth.push((0.5 + behind) * self.spacing);
                tie.push(wall);
            }
        }
        let position = cells.iter().map(|(cell, _)| self.centre(cell)).collect();
        let normal = cells.iter().map(|(_, normal)| *normal).collect();
        Particles::from_solid(position, normal, depth, tie)
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
    fn lengths_snap_and_say_so() {
        let mut shapes = tank2(true);
        shapes.blocks[0].extent.max.y = 0.4021;
        let lattice = Lattice::new(&shapes, 0.005);
        assert_eq!(lattice.snapped, ["fluid block max y = 0.4021 m becomes 0.400000 m"]);
    }
}
