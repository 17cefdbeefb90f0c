//! Gauges: pressure at a point, water height on a vertical line.
//!
//! **Pressure** at r is the kernel mean over liquid and wet walls, each neighbour's pressure carried to r
//! hydrostatically: p(r) = sum_b W_b (p_b + rho g . (r - r_b)) / sum_b W_b. In still water this is exact wherever r lies,
//! on a wall's face too. A gauge whose liquid neighbours fill less than a quarter of what a wall leaves open is *dry*.
//!
//! **Height** is where, going up from the foot of the line, the kernel sum of liquid and solids first falls below one
//! half: at a flat surface that is half a spacing above the top row, where the surface is. Splashes above a gap do not
//! count.

use super::table::Cell;
use crate::case::{Probe, build::vector};
use crate::kernel::{CubicSpline, Kernel, KernelKind, Quintic, Smoothing, WendlandC2};
use crate::particles::Vector;
use crate::scheme::Params;
use crate::simulation::Simulation;

/// What a gauge says where there is no water.
pub const DRY: &str = "dry";

/// Share of the kernel that liquid must fill at a pressure gauge.
const WET: f64 = 0.125;

/// All gauges of a scene.
pub struct Gauges<const D: usize> {
    gauges: Vec<Gauge<D>>,
    kernel: fn(f64, f64) -> f64,
    params: Params<D>,
}

enum Gauge<const D: usize> {
    Pressure(Vector<D>),
    Height(Vector<D>),
}

fn kernel_value<const D: usize, K: Kernel>(r: f64, h: f64) -> f64 {
    Smoothing::<D, K>::new(h).pair(r).0
}

impl<const D: usize> Gauges<D> {
    /// Gauges of the case, for a scheme with these parameters.
    pub fn new(probes: &[Probe], params: &Params<D>) -> Self {
        let gauges = probes.iter().map(|probe| match probe {
            Probe::Pressure { position, .. } => Gauge::Pressure(vector(position)),
            Probe::Height { position, .. } => Gauge::Height(vector(position)),
        });
        let kernel = match params.kernel {
            KernelKind::WendlandC2 => kernel_value::<D, WendlandC2>,
            KernelKind::CubicSpline => kernel_value::<D, CubicSpline>,
            KernelKind::Quintic => kernel_value::<D, Quintic>,
        };
        Self { gauges: gauges.collect(), kernel, params: params.clone() }
    }

    /// Column names with units, in the order of [`read`](Self::read).
    pub fn columns(probes: &[Probe]) -> Vec<String> {
        let column = |probe: &Probe| match probe {
            Probe::Pressure { name, .. } => format!("{name}_pa"),
            Probe::Height { name, .. } => format!("{name}_m"),
        };
        probes.iter().map(column).collect()
    }

    /// Present values.
    pub fn read(&self, simulation: &Simulation<D>) -> Vec<Cell<'static>> {
        let value = |gauge: &Gauge<D>| match gauge {
            Gauge::Pressure(at) => self.pressure(simulation, at),
            Gauge::Height(foot) => self.height(simulation, foot),
        };
        self.gauges.iter().map(|gauge| value(gauge).map_or(Cell::Word(DRY), Cell::Number)).collect()
    }

    fn weight(&self, r: f64) -> f64 {
        (self.kernel)(r, self.params.smoothing_length())
    }

    fn pressure(&self, simulation: &Simulation<D>, at: &Vector<D>) -> Option<f64> {
        let particles = &simulation.particles;
        let active = simulation.scheme.fields().active;
        let (support, gradient) = (self.params.support(), self.params.density * self.params.gravity);
        let (mut weights, mut wet, mut sum) = (0.0, 0.0, 0.0);
        for b in particles.walls().chain(particles.fluid()) {
            let away = at - particles.position[b];
            let r = away.norm();
            if r < support && active.get(b).copied().unwrap_or(false) {
                let w = self.weight(r);
                weights += w;
                sum += w * (particles.pressure[b] + gradient.dot(&away));
                if b >= particles.solids() {
                    wet += w;
                }
            }
        }
        let volume = self.params.volume();
        (wet * volume > WET).then(|| sum / weights)
    }

    fn height(&self, simulation: &Simulation<D>, foot: &Vector<D>) -> Option<f64> {
        let position = &simulation.particles.position;
        let (support, spacing) = (self.params.support(), self.params.spacing);
        let volume = spacing.powi(D as i32);
        let up = D - 1;
        let near: Vec<&Vector<D>> = position
            .iter()
            .filter(|r| {
                let away = *r - foot;
                away.norm_squared() - away[up] * away[up] < support * support
            })
            .collect();
        let filled = |height: f64| {
            let mut at = *foot;
            at[up] += height;
            let weights = near.iter().map(|r| (at - *r).norm()).filter(|r| *r < support);
            volume * weights.map(|r| self.weight(r)).sum::<f64>()
        };
        let step = 0.25 * spacing;
        let (mut height, mut below) = (0.0, filled(0.0));
        // At the foot of a wet line the floor fills the lower half: liquid has to add to it.
        if filled(0.5 * spacing) < 0.5 {
            return None;
        }
        loop {
            let above = filled(height + step);
            if above < 0.5 && height >= step {
                return Some(height + step * (below - 0.5) / (below - above));
            }
            (height, below) = (height + step, above);
        }
    }
}
