//! Forms of bodies: which points they contain, and their surfaces as polygons.
//!
//! A form fills its extent, an axis-aligned box, so that it touches all sides of it. Closed triangle meshes come from STL files,
//! binary or text; a point lies inside where the mesh winds around it once (Jacobson, Kavan & Sorkine-Hornung 2013, ACM Trans.
//! Graph. 32, 33): the sum of the solid angles of all triangles, seen from it, is 4 pi, and 0 outside.

use crate::geometry::Aabb;
use crate::particles::Vector;
use std::collections::HashMap;
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

/// A point in space in m; in 2D its last component is 0.
pub type Point = nalgebra::Vector3<f64>;

/// What of an extent is solid.
#[derive(Debug, Clone, PartialEq)]
pub enum Form {
    /// All of it.
    Box,
    /// The ellipsoid, of a cube the sphere, that touches all sides.
    Ellipsoid,
    /// The elliptic, of a square section the round cylinder along an axis.
    Cylinder {
        /// Axis, 0 for x; in 2D the third, which is not there.
        axis: usize,
    },
    /// A closed mesh (3D), in m.
    Mesh(Arc<Mesh>),
}

/// A surface of polygons.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Surface {
    /// Corners in m.
    pub points: Vec<Point>,
    /// Corners of each polygon, counterclockwise from outside.
    pub polygons: Vec<Vec<u32>>,
}

/// Straight pieces that a circle is drawn with.
const ARC: usize = 48;

impl Form {
    /// Tells whether a point is inside.
    pub fn filter<const D: usize>(&self, extent: &Aabb<D>) -> Box<dyn Fn(&Vector<D>) -> bool> {
        let extent = *extent;
        match self {
            Self::Box => Box::new(move |r| (0..D).all(|d| extent.min[d] < r[d] && r[d] < extent.max[d])),
            Self::Ellipsoid => Box::new(move |r| extent.ellipsoid_contains(r)),
            Self::Cylinder { axis } => {
                let axis = *axis;
                Box::new(move |r| {
                    let half = 0.5 * (extent.max - extent.min);
                    let relative = (r - extent.centre()).component_div(&half);
                    let across: f64 = (0..D).filter(|d| *d != axis).map(|d| relative[d].powi(2)).sum();
                    across < 1.0 && (axis >= D || relative[axis].abs() < 1.0)
                })
            }
            Self::Mesh(mesh) => {
                let mesh = mesh.clone();
                Box::new(move |r| mesh.winding(&point(r)) > 0.5)
            }
        }
    }

