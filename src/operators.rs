//! SPH operators: pair formulas and their sums over a particle's neighbours.
//!
//! Notation: particle a, neighbour b, r_ab = r_a - r_b, grad W = F_ab r_ab with F = (dW/dr)/r < 0, V the volume of
//! every particle (dx^D: the liquid is incompressible and all particles are equal). Sums run over *active*
//! neighbours: liquid, and walls where they are wet; a dry wall counts as air.
//!
//! - Position divergence (Lee et al. 2008): div r = -sum_b V r_ab . grad W, D in a full support.
//! - Support defect: S_a = sum_b V grad W, zero in a full regular support.
//! - First-order exact gradient (Randles & Libersky 1996): grad p = B_a sum_b V (p_b - p_a) grad W,
//!   B_a = (-sum_b V r_ab (x) grad W)^-1.
//! - Laplacian of Shao & Lo (2003): sum_b 2 V F_ab (p_a - p_b); with the correction of Eq. (3) of Jian et al.
//!   (2016), after Schwaiger (2008): - 2 grad p . S_a with the exact gradient, so that linear fields give zero.
//!   Neither softens F with an eta^2: only then do both sums of Eq. (3) carry the same weights. Coincident
//!   particles are kept apart elsewhere.

use crate::neighbors::Neighbors;
use crate::parallel::Packed;
use crate::particles::{Matrix, Vector};

/// What every sum needs to see.
#[derive(Debug, Clone, Copy)]
pub struct Surroundings<'a, const D: usize> {
    /// Positions in m, all particles.
    pub position: &'a [Vector<D>],
    /// Neighbour rows.
    pub neighbors: &'a Neighbors<D>,
    /// Which particles are liquid or wet.
    pub active: &'a [bool],
    /// Particle volume in m^D.
    pub volume: f64,
}

impl<'a, const D: usize> Surroundings<'a, D> {
    /// (b, r_ab, V F_ab) of each active neighbour of `a`.
    #[inline]
    pub fn active(&self, a: usize) -> impl Iterator<Item = (usize, Vector<D>, f64)> + 'a {
        let Self { position, neighbors, active, volume } = *self;
        let r_a = position[a];
        neighbors
            .row(a)
            .iter()
            .filter(move |(b, ..)| active[*b])
            .map(move |(b, _, f)| (b, r_a - position[b], volume * f))
    }

    /// Moments of the support of particle `a`; see [`Moments`]. One pass over its neighbours.
    pub fn moments(&self, a: usize) -> Moments<D> {
        self.moments_over(a, |b| self.active[b])
    }

    /// Moments of the support of particle `a` over the neighbours that `count`.
    pub fn moments_over(&self, a: usize, count: impl Fn(usize) -> bool) -> Moments<D> {
        let mut moments = Moments::default();
        let r_a = self.position[a];
        for (b, w, f) in self.neighbors.row(a).iter().filter(|(b, ..)| count(*b)) {
            let (r_ab, vf) = (r_a - self.position[b], self.volume * f);
            let grad = vf * r_ab;
            moments.kernel_sum += self.volume * w;
            moments.defect += grad;
            moments.stiffness -= vf;
            moments.matrix -= r_ab * grad.transpose();
        }
        moments
    }

    /// Divergence sum_b V (v_b - v_a) . B_a grad W in 1/s, exact for linear fields where B_a exists; without it the
    /// plain difference form.
    pub fn divergence(&self, a: usize, velocity: &[Vector<D>], moments: &Moments<D>) -> f64 {
        let v_a = velocity[a];
        match moments.correction() {
            Some(b_a) => {
                self.active(a).map(|(b, r_ab, vf)| vf * (velocity[b] - v_a).dot(&(b_a * r_ab))).sum()
            }
            None => self.active(a).map(|(b, r_ab, vf)| vf * (velocity[b] - v_a).dot(&r_ab)).sum(),
        }
    }

    /// sum_b V (q_b - q_a) grad W: the difference gradient before the correction by B_a.
    pub fn difference_gradient(&self, a: usize, field: &[f64]) -> Vector<D> {
        let q_a = field[a];
        self.active(a).map(|(b, r_ab, vf)| (vf * (field[b] - q_a)) * r_ab).sum()
    }

    /// sum_b V (q_b + q_a) grad W: the symmetric gradient, whose pair forces are opposite and equal.
    pub fn symmetric_gradient(&self, a: usize, field: &[f64]) -> Vector<D> {
        let q_a = field[a];
        self.active(a).map(|(b, r_ab, vf)| (vf * (field[b] + q_a)) * r_ab).sum()
    }

    /// Mean, weighted by -F, of q_a - q_b - r_ab . grad q with the exact gradient: how far q_a is from a plane through its neighbours. `None`
    /// where the support has no exact gradient.
    pub fn distance_from_plane(&self, a: usize, field: &[f64], moments: &Moments<D>) -> Option<f64> {
        let gradient = moments.correction()? * self.difference_gradient(a, field);
        let (q_a, r_a) = (field[a], self.position[a]);
        let row = self.neighbors.row(a).iter().filter(|(b, ..)| self.active[*b]);
        let (sum, weights) = row.fold((0.0, 0.0), |(sum, weights), (b, _, f)| {
            (sum - f * (q_a - field[b] - gradient.dot(&(r_a - self.position[b]))), weights - f)
        });
        Some(sum / weights)
    }

    /// Laplacian of Shao & Lo (2003): sum_b 2 V F (q_a - q_b).
    pub fn laplacian(&self, a: usize, field: &[f64]) -> f64 {
        let q_a = field[a];
        self.active(a).map(|(b, _, vf)| 2.0 * vf * (q_a - field[b])).sum()
    }

    /// Laplacian of Eq. (3) of Jian et al. (2016); without B_a the uncorrected one.
    pub fn corrected_laplacian(&self, a: usize, field: &[f64], moments: &Moments<D>) -> f64 {
        let plain = self.laplacian(a, field);
        match moments.correction() {
            Some(b) => plain - 2.0 * (b * self.difference_gradient(a, field)).dot(&moments.defect),
            None => plain,
        }
    }
}

