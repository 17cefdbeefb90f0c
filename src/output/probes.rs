//! Gauges: pressure at a point, water height on a vertical line.
//!
//! **Place.** A gauge within half a spacing of a side of a box or a tank wall lies on that side and goes with it to the
//! lattice; any other stays where the case puts it.
//!
//! **Pressure** at r is the kernel mean over liquid and wet walls, each neighbour's pressure carried to r
//! hydrostatically: p(r) = sum_b W_b (p_b + rho g . (r - r_b)) / sum_b W_b. In still water this is exact wherever r lies,
//! on a wall's face too. Only what r sees counts: liquid with no solid box in between, and wall particles one of whose
//! faces it sees, so that a thin box does not mix the pressures of its two sides. (A plate one particle thick is open on
//! two opposite sides and carries one pressure for both: its own particles do not count.) Walls that carry no pressure but repel liquid
//! tell what pushes them: where a gauge sees some beside liquid, p_b is the force on such a particle along its normal over the area that
//! it stands for, and liquid does not count: its pressures ring beside a wall that stops particles one by one. A gauge whose liquid neighbours fill less than a quarter of what a flat wall leaves
//! open is *dry*.
//!
//! A gauge with a **body** rides on it: it moves and turns with it, and sees of the walls those of that body's, of the liquid what is
//! before its face.
//!
//! A **filter**, if asked for, is the mean of the rows within the last `filter` seconds: causal, so a signal comes out
//! half the window late. Dry rows count as 0 in it; a gauge that is dry now says so all the same.
//!
//! **Height** is where, going up from the foot of the line, liquid first fills less than half of the kernel. What lies
//! below the foot counts as filled (the floor), other solids as if not there (a box or wall beside the line): so at
//! a flat surface, beside a box as well, the height is half a spacing above the top row, where the surface is, and a
//! single layer on the floor is one spacing high. Splashes above a gap do not count.

use super::checkpoint;
use super::table::Cell;
use crate::bodies::{Bodies, restrict};
use crate::case::{Probe, build::vector};
use crate::geometry::{Lattice, Obstacles, WallCell};
use crate::parallel::Packed;
use crate::particles::{Particles, Vector};
use crate::scheme::{Fields, Params};
use crate::{Error, Result};
use std::collections::VecDeque;

/// What a gauge says where there is no water.
pub const DRY: &str = "dry";

/// Share of the kernel that liquid must fill at a pressure gauge.
const WET: f64 = 0.125;

/// Within how many spacings liquid stands beside a wall particle.
const BESIDE: f64 = 1.5;

/// All gauges of a scene.
pub struct Gauges<const D: usize> {
    gauges: Vec<Gauge<D>>,
    bins: Bins,
    obstacles: Obstacles<D>,
    params: Params<D>,
}

struct Gauge<const D: usize> {
    at: Vector<D>,
    kind: Kind<D>,
    rider: Option<Rider<D>>,
}

/// How a gauge sits on a body, both at the start.
struct Rider<const D: usize> {
    body: usize,
    /// From the body's centre in m.
    arm: Vector<D>,
    /// Normal of the face; zero where it is on none.
    outward: Vector<D>,
}

impl<const D: usize> Gauge<D> {
    /// Goes where its body is.
    fn ride(&mut self, bodies: &Bodies<D>) {
        if let Some(rider) = &self.rider {
            let body = &bodies.list[rider.body];
            self.at = restrict::<D>(&body.state.position) + body.turned(&rider.arm);
        }
    }

    /// Whether a body that it rides on leaves the sight of `r` free. Half a spacing is for liquid that is pressed into the face.
    fn sees(&self, r: &Vector<D>, bodies: &Bodies<D>, spacing: f64) -> bool {
        self.rider.as_ref().is_none_or(|rider| {
            let outward = bodies.list[rider.body].turned(&rider.outward);
            outward.dot(&(r - self.at)) >= -0.5 * spacing
        })
    }

    /// Wall particles in sight, with their kernel values.
    fn walls(&self) -> &[(u32, f64)] {
        match &self.kind {
            Kind::Pressure { walls, .. } => walls,
            Kind::Height { .. } => &[],
        }
    }
}

/// A particle of the liquid near a gauge.
#[derive(Clone, Copy)]
struct Liquid<const D: usize> {
    r: Vector<D>,
    pressure: f64,
}