    /// Its surface; in 2D the outline as one polygon.
    pub fn surface<const D: usize>(&self, extent: &Aabb<D>) -> Surface {
        let (centre, half) = (point(&extent.centre()), point(&(0.5 * (extent.max - extent.min))));
        let place = |p: Point| centre + half.component_mul(&p);
        let arc = |k: usize| (k as f64 * TAU / ARC as f64).sin_cos();
        if D == 2 {
            let corners: Vec<Point> = match self {
                Self::Box => [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
                    .map(|(x, y)| Point::new(x, y, 0.0))
                    .to_vec(),
                _ => (0..ARC).map(|k| Point::new(arc(k).1, arc(k).0, 0.0)).collect(),
            };
            let polygons = vec![(0..corners.len() as u32).collect()];
            return Surface { points: corners.into_iter().map(place).collect(), polygons };
        }
        match self {
            Self::Box => {
                let corner = |k: usize| Point::from_fn(|d, _| if k >> d & 1 == 1 { 1.0 } else { -1.0 });
                let polygons =
                    [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
                Surface {
                    points: (0..8).map(corner).map(place).collect(),
                    polygons: polygons.into_iter().map(|corners| corners.to_vec()).collect(),
                }
            }
            Self::Ellipsoid => {
                let rings = ARC / 2;
                let on = |ring: usize, k: usize| {
                    let (out, up) = (ring as f64 * PI / rings as f64).sin_cos();
                    Point::new(out * arc(k).1, out * arc(k).0, -up)
                };
                let points = (0..=rings).flat_map(|ring| (0..ARC).map(move |k| on(ring, k)));
                let number = |ring: usize, k: usize| (ring * ARC + k % ARC) as u32;
                let quad = |ring: usize, k: usize| {
                    let mut corners = vec![
                        number(ring, k),
                        number(ring, k + 1),
                        number(ring + 1, k + 1),
                        number(ring + 1, k),
                    ];
                    // At the poles all corners of a ring are one.
                    if ring == 0 {
                        corners.remove(1);
                    } else if ring + 1 == rings {
                        corners.remove(2);
                    }
                    corners
                };
                let polygons = (0..rings).flat_map(|ring| (0..ARC).map(move |k| quad(ring, k))).collect();
                Surface { points: points.map(place).collect(), polygons }
            }
            Self::Cylinder { axis } => {
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                let on = |end: f64, k: usize| {
                    let mut p = Point::zeros();
                    (p[*axis], p[u], p[v]) = (end, arc(k).1, arc(k).0);
                    p
                };
                let points = (0..2 * ARC).map(|k| on(if k < ARC { -1.0 } else { 1.0 }, k));
                let (count, next) = (ARC as u32, |k: u32| (k + 1) % ARC as u32);
                let sides = (0..count).map(|k| vec![k, next(k), count + next(k), count + k]);
                let ends = [(0..count).rev().collect(), (count..2 * count).collect()];
                Surface { points: points.map(place).collect(), polygons: sides.chain(ends).collect() }
            }
            Self::Mesh(mesh) => mesh.surface.clone(),
        }
    }
}

/// A vector as a point in space.
pub fn point<const D: usize>(r: &Vector<D>) -> Point {
    Point::from_fn(|d, _| if d < D { r[d] } else { 0.0 })
}

/// A closed triangle mesh whose triangles are counterclockwise from outside.
#[derive(Debug, Clone, PartialEq)]
pub struct Mesh {
    surface: Surface,
}

impl Mesh {
    /// Reads an STL file, binary or text, its lengths multiplied by `scale`, and moves it by `offset` m.
    ///
    /// # Errors
    /// What is wrong with it: no STL, open, or inside out.
    pub fn read(bytes: &[u8], scale: f64, offset: Point) -> std::result::Result<Self, String> {
        let corners = binary(bytes).or_else(|| text(bytes)).ok_or("is no STL file: export it as one")?;
        let mut numbers = HashMap::new();
        let mut surface = Surface::default();
        let mut number = |p: &[f32; 3]| {
            // Adding zero makes one number of 0 and -0.
            *numbers.entry(p.map(|x| (x + 0.0).to_bits())).or_insert_with(|| {
                surface.points.push(Point::from_fn(|d, _| f64::from(p[d])) * scale + offset);
                surface.points.len() as u32 - 1
            })
        };
        let triangles: Vec<[u32; 3]> =
            corners.iter().map(|corners| [0, 1, 2].map(|k| number(&corners[k]))).collect();
        let is_flat = |t: &[u32; 3]| t[0] == t[1] || t[1] == t[2] || t[2] == t[0];
        surface.polygons = triangles.iter().filter(|t| !is_flat(t)).map(|t| t.to_vec()).collect();
        let mesh = Self { surface };
        match mesh.open_edges() {
            0 if mesh.surface.polygons.is_empty() => Err("holds no triangle: export it again".into()),
            0 if mesh.volume() < 0.0 => Err("is inside out: turn its triangles round".into()),
            0 => Ok(mesh),
            open => Err(format!("is open along {open} edges of triangles: close it")),
        }
    }

    /// Lowest and highest coordinates in m.
    pub fn extent(&self) -> (Point, Point) {
        let points = self.surface.points.iter();
        points.fold((Point::repeat(f64::INFINITY), Point::repeat(f64::NEG_INFINITY)), |(low, high), p| {
            (low.inf(p), high.sup(p))
        })
    }

    /// Its corners in m.
    pub fn points(&self) -> &[Point] {
        &self.surface.points
    }

    /// Its triangles by their corners.
    pub fn triangles(&self) -> impl Iterator<Item = [u32; 3]> + '_ {
        self.surface.polygons.iter().map(|t| [t[0], t[1], t[2]])
    }

    /// Edges that do not meet as many of the opposite direction.
    fn open_edges(&self) -> usize {
        let mut balance: HashMap<(u32, u32), i32> = HashMap::new();
        for [a, b, c] in self.triangles() {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                *balance.entry((from.min(to), from.max(to))).or_default() += if from < to { 1 } else { -1 };
            }
        }
        balance.values().filter(|count| **count != 0).count()
    }

    fn corners(&self, triangle: [u32; 3]) -> [Point; 3] {
        triangle.map(|k| self.surface.points[k as usize])
    }

    fn volume(&self) -> f64 {
        self.triangles().map(|t| self.corners(t)).map(|[a, b, c]| a.dot(&b.cross(&c)) / 6.0).sum()
    }

    /// How often the mesh winds around a point (van Oosterom & Strackee 1983, IEEE Trans. Biomed. Eng. 30, 125-126).
    fn winding(&self, at: &Point) -> f64 {
        let angle = |t: [u32; 3]| {
            let [a, b, c] = self.corners(t).map(|corner| corner - at);
            let [la, lb, lc] = [a.norm(), b.norm(), c.norm()];
            let below = la * lb * lc + a.dot(&b) * lc + b.dot(&c) * la + c.dot(&a) * lb;
            2.0 * a.dot(&b.cross(&c)).atan2(below)
        };
        self.triangles().map(angle).sum::<f64>() / (4.0 * PI)
    }
}

/// Corners of the triangles of a binary STL: 80 bytes, their number, and 50 bytes each.
fn binary(bytes: &[u8]) -> Option<Vec<[[f32; 3]; 3]>> {
    let count = u32::from_le_bytes(*bytes.get(80..84)?.first_chunk()?) as usize;
    let triangles = bytes.get(84..)?.chunks_exact(50);
    if triangles.len() != count || !triangles.remainder().is_empty() {
        return None;
    }
    let number = |triangle: &[u8], k: usize| {
        let at = 12 + 4 * k;
        f32::from_le_bytes([triangle[at], triangle[at + 1], triangle[at + 2], triangle[at + 3]])
    };
    let corners = triangles.map(|t| [0, 1, 2].map(|c| [0, 1, 2].map(|d| number(t, 3 * c + d))));
    corners.map(|t| t.iter().flatten().all(|x| x.is_finite()).then_some(t)).collect()
}

