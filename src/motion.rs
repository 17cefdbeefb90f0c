//! A tank that is moved: what its liquid feels beside gravity.
//!
//! Everything is computed in the frame of the tank, where the walls stand still and the liquid feels g - a(t), with a(t) the
//! acceleration of the tank in m/s2. At t = 0 liquid moves with the tank. What schemes estimate from gravity before the first step
//! (speed of sound, strength of repulsive walls, the limit of runaway speeds) knows nothing of the motion: in a tank shaken at g
//! or more give `scheme.sound_speed`.

use crate::case::{self, CaseFile};
use crate::particles::Vector;

/// Acceleration of a tank over time.
#[derive(Debug, Clone, PartialEq)]
pub enum Motion<const D: usize> {
    /// Times in s, ascending, and accelerations in m/s2 there; linear between, constant beyond the ends.
    Table(Vec<(f64, Vector<D>)>),
    /// Displacement `amplitude` sin(`frequency` t) in m: this acceleration begins at 0.
    Sine {
        /// Direction and size in m.
        amplitude: Vector<D>,
        /// Angular frequency in 1/s.
        frequency: f64,
    },
}

impl<const D: usize> Motion<D> {
    /// The motion of a proven case, if its tank moves.
    pub fn of(case: &CaseFile) -> Option<Self> {
        Some(match case.motion.as_ref()? {
            case::Motion::Acceleration(rows) => {
                Self::Table(rows.iter().map(|row| (row[0], Vector::from_fn(|d, _| row[d + 1]))).collect())
            }
            case::Motion::Sine { axis, amplitude, period } => {
                let along = |d: usize, _| if d == *axis as usize { *amplitude } else { 0.0 };
                Self::Sine { amplitude: Vector::from_fn(along), frequency: std::f64::consts::TAU / period }
            }
        })
    }

    /// Acceleration of the tank in m/s2 at `time` in s.
    pub fn acceleration(&self, time: f64) -> Vector<D> {
        match self {
            Self::Sine { amplitude, frequency } => -frequency.powi(2) * (frequency * time).sin() * *amplitude,
            Self::Table(rows) => {
                let after = rows.partition_point(|(t, _)| *t <= time);
                match (after.checked_sub(1).map(|k| rows[k]), rows.get(after)) {
                    (Some((t0, a0)), Some((t1, a1))) => a0 + (time - t0) / (t1 - t0) * (a1 - a0),
                    (Some((_, a)), None) | (None, Some(&(_, a))) => a,
                    (None, None) => Vector::zeros(),
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_are_linear_between_and_constant_beyond() {
        let rows = [(1.0, 0.0, 2.0), (2.0, 4.0, 2.0)].map(|(t, x, y)| (t, Vector::<2>::new(x, y)));
        let motion = Motion::Table(rows.to_vec());
        for (time, x) in [(0.0, 0.0), (1.0, 0.0), (1.25, 1.0), (2.0, 4.0), (9.0, 4.0)] {
            assert_eq!(motion.acceleration(time), Vector::<2>::new(x, 2.0), "{time}");
        }
    }

    #[test]
    fn a_sine_is_the_second_derivative_of_its_displacement() {
        let motion = Motion::Sine { amplitude: Vector::<2>::new(0.1, 0.0), frequency: 3.0 };
        let (time, step) = (0.4, 1e-4);
        let at = |t: f64| 0.1 * (3.0 * t).sin();
        let difference = (at(time + step) - 2.0 * at(time) + at(time - step)) / (step * step);
        assert!((motion.acceleration(time)[0] - difference).abs() < 1e-6);
    }
}
