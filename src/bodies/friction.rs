//! Friction between a body that slides along one axis and the floor it stands on.
//!
//! It opposes the motion with the size f, whether the body moves or is about to:
//!
//! - `jian2016`: f = alpha m, Eq. (4) of Jian et al. (2016) as printed, a force of alpha newtons a kilogram.
//! - `coulomb`: f = alpha N with the normal force N = m |g| - F_up. F_up, the upward part of the liquid's force, includes the pressure
//!   on the base as water that seeps under the body exerts it: the mean of that along the rim, which is what a pressure
//!   falling linearly from one side to the other amounts to. Without `uplift` N is the weight alone.
//!
//! Eq. (5) of Jian et al. with signs, for a force F and a velocity u along the axis:
//!
//! m du/dt = F - f sign(u)   where u != 0,
//! m du/dt = F - f sign(F)   where u = 0 and |F| > f,                                              (1)
//! du/dt = 0                 where u = 0 and |F| <= f.
//!
//! Friction ends a motion but does not turn it round: where (1) would change the sign of u within a step, the step ends at rest
//! with the friction that this takes, which is at most f.

/// A law of friction and its coefficient.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Friction {
    /// The law.
    pub law: Law,
    /// alpha: N/kg under `jian2016`, a pure number under `coulomb`.
    pub coefficient: f64,
    /// Whether liquid lifts the body (`coulomb`).
    pub uplift: bool,
}

/// Laws of friction.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Law {
    /// In proportion to the normal force.
    #[default]
    Coulomb,
    /// As printed in Jian et al. (2016): in proportion to the mass.
    Jian2016,
}

impl Friction {
    /// Largest friction f in N on a body of `mass` kg and `weight` N that liquid lifts by `lift` N.
    pub fn limit(&self, mass: f64, weight: f64, lift: f64) -> f64 {
        match (self.law, self.uplift) {
            (Law::Jian2016, _) => self.coefficient * mass,
            (Law::Coulomb, true) => self.coefficient * (weight - lift).max(0.0),
            (Law::Coulomb, false) => self.coefficient * weight,
        }
    }
}

/// Which line of Eq. (1) a body is on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Regime {
    /// It moves, or begins to, in this direction: 1 or -1.
    Slides(f64),
    /// It is at rest at the end of the step.
    Rests,
}

impl Regime {
    /// Where to begin with a velocity `u` in m/s.
    pub fn first(u: f64) -> Self {
        if u == 0.0 { Self::Rests } else { Self::Slides(u.signum()) }
    }

    /// Where to go on, if this was wrong: the body had the velocity `u` in m/s and has now `after`, under a `force` in N
    /// but for friction, whose `limit` is in N.
    pub fn correction(self, u: f64, after: f64, force: f64, limit: f64) -> Option<Self> {
        match self {
            Self::Rests if u == 0.0 && force.abs() > limit => Some(Self::Slides(force.signum())),
            Self::Slides(direction) if u != 0.0 && after * direction < 0.0 => Some(Self::Rests),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn laws_give_their_forces() {
        let friction = |law, uplift| Friction { law, coefficient: 0.3, uplift };
        assert_eq!(friction(Law::Jian2016, true).limit(100.0, 981.0, 500.0), 30.0);
        assert!((friction(Law::Coulomb, false).limit(100.0, 981.0, 500.0) - 294.3).abs() < 1e-12);
        assert!((friction(Law::Coulomb, true).limit(100.0, 981.0, 481.0) - 150.0).abs() < 1e-12);
        assert_eq!(friction(Law::Coulomb, true).limit(100.0, 981.0, 1000.0), 0.0, "it floats");
    }

    #[test]
    fn friction_holds_while_it_can_and_reverses_nothing() {
        let rests = Regime::first(0.0);
        assert_eq!(rests.correction(0.0, 0.0, -25.0, 30.0), None);
        assert_eq!(rests.correction(0.0, 0.0, -35.0, 30.0), Some(Regime::Slides(-1.0)));
        let slides = Regime::first(2.0);
        assert_eq!(slides.correction(2.0, 0.1, 0.0, 30.0), None);
        assert_eq!(slides.correction(2.0, -0.1, 0.0, 30.0), Some(Regime::Rests));
        assert_eq!(Regime::Slides(1.0).correction(0.0, -1e-9, 31.0, 30.0), None, "no way back within a step");
    }
}
