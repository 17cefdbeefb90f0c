//! The discrete Laplacian on known fields: the patch test of Schwaiger (2008, Int. J. Numer. Methods Eng. 75).
//!
//! No flow and no walls: a block of particles ends where its last rows end, and supports that the sides cut off
//! stand for those at walls and surfaces. Three operators are compared, with S and B as in [`crate::operators`]:
//!
//! - Shao & Lo (2003): L0(p) = sum_b 2 V F (p_a - p_b);
//! - Eq. (3) of Jian et al. (2016): L(p) = L0(p) - 2 grad p . S, with grad p exact for linear fields;
//! - Schwaiger (2008): L(p) / (tr(B^-1) / D), which Eq. (3) leaves out.
//!
//! **Why.** Put the Taylor series of p into L0: its first term is 2 grad p . S, of order |grad p| / h where the
//! support is cut off, and Eq. (3) takes it away. What remains is the second-order term, tr(B^-1) / D times the
//! Laplacian for isotropic fields: 1 inside, about 0.6 at a side. So Eq. (3) is exact for linear fields anywhere,
//! but does not converge at a side for others. Where the gradient has no normal part at the side it can lose: on the
//! regular lattice the error of the cosine grows there, because the two terms of L0 happened to cancel.
//!
//! **Zones.** *Inside* are particles farther from each side than the support radius. The others have truncated
//! supports: *side* where B exists, *corner* where the support is too one-sided for it and Eq. (3) falls back to
//! Shao & Lo (so the division has nothing exact to divide there); *truncated* is both together.
//!
//! **Normalisation.** Errors are divided by the largest |Laplacian| of the field on the block; for the constant and
//! the linear field, which have none, by 1 / l^2, l the longest edge of the block (the fields are functions of
//! x = (r - r_min) / l, of order 1).
//!
//! **Order.** On the regular lattice at a spacing, its half and its quarter, over the same inner part of the block.
//! With h / dx fixed tr(B^-1) / D does not tend to 1 but to a lattice constant, so the undivided forms stall.

use std::f64::consts::PI;
use std::fmt;

use rayon::prelude::*;
use serde_json::{Value, json};

use crate::Result;
use crate::case::{BlockForm, CaseFile, FluidBlock, build};
use crate::geometry::Aabb;
use crate::neighbors::{Layout, Neighbors};
use crate::operators::{Moments, Surroundings};
use crate::output::{Cell, RunFolder, Table, write_atomic};
use crate::particles::Vector;
use crate::scheme::Params;

/// Names of the compared operators.
const OPERATORS: [&str; 3] = ["Shao-Lo", "Eq. (3)", "Schwaiger"];
/// Reduction of the boundary error that Jian et al. (2016) report, in %.
const CLAIM: f64 = 50.0;
/// Errors below this are round-off: no order can be measured.
const ROUND_OFF: f64 = 1e-10;

/// A test field, as a function of x in about [0, 1]^D.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Field {
    Constant,
    Linear,
    Quadratic,
    Cubic,
    Sine,
    Cosine,
}

impl Field {
    const ALL: [Self; 6] =
        [Self::Constant, Self::Linear, Self::Quadratic, Self::Cubic, Self::Sine, Self::Cosine];

    fn name(self) -> &'static str {
        match self {
            Self::Constant => "constant",
            Self::Linear => "linear",
            Self::Quadratic => "quadratic",
            Self::Cubic => "cubic",
            Self::Sine => "sine",
            Self::Cosine => "cosine",
        }
    }

    fn formula(self) -> &'static str {
        match self {
            Self::Constant => "1",
            Self::Linear => "1 + sum k x_k",
            Self::Quadratic => "sum x_k^2",
            Self::Cubic => "sum x_k^3",
            Self::Sine => "prod sin(pi x_k)",
            Self::Cosine => "prod cos(pi x_k)",
        }
    }

    /// True if the gradient has a part normal to the sides of a unit block.
    fn has_normal_gradient(self) -> bool {
        !matches!(self, Self::Constant | Self::Cosine)
    }

    fn value<const D: usize>(self, x: &Vector<D>) -> f64 {
        match self {
            Self::Constant => 1.0,
            Self::Linear => 1.0 + x.iter().enumerate().map(|(k, x)| (k + 1) as f64 * x).sum::<f64>(),
            Self::Quadratic => x.norm_squared(),
            Self::Cubic => x.iter().map(|x| x.powi(3)).sum(),
            Self::Sine => x.iter().map(|x| (PI * x).sin()).product(),
            Self::Cosine => x.iter().map(|x| (PI * x).cos()).product(),
        }
    }

    fn laplacian<const D: usize>(self, x: &Vector<D>) -> f64 {
        match self {
            Self::Constant | Self::Linear => 0.0,
            Self::Quadratic => 2.0 * D as f64,
            Self::Cubic => 6.0 * x.sum(),
            Self::Sine | Self::Cosine => -(D as f64) * PI * PI * self.value(x),
        }
    }
}