/// Sums over a particle's support that carry no field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moments<const D: usize> {
    /// sum V W over active neighbours, without the particle itself; not a number where rows keep no W.
    pub kernel_sum: f64,
    /// Support defect S = sum V grad W over active neighbours, in 1/m; also the gradient of their concentration.
    pub defect: Vector<D>,
    /// sum of -V F over active neighbours, in 1/m2: half the diagonal of the plain Laplacian.
    pub stiffness: f64,
    /// -sum V r (x) grad W over active neighbours: about the identity in a full support.
    pub matrix: Matrix<D>,
}

impl<const D: usize> Default for Moments<D> {
    fn default() -> Self {
        Self { kernel_sum: 0.0, defect: Vector::zeros(), stiffness: 0.0, matrix: Matrix::zeros() }
    }
}

impl<const D: usize> Packed for Moments<D> {
    const WIDTH: usize = 2 + D + D * D;
    fn pack(&self, message: &mut Vec<f64>) {
        message.extend([self.kernel_sum, self.stiffness]);
        message.extend(self.defect.iter().chain(self.matrix.iter()));
    }
    fn unpack(words: &[f64]) -> Self {
        let (defect, matrix) = words[2..].split_at(D);
        Self {
            kernel_sum: words[0],
            stiffness: words[1],
            defect: Vector::from_column_slice(defect),
            matrix: Matrix::from_column_slice(matrix),
        }
    }
}

/// Below this determinant of `Moments::matrix` a support is too one-sided (a film, a corner of spray) for the
/// exact gradient: its inverse would amplify noise more than about threefold.
const SMALLEST_DETERMINANT: f64 = 0.3;

/// det(M)^(1/D) of supports too poor for [`Moments::shape_correction`], and of good ones. A flat surface has about 0.6. With (0.55, 0.7) spray
/// of floating boxes gains energy (`debris` in `wcsph`, 0.02 m: 15 instead of 1 to 2 %); with (0.9, 0.95) waves are damped as without (38 instead of
/// 27 % off in `standing_wave` at 0.05 m).
const SHAPED: [f64; 2] = [0.7, 0.85];

impl<const D: usize> Moments<D> {
    /// Position divergence div r.
    pub fn position_divergence(&self) -> f64 {
        self.matrix.trace()
    }

    /// How full the support is, from 0 to D, with no direction making up for another: D det(M)^(1/D). It is div r where all
    /// directions are alike, and less elsewhere.
    pub fn filling(&self) -> f64 {
        D as f64 * fullness::<D>(inverse(&self.matrix).1)
    }

    /// What makes sums over the support see a pure strain as one: det(M)^(1/D) M^-1 in a good support, the identity in a poor one.
    ///
    /// Its determinant is 1: how full the support is stays in the sums, as the only word that a cluster of few particles has of its
    /// density. With B_a itself such clusters collapse.
    pub fn shape_correction(&self) -> Matrix<D> {
        let (inverse, determinant) = inverse(&self.matrix);
        let fullness = fullness::<D>(determinant);
        let [poor, good] = SHAPED;
        let share = ((fullness - poor) / (good - poor)).clamp(0.0, 1.0);
        if share > 0.0 {
            (share * fullness) * inverse + Matrix::from_diagonal_element(1.0 - share)
        } else {
            Matrix::identity()
        }
    }

    /// B_a, where the support is good enough for it.
    pub fn correction(&self) -> Option<Matrix<D>> {
        // Cofactors written out: nalgebra's general inverse is bounded by dimension traits that a const D lacks.
        let (inverse, determinant) = inverse(&self.matrix);
        (determinant > SMALLEST_DETERMINANT).then_some(inverse)
    }
}

/// det(M)^(1/D), 1 in a full support, of the determinant.
fn fullness<const D: usize>(determinant: f64) -> f64 {
    determinant.max(0.0).powf(1.0 / D as f64)
}

/// Inverse and determinant of a 2 x 2 or 3 x 3 matrix by cofactors.
fn inverse<const D: usize>(m: &Matrix<D>) -> (Matrix<D>, f64) {
    let mut adjugate = Matrix::<D>::zeros();
    match D {
        2 => {
            adjugate[(0, 0)] = m[(1, 1)];
            adjugate[(1, 1)] = m[(0, 0)];
            adjugate[(0, 1)] = -m[(0, 1)];
            adjugate[(1, 0)] = -m[(1, 0)];
        }
        _ => {
            for i in 0..3 {
                for j in 0..3 {
                    let (a, b, c, d) = ((i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3);
                    adjugate[(j, i)] = m[(a, c)] * m[(b, d)] - m[(a, d)] * m[(b, c)];
                }
            }
        }
    }
    let determinant = (0..D).map(|k| m[(0, k)] * adjugate[(k, 0)]).sum::<f64>();
    (adjugate / determinant, determinant)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cofactor_inverse_inverts() {
        let m = Matrix::<2>::new(1.1, 0.2, -0.3, 0.9);
        assert!((inverse(&m).0 * m - Matrix::<2>::identity()).norm() < 1e-14);
        let m = Matrix::<3>::new(1.1, 0.2, -0.3, 0.05, 0.9, 0.1, -0.2, 0.3, 1.3);
        let (inverted, determinant) = inverse(&m);
        assert!((inverted * m - Matrix::<3>::identity()).norm() < 1e-14);
        assert!((determinant - m.determinant()).abs() < 1e-14);
    }
}
