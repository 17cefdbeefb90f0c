//! Forces of the liquid on boxes and tank walls.
//!
//! The faces of wall particles that touch open space tile the surface of a solid, each with the area dx^(D-1) (in 2D for
//! 1 m of width); a particle on an edge has several. The force is the surface integral of the pressure,
//!
//! F = -sum p_face n dA,   p_face = p_wall + rho g . n dx / 2                                      (1)
//!
//! with n the normal into the liquid and p_wall, half a spacing behind the face, carried to it hydrostatically. In still
//! water (1) is exact: a floor bears the weight above it, a wall rho g H^2 / 2 per width, a submerged box its
//! buoyancy. Dry wall particles add nothing, and friction is left out.
//!
//! Schemes whose walls also repel the liquid, or do only that, report the reaction on each wall particle, and it is added; so are
//! the impulses of particles that collide with walls, over the step. A particle in a corner of the tank belongs to several sides, to
//! each with the component along that side's normal.

use crate::case::{CaseFile, Probe, Side, build::side_of};
use crate::geometry::{Lattice, WallCell};
use crate::parallel::Ranks;
use crate::particles::{Particles, Vector};
use crate::scheme::{Fields, Params};
use clap::ValueEnum;

/// All force probes of a scene.
pub struct Forces<const D: usize> {
    patches: Vec<Patch<D>>,
    /// Half a spacing times the density, in kg/m2: by the body force, the pressure from a wall particle to its face.
    half_cell: f64,
    area: f64,
    ranks: Ranks,
}

/// The part of the walls that one probe is on.
struct Patch<const D: usize> {
    /// Wall particle, axis, and direction of the outward normal of each face.
    faces: Vec<(u32, usize, f64)>,
    /// Wall particles, and the components of forces on them that count.
    members: Vec<(u32, Vector<D>)>,
}

impl<const D: usize> Forces<D> {
    /// Force probes of the case on the walls of `lattice`.
    pub fn new(case: &CaseFile, lattice: &Lattice<D>, params: &Params<D>) -> Self {
        let cells = lattice.wall_cells();
        let patch = |probe: &Probe| match probe {
            Probe::Force { on, .. } => Some(Patch::new(&cells, Target::named(on, case))),
            _ => None,
        };
        Self {
            patches: case.probes.iter().filter_map(patch).collect(),
            half_cell: 0.5 * params.spacing * params.density,
            area: params.spacing.powi(D as i32 - 1),
            ranks: params.ranks,
        }
    }

    /// Present forces in N, in the order of the probes, where the last step felt `body_force` m/s2: all ranks read together, each the
    /// walls that it `holds`.
    pub fn read(
        &self,
        particles: &Particles<D>,
        fields: &Fields<D>,
        holds: impl Fn(usize) -> bool,
        body_force: &Vector<D>,
    ) -> Vec<Vector<D>> {
        let step = self.half_cell * body_force;
        let is_wet = |a: usize| holds(a) && fields.active.get(a).copied().unwrap_or(false);
        let pressure = |&(a, axis, normal): &(u32, usize, f64)| {
            let mut force = Vector::zeros();
            if is_wet(a as usize) {
                let p = particles.pressure[a as usize] + normal * step[axis];
                force[axis] = -p * normal * self.area;
            }
            force
        };
        let reaction = |(a, counts): &(u32, Vector<D>)| fields.wall_force[*a as usize].component_mul(counts);
        let is_held = |(a, _): &&(u32, Vector<D>)| holds(*a as usize);
        let force = |patch: &Patch<D>| -> Vector<D> {
            let mut force = Vector::zeros();
            if fields.walls_carry_pressure {
                force += patch.faces.iter().map(pressure).sum::<Vector<D>>();
            }
            if !fields.wall_force.is_empty() {
                force += patch.members.iter().filter(is_held).map(reaction).sum::<Vector<D>>();
            }
            force
        };
        let here: Vec<f64> = self.patches.iter().flat_map(|patch| <[f64; D]>::from(force(patch))).collect();
        self.ranks.sums(&here).chunks_exact(D).map(Vector::from_column_slice).collect()
    }
}

/// What a force probe is on.
#[derive(Clone, Copy)]
enum Target {
    Box(usize),
    Tank,
    Side { axis: usize, end: usize },
}

impl Target {
    /// A name that the case has been proven to know.
    fn named(on: &str, case: &CaseFile) -> Self {
        if let Some(k) = case.boxes.iter().position(|solid| solid.name == on) {
            return Self::Box(k);
        }
        match Side::from_str(on, false) {
            Ok(side) => {
                let (axis, end) = if case.dimension == 2 { side_of::<2>(side) } else { side_of::<3>(side) };
                Self::Side { axis, end }
            }
            Err(_) => Self::Tank,
        }
    }
}

