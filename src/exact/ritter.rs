//! A dam break over a dry bed in shallow water (Ritter 1892; Stoker 1957, section 10.8).
//!
//! Water of depth H behind a dam at x_0, released at t = 0, flows off with c = sqrt(g H) as
//!
//! h = (2 c - (x - x_0) / t)^2 / (9 g)   between   x_0 - c t   and the front   x_0 + 2 c t,
//!
//! and is 4/9 H deep at the dam for ever. That is an asymptote: shallow water theory leaves out vertical accelerations, which rule
//! the first few sqrt(H / g), and its front is infinitely thin, which no real and no discrete liquid is. Frictionless liquid approaches
//! it as time goes on, with a front that stays behind by a length.
//!
//! Compared are where the flood is H / 10 deep, at x_0 + (2 - 3 / sqrt(10)) c t, the depth at the dam, and the depth everywhere (root
//! mean square over columns from the reservoir's end to the exact front), depths by the volume of the particles in columns
//! `COLUMN` spacings wide; and over the second half of the run the speed of that place and the depth at the dam. The front itself is
//! recorded beside the run's largest x, not judged: the last of it is thinner than any particle. The solution holds until
//! the reservoir's end or the far wall is reached.

use super::{ErrorMeasure, Exact, Quantity, Scale};
use crate::case::CaseFile;
use crate::output::quantities::{self, Scene};
use crate::particles::Vector;
use crate::scheme::Params;

/// Width of the columns in which depths are found, in spacings.
const COLUMN: f64 = 4.0;
/// Depth that is followed, over H.
const FOLLOWED: f64 = 0.1;

pub struct DamBreak {
    /// Reservoir's end in m.
    end: f64,
    /// x_0 in m.
    dam: f64,
    /// H in m.
    depth: f64,
    gravity: f64,
}

impl DamBreak {
    pub fn new<const D: usize>(case: &CaseFile, params: &Params<D>) -> Self {
        let block = &case.fluid.blocks[0];
        let up = D - 1;
        let depth = block.max[up] - block.min[up];
        Self { end: block.min[0], dam: block.max[0], depth, gravity: params.gravity.norm() }
    }

    /// c in m/s.
    fn celerity(&self) -> f64 {
        (self.gravity * self.depth).sqrt()
    }

    fn front(&self, time: f64) -> f64 {
        self.dam + 2.0 * self.celerity() * time
    }

    /// h in m.
    fn depth_at(&self, x: f64, time: f64) -> f64 {
        let c = self.celerity();
        match x - self.dam {
            distance if distance <= -c * time => self.depth,
            distance if distance >= 2.0 * c * time => 0.0,
            distance => (2.0 * c - distance / time).powi(2) / (9.0 * self.gravity),
        }
    }

    /// Where the flood is as deep as is followed.
    fn followed(&self, time: f64) -> f64 {
        self.dam + (2.0 - 3.0 * FOLLOWED.sqrt()) * self.celerity() * time
    }

    /// The same of columns: interpolated between the centres of the last one that is as deep and the next.
    fn last_as_deep(&self, depth: &[f64], width: f64) -> f64 {
        let level = FOLLOWED * self.depth;
        let Some(k) = depth.iter().rposition(|depth| *depth >= level) else { return self.end };
        let next = depth.get(k + 1).copied().unwrap_or(0.0);
        self.end + width * (k as f64 + 0.5 + (depth[k] - level) / (depth[k] - next))
    }

    /// Depths in m in columns of `width` m, side by side from `from`.
    fn found<const D: usize>(scene: &Scene<'_, D>, from: f64, width: f64, count: usize) -> Vec<f64> {
        let mut depth = vec![0.0; count];
        for a in scene.particles.fluid() {
            let column = ((scene.particles.position[a][0] - from) / width).floor();
            if column >= 0.0 && column < count as f64 {
                depth[column as usize] += scene.params.spacing.powi(2) / width;
            }
        }
        depth
    }
}

impl<const D: usize> Exact<D> for DamBreak {
    fn initial_velocity(&self, _: &Vector<D>) -> Vector<D> {
        Vector::zeros()
    }

    fn quantities(&self) -> Vec<Quantity> {
        let quantity = |column| Quantity { column, scale: Scale::Fixed(self.depth, "the initial depth") };
        ["tenth_m", "dam_depth_m", "depth_error_m", "front_m"].map(quantity).to_vec()
    }

    fn compare(&self, scene: &Scene<'_, D>, time: f64) -> Vec<(f64, f64)> {
        let (width, front) = (COLUMN * scene.params.spacing, self.front(time));
        let at_dam = Self::found(scene, self.dam - 0.5 * width, width, 1)[0];
        let count = ((front - self.end) / width).ceil() as usize;
        let square = |(k, found): (usize, &f64)| {
            (found - self.depth_at(self.end + (k as f64 + 0.5) * width, time)).powi(2)
        };
        let depth = Self::found(scene, self.end, width, count);
        let squares: f64 = depth.iter().enumerate().map(square).sum();
        vec![
            (self.last_as_deep(&depth, width), self.followed(time)),
            (at_dam, 4.0 / 9.0 * self.depth),
            ((squares / count as f64).sqrt(), 0.0),
            (quantities::front(scene), front),
        ]
    }

    fn of_series(&self, time: &[f64], series: &[Vec<(f64, f64)>]) -> Vec<ErrorMeasure> {
        let half = 0.5 * time.last().copied().unwrap_or(0.0);
        let first = time.partition_point(|t| *t < half);
        let (time, place, depth) = (&time[first..], &series[0][first..], &series[1][first..]);
        let count = time.len() as f64;
        let mean = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / count;
        let (t, x) = (mean(&mut time.iter().copied()), mean(&mut place.iter().map(|pair| pair.0)));
        let (up, down) = time.iter().zip(place).fold((0.0, 0.0), |(up, down), (time, pair)| {
            (up + (time - t) * (pair.0 - x), down + (time - t).powi(2))
        });
        if down == 0.0 {
            return vec![];
        }
        let measure = |name: &str, found: f64, exact: f64| {
            let error = ((found - exact) / exact).abs();
            ErrorMeasure { name: name.to_owned(), rms: error, max: error, of: "the exact value".to_owned() }
        };
        vec![
            measure(
                "speed of tenth_m, second half",
                up / down,
                (2.0 - 3.0 * FOLLOWED.sqrt()) * self.celerity(),
            ),
            measure(
                "mean dam depth, second half",
                mean(&mut depth.iter().map(|pair| pair.0)),
                4.0 / 9.0 * self.depth,
            ),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_volume_stays_and_the_dam_is_four_ninths_deep() {
        let flow = DamBreak { end: 0.0, dam: 1.0, depth: 0.1, gravity: 9.81 };
        let (count, time) = (200_000, 0.4);
        let step = flow.front(time) / f64::from(count);
        let volume: f64 = (0..count).map(|k| step * flow.depth_at((f64::from(k) + 0.5) * step, time)).sum();
        assert!((volume - 0.1).abs() < 1e-8, "{volume}");
        assert!((flow.depth_at(1.0, time) - 4.0 / 9.0 * 0.1).abs() < 1e-12);
        assert!((flow.depth_at(flow.followed(time), time) - 0.01).abs() < 1e-12);
        let columns: Vec<f64> = (0..500).map(|k| flow.depth_at((f64::from(k) + 0.5) * 0.01, time)).collect();
        assert!((flow.last_as_deep(&columns, 0.01) - flow.followed(time)).abs() < 1e-3);
    }
}