/// Corners of the triangles of a text STL.
fn text(bytes: &[u8]) -> Option<Vec<[[f32; 3]; 3]>> {
    let text = std::str::from_utf8(bytes).ok().filter(|text| text.trim_start().starts_with("solid"))?;
    let vertex = |line: &str| -> Option<Option<[f32; 3]>> {
        let numbers = line.trim().strip_prefix("vertex")?;
        let numbers: Option<Vec<f32>> = numbers.split_whitespace().map(|x| x.parse().ok()).collect();
        Some(numbers.and_then(|x| <[f32; 3]>::try_from(x).ok()).filter(|x| x.iter().all(|x| x.is_finite())))
    };
    let vertices: Vec<[f32; 3]> = text.lines().filter_map(vertex).collect::<Option<_>>()?;
    let triangles = vertices.chunks_exact(3);
    triangles.remainder().is_empty().then(|| triangles.map(|t| [t[0], t[1], t[2]]).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Corners of a tetrahedron's four triangles, counterclockwise from outside.
    const TETRAHEDRON: [[[f32; 3]; 3]; 4] = {
        let (o, x, y, z) = ([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
        [[o, y, x], [o, x, z], [o, z, y], [x, y, z]]
    };

    fn as_binary(triangles: &[[[f32; 3]; 3]]) -> Vec<u8> {
        let mut bytes = vec![0; 80];
        bytes.extend((triangles.len() as u32).to_le_bytes());
        for corners in triangles {
            bytes.extend([0; 12]);
            bytes.extend(corners.iter().flatten().flat_map(|x| x.to_le_bytes()));
            bytes.extend([0; 2]);
        }
        bytes
    }

    fn as_text(triangles: &[[[f32; 3]; 3]]) -> Vec<u8> {
        let mut text = "solid t\n".to_owned();
        for corners in triangles {
            text += "facet normal 0 0 0\nouter loop\n";
            corners.iter().for_each(|[x, y, z]| text += &format!("vertex {x} {y} {z}\n"));
            text += "endloop\nendfacet\n";
        }
        text.into_bytes()
    }

    #[test]
    fn meshes_are_read_and_contain_what_is_inside() {
        for bytes in [as_binary(&TETRAHEDRON), as_text(&TETRAHEDRON)] {
            let mesh = Mesh::read(&bytes, 2.0, Point::new(1.0, 0.0, 0.0)).unwrap();
            assert!((mesh.volume() - 8.0 / 6.0).abs() < 1e-12);
            assert_eq!(mesh.extent(), (Point::new(1.0, 0.0, 0.0), Point::new(3.0, 2.0, 2.0)));
            let form = Form::Mesh(Arc::new(mesh));
            let inside = form.filter(&Aabb { min: Vector::<3>::zeros(), max: Vector::<3>::zeros() });
            assert!(inside(&Vector::<3>::new(1.4, 0.4, 0.4)));
            assert!(!inside(&Vector::<3>::new(2.0, 1.0, 1.0)));
            assert!(!inside(&Vector::<3>::new(0.9, 0.1, 0.1)));
        }
    }

    #[test]
    fn bad_meshes_are_refused_in_a_sentence() {
        let read = |bytes: &[u8]| Mesh::read(bytes, 1.0, Point::zeros()).unwrap_err();
        assert_eq!(read(&as_binary(&TETRAHEDRON[..3])), "is open along 3 edges of triangles: close it");
        let turned = TETRAHEDRON.map(|[a, b, c]| [a, c, b]);
        assert_eq!(read(&as_text(&turned)), "is inside out: turn its triangles round");
        assert_eq!(read(b"PNG"), "is no STL file: export it as one");
        assert_eq!(read(b"solid empty\n"), "holds no triangle: export it again");
    }

    #[test]
    fn surfaces_are_closed_and_turn_outward() {
        let extent = Aabb { min: Vector::<3>::zeros(), max: Vector::<3>::new(1.0, 2.0, 3.0) };
        for (form, share) in
            [(Form::Box, 1.0), (Form::Ellipsoid, PI / 6.0), (Form::Cylinder { axis: 1 }, PI / 4.0)]
        {
            let surface = form.surface(&extent);
            let mut volume = 0.0;
            for polygon in &surface.polygons {
                for k in 1..polygon.len() - 1 {
                    let [a, b, c] = [0, k, k + 1].map(|k| surface.points[polygon[k] as usize]);
                    volume += a.dot(&b.cross(&c)) / 6.0;
                }
            }
            // 48 pieces of a circle fill 0.3 % less of it.
            assert!((volume / (6.0 * share) - 1.0).abs() < 0.01, "{form:?}: {volume}");
        }
    }
}
