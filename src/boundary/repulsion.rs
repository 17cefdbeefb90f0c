//! Walls of repulsive particles (Monaghan 1994, J. Comput. Phys. 110, 399-406; Monaghan & Kos 1999, J. Waterway Port Coast.
//! Ocean Eng. 125, 145-154).
//!
//! Each particle b of a wall's first layer, with normal n, pushes liquid within r_0 of its plane along n, with the force per
//! unit mass
//!
//! f = K ((r_0 / y)^4 - (r_0 / y)^2) n / y  prod_d max(0, 1 - |t_d| / dx),   y = n . r_ab,   t = r_ab - y n,   0 < y < r_0  (1)
//!
//! with K = 5 g H for liquid of depth H. r_0 is the particle spacing dx, the distance at which the lattice puts the first row of
//! liquid. At half of K water at rest sinks deeper, at twice K wall forces limit the time step. Nothing else of a
//! wall acts on the liquid: no mass, no pressure, no friction.
//!
//! **Smooth floors.** The products add up to 1 over the particles of a flat wall, so that liquid which glides along it feels no
//! lattice. Monaghan's central forces, (1) with the direction of r_ab for n and r_ab for y, let it roll over a row of humps: a friction
//! that nobody asked for. Those stay for the particles of edges and corners, whose normals are oblique: their planes cut through
//! the liquid beside them.
//!
//! **Turned bodies.** (1) does not know their lattice, so max(0, 1 - |t| / dx) takes the place of the product: the same in 2D, between 1
//! and 1.17 in all in 3D. Central forces, weakest half way between two particles, let liquid that a box presses on slip into it.

use crate::particles::{Vector, axis_of};

/// The force of one wall particle.
#[derive(Debug, Clone, Copy)]
pub struct Repulsion {
    /// K in m2/s2.
    pub strength: f64,
    /// r_0 in m.
    pub reach: f64,
    /// dx in m.
    pub spacing: f64,
}

impl Repulsion {
    /// Walls for liquid of `depth` m under `gravity` m/s2 and of an initial `speed` m/s: K = 5 (g H + v^2 / 2), within `reach`
    /// spacings.
    pub fn new(gravity: f64, depth: f64, speed: f64, spacing: f64, reach: f64) -> Self {
        Self { strength: 5.0 * (gravity * depth + 0.5 * speed * speed), reach: reach * spacing, spacing }
    }

    /// Eq. (1) in m/s2 on liquid at r_ab from a wall particle with the normal of a flat wall, or none.
    #[inline]
    pub fn of<const D: usize>(&self, r_ab: &Vector<D>, normal: Option<&Vector<D>>) -> Vector<D> {
        let Some((y, direction, share)) = self.approach(r_ab, normal) else { return Vector::zeros() };
        let ratio = (self.reach / y).powi(2);
        share * self.strength * (ratio * ratio - ratio) / y * direction
    }

    /// What moving liquid there from out of reach along the normal took, in J/kg: the integral of (1).
    pub fn potential<const D: usize>(&self, r_ab: &Vector<D>, normal: Option<&Vector<D>>) -> f64 {
        let Some((y, _, share)) = self.approach(r_ab, normal) else { return 0.0 };
        let ratio = (self.reach / y).powi(2);
        share * self.strength * (0.25 * (ratio * ratio - 1.0) - 0.5 * (ratio - 1.0))
    }

    /// y, n and the product of (1), within reach.
    #[inline]
    fn approach<const D: usize>(
        &self,
        r_ab: &Vector<D>,
        normal: Option<&Vector<D>>,
    ) -> Option<(f64, Vector<D>, f64)> {
        let (y, direction) = match normal {
            Some(normal) => (r_ab.dot(normal), *normal),
            None => (r_ab.norm(), r_ab.normalize()),
        };
        if y >= self.reach || y <= 0.0 {
            return None;
        }
        let aside = r_ab - y * direction;
        let near = |t: f64| (1.0 - t.abs() / self.spacing).max(0.0);
        let share = match axis_of(&direction).is_some() {
            true => aside.iter().map(|t| near(*t)).product(),
            false => near(aside.norm()),
        };
        Some((y, direction, share))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn walls_push_within_their_reach_only() {
        let (wall, up) = (Repulsion::new(9.81, 0.4, 0.0, 0.01, 1.0), Vector::<2>::new(0.0, 1.0));
        assert!((wall.strength - 19.62).abs() < 1e-12);
        assert_eq!(wall.of(&Vector::<2>::new(0.0, 0.01), Some(&up)).norm(), 0.0);
        assert_eq!(wall.of(&Vector::<2>::new(0.01, 0.005), Some(&up)).norm(), 0.0);
        // (2^4 - 2^2) K / y at half the reach
        for normal in [Some(&up), None] {
            let f = wall.of(&Vector::<2>::new(0.0, 0.005), normal);
            assert!((f.y - 12.0 * 19.62 / 0.005).abs() < 1e-8 && f.x == 0.0);
        }
    }

    #[test]
    fn the_potential_falls_by_the_force() {
        let (wall, up) = (Repulsion::new(9.81, 0.4, 0.0, 0.01, 1.0), Vector::<2>::new(0.0, 1.0));
        for normal in [Some(&up), None] {
            let potential = |y: f64| wall.potential(&Vector::<2>::new(0.0, y), normal);
            assert!(potential(0.01) == 0.0 && potential(0.00999) > 0.0);
            for y in [0.004, 0.007, 0.0095] {
                let slope = (potential(y + 1e-7) - potential(y - 1e-7)) / 2e-7;
                let force = wall.of(&Vector::<2>::new(0.0, y), normal).y;
                assert!((slope + force).abs() < 1e-5 * force, "{y}: {slope}, {force}");
            }
        }
    }

    #[test]
    fn a_turned_wall_pushes_as_before() {
        let wall = Repulsion::new(9.81, 0.4, 0.0, 0.01, 1.0);
        let (along, normal) = (Vector::<2>::new(0.8, 0.6), Vector::<2>::new(-0.6, 0.8));
        for x in [0.0, 0.0025, 0.005] {
            let r = x * along + 0.007 * normal;
            let turned: Vector<2> =
                (-3..4).map(|k| wall.of(&(r - 0.01 * f64::from(k) * along), Some(&normal))).sum();
            let straight = wall.of(&Vector::<2>::new(0.0, 0.007), Some(&Vector::<2>::new(0.0, 1.0)));
            assert!((turned - straight.y * normal).norm() < 1e-12 * straight.y, "{x}: {turned}");
        }
    }

    #[test]
    fn a_flat_wall_shows_no_lattice() {
        let wall = Repulsion::new(9.81, 0.4, 0.0, 0.01, 1.0);
        let up = Vector::<3>::new(0.0, 0.0, 1.0);
        let force = |x: f64, y: f64| -> Vector<3> {
            let sites = (-3..4).flat_map(|i| (-3..4).map(move |j| (f64::from(i), f64::from(j))));
            sites.map(|(i, j)| wall.of(&Vector::<3>::new(x - 0.01 * i, y - 0.01 * j, 0.007), Some(&up))).sum()
        };
        let expected = force(0.0, 0.0);
        assert!(expected.z > 0.0);
        for (x, y) in [(0.005, 0.0), (0.003, 0.009), (-0.0071, 0.0024)] {
            assert!((force(x, y) - expected).norm() < 1e-12 * expected.norm(), "at {x}, {y}");
        }
    }
}