impl<const D: usize> Patch<D> {
    fn new(cells: &[WallCell<D>], target: Target) -> Self {
        let mut patch = Self { faces: vec![], members: vec![] };
        for (a, cell) in cells.iter().enumerate() {
            let counts = Self::counts(cell, target);
            if counts == Vector::<D>::zeros() {
                continue;
            }
            patch.members.push((a as u32, counts));
            for (axis, open) in cell.open.iter().enumerate().filter(|(axis, _)| counts[*axis] > 0.0) {
                let faces = [(open[0], -1.0), (open[1], 1.0)].into_iter().filter(|(open, _)| *open);
                patch.faces.extend(faces.map(|(_, normal)| (a as u32, axis, normal)));
            }
        }
        patch
    }

    /// 1 for each component of a force on this cell that the target takes.
    fn counts(cell: &WallCell<D>, target: Target) -> Vector<D> {
        let belongs = match target {
            Target::Box(k) => cell.solid == Some(k),
            Target::Tank => cell.solid.is_none(),
            Target::Side { axis, end } => cell.solid.is_none() && cell.outside[axis] == [-1, 1][end],
        };
        let is_corner = cell.outside.iter().filter(|side| **side != 0).count() > 1;
        match (belongs, target) {
            (true, Target::Side { axis, .. }) if is_corner => {
                Vector::from_fn(|d, _| f64::from(u8::from(d == axis)))
            }
            (true, _) => Vector::repeat(1.0),
            _ => Vector::zeros(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::{build, read};

    /// A box hangs under 0.4 m of water in a tank 0.6 m long; the pressure of walls is hydrostatic by decree.
    const CASE: &str = r#"
name = "bath"
dimension = 2
spacing = 0.02
[[fluid.block]]
min = [0, 0]
max = [0.2, 0.4]
[tank]
min = [0, 0]
max = [0.6, 0.6]
open = ["top"]
[[box]]
min = [0.2, 0.1]
max = [0.4, 0.3]
[time]
until = 1
"#;

    fn forces(wall_force: Option<Vector<2>>) -> Vec<Vector<2>> {
        let names = ["box1", "left", "right", "bottom", "walls"];
        let probes = names.map(|on| format!("{{kind = 'force', name = '{on}', on = '{on}'}}")).join(", ");
        let case = read::read(CASE, "bath", &[("probe".to_owned(), format!("[{probes}]"))]).unwrap();
        let scene = build::scene::<2>(&case);
        let mut particles = scene.particles;
        let depth = |y: f64| 0.4 - y;
        let pressure = particles.position.iter().map(|r| 9810.0 * depth(r.y)).collect();
        particles.pressure = pressure;
        let active: Vec<bool> = particles.position.iter().map(|r| r.y < 0.4).collect();
        let reactions = vec![wall_force.unwrap_or_default(); particles.walls().len()];
        let fields = Fields {
            active: &active,
            walls_carry_pressure: wall_force.is_none(),
            wall_force: if wall_force.is_some() { &reactions } else { &[] },
            ..Fields::none()
        };
        let forces = Forces::new(&case, &scene.lattice, &scene.params);
        forces.read(&particles, &fields, |_| true, &scene.params.gravity)
    }

    #[test]
    fn hydrostatic_pressure_gives_weight_thrust_and_buoyancy() {
        let found = forces(None);
        let thrust = 0.5 * 9810.0 * 0.4 * 0.4;
        let expected = [
            [0.0, 9810.0 * 0.04],
            [-thrust, 0.0],
            [thrust, 0.0],
            [0.0, -9810.0 * 0.4 * 0.6],
            [0.0, -9810.0 * 0.4 * 0.6],
        ];
        for (force, expected) in found.iter().zip(expected) {
            assert!((force - Vector::<2>::from(expected)).norm() < 1e-6, "{found:?}");
        }
    }

    #[test]
    fn reactions_of_wall_particles_are_summed() {
        let found = forces(Some(Vector::<2>::new(1.0, -2.0)));
        // A box of 10 x 10 cells has 36 on its rim; the left wall 30 and a corner, the floor 30 and two corners.
        let expected = [[36.0, -72.0], [31.0, -60.0], [31.0, -60.0], [30.0, -64.0], [92.0, -184.0]];
        for (force, expected) in found.iter().zip(expected) {
            assert!((force - Vector::<2>::from(expected)).norm() < 1e-9, "{found:?}");
        }
    }
}