/// A wall particle in sight of a gauge.
struct Wall<const D: usize> {
    r: Vector<D>,
    /// Kernel value of the gauge.
    weight: f64,
    is_active: bool,
    pressure: f64,
    /// Force of the liquid along the normal, in N.
    push: f64,
}

/// Solids keep their distances from a gauge, on which it rides if they move: what it needs of them is found once.
enum Kind<const D: usize> {
    Pressure {
        /// Wall particles in sight, with their kernel values.
        walls: Vec<(u32, f64)>,
        filter: Option<Filter>,
    },
    Height {
        /// Positions of the solid particles around the line.
        solids: Vec<Vector<D>>,
    },
}

impl<const D: usize> Gauges<D> {
    /// Gauges among `probes`, in the scene of `particles` on `lattice`, for a scheme with these parameters.
    pub fn new(probes: &[Probe], lattice: &Lattice<D>, particles: &Particles<D>, params: &Params<D>) -> Self {
        let support = params.support();
        let mut all = Self {
            gauges: vec![],
            bins: Bins::default(),
            obstacles: lattice.obstacles(),
            params: params.clone(),
        };
        let cells = lattice.wall_cells();
        for probe in probes {
            let Some(position) = probe.position().map(vector) else { continue };
            let ridden = |name| params.bodies.list.iter().position(|body| body.name == name);
            let body = probe.rides_on().and_then(ridden);
            let at = match body {
                Some(body) => lattice.follow_body(body, &position),
                None => lattice.follow(&position).0,
            };
            let mut rider = None;
            let kind = match probe {
                Probe::Pressure { filter, .. } => {
                    let walls = match body {
                        Some(body) => all.walls_of(body, &at, particles),
                        None => all.walls_in_sight(&at, particles, &cells),
                    };
                    rider = body.map(|body| {
                        let normal = |&(a, w): &(u32, f64)| w * particles.normal[a as usize];
                        let outward: Vector<D> = walls.iter().map(normal).sum();
                        let arm = at - restrict::<D>(&params.bodies.list[body].state.position);
                        Rider { body, arm, outward: outward.try_normalize(0.0).unwrap_or_else(Vector::zeros) }
                    });
                    Kind::Pressure { walls, filter: filter.map(Filter::new) }
                }
                _ => {
                    let near = |r: &&Vector<D>| horizontal_square(&at, r) < support * support;
                    Kind::Height {
                        // Those that move away are not beside it for long.
                        solids: (0..particles.solids())
                            .filter(|&a| params.bodies.movable(a).is_none())
                            .map(|a| &particles.position[a])
                            .filter(near)
                            .copied()
                            .collect(),
                    }
                }
            };
            all.gauges.push(Gauge { at, kind, rider });
        }
        all.bins = all.bins();
        all
    }

    fn bins(&self) -> Bins {
        Bins::new(self.gauges.iter().map(|gauge| gauge.at[0]), self.params.support())
    }

    /// Walls of a body whose outer side faces `at`, with their kernel values: they keep their distances.
    fn walls_of(&self, body: usize, at: &Vector<D>, particles: &Particles<D>) -> Vec<(u32, f64)> {
        let in_sight = |a: usize| {
            let away = at - particles.position[a];
            let is_seen = away.norm() < self.params.support() && away.dot(&particles.normal[a]) > 0.0;
            is_seen.then(|| (a as u32, self.weight(away.norm())))
        };
        particles.walls().filter(|&a| self.params.bodies.of(a) == Some(body)).filter_map(in_sight).collect()
    }

    fn walls_in_sight(
        &self,
        at: &Vector<D>,
        particles: &Particles<D>,
        cells: &[WallCell<D>],
    ) -> Vec<(u32, f64)> {
        let in_sight = |(a, cell): (usize, &WallCell<D>)| {
            let centre = particles.position[a];
            let r = (at - centre).norm();
            let is_plate = cell.open.contains(&[true, true]);
            let is_seen = |(axis, end): (usize, usize)| {
                let mut face = centre;
                face[axis] += (end as f64 - 0.5) * self.params.spacing;
                cell.open[axis][end] && self.obstacles.leave_free(at, &face)
            };
            let mut sides = (0..D).flat_map(|axis| [(axis, 0), (axis, 1)]);
            let is_closed = cell.open == [[false; 2]; D];
            let seen = sides.any(is_seen) || is_closed && self.obstacles.leave_free(at, &centre);
            (r < self.params.support() && !is_plate && seen).then(|| (a as u32, self.weight(r)))
        };
        cells.iter().enumerate().filter_map(in_sight).collect()
    }

