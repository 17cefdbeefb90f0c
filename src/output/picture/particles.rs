//! Particles coloured by pressure: all of them in 2D; in 3D a vertical slice through the middle and a view from outside.

use std::ops::Range;
use std::path::Path;

use plotters::element::{Circle, PathElement, Polygon, Rectangle};
use plotters::style::text_anchor::{HPos, VPos};
use plotters::style::{BLACK, Color, RGBColor};

use super::color::{ColorScale, darker};
use super::{Area, Axes, Drawn, Place, dots, letters, number, ticks, write_png};
use crate::Result;
use crate::particles::Vector;

/// Largest plot in pixels; its shape is that of the scene.
const PLOT: (f64, f64) = (820.0, 620.0);
/// Pixels around a plot: for its labels at the left and below, the title above, the colours at the right.
const LEFT: i32 = 85;
const BELOW: i32 = 60;
const ABOVE: i32 = 55;
const RIGHT: i32 = 135;
/// Narrowest plot in pixels that leaves room for a title.
const NARROWEST: i32 = 360;
/// Height of the view from outside in pixels.
const VIEW: i32 = 470;

const WALL: RGBColor = RGBColor(165, 165, 165);
const STRUCTURE: RGBColor = RGBColor(176, 140, 104);
const FLOOR: RGBColor = RGBColor(236, 236, 236);
const EDGE: RGBColor = RGBColor(110, 110, 110);

/// What a picture shows.
#[derive(Debug, Clone, Copy)]
pub struct Scene<'a, const D: usize> {
    /// Line above the picture.
    pub title: &'a str,
    /// Positions of the liquid particles in m.
    pub fluid: &'a [Vector<D>],
    /// Their pressures in Pa.
    pub pressure: &'a [f64],
    /// Positions of the wall particles in m.
    pub walls: &'a [Vector<D>],
    /// Particle spacing in m.
    pub spacing: f64,
    /// Lower and upper inner corner of the tank in m: what is shown. Without a tank, that is where particles are.
    pub tank: Option<(Vector<D>, Vector<D>)>,
}

/// Draws a scene in two or three dimensions as a PNG file.
///
/// # Errors
/// [`Error::Io`](crate::Error::Io) if the file cannot be written.
pub fn particle_picture<const D: usize>(path: &Path, scene: &Scene<D>) -> Result<()> {
    let colors = ColorScale::of(scene.pressure.iter().copied());
    let (low, high) = scene.frame();
    let (x, up) = (low[0]..high[0], low[D - 1]..high[D - 1]);
    let scale = (PLOT.0 / (x.end - x.start)).min(PLOT.1 / (up.end - up.start));
    let size = |range: &Range<f64>| ((range.end - range.start) * scale).round().max(40.0) as i32;
    let (wide, high) = (size(&x), size(&up));
    let column = wide.max(NARROWEST);
    let view = if D == 3 { VIEW } else { 0 };
    let picture = (LEFT + column + RIGHT, ABOVE + high + BELOW + view);
    write_png(path, picture, |area| {
        let middle = dots(LEFT + column / 2);
        area.draw_text(scene.title, &letters(HPos::Center, VPos::Top), (middle, dots(18)))?;
        let place = Place { left: LEFT + (column - wide) / 2, top: ABOVE, width: wide, height: high };
        map(area, place, (x, up), scene, &colors)?;
        if D == 3 {
            let below = Place { left: LEFT, top: ABOVE + high + BELOW, width: column, height: VIEW - 20 };
            perspective(area, below, scene, &colors)?;
        }
        let bar = Place { left: LEFT + column + 28, top: ABOVE + 14, width: 20, height: high.max(200) - 14 };
        color_bar(area, bar, &colors)
    })
}

impl<const D: usize> Scene<'_, D> {
    /// Corners of what is shown: the tank with its walls, or all particles.
    fn frame(&self) -> (Vector<D>, Vector<D>) {
        let margin = Vector::repeat(1.5 * self.spacing);
        if let Some((low, high)) = self.tank {
            return (low - margin, high + margin);
        }
        let all = || self.fluid.iter().chain(self.walls).filter(|r| r.iter().all(|x| x.is_finite()));
        match all().next() {
            None => (Vector::zeros(), Vector::repeat(1.0)),
            Some(&first) => {
                let low = all().fold(first, |low, r| low.inf(r));
                let high = all().fold(first, |high, r| high.sup(r));
                (low - margin, high + margin)
            }
        }
    }

    /// Wall particles in their colour, then the liquid in its colours.
    fn particles(&self, colors: &ColorScale) -> impl Iterator<Item = (Vector<D>, RGBColor)> {
        let walls = self.walls.iter().map(|&r| (r, WALL));
        let fluid = self.fluid.iter().zip(self.pressure);
        let fluid: Vec<_> = fluid.map(|(&r, &p)| (r, colors.color(p))).collect();
        walls.chain(fluid).filter(|(r, _)| r.iter().all(|x| x.is_finite()))
    }
}