/// Where a particle lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Zone {
    Inside,
    Side,
    Corner,
    Truncated,
}

impl Zone {
    const ALL: [Self; 4] = [Self::Inside, Self::Side, Self::Corner, Self::Truncated];

    fn name(self) -> &'static str {
        match self {
            Self::Inside => "inside",
            Self::Side => "side",
            Self::Corner => "corner",
            Self::Truncated => "truncated",
        }
    }

    fn contains(self, is_inside: bool, has_correction: bool) -> bool {
        match self {
            Self::Inside => is_inside,
            Self::Side => !is_inside && has_correction,
            Self::Corner => !is_inside && !has_correction,
            Self::Truncated => !is_inside,
        }
    }
}

/// Errors of one operator over a zone, normalised.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Errors {
    rms: f64,
    max: f64,
}

/// One line of the comparison.
#[derive(Debug, Clone, PartialEq)]
struct Line {
    lattice: &'static str,
    field: Field,
    zone: Zone,
    particles: usize,
    errors: [Errors; 3],
}

impl Line {
    /// How much smaller the rms error of Eq. (3) is than that of Shao & Lo, in %; `None` where there is none.
    fn reduction(&self) -> Option<f64> {
        let [plain, corrected, _] = self.errors.map(|e| e.rms);
        (plain > ROUND_OFF).then(|| 100.0 * (1.0 - corrected / plain))
    }
}

/// Orders of convergence inside, from each halving of the spacing; `None` at round-off.
#[derive(Debug, Clone, PartialEq)]
struct Order {
    field: Field,
    spacings: [f64; 3],
    rms: [[f64; 3]; 3],
}

impl Order {
    fn of(&self, operator: usize) -> [Option<f64>; 2] {
        let [a, b, c] = self.rms[operator];
        [(a, b), (b, c)].map(|(wide, near)| (near > ROUND_OFF).then(|| (wide / near).log2()))
    }
}

/// What the patch test measured.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    lines: Vec<Line>,
    orders: Vec<Order>,
    linear_bound: f64,
}

/// The particles of the case's first fluid block, or of a unit block if it has none.
struct Patch<const D: usize> {
    params: Params<D>,
    position: Vec<Vector<D>>,
    neighbors: Neighbors<D>,
    active: Vec<bool>,
    moments: Vec<Moments<D>>,
    block: Aabb<D>,
}

impl<const D: usize> Patch<D> {
    fn new(case: &CaseFile, jitter: f64, refinement: f64) -> Self {
        let mut case = case.clone();
        (case.tank, case.boxes) = (None, vec![]);
        case.spacing /= refinement;
        case.fluid.blocks.truncate(1);
        if case.fluid.blocks.is_empty() {
            case.fluid.blocks.push(FluidBlock {
                shape: BlockForm::Box,
                min: vec![0.0; D],
                max: vec![1.0; D],
                velocity: vec![0.0; D],
                rotation: 0.0,
            });
        }
        let at = |jitter: f64| {
            let mut case = case.clone();
            case.scheme.jitter = jitter;
            build::scene::<D>(&case)
        };
        let scene = at(jitter);
        let half = Vector::repeat(0.5 * case.spacing);
        let regular = at(0.0).particles.position;
        let first = regular.first().copied().unwrap_or_else(Vector::zeros);
        let block = Aabb {
            min: regular.iter().fold(first, |low, r| low.inf(r)) - half,
            max: regular.iter().fold(first, |high, r| high.sup(r)) + half,
        };
        let position = scene.particles.position;
        let neighbors = search(&scene.params, &position);
        let active = vec![true; position.len()];
        let mut patch = Self { params: scene.params, position, neighbors, active, moments: vec![], block };
        let around = patch.surroundings();
        patch.moments = (0..patch.position.len()).into_par_iter().map(|a| around.moments(a)).collect();
        patch
    }