    /// Present values, in the order of the probes, where the last step felt `body_force` m/s2; `time` in s tells filters how
    /// old a reading is. All ranks read together, each its liquid and the walls that it `holds`.
    pub fn read(
        &mut self,
        particles: &Particles<D>,
        bodies: &Bodies<D>,
        fields: &Fields<D>,
        holds: impl Fn(usize) -> bool,
        body_force: &Vector<D>,
        time: f64,
    ) -> Vec<Cell<'static>> {
        self.params.gravity = *body_force;
        if self.gauges.iter().any(|gauge| gauge.rider.is_some()) {
            self.gauges.iter_mut().for_each(|gauge| gauge.ride(bodies));
            self.bins = self.bins();
        }
        let near = self.liquid_near(particles);
        let walls = self.walls_seen(particles, fields, holds);
        let reading =
            |((gauge, near), walls): ((&Gauge<D>, &Vec<Liquid<D>>), &Vec<Wall<D>>)| match &gauge.kind {
                Kind::Pressure { .. } => self.pressure(fields, bodies, gauge, (near, walls)),
                Kind::Height { solids } => self.height(&gauge.at, solids, near),
            };
        let readings: Vec<Option<f64>> = self.gauges.iter().zip(&near).zip(&walls).map(reading).collect();
        let filtered = self.gauges.iter_mut().zip(readings).map(|(gauge, reading)| match &mut gauge.kind {
            Kind::Pressure { filter: Some(filter), .. } => {
                let mean = filter.mean_with(time, reading.unwrap_or(0.0));
                reading.map(|_| mean)
            }
            _ => reading,
        });
        filtered.map(|value| value.map_or(Cell::Word(DRY), Cell::Number)).collect()
    }

    /// For each gauge the liquid of all ranks that it may count.
    fn liquid_near(&self, particles: &Particles<D>) -> Vec<Vec<Liquid<D>>> {
        let support = self.params.support();
        let reach = support + BESIDE * self.params.spacing;
        let mut message = vec![];
        for (number, (gauge, near)) in self.gauges.iter().zip(self.bins.sort(particles)).enumerate() {
            for b in near.into_iter().map(|b| b as usize) {
                let r = &particles.position[b];
                let is_near = match gauge.kind {
                    Kind::Pressure { .. } => (gauge.at - r).norm_squared() < reach * reach,
                    Kind::Height { .. } => horizontal_square(&gauge.at, r) < support * support,
                };
                if is_near {
                    message.push(number as f64);
                    r.pack(&mut message);
                    message.push(particles.pressure[b]);
                }
            }
        }
        let mut near = vec![vec![]; self.gauges.len()];
        for words in self.params.ranks.all(&message).iter().flat_map(|part| part.chunks_exact(D + 2)) {
            near[words[0] as usize].push(Liquid { r: Vector::unpack(&words[1..=D]), pressure: words[D + 1] });
        }
        near
    }

    /// For each gauge the walls in its sight, as the ranks that hold them know them.
    fn walls_seen(
        &self,
        particles: &Particles<D>,
        fields: &Fields<D>,
        holds: impl Fn(usize) -> bool,
    ) -> Vec<Vec<Wall<D>>> {
        let knowledge = |&(b, _): &(u32, f64)| {
            let b = b as usize;
            if !holds(b) {
                return [0.0; 3];
            }
            let is_active = fields.active.get(b).copied().unwrap_or(false);
            let push = fields.wall_force.get(b).map_or(0.0, |force| -force.dot(&particles.normal[b]));
            [f64::from(u8::from(is_active)), particles.pressure[b], push]
        };
        let here: Vec<f64> = self.gauges.iter().flat_map(Gauge::walls).flat_map(knowledge).collect();
        let everywhere = self.params.ranks.sums(&here);
        let mut known = everywhere.as_chunks().0.iter();
        let wall = |(&(b, weight), &[active, pressure, push]): (&(u32, f64), &[f64; 3])| Wall {
            r: particles.position[b as usize],
            weight,
            is_active: active > 0.0,
            pressure,
            push,
        };
        self.gauges.iter().map(|gauge| gauge.walls().iter().zip(&mut known).map(wall).collect()).collect()
    }

    fn weight(&self, r: f64) -> f64 {
        self.params.kernel.value::<D>(r, self.params.smoothing_length())
    }

    fn pressure(
        &self,
        fields: &Fields<D>,
        bodies: &Bodies<D>,
        gauge: &Gauge<D>,
        (near, walls): (&[Liquid<D>], &[Wall<D>]),
    ) -> Option<f64> {
        let (at, spacing) = (&gauge.at, self.params.spacing);
        let (support, gradient) = (self.params.support(), self.params.density * self.params.gravity);
        let (mut weights, mut sum) = (0.0, 0.0);
        let mut add = |r: &Vector<D>, pressure: f64, w: f64| {
            weights += w;
            sum += w * (pressure + gradient.dot(&(at - r)));
            weights
        };
        let mut wet = 0.0;
        for liquid in near {
            let r = (at - liquid.r).norm();
            let is_seen =
                || self.obstacles.leave_free(at, &liquid.r) && gauge.sees(&liquid.r, bodies, spacing);
            if r < support && is_seen() {
                wet = add(&liquid.r, liquid.pressure, self.weight(r));
            }
        }
        if wet * self.params.volume() <= WET {
            return None;
        }
        if !fields.walls_carry_pressure {
            let feel = !fields.wall_force.is_empty();
            let pushed = if feel { self.pressure_by_force(at, near, walls) } else { None };
            return Some(pushed.unwrap_or(sum / weights));
        }
        for wall in walls.iter().filter(|wall| wall.is_active) {
            add(&wall.r, wall.pressure, wall.weight);
        }
        Some(sum / weights)
    }

    /// What liquid pushes walls in sight with, in Pa, where it stands beside some.
    fn pressure_by_force(&self, at: &Vector<D>, near: &[Liquid<D>], walls: &[Wall<D>]) -> Option<f64> {
        let (spacing, gradient) = (self.params.spacing, self.params.density * self.params.gravity);
        let is_beside_liquid =
            |r: &Vector<D>| near.iter().any(|liquid| (liquid.r - r).norm() < BESIDE * spacing);
        let (mut weights, mut sum) = (0.0, 0.0);
        for wall in walls.iter().filter(|wall| is_beside_liquid(&wall.r)) {
            let pressure = wall.push / spacing.powi(D as i32 - 1);
            weights += wall.weight;
            sum += wall.weight * (pressure + gradient.dot(&(at - wall.r)));
        }
        (weights > 0.0).then(|| sum / weights)
    }

    fn height(&self, foot: &Vector<D>, solids: &[Vector<D>], near: &[Liquid<D>]) -> Option<f64> {
        let (support, spacing, volume) = (self.params.support(), self.params.spacing, self.params.volume());
        let up = D - 1;
        // Above one half where liquid fills more than half of the kernel.
        let filled = |height: f64| {
            let mut at = *foot;
            at[up] += height;
            let share = |r: &Vector<D>| match (at - r).norm() {
                r if r < support => volume * self.weight(r),
                _ => 0.0,
            };
            let (mut full, mut open) = (0.0, 1.0);
            full += near.iter().map(|liquid| share(&liquid.r)).sum::<f64>();
            for r in solids {
                if r[up] < foot[up] { full += share(r) } else { open -= share(r) }
            }
            full / open
        };
        // At the foot of a wet line the floor fills the lower half: liquid has to add to it.
        if filled(0.5 * spacing) < 0.5 {
            return None;
        }
        let step = 0.25 * spacing;
        let (mut height, mut below) = (0.5 * spacing, filled(0.5 * spacing));
        loop {
            let above = filled(height + step);
            if above < 0.5 {
                return Some(height + step * (below - 0.5) / (below - above));
            }
            (height, below) = (height + step, above);
        }
    }

    /// What filters remember.
    pub fn save(&self, writer: &mut checkpoint::Writer) {
        let past = self.gauges.iter().enumerate().flat_map(|(k, gauge)| match &gauge.kind {
            Kind::Pressure { filter: Some(filter), .. } => {
                filter.past.iter().flat_map(|(time, value)| [k as f64, *time, *value]).collect()
            }
            _ => vec![],
        });
        writer.f64("filters", &past.collect::<Vec<_>>());
    }

    /// Goes on from a saved state.
    ///
    /// # Errors
    /// [`Error::Input`] if it has none of these gauges.
    pub fn restore(&mut self, reader: &checkpoint::Reader) -> Result<()> {
        // Gauges that are new in the resumed run have nothing to remember.
        if !reader.names().any(|name| name == "filters") {
            return Ok(());
        }
        for entry in reader.f64("filters")?.chunks_exact(3) {
            match self.gauges.get_mut(entry[0] as usize).map(|gauge| &mut gauge.kind) {
                Some(Kind::Pressure { filter: Some(filter), .. }) => {
                    filter.past.push_back((entry[1], entry[2]))
                }
                _ => {
                    return Err(Error::Input(
                        "the checkpoint has other filters: start the run afresh".into(),
                    ));
                }
            }
        }
        Ok(())
    }
}

