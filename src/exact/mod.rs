//! Flows whose solution is known: where they start, and how far a run is from them.
//!
//! A case names its solution; the liquid then starts with its velocity (and, where no equation is solved for it, its pressure), `exact.csv` records found and exact values side
//! by side, and the end table gives the errors, each divided by what its entry says.

mod drop;
mod ode;
mod ritter;
mod taylor_green;
mod waves;

use crate::case::{CaseFile, ExactSolution};
use crate::output::quantities::Scene;
use crate::particles::Vector;
use crate::scheme::Params;
use serde::Serialize;

/// A solution in `D` dimensions.
pub trait Exact<const D: usize> {
    /// Velocity at the start in m/s.
    fn initial_velocity(&self, r: &Vector<D>) -> Vector<D>;

    /// Pressure at the start in Pa, for schemes whose pressure is a state; 0 where gravity gives it.
    fn initial_pressure(&self, _r: &Vector<D>) -> f64 {
        0.0
    }

    /// What is compared, in the order of [`compare`](Self::compare).
    fn quantities(&self) -> Vec<Quantity>;

    /// (found, exact) at `time` in s of each quantity.
    fn compare(&self, scene: &Scene<'_, D>, time: f64) -> Vec<(f64, f64)>;

    /// Errors that only the whole series of a quantity shows, from times in s and (found, exact).
    fn of_series(&self, _time: &[f64], _series: &[Vec<(f64, f64)>]) -> Vec<ErrorMeasure> {
        vec![]
    }
}

/// One column of `exact.csv`, and what its error is divided by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quantity {
    /// Name with unit.
    pub column: &'static str,
    /// Divisor of its error.
    pub scale: Scale,
}

/// What an error is divided by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Scale {
    /// The exact value at the same time.
    Exact,
    /// A number in SI units, and what it is.
    Fixed(f64, &'static str),
}

/// Distance of a run from the exact solution.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ErrorMeasure {
    /// What is compared.
    pub name: String,
    /// Root mean square over the run.
    pub rms: f64,
    /// Largest over the run.
    pub max: f64,
    /// What both are divided by.
    pub of: String,
}

/// The solution a case names.
pub fn of_case<const D: usize>(case: &CaseFile, params: &Params<D>) -> Option<Box<dyn Exact<D>>> {
    Some(match case.exact.as_ref()? {
        ExactSolution::TaylorGreen { speed } => Box::new(taylor_green::TaylorGreen::new(*speed, params)),
        ExactSolution::StretchingDrop { rate } => {
            Box::new(drop::StretchingDrop::new(case, *rate, params.density, case.time.until))
        }
        ExactSolution::StandingWave { amplitude, mode } => {
            Box::new(waves::StandingWave::new(case, *amplitude, *mode, params))
        }
        ExactSolution::Sloshing { mode } => Box::new(waves::StandingWave::new(case, 0.0, *mode, params)),
        ExactSolution::Ritter => Box::new(ritter::DamBreak::new(case, params)),
    })
}

/// Errors over a run: of each quantity, then those of the series.
pub fn errors<const D: usize>(
    exact: &dyn Exact<D>,
    time: &[f64],
    series: &[Vec<(f64, f64)>],
) -> Vec<ErrorMeasure> {
    let of_quantity = |(quantity, pairs): (&Quantity, &Vec<(f64, f64)>)| {
        let error = |(found, exact): &(f64, f64)| match quantity.scale {
            Scale::Exact => (found - exact) / exact,
            Scale::Fixed(scale, _) => (found - exact) / scale,
        };
        let squares: f64 = pairs.iter().map(|pair| error(pair).powi(2)).sum();
        ErrorMeasure {
            name: quantity.column.to_owned(),
            rms: (squares / pairs.len() as f64).sqrt(),
            max: pairs.iter().map(|pair| error(pair).abs()).fold(0.0, f64::max),
            of: match quantity.scale {
                Scale::Exact => "the exact value".to_owned(),
                Scale::Fixed(_, what) => what.to_owned(),
            },
        }
    };
    let quantities = exact.quantities();
    let mut errors: Vec<_> = quantities.iter().zip(series).map(of_quantity).collect();
    errors.extend(exact.of_series(time, series));
    errors
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Known;

    impl Exact<2> for Known {
        fn initial_velocity(&self, _: &Vector<2>) -> Vector<2> {
            Vector::zeros()
        }
        fn quantities(&self) -> Vec<Quantity> {
            let fixed = Scale::Fixed(2.0, "2");
            vec![Quantity { column: "x_m", scale: Scale::Exact }, Quantity { column: "y_m", scale: fixed }]
        }
        fn compare(&self, _: &Scene<'_, 2>, _: f64) -> Vec<(f64, f64)> {
            vec![]
        }
    }

    #[test]
    fn errors_are_divided_as_they_say() {
        let series = vec![vec![(1.1, 1.0), (4.0, 4.0)], vec![(1.0, 1.0), (2.0, 1.0)]];
        let [x, y] = &errors(&Known, &[0.0, 1.0], &series)[..] else { panic!("two quantities") };
        assert!((x.max - 0.1).abs() < 1e-12 && (x.rms - 0.1 / 2_f64.sqrt()).abs() < 1e-12, "{x:?}");
        assert!((y.max - 0.5).abs() < 1e-12 && y.of == "2", "{y:?}");
    }
}
