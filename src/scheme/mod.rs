//! Schemes: what happens in one time step.

pub mod isph;

use crate::Result;
use crate::particles::Particles;
use crate::ppe::SolveRecord;
use std::path::Path;
use std::time::Duration;

/// A method that advances particles in time.
pub trait Scheme<const D: usize> {
    /// Advances `particles` by `dt` s. On an error the particles are left as they were at that moment.
    fn step(&mut self, particles: &mut Particles<D>, dt: f64) -> Result<StepReport>;

    /// Largest stable time step in s for the present state.
    fn max_dt(&self, particles: &Particles<D>) -> f64;

    /// Prepares the first step: finds the pressure of the present state and checks that the solver can work.
    /// Positions and velocities stay as they are.
    fn start(&mut self, particles: &mut Particles<D>) -> Result<()>;

    /// What the next step depends on beside the particles.
    fn state(&self) -> Vec<f64>;

    /// Takes back a [`state`](Self::state); `None` if it is not one.
    fn set_state(&mut self, state: &[f64]) -> Option<()>;

    /// What the last step knows about each particle beside its state.
    fn fields(&self) -> Fields<'_, D>;

    /// Writes the last pressure system, where there is one, into `folder` (made if need be) as `name`.
    fn save_system(&self, folder: &Path, name: &str) -> Result<()>;

    /// Time spent by stage since the start.
    fn stages(&self) -> &Stages;
}

/// Per-particle results of the last step, beside the state itself. Arrays have one entry a particle.
#[derive(Debug, Clone, Copy)]
pub struct Fields<'a, const D: usize> {
    /// Kernel sum over its value on the regular lattice: 1 in undisturbed liquid.
    pub crowding: &'a [f64],
    /// Surface weight, 1 on the free surface and 0 inside.
    pub surface: &'a [f64],
    /// Liquid, and walls where they are wet.
    pub active: &'a [bool],
    /// Neighbours at the last search.
    pub neighbors: &'a crate::neighbors::Neighbors<D>,
}

/// What one step did.
#[derive(Debug, Clone, Default)]
pub struct StepReport {
    /// The pressure solve, in schemes that have one.
    pub solve: Option<SolveRecord>,
    /// Negative pressures set to zero.
    pub clipped: usize,
    /// Pairs that collided.
    pub collisions: usize,
}

/// Wall-clock time by named stage.
#[derive(Debug, Clone, Default)]
pub struct Stages(Vec<(&'static str, Duration)>);

impl Stages {
    /// Runs `work` and books its time under `name`.
    pub fn time<T>(&mut self, name: &'static str, work: impl FnOnce() -> T) -> T {
        let start = std::time::Instant::now();
        let result = work();
        let spent = start.elapsed();
        match self.0.iter_mut().find(|(n, _)| *n == name) {
            Some((_, total)) => *total += spent,
            None => self.0.push((name, spent)),
        }
        result
    }

    /// (stage, time) in order of first appearance.
    pub fn iter(&self) -> impl Iterator<Item = (&'static str, Duration)> + '_ {
        self.0.iter().copied()
    }
}