fn horizontal_square<const D: usize>(a: &Vector<D>, b: &Vector<D>) -> f64 {
    (0..D - 1).map(|d| (a[d] - b[d]).powi(2)).sum()
}

/// A running mean over the past.
struct Filter {
    window: f64,
    /// Times and readings, oldest first.
    past: VecDeque<(f64, f64)>,
}

impl Filter {
    fn new(window: f64) -> Self {
        Self { window, past: VecDeque::new() }
    }

    fn mean_with(&mut self, time: f64, value: f64) -> f64 {
        self.past.push_back((time, value));
        while self.past.front().is_some_and(|(old, _)| *old <= time - self.window) {
            self.past.pop_front();
        }
        self.past.iter().map(|(_, value)| value).sum::<f64>() / self.past.len() as f64
    }
}

/// Slices of the scene along x, each with the gauges whose kernels reach into it: one pass over the liquid then serves
/// all gauges, and most particles meet no gauge at all.
#[derive(Default)]
struct Bins {
    min: f64,
    width: f64,
    gauges: Vec<Vec<u32>>,
    count: usize,
}

/// Enough bins for any scene of few gauges, and no trouble for memory.
const MOST_BINS: f64 = 4096.0;

impl Bins {
    fn new(x: impl Iterator<Item = f64>, support: f64) -> Self {
        let x: Vec<f64> = x.collect();
        let min = x.iter().copied().fold(f64::INFINITY, f64::min) - support;
        let max = x.iter().copied().fold(f64::NEG_INFINITY, f64::max) + support;
        if x.is_empty() {
            return Self::default();
        }
        let width = (0.5 * support).max((max - min) / MOST_BINS);
        let mut gauges = vec![vec![]; ((max - min) / width) as usize + 1];
        for (k, x) in x.iter().enumerate() {
            let [from, to] = [x - support, x + support].map(|edge| ((edge - min) / width).max(0.0) as usize);
            gauges[from..=to].iter_mut().for_each(|bin| bin.push(k as u32));
        }
        Self { min, width, gauges, count: x.len() }
    }

