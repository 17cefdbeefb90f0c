//! Walls of repulsive particles (Monaghan 1994, J. Comput. Phys. 110, 399-406).
//!
//! Each particle of a wall's first layer pushes liquid within r_0 away along the line of centres, with the force per
//! unit mass
//!
//! f(r) = K ((r_0 / r)^4 - (r_0 / r)^2) r / r^2,   r < r_0,   K = 5 g H                           (1)
//!
//! for liquid of depth H. r_0 is the particle spacing, the distance at which the lattice puts the first row of liquid.
//! Between two wall particles dx apart the barrier is 4.5 K, some ten times the specific energy 2 g H of the fastest
//! flow: at half of K water at rest sinks deeper, at twice K wall forces limit the time step. Nothing else of a
//! wall acts on the liquid: no mass, no pressure, no friction.

use crate::particles::Vector;

/// The force of one wall particle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Repulsion {
    /// K in m2/s2.
    pub strength: f64,
    /// r_0 in m.
    pub reach: f64,
}

impl Repulsion {
    /// Walls for liquid of `depth` m under `gravity` m/s2 and of an initial `speed` m/s: K = 5 (g H + v^2 / 2).
    pub fn new(gravity: f64, depth: f64, speed: f64, spacing: f64) -> Self {
        Self { strength: 5.0 * (gravity * depth + 0.5 * speed * speed), reach: spacing }
    }

    /// Eq. (1) in m/s2 on liquid at r_ab from the wall particle.
    #[inline]
    pub fn of<const D: usize>(&self, r_ab: &Vector<D>) -> Vector<D> {
        let square = r_ab.norm_squared();
        let ratio = self.reach * self.reach / square;
        if ratio <= 1.0 { Vector::zeros() } else { self.strength * (ratio * ratio - ratio) / square * r_ab }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn walls_push_within_their_reach_only() {
        let wall = Repulsion::new(9.81, 0.4, 0.0, 0.01);
        assert!((wall.strength - 19.62).abs() < 1e-12);
        assert_eq!(wall.of(&Vector::<2>::new(0.0, 0.01)).norm(), 0.0);
        // (2^4 - 2^2) K / r at half the reach
        let f = wall.of(&Vector::<2>::new(0.0, 0.005));
        assert!((f.y - 12.0 * 19.62 / 0.005).abs() < 1e-8 && f.x == 0.0);
    }
}