    fn surroundings(&self) -> Surroundings<'_, D> {
        Surroundings {
            position: &self.position,
            neighbors: &self.neighbors,
            active: &self.active,
            volume: self.params.spacing.powi(D as i32),
        }
    }

    /// Distance to the nearest side in m.
    fn depth(&self, a: usize) -> f64 {
        let r = self.position[a];
        (r - self.block.min).inf(&(self.block.max - r)).min()
    }

    fn length(&self) -> f64 {
        (self.block.max - self.block.min).max()
    }

    fn scaled(&self, a: usize) -> Vector<D> {
        (self.position[a] - self.block.min) / self.length()
    }

    fn values(&self, field: Field) -> Vec<f64> {
        (0..self.position.len()).map(|a| field.value(&self.scaled(a))).collect()
    }

    /// Normalised errors of the three operators at each particle.
    fn errors(&self, field: Field) -> Vec<[f64; 3]> {
        let (around, values, square) = (self.surroundings(), self.values(field), self.length().powi(2));
        let exact: Vec<f64> = (0..values.len()).map(|a| field.laplacian(&self.scaled(a))).collect();
        let largest = exact.iter().fold(0.0_f64, |m, e| m.max(e.abs()));
        let scale = if largest > 0.0 { largest } else { 1.0 };
        (0..values.len())
            .into_par_iter()
            .map(|a| {
                let plain = around.laplacian(a, &values);
                let corrected = around.corrected_laplacian(a, &values, &self.moments[a]);
                let divided = corrected * D as f64 / self.moments[a].position_divergence();
                [plain, corrected, divided].map(|l| (square * l - exact[a]) / scale)
            })
            .collect()
    }

    fn lines(&self, lattice: &'static str) -> Vec<Line> {
        let support = self.params.support();
        let place: Vec<_> = (0..self.position.len())
            .map(|a| (self.depth(a) > support, self.moments[a].correction().is_some()))
            .collect();
        let of = |field: Field| {
            let errors = self.errors(field);
            let place = &place;
            Zone::ALL.map(|zone| {
                let members =
                    errors.iter().zip(place).filter(|(_, p)| zone.contains(p.0, p.1)).map(|(e, _)| e);
                let particles = members.clone().count();
                Line { lattice, field, zone, particles, errors: summary(members) }
            })
        };
        Field::ALL.into_iter().flat_map(of).collect()
    }

    /// Largest |L(p)| / sum_b |a_ab (p_a - p_b)| of the linear field where B exists, a_ab being the weights of Eq. (3).
    fn linear_bound(&self) -> f64 {
        let (around, values) = (self.surroundings(), self.values(Field::Linear));
        let ratio = |a: usize| {
            let moments = &self.moments[a];
            let along = moments.correction()?.tr_mul(&moments.defect);
            let term = |(b, r, vf): (usize, Vector<D>, f64)| {
                2.0 * vf * (1.0 + r.dot(&along)) * (values[a] - values[b])
            };
            let size: f64 = around.active(a).map(|pair| term(pair).abs()).sum();
            Some(around.corrected_laplacian(a, &values, moments).abs() / size)
        };
        (0..values.len()).filter_map(ratio).fold(0.0, f64::max)
    }
}

fn search<const D: usize>(params: &Params<D>, position: &[Vector<D>]) -> Neighbors<D> {
    let mut found = Neighbors::default();
    let layout = Layout::without_ghosts(0, position.len());
    found.search(params.kernel, params.smoothing_length(), position, &layout, |_| f64::NEG_INFINITY);
    found
}

fn summary<'a>(errors: impl Iterator<Item = &'a [f64; 3]>) -> [Errors; 3] {
    let (mut of, mut count) = ([Errors::default(); 3], 0.0_f64);
    for error in errors {
        count += 1.0;
        for (sum, e) in of.iter_mut().zip(error) {
            sum.rms += e * e;
            sum.max = sum.max.max(e.abs());
        }
    }
    of.map(|e| Errors { rms: (e.rms / count.max(1.0)).sqrt(), ..e })
}

/// Measures the operators on the case's first fluid block, on the regular lattice and on the disordered one.
pub fn run<const D: usize>(case: &CaseFile) -> Report {
    let regular = Patch::<D>::new(case, 0.0, 1.0);
    let disordered = Patch::<D>::new(case, case.scheme.jitter, 1.0);
    let mut lines = regular.lines("regular");
    lines.extend(disordered.lines("disordered"));
    let margin = regular.params.support();
    let levels = [1.0, 2.0, 4.0].map(|refinement| Patch::<D>::new(case, 0.0, refinement));
    let order = |field: Field| {
        let by_level = levels.each_ref().map(|patch| {
            let errors = patch.errors(field);
            summary(errors.iter().enumerate().filter(|(a, _)| patch.depth(*a) > margin).map(|(_, e)| e))
        });
        Order {
            field,
            spacings: levels.each_ref().map(|patch| patch.params.spacing),
            rms: std::array::from_fn(|operator| by_level.map(|errors| errors[operator].rms)),
        }
    };
    Report {
        lines,
        orders: Field::ALL.into_iter().map(order).collect(),
        linear_bound: disordered.linear_bound(),
    }
}