    /// For each gauge the liquid particles in its bins.
    fn sort<const D: usize>(&self, particles: &Particles<D>) -> Vec<Vec<u32>> {
        let mut near = vec![vec![]; self.count];
        let fluid = particles.fluid();
        for (b, r) in fluid.clone().zip(&particles.position[fluid]) {
            let bin = (r[0] - self.min) / self.width;
            if bin >= 0.0 && bin < self.gauges.len() as f64 {
                self.gauges[bin as usize].iter().for_each(|&k| near[k as usize].push(b as u32));
            }
        }
        near
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::{build, read};

    const CASE: &str = r#"
name = "bath"
dimension = 2
spacing = 0.02
[[fluid.block]]
min = [0, 0]
max = [0.4, 0.2]
[[fluid.block]]
min = [0.44, 0]
max = [0.8, 0.1]
[tank]
min = [0, 0]
max = [0.8, 0.6]
open = ["top"]
[[box]]
min = [0.4, 0]
max = [0.44, 0.3]
[time]
until = 1
"#;

    /// How walls know the pressure.
    #[derive(Clone, Copy, PartialEq)]
    enum Walls {
        Carry,
        Ignore,
        Feel,
    }

    /// Readings with 0.2 m of water before a thin box and 0.1 m behind it, each hydrostatic by decree; walls that feel it know it alone.
    fn read_with(probes: &str, walls: Walls) -> Vec<Cell<'static>> {
        let case = read::read(CASE, "bath", &[("probe".to_owned(), format!("[{probes}]"))]).unwrap();
        let scene = build::scene::<2>(&case);
        let mut particles = scene.particles;
        let level = |r: &Vector<2>| if r.x < 0.42 { 0.2 } else { 0.1 };
        let hydrostatic = |r: &Vector<2>| 9810.0 * (level(r) - r.y);
        for b in if walls == Walls::Carry { 0..particles.len() } else { particles.fluid() } {
            particles.pressure[b] = hydrostatic(&particles.position[b]);
        }
        let mut wall_force = vec![];
        if walls == Walls::Feel {
            particles.pressure.fill(1e6);
            let push = |w: usize| -0.02 * hydrostatic(&particles.position[w]) * particles.normal[w];
            wall_force.extend(particles.walls().map(push));
        }
        let active: Vec<bool> = particles.position.iter().map(|r| r.y < level(r)).collect();
        let fields = Fields {
            active: &active,
            walls_carry_pressure: walls == Walls::Carry,
            wall_force: &wall_force,
            ..Fields::none()
        };
        let mut gauges = Gauges::new(&case.probes, &scene.lattice, &particles, &scene.params);
        gauges.read(&particles, &scene.params.bodies, &fields, |_| true, &scene.params.gravity, 0.0)
    }