/// The plane of the first and the last axis: in 3D the particles within one spacing of the middle.
fn map<const D: usize>(
    area: &Area,
    place: Place,
    (x, up): (Range<f64>, Range<f64>),
    scene: &Scene<D>,
    colors: &ColorScale,
) -> Drawn {
    // About one mark in 90 pixels across and in 60 up.
    let marks = |range: &Range<f64>, pixels: i32, each: i32| {
        ticks(range.start, range.end, (pixels / each).clamp(2, 10) as usize)
    };
    let axes = Axes {
        place,
        x: (x.start, x.end),
        y: (up.start, up.end),
        marks: (marks(&x, place.width, 90), marks(&up, place.height, 60)),
        names: ("x, m", if D == 2 { "height, m" } else { "z, m" }),
        label: number,
        grid: false,
    };
    axes.draw(area)?;
    // A little more than half a spacing: no gaps between the discs of a lattice.
    let radius = 0.54 * scene.spacing * f64::from(dots(place.width)) / (x.end - x.start);
    let radius = radius.ceil().max(1.0) as i32;
    let (low, high) = scene.frame();
    let middle = 0.5 * (low + high);
    let shown = |r: &Vector<D>| {
        let inside = x.contains(&r[0]) && up.contains(&r[D - 1]);
        inside && (D == 2 || (r[1] - middle[1]).abs() <= scene.spacing)
    };
    for (r, color) in scene.particles(colors).filter(|(r, _)| shown(r)) {
        area.draw(&Circle::new(axes.dot((r[0], r[D - 1])), radius, color.filled()))?;
    }
    Ok(())
}

/// Colours and the pressures they stand for.
fn color_bar(area: &Area, place: Place, colors: &ColorScale) -> Drawn {
    let (left, right) = (dots(place.left), dots(place.left + place.width));
    let (top, height) = (dots(place.top), dots(place.height));
    let at = |pressure: f64| {
        let share = (pressure - colors.low) / (colors.high - colors.low);
        top + height - (share * f64::from(height)).round() as i32
    };
    for y in 0..height {
        let pressure = colors.high + (colors.low - colors.high) * f64::from(y) / f64::from(height);
        let style = colors.color(pressure).filled();
        area.draw(&Rectangle::new([(left, top + y), (right, top + y + 1)], style))?;
    }
    area.draw(&Rectangle::new([(left, top), (right, top + height)], BLACK.stroke_width(1)))?;
    for mark in ticks(colors.low, colors.high, (place.height / 60).clamp(2, 8) as usize) {
        area.draw(&PathElement::new(
            [(right, at(mark)), (right + dots(5), at(mark))],
            BLACK.stroke_width(2),
        ))?;
        let style = letters(HPos::Left, VPos::Center);
        area.draw_text(&number(mark), &style, (right + dots(10), at(mark)))?;
    }
    let style = letters(HPos::Left, VPos::Bottom);
    area.draw_text("pressure, Pa", &style, (left - dots(10), top - dots(12)))?;
    Ok(())
}

