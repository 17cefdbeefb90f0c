//! Laminar viscosity nu laplacian(v), in one of two forms:
//!
//! - *Two-point* (Morris et al. 1997; Shao & Lo 2003): nu sum_b 2 V F_ab v_ab. Exact for quadratic velocities up to a
//!   factor that the support's second moment gives, sum -V F r^2 / D, by which it is divided.
//! - *Central* (Monaghan & Gingold 1983; Monaghan 2005): nu sum_b 2 (D + 2) V F_ab (v_ab . r_ab) r_ab / r_ab^2. It leaves
//!   the stress on a free surface zero, and so damps waves at their right rate, where the two-point form sets
//!   the normal derivative of v to zero and damps at half that rate (Colagrossi et al. 2011). It also keeps
//!   angular momentum. On a regular lattice it depends on the direction (shear along an axis of the 2D lattice meets 1.5
//!   times the viscosity at h = 1.2 dx), which disorder averages out. Divided by the lattice's factor.
//!
//! Scenes with a free surface take the central form, those without the two-point form.
//!
//! Walls either slip freely (no contribution) or hold the liquid: a no-slip wall particle b is given the velocity
//! that makes the profile from particle a through the wall's face linear, v_a - v_b = (1 + d_b / d_a) (v_a - v_wall)
//! with d the distances to the face (Morris et al. 1997). The factor is capped where a touches the face.

use crate::case::Slip;
use crate::operators::{Moments, Surroundings};
use crate::particles::{Particles, Vector};

/// Largest factor of the no-slip extrapolation: d_a is never taken below d_b / 2 (Morris et al. use 0.5 as well).
const LARGEST_FACTOR: f64 = 3.0;

/// Factor on the velocity difference of a no-slip pair, from the distances to the face of the wall.
pub fn no_slip_factor(distance_a: f64, distance_b: f64) -> f64 {
    let factor = if distance_a > 0.0 { 1.0 + distance_b / distance_a } else { LARGEST_FACTOR };
    factor.min(LARGEST_FACTOR)
}

/// Factor on the velocity difference of a pair of liquid and solid particle `b`: none where liquid slips.
pub fn wall_factor<const D: usize>(particles: &Particles<D>, b: usize, r_ab: &Vector<D>, slip: Slip) -> f64 {
    match slip {
        Slip::Free => 0.0,
        Slip::None => {
            let behind = particles.depth[b];
            no_slip_factor(r_ab.dot(&particles.normal[b]) - behind, behind)
        }
    }
}

/// A form of the viscous term.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Form {
    /// For scenes without a free surface.
    TwoPoint,
    /// For scenes with one; `moment` is sum -V F r^2 / D on the lattice.
    Central {
        /// Without unit.
        moment: f64,
    },
}

/// What neighbour `with` contributes to laplacian(v) at a: `coefficient` P (v_a - v_b).
#[derive(Debug, Clone, Copy)]
pub struct Pair<const D: usize> {
    /// The neighbour.
    pub with: usize,
    /// Whether it is solid.
    pub is_solid: bool,
    /// In 1/m2, negative.
    pub coefficient: f64,
    /// P projects on this unit vector; without one it is the identity.
    pub line: Option<Vector<D>>,
}

/// The projection of `v` on the unit vector `line`, or without one `v`.
pub fn along<const D: usize>(line: Option<&Vector<D>>, v: &Vector<D>) -> Vector<D> {
    line.map_or(*v, |line| line.dot(v) * line)
}

impl<const D: usize> Pair<D> {
    /// P v.
    pub fn along(&self, v: &Vector<D>) -> Vector<D> {
        along(self.line.as_ref(), v)
    }

    /// Component (d, e) of P.
    pub fn direction(&self, d: usize, e: usize) -> f64 {
        self.line.map_or(f64::from(u8::from(d == e)), |line| line[d] * line[e])
    }
}

impl Form {
    /// The pairs at fluid particle `a`, the moments of whose support are `moments`.
    pub fn pairs<'a, const D: usize>(
        self,
        surroundings: &Surroundings<'a, D>,
        particles: &'a Particles<D>,
        moments: &Moments<D>,
        a: usize,
        slip: Slip,
    ) -> impl Iterator<Item = Pair<D>> {
        let factor = self.factor(moments);
        surroundings.active(a).map(move |(b, r_ab, vf)| self.pair(particles, slip, factor, (b, &r_ab, vf)))
    }

    /// What the weights of a row are multiplied by.
    pub fn factor<const D: usize>(self, moments: &Moments<D>) -> f64 {
        match self {
            Self::TwoPoint => 2.0 / (moments.position_divergence() / D as f64),
            Self::Central { moment } => 2.0 * (D + 2) as f64 / moment,
        }
    }

    /// The pair with `b`, r_ab in m away and of the weight V F_ab in 1/m2, in a row of that [`factor`](Self::factor).
    #[inline]
    pub fn pair<const D: usize>(
        self,
        particles: &Particles<D>,
        slip: Slip,
        factor: f64,
        (b, r_ab, vf): (usize, &Vector<D>, f64),
    ) -> Pair<D> {
        let original = particles.original(b);
        let is_solid = original < particles.solids();
        let wall = if is_solid { wall_factor(particles, original, r_ab, slip) } else { 1.0 };
        let line = match self {
            Self::TwoPoint => None,
            Self::Central { .. } => Some(r_ab / r_ab.norm()),
        };
        Pair { with: b, is_solid, coefficient: factor * wall * vf, line }
    }

    /// laplacian(v) at fluid particle `a` in 1/(m s).
    pub fn laplacian<const D: usize>(
        self,
        surroundings: &Surroundings<'_, D>,
        particles: &Particles<D>,
        moments: &Moments<D>,
        a: usize,
        slip: Slip,
    ) -> Vector<D> {
        let velocity = &particles.velocity;
        let term = |pair: Pair<D>| pair.coefficient * pair.along(&(velocity[a] - velocity[pair.with]));
        self.pairs(surroundings, particles, moments, a, slip).map(term).sum()
    }
}
