//! Wall pressure extrapolated from the liquid (Adami, Hu & Adams 2012, J. Comput. Phys. 231, 7057-7075, Eq. 27):
//!
//! p_w = sum_f (p_f + rho_f (g - a_wall) . r_wf) W_wf / sum_f W_wf                                (1)
//!
//! over liquid neighbours f of a wall or dummy particle w, exact for water at rest. A negative p_w is set to zero:
//! a wall may hold water back but not hold on to it. Otherwise films stick to walls above the water line.

use crate::particles::Vector;

/// The sums of Eq. (1) for one wall particle.
#[derive(Debug, Clone, Copy)]
pub struct Extrapolation<const D: usize> {
    weights: f64,
    pressure: f64,
    weighted: Vector<D>,
}

impl<const D: usize> Default for Extrapolation<D> {
    fn default() -> Self {
        Self { weights: 0.0, pressure: 0.0, weighted: Vector::zeros() }
    }
}

impl<const D: usize> Extrapolation<D> {
    /// Adds a neighbour: W_wf, its pressure in Pa, its density in kg/m3, and r_wf in m.
    #[inline]
    pub fn add(&mut self, w: f64, pressure: f64, density: f64, r_wf: &Vector<D>) {
        self.weights += w;
        self.pressure += w * pressure;
        self.weighted += (w * density) * r_wf;
    }

    /// sum_f W_wf in 1/m^D.
    pub fn weights(&self) -> f64 {
        self.weights
    }

    /// p_w in Pa, given g - a_wall in m/s2; zero far from the liquid.
    #[inline]
    pub fn pressure(&self, acceleration: &Vector<D>) -> f64 {
        if self.weights == 0.0 {
            return 0.0;
        }
        ((self.pressure + acceleration.dot(&self.weighted)) / self.weights).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn water_at_rest_is_extrapolated_exactly() {
        let (g, rho, wall) = (Vector::<2>::new(0.0, -9.81), 1000.0, Vector::<2>::new(0.013, -0.024));
        let hydrostatic = |r: &Vector<2>| rho * g.dot(&(r - Vector::<2>::new(0.0, 0.4)));
        let mut sums = Extrapolation::default();
        for (x, y, w) in [(0.01, 0.005, 3.0), (0.02, 0.006, 1.0), (-0.004, 0.014, 0.5)] {
            let r = Vector::<2>::new(x, y);
            sums.add(w, hydrostatic(&r), rho, &(wall - r));
        }
        assert!((sums.pressure(&g) - hydrostatic(&wall)).abs() < 1e-9);
        assert_eq!(Extrapolation::<2>::default().pressure(&g), 0.0);
    }

    #[test]
    fn walls_do_not_pull() {
        let mut sums = Extrapolation::<2>::default();
        sums.add(1.0, -50.0, 1000.0, &Vector::zeros());
        assert_eq!(sums.pressure(&Vector::zeros()), 0.0);
    }
}