/// A view of a 3D scene from outside: the tank as a glass box, what stands in it, and the liquid.
///
/// The painter's algorithm: the farthest first, each disc as large as its distance makes it.
fn perspective<const D: usize>(area: &Area, place: Place, scene: &Scene<D>, colors: &ColorScale) -> Drawn {
    let (low, high) = scene.tank.unwrap_or_else(|| scene.frame());
    let camera = Camera::towards(low, high);
    let corners: Vec<[f64; 3]> = (0..8).map(|k| camera.see(&corner(low, high, k))).collect();
    let bounds = |axis: usize| {
        let all = corners.iter().map(|seen| seen[axis]);
        (all.clone().fold(f64::INFINITY, f64::min), all.fold(f64::NEG_INFINITY, f64::max))
    };
    let ((left, right), (bottom, top)) = (bounds(0), bounds(1));
    let (width, height) = (f64::from(dots(place.width)), f64::from(dots(place.height)));
    let scale = (width / (right - left)).min(height / (top - bottom));
    let dot = |seen: &[f64; 3]| {
        let x = f64::from(dots(place.left)) + 0.5 * width + scale * (seen[0] - 0.5 * (left + right));
        let y = f64::from(dots(place.top)) + 0.5 * height - scale * (seen[1] - 0.5 * (bottom + top));
        (x.round() as i32, y.round() as i32)
    };
    let line = |from: usize, to: usize, strength: f64| {
        PathElement::new([dot(&corners[from]), dot(&corners[to])], EDGE.mix(strength).stroke_width(2))
    };

    let floor: Vec<_> = [0, 1, 3, 2].iter().map(|&k| dot(&corners[k])).collect();
    area.draw(&Polygon::new(floor, FLOOR.filled()))?;
    for (from, to) in edges() {
        area.draw(&line(from, to, 0.7))?;
    }
    // The tank's own walls would hide everything.
    let stands_inside = |r: &Vector<D>| {
        scene.tank.is_none() || (0..D).all(|d| low[d] < r[d] && (r[d] < high[d] || d == D - 1))
    };
    let particles = scene.particles(colors).filter(|(r, color)| *color != WALL || stands_inside(r));
    let mut seen: Vec<_> = particles.map(|(r, color)| (camera.see(&r), color)).collect();
    seen.sort_by(|(a, _), (b, _)| b[2].total_cmp(&a[2]));
    let inside = |(x, y): (i32, i32)| x > 0 && y > dots(place.top) && y < dots(place.top + place.height + 15);
    let radius_at = |distance: f64| (0.56 * scale * scene.spacing / distance).ceil().max(1.0);
    // A darker rim tells one particle from the next, where there are dots enough for it. What stands in the tank always
    // has it: all of one colour, its edges would not show.
    let rimmed = radius_at(camera.see(&(0.5 * (low + high)))[2]) > 6.0;
    for (at, color) in seen {
        let color = if color == WALL { STRUCTURE } else { color };
        let radius = radius_at(at[2]);
        let centre = dot(&at);
        if at[2] > 0.0 && inside(centre) {
            let rim = rimmed || color == STRUCTURE;
            let outer = if rim { darker(color) } else { color };
            area.draw(&Circle::new(centre, radius as i32, outer.filled()))?;
            if rim {
                area.draw(&Circle::new(centre, (0.72 * radius).round() as i32, color.filled()))?;
            }
        }
    }
    // The edges in front of the liquid once more: all that do not end in the farthest corner.
    let farthest = (0..8).max_by(|&a, &b| corners[a][2].total_cmp(&corners[b][2])).unwrap_or(0);
    for (from, to) in edges().filter(|&(from, to)| from != farthest && to != farthest) {
        area.draw(&line(from, to, 0.35))?;
    }
    Ok(())
}

/// Corner `k` of a box: bit d of `k` chooses the end along axis d.
fn corner<const D: usize>(low: Vector<D>, high: Vector<D>, k: usize) -> Vector<D> {
    Vector::from_fn(|d, _| if k >> d & 1 == 0 { low[d] } else { high[d] })
}

/// Pairs of corners that differ in one bit.
fn edges() -> impl Iterator<Item = (usize, usize)> {
    (0..8).flat_map(|k| (0..3).map(move |d| (k, k | 1 << d))).filter(|(from, to)| from != to)
}

/// An eye in front of a scene (low y), to the right and above, looking at its middle.
struct Camera {
    eye: [f64; 3],
    right: [f64; 3],
    up: [f64; 3],
    forward: [f64; 3],
}

impl Camera {
    /// From the middle of a scene towards the eye.
    const DIRECTION: [f64; 3] = [0.5, -1.0, 0.55];
    /// Distance of the eye in diagonals of the scene: near enough that depth shows.
    const DISTANCE: f64 = 1.6;

    fn towards<const D: usize>(low: Vector<D>, high: Vector<D>) -> Self {
        let direction = unit(Self::DIRECTION);
        let distance = Self::DISTANCE * (high - low).norm();
        let eye = std::array::from_fn(|d| 0.5 * (low[d] + high[d]) + distance * direction[d]);
        let forward = direction.map(|x| -x);
        let right = unit(cross(forward, [0.0, 0.0, 1.0]));
        Self { eye, right, up: cross(right, forward), forward }
    }

    /// Place to the right and up in units of the picture plane at distance 1, and the distance in m.
    fn see<const D: usize>(&self, at: &Vector<D>) -> [f64; 3] {
        let away: [f64; 3] = std::array::from_fn(|d| at[d] - self.eye[d]);
        let along = |axis: [f64; 3]| -> f64 { axis.iter().zip(away).map(|(a, b)| a * b).sum() };
        let distance = along(self.forward);
        [along(self.right) / distance, along(self.up) / distance, distance]
    }
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn unit(a: [f64; 3]) -> [f64; 3] {
    let length = a.iter().map(|x| x * x).sum::<f64>().sqrt();
    a.map(|x| x / length)
}