    fn pressure(x: f64, y: f64) -> String {
        format!("{{kind = 'pressure', name = 'p{:.0}_{:.0}', position = [{x}, {y}]}}", 1e3 * x, 1e3 * y)
    }

    fn height(x: f64) -> String {
        format!("{{kind = 'height', name = 'h{:.0}', position = [{x}, 0]}}", 1e3 * x)
    }

    fn number(cell: Cell) -> f64 {
        if let Cell::Number(value) = cell { value } else { panic!("{cell:?}") }
    }

    #[test]
    fn hydrostatic_pressure_is_exact_on_faces_on_either_side_of_a_thin_box() {
        let places =
            [(0.1, 0.1), (0.0, 0.07), (0.2, 0.0), (0.0, 0.0), (0.4, 0.05), (0.44, 0.05), (0.44, 0.0)];
        for walls in [Walls::Carry, Walls::Ignore, Walls::Feel] {
            let probes = places.map(|(x, y)| pressure(x, y)).join(", ");
            let found = read_with(&probes, walls);
            // The first stands in the water, out of reach of walls that feel.
            let on_walls = usize::from(walls == Walls::Feel);
            for ((x, y), cell) in places.into_iter().zip(found).skip(on_walls) {
                let expected = 9810.0 * (if x < 0.42 { 0.2 } else { 0.1 } - y);
                assert!((number(cell) - expected).abs() < 1e-6, "({x}, {y}): {cell:?} Pa, {expected} Pa");
            }
        }
    }

    #[test]
    fn a_gauge_rides_on_a_body_that_moves_and_turns() {
        let body = "[{name = 'crate', shape = 'box', min = [0.5, 0.2], max = [0.7, 0.36], density = 500, motion = 'free'}]";
        let probe = "[{kind = 'pressure', name = 'p', position = [0.499, 0.281], body = 'crate'}]";
        let sets = [("fluid.block", "[{min = [0, 0], max = [0.4, 0.2]}]"), ("body", body), ("probe", probe)];
        let case = read::read(CASE, "bath", &sets.map(|(key, value)| (key.to_owned(), value.to_owned())));
        let case = case.unwrap();
        let mut scene = build::scene::<2>(&case);
        let mut gauges = Gauges::new(&case.probes, &scene.lattice, &scene.particles, &scene.params);
        let bodies = &mut scene.params.bodies;
        let before = restrict::<2>(&bodies.list[0].state.position);
        let angle = 0.4_f64;
        bodies.list[0].state.position += crate::form::Point::new(-0.35, -0.22, 0.0);
        bodies.list[0].state.rotation = *nalgebra::Rotation3::from_euler_angles(0.0, 0.0, angle).matrix();
        bodies.place(&mut scene.particles, false);
        // Of the middle of the left face, as it was snapped.
        let arm = Vector::<2>::new(0.5, 0.281) - before;
        let at = before + Vector::<2>::new(-0.35, -0.22) + nalgebra::Rotation2::new(angle) * arm;
        let depth = |r: &Vector<2>| 9810.0 * (0.2 - r.y);
        for b in 0..scene.particles.len() {
            scene.particles.pressure[b] = depth(&scene.particles.position[b]);
        }
        // Liquid behind the face, in the body, tells nothing.
        let normal = nalgebra::Rotation2::new(angle) * Vector::<2>::new(-1.0, 0.0);
        let mut behind = 0;
        for b in scene.particles.fluid() {
            if normal.dot(&(scene.particles.position[b] - at)) < -0.011 {
                scene.particles.pressure[b] = 1e6;
                behind += usize::from((scene.particles.position[b] - at).norm() < 0.03);
            }
        }
        assert!(behind > 0, "the body is in the liquid");
        let active = vec![true; scene.particles.len()];
        let fields = Fields { active: &active, ..Fields::none() };
        let (particles, params) = (&scene.particles, &scene.params);
        let found = gauges.read(particles, &params.bodies, &fields, |_| true, &params.gravity, 0.0);
        assert!((number(found[0]) - depth(&at)).abs() < 1e-6, "{found:?} Pa, {} Pa", depth(&at));
    }