impl Report {
    /// Writes `comparison.csv` and `summary.json`.
    pub fn write(&self, folder: &RunFolder) -> Result<()> {
        let mut table = Table::create(
            &folder.join("comparison.csv"),
            &[
                "lattice",
                "field",
                "zone",
                "particles",
                "shao_lo_rms",
                "shao_lo_max",
                "eq_3_rms",
                "eq_3_max",
                "schwaiger_rms",
                "schwaiger_max",
                "reduction_percent",
            ],
        )?;
        for line in &self.lines {
            let mut row: Vec<Cell> = vec![
                line.lattice.into(),
                line.field.name().into(),
                line.zone.name().into(),
                line.particles.into(),
            ];
            row.extend(line.errors.iter().flat_map(|e| [Cell::from(e.rms), Cell::from(e.max)]));
            row.push(line.reduction().map_or(Cell::Word("none"), Cell::Number));
            table.row(&row)?;
        }
        table.flush()?;
        write_atomic(&folder.join("summary.json"), |file| {
            serde_json::to_writer_pretty(file, &self.json()).map_err(Into::into)
        })
    }

    fn json(&self) -> Value {
        let boundary = self.lines.iter().filter(|line| matches!(line.zone, Zone::Side | Zone::Truncated));
        json!({
            "linear_bound": self.linear_bound,
            "boundary": boundary.map(|line| json!({
                "lattice": line.lattice, "field": line.field.name(), "zone": line.zone.name(),
                "normal_gradient": line.field.has_normal_gradient(),
                "shao_lo_rms": line.errors[0].rms, "eq_3_rms": line.errors[1].rms,
                "reduction_percent": line.reduction(),
            })).collect::<Vec<_>>(),
            "orders_inside": self.orders.iter().map(|order| json!({
                "field": order.field.name(), "spacings_m": order.spacings,
                "shao_lo": order.of(0), "eq_3": order.of(1), "schwaiger": order.of(2),
            })).collect::<Vec<_>>(),
        })
    }

    /// Names of the fields with a normal gradient whose error in a zone falls by less than the paper's half.
    fn exceptions(&self, zone: Zone) -> Vec<String> {
        self.lines
            .iter()
            .filter(|line| line.zone == zone && line.field.has_normal_gradient())
            .filter(|line| line.reduction().is_some_and(|percent| percent < CLAIM))
            .map(|line| format!("{} ({})", line.field.name(), line.lattice))
            .collect()
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [shao_lo, eq_3, schwaiger] = OPERATORS;
        writeln!(f, "Error of the Laplacian, rms | max, over the field's largest Laplacian")?;
        writeln!(
            f,
            "{:<11}{:<10}{:<10}{:>9}  {shao_lo:>19}  {eq_3:>19}  {schwaiger:>19}  reduction",
            "lattice", "field", "zone", "particles"
        )?;
        for line in &self.lines {
            write!(
                f,
                "{:<11}{:<10}{:<10}{:>9}",
                line.lattice,
                line.field.name(),
                line.zone.name(),
                line.particles
            )?;
            for e in &line.errors {
                write!(f, "  {:>8.2e} | {:>8.2e}", e.rms, e.max)?;
            }
            match line.reduction() {
                Some(percent) => writeln!(f, "{percent:>9.1} %")?,
                None => writeln!(f, "{:>11}", "-")?,
            }
        }
        writeln!(f, "\nOrder inside, regular lattice, from each halving of the spacing")?;
        writeln!(f, "{:<10}{:<18}{shao_lo:>15}{eq_3:>15}{schwaiger:>15}", "field", "")?;
        for order in &self.orders {
            write!(f, "{:<10}{:<18}", order.field.name(), order.field.formula())?;
            for operator in 0..OPERATORS.len() {
                let [first, second] =
                    order.of(operator).map(|o| o.map_or("exact".into(), |o| format!("{o:.2}")));
                write!(f, "{:>15}", format!("{first} {second}"))?;
            }
            writeln!(f)?;
        }
        writeln!(f, "\nlinear field, disordered: |L| <= {:.1e} sum |a_ab (p_a - p_b)|", self.linear_bound)?;
        writeln!(f, "Eq. (3) lowers the error by at least {CLAIM} % for fields with a normal gradient:")?;
        for (zone, place) in [(Zone::Side, "at sides"), (Zone::Truncated, "with corners")] {
            let exceptions = self.exceptions(zone);
            let outcome = match exceptions.is_empty() {
                true => "all of them".to_owned(),
                false => format!("all except {}", exceptions.join(", ")),
            };
            writeln!(f, "  {place}: {outcome}")?;
        }
        Ok(())
    }
}