    #[test]
    fn gauges_above_the_water_are_dry() {
        let probes = [pressure(0.0, 0.24), pressure(0.44, 0.15), pressure(0.6, 0.3)].join(", ");
        assert_eq!(read_with(&probes, Walls::Carry), [Cell::Word(DRY); 3]);
        let lines = "{kind = 'height', name = 'a', position = [0.6, 0.2]}, \
                     {kind = 'height', name = 'b', position = [0.42, 0.3]}";
        assert_eq!(read_with(lines, Walls::Carry), [Cell::Word(DRY); 2]);
    }

    #[test]
    fn heights_are_those_of_the_surface_beside_walls_and_boxes_too() {
        let lines = [
            (0.2, 0.2),
            (0.0, 0.2),
            (0.01, 0.2),
            (0.39, 0.2),
            (0.4, 0.2),
            (0.45, 0.1),
            (0.6, 0.1),
            (0.8, 0.1),
        ];
        let found = read_with(&lines.map(|(x, _)| height(x)).join(", "), Walls::Carry);
        for ((x, expected), cell) in lines.into_iter().zip(found) {
            assert!((number(cell) - expected).abs() < 0.05 * 0.02, "{x}: {cell:?} m, {expected} m");
        }
    }

    #[test]
    fn a_layer_of_one_particle_is_one_spacing_high() {
        for spacing in [0.0275, 0.02] {
            let sets = [
                ("spacing", format!("{spacing}")),
                ("fluid.block", format!("[{{min = [0, 0], max = [0.4, {spacing}]}}]")),
                ("box", "[]".to_owned()),
                ("probe", format!("[{}]", height(0.2))),
            ];
            let case = read::read(CASE, "bath", &sets.map(|(k, v)| (k.to_owned(), v))).unwrap();
            let scene = build::scene::<2>(&case);
            let fields = Fields::none();
            let mut gauges = Gauges::new(&case.probes, &scene.lattice, &scene.particles, &scene.params);
            let height = number(
                gauges.read(
                    &scene.particles,
                    &scene.params.bodies,
                    &fields,
                    |_| true,
                    &scene.params.gravity,
                    0.0,
                )[0],
            );
            assert!((height / spacing - 1.0).abs() < 0.05, "{height} m at {spacing} m");
        }
    }

    #[test]
    fn a_filter_is_the_mean_of_the_last_rows() {
        let mut filter = Filter::new(0.03);
        let means =
            [4.0, 0.0, 2.0, 7.0].iter().zip(0..).map(|(v, k)| filter.mean_with(0.011 * f64::from(k), *v));
        assert_eq!(means.collect::<Vec<_>>(), [4.0, 2.0, 2.0, 3.0]);
    }

    #[test]
    fn bins_find_all_that_is_near() {
        let case = read::read(CASE, "bath", &[]).unwrap();
        let particles = build::scene::<2>(&case).particles;
        let x = [0.0, 0.31, 0.8];
        let near = Bins::new(x.into_iter(), 0.05).sort(&particles);
        for (x, near) in x.into_iter().zip(near) {
            let found: Vec<usize> = near.iter().map(|&b| b as usize).collect();
            for b in particles.fluid().filter(|&b| (particles.position[b].x - x).abs() < 0.05) {
                assert!(found.contains(&b));
            }
            assert!(found.iter().all(|&b| (particles.position[b].x - x).abs() < 0.1), "and not much more");
        }
    }
}
