//! The time loop: step size, particles that leave, and the watch on finite and bounded values.
//!
//! The loop knows no file formats: an [`Observer`] looks at the simulation after each step.

use crate::geometry::{Aabb, Enclosure};
use crate::invariants::{Deed, Invariants};
use crate::motion::Motion;
use crate::parallel::Ranks;
use crate::particles::{Particles, Vector};
use crate::scheme::still::Still;
use crate::scheme::{Scheme, StepReport};
use crate::{Error, Result};
use rayon::prelude::*;

/// A simulation in progress.
pub struct Simulation<const D: usize> {
    /// Particles at `time`.
    pub particles: Particles<D>,
    /// The method that advances them.
    pub scheme: Box<dyn Scheme<D>>,
    /// Flow time in s.
    pub time: f64,
    /// Number of steps done.
    pub step: u64,
    /// Last time step in s.
    pub dt: f64,
    /// Totals since the start.
    pub totals: Totals,
    /// What the flow should have kept.
    pub invariants: Invariants<D>,
    /// Body force per mass in m/s2 that the liquid felt in the last step: gravity, minus the acceleration of the tank.
    pub body_force: Vector<D>,
    /// In m/s2, without the motion of the tank: it tells which way things fall in the end.
    pub gravity: Vector<D>,
    motion: Option<Motion<D>>,
    control: StepControl,
    enclosure: Enclosure<D>,
    speed_limit: f64,
    margin: f64,
    ranks: Ranks,
    before: State<D>,
    /// Share of the stable step that is taken: less than 1 after steps that went wrong.
    pub caution: f64,
    /// Whether a fixed step has been found too long already.
    warned_of_step: bool,
}

/// What a step starts from: pressure of each particle; position, velocity and id of those that may move; what scheme and bodies keep.
#[derive(Default)]
struct State<const D: usize> {
    /// Those before it stay where they are.
    first: usize,
    particles: (Vec<Vector<D>>, Vec<Vector<D>>, Vec<f64>, Vec<u64>),
    scheme: Vec<f64>,
    bodies: Vec<f64>,
}

/// How the time step is chosen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepControl {
    /// A fixed step in s; adaptive when absent.
    pub fixed: Option<f64>,
    /// Largest adaptive step in s.
    pub largest: f64,
}

/// Counts since the start of a run; those of particles are of this rank.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Totals {
    /// Negative pressures set to zero.
    pub clipped: u64,
    /// Pairs that collided.
    pub collisions: u64,
    /// Particles that left over an open side.
    pub left: u64,
    /// Particles found behind a wall: a defect.
    pub through_walls: u64,
    /// Iterations of the pressure solver.
    pub iterations: u64,
    /// Largest number of iterations in one step.
    pub most_iterations: u64,
    /// Solves that needed a fallback.
    pub fallbacks: u64,
    /// Steps that went wrong and were done again, shorter.
    pub retries: u64,
}

/// Looks at a simulation after each step.
pub trait Observer<const D: usize> {
    /// Called after a step with its report.
    fn observe(&mut self, simulation: &Simulation<D>, report: &StepReport) -> Result<()>;

    /// Whether it would look at particles at `time` in s.
    fn is_due(&self, time: f64) -> bool;
}

/// Largest growth of the time step from one step to the next.
const GROWTH: f64 = 1.1;
/// The first step as a share of the stable one: the pressure starts from a guess.
const FIRST: f64 = 0.1;
/// How often an adaptive step that went wrong is done again, each time half as long: down to a thirtieth, which makes up for a
/// Courant number ten times too large three times over. With half as many attempts that one is only just made up for; twice as
/// many put off the end of a run that no step saves.
const RETRIES: u64 = 5;
/// Growth of the caution after a step that went well: what made a step go wrong is likely to come back. Half and twice the exponent
/// forget within 700 and 170 steps what halved a step.
const RELIEF: f64 = 1.002;
/// Least share of the stable step, for careful steps and for those done again.
const LEAST_CAUTION: f64 = 1.0 / 32.0;
/// A speed this many times that of a fall through the whole scene is a run out of control.
const RUNAWAY: f64 = 20.0;

impl<const D: usize> Simulation<D> {
    /// Starts from `particles`, the whole scene on every rank, which are left alone until the first step. `support` is the kernel's reach in m.
    pub fn new(
        particles: Particles<D>,
        scheme: Box<dyn Scheme<D>>,
        control: StepControl,
        enclosure: Enclosure<D>,
        gravity: Vector<D>,
        support: f64,
    ) -> Self {
        let speed = particles.velocity.iter().map(|v| v.norm()).fold(0.0, f64::max);
        let (mut low, mut high) = (Vector::zeros(), Vector::zeros());
        if let Some(first) = particles.position.first() {
            (low, high) = (*first, *first);
        }
        for r in &particles.position {
            low = low.inf(r);
            high = high.sup(r);
        }
        let fall = (2.0 * gravity.norm() * (high - low).norm()).sqrt();
        let ranks = scheme.params().ranks;
        let mut simulation = Self {
            dt: 0.0,
            ranks,
            particles,
            scheme,
            time: 0.0,
            step: 0,
            totals: Totals::default(),
            invariants: Invariants::default(),
            body_force: gravity,
            motion: None,
            control,
            enclosure,
            gravity,
            // Where nothing moves or falls, nothing tells what is too fast.
            speed_limit: if speed + fall > 0.0 { RUNAWAY * (speed + fall) } else { f64::INFINITY },
            margin: support,
            before: State::default(),
            caution: 1.0,
            warned_of_step: false,
        };
        simulation.share_out();
        simulation.invariants =
            Invariants::at_start(&simulation.particles, simulation.scheme.as_ref(), &gravity);
        simulation.dt = FIRST * simulation.stable_dt();
        simulation
    }

    /// Leaves to this rank its part of the liquid, where every rank has all of it, and the counts to the first.
    pub fn share_out(&mut self) {
        let (rank, count, fluid) = (self.ranks.rank(), self.ranks.count(), self.particles.fluid());
        let end = |rank: usize| fluid.start + fluid.len() * rank / count;
        let mine = end(rank)..end(rank + 1);
        if mine != fluid {
            self.particles.retain_fluid(|a| mine.contains(&a));
        }
        if !self.ranks.is_first() {
            self.totals = Totals { clipped: 0, collisions: 0, left: 0, through_walls: 0, ..self.totals };
        }
    }

    /// Lets the first rank look at the whole scene; a failure there is one of all ranks.
    pub fn show(&self, look: impl FnOnce(&Self) -> Result<()>) -> Result<()> {
        if !self.ranks.are_several() {
            return look(self);
        }
        let whole = self.whole();
        self.ranks.agree(whole.map_or(Ok(()), |whole| look(&whole)))
    }

    /// The whole scene, on the first rank.
    fn whole(&self) -> Option<Self> {
        let Totals { clipped, collisions, left, through_walls, .. } = self.totals;
        let counts = [clipped, collisions, left, through_walls].map(|count| count as f64);
        let counts: Vec<u64> = self.ranks.sums(&counts).into_iter().map(|sum| sum as u64).collect();
        let (particles, still) = Still::gather(self.scheme.as_ref(), &self.particles)?;
        let &[clipped, collisions, left, through_walls] = &counts[..] else { return None };
        Some(Self {
            particles,
            scheme: Box::new(still),
            totals: Totals { clipped, collisions, left, through_walls, ..self.totals },
            motion: self.motion.clone(),
            enclosure: self.enclosure.clone(),
            before: State::default(),
            ranks: Ranks::default(),
            ..*self
        })
    }

    /// Moves the tank from now on.
    pub fn shake(&mut self, motion: Option<Motion<D>>) {
        self.motion = motion;
        self.feel_last_step();
    }

    /// Brings the body force to that of the last step done, or of the start.
    pub fn feel_last_step(&mut self) {
        self.feel(if self.step > 0 { self.time - 0.5 * self.dt } else { self.time });
    }

    fn feel(&mut self, time: f64) {
        if let Some(motion) = &self.motion {
            self.body_force = self.gravity - motion.acceleration(time);
            self.scheme.set_gravity(self.body_force);
        }
    }

    /// Finds the pressure of the initial state; see [`Scheme::start`].
    pub fn start(&mut self) -> Result<()> {
        self.remember();
        let outcome = self.scheme.start(&mut self.particles).map_err(|error| self.located(error, self.dt));
        self.ranks.agree(outcome)
    }

    fn stable_dt(&self) -> f64 {
        self.scheme.max_dt(&self.particles).min(self.control.largest)
    }

    /// Advances by one step. An adaptive step that goes wrong is done again, half as long, from where it began. After an error
    /// the particles are those of the last good state, and [`swap_states`](Self::swap_states) brings up the failing one.
    pub fn advance(&mut self) -> Result<StepReport> {
        // Here and not after the last step, so that observers find the particles as the step saw them.
        self.remove_leavers();
        let stable = self.stable_dt();
        // Fixed, or as long as stability and a steady growth allow.
        let mut dt = self.control.fixed.unwrap_or((self.caution * stable).min(GROWTH * self.dt));
        self.warn_of_long_step(dt, stable);
        let mut retries = 0;
        let (report, invariants) = loop {
            // Each time: a failing state took the place of the good one, and a second failure must not lead back to it.
            self.remember();
            // Steps that nothing mends must not become ever shorter.
            let may_retry =
                self.control.fixed.is_none() && retries < RETRIES && 0.5 * dt >= LEAST_CAUTION * stable;
            let wrong = match self.attempt(dt) {
                Ok((report, invariants)) => match self.flaw(&invariants) {
                    Some(flaw) if may_retry => Error::Run(flaw.into()),
                    _ => break (report, invariants),
                },
                Err(error) => error,
            };
            self.swap_states();
            if !may_retry || !matches!(wrong, Error::Run(_) | Error::Petsc(_)) {
                return Err(self.located(wrong, dt));
            }
            log::debug!("{}: again, half as long", self.located(wrong, dt));
            (dt, retries) = (0.5 * dt, retries + 1);
        };
        self.caution = match retries {
            0 => (RELIEF * self.caution).min(1.0),
            _ => (self.caution * 0.5_f64.powi(retries as i32)).max(LEAST_CAUTION),
        };
        self.invariants = invariants;
        self.time += dt;
        self.step += 1;
        self.dt = dt;
        self.totals.retries += retries;
        self.count(&report);
        Ok(report)
    }

    /// One step of `dt` s, whatever becomes of it, and the invariants after it.
    fn attempt(&mut self, dt: f64) -> Result<(StepReport, Invariants<D>)> {
        // The middle, told from the end: so a resumed run finds the same number.
        self.feel(self.time + dt - 0.5 * dt);
        let outcome = self.scheme.step(&mut self.particles, dt).and_then(|report| {
            self.watch(dt)?;
            Ok(report)
        });
        let report = self.ranks.agree(outcome)?;
        let deed = Deed { dt, gravity: self.gravity, body_force: self.body_force };
        let mut invariants = self.invariants;
        invariants.watch(self.step + 1, &self.particles, self.scheme.as_ref(), &deed)?;
        Ok((report, invariants))
    }

    /// What an adaptive step should be done again for.
    fn flaw(&self, invariants: &Invariants<D>) -> Option<&'static str> {
        let is_lost = |(_, fate): &(usize, Fate)| matches!(fate, Fate::ThroughWall(_));
        match () {
            () if self.control.fixed.is_some() => None,
            () if invariants.jumped_from(&self.invariants) => {
                Some("the liquid gained energy that nothing gave it")
            }
            () if self.ranks.any(self.fates().iter().any(is_lost)) => Some("a particle went through a wall"),
            () => None,
        }
    }

    /// Says once that a fixed step is longer than a stable one.
    fn warn_of_long_step(&mut self, dt: f64, stable: f64) {
        if self.control.fixed.is_none() || self.warned_of_step {
            return;
        }
        if dt > (1.0 + 1e-9) * stable && self.step > 0 {
            self.warned_of_step = true;
            log::warn!(
                "step {} at t = {:.6} s: the fixed step of {dt:.3e} s is {:.1} times the longest stable one, {stable:.3e} s: \
                 leave time.step out to have it chosen, or make it smaller",
                self.step + 1,
                self.time,
                dt / stable
            );
        }
    }

    fn remember(&mut self) {
        self.particles.drop_ghosts();
        let first = if self.scheme.bodies().can_move() { 0 } else { self.particles.solids() };
        self.before.first = first;
        let (position, velocity, pressure, id) = &mut self.before.particles;
        self.particles.position[first..].clone_into(position);
        self.particles.velocity[first..].clone_into(velocity);
        self.particles.pressure.clone_into(pressure);
        self.particles.id[first..].clone_into(id);
        self.before.scheme = self.scheme.state();
        if self.scheme.bodies().can_move() {
            self.before.bodies = self.scheme.bodies().state();
        }
    }

    /// Exchanges the present state with the one before the last step.
    pub fn swap_states(&mut self) {
        self.particles.drop_ghosts();
        let State { first, particles: (position, velocity, pressure, id), .. } = &mut self.before;
        exchange(position, &mut self.particles.position, *first);
        exchange(velocity, &mut self.particles.velocity, *first);
        exchange(pressure, &mut self.particles.pressure, 0);
        exchange(id, &mut self.particles.id, *first);
        // What came from the scheme and its bodies fits them.
        let present = self.scheme.state();
        let _ = self.scheme.set_state(&self.before.scheme);
        self.before.scheme = present;
        if self.scheme.bodies().can_move() {
            let present = self.scheme.bodies().state();
            let _ = self.scheme.bodies_mut().set_state(&self.before.bodies);
            self.before.bodies = present;
        }
    }

    /// Finite and bounded? A particle that leaves all its neighbours behind within one step has jumped, not flowed.
    fn watch(&self, dt: f64) -> Result<()> {
        let limit = self.speed_limit.min(self.margin / dt);
        let Particles { position, velocity, .. } = &self.particles;
        let runs_away = |a: &usize| {
            let finite = position[*a].iter().all(|x| x.is_finite());
            // The negation catches NaN.
            !(finite && velocity[*a].norm() <= limit)
        };
        let fluid = self.particles.fluid().into_par_iter().with_min_len(1024);
        let Some(a) = fluid.find_first(runs_away) else { return Ok(()) };
        Err(Error::Run(format!(
            "particle {} is out of control, with a speed of {:.3e} m/s at {:?} (allowed are {limit:.3e} m/s): try a \
             smaller time step (--set time.step=... or time.courant=...)",
            self.particles.id[a],
            self.particles.velocity[a].norm(),
            self.particles.position[a].as_slice()
        )))
    }

    fn located(&self, error: Error, dt: f64) -> Error {
        match error {
            Error::Run(what) => Error::Run(format!(
                "step {} at t = {:.6} s (dt = {dt:.3e} s): {what}",
                self.step + 1,
                self.time
            )),
            other => other,
        }
    }

    fn count(&mut self, report: &StepReport) {
        self.totals.clipped += report.clipped as u64;
        self.totals.collisions += report.collisions as u64;
        if let Some(solve) = &report.solve {
            self.totals.iterations += solve.iterations as u64;
            self.totals.most_iterations = self.totals.most_iterations.max(solve.iterations as u64);
            self.totals.fallbacks += u64::from(solve.fallback.is_some());
        }
    }

    /// Takes out particles that went over an open side for good, and any that got behind a wall.
    fn remove_leavers(&mut self) {
        let fates = self.fates();
        if fates.is_empty() {
            return;
        }
        let mut stays = vec![true; self.particles.len()];
        for (a, fate) in fates {
            stays[a] = false;
            let (r, v) = (&self.particles.position[a], &self.particles.velocity[a]);
            self.invariants.let_go(r, v, self.scheme.params().mass(), &self.gravity);
            match fate {
                Fate::ThroughWall(wall) => {
                    self.totals.through_walls += 1;
                    log::warn!(
                        "step {}: particle {} went through the {wall} wall at {:?}: try a smaller time step",
                        self.step,
                        self.particles.id[a],
                        self.particles.position[a].as_slice()
                    );
                }
                _ => self.totals.left += 1,
            }
        }
        self.particles.retain_fluid(|a| stays[a]);
    }

    /// The liquid that does not stay, and where it is bound.
    fn fates(&self) -> Vec<(usize, Fate)> {
        let (bodies, Self { particles, enclosure, gravity, margin, .. }) = (self.scheme.bodies(), self);
        let fate = |r: &Vector<D>| match Fate::of(r, enclosure, gravity, *margin) {
            Fate::Stays if bodies.contain(r) => Fate::ThroughWall("body's"),
            fate => fate,
        };
        let fluid = particles.fluid().into_par_iter().with_min_len(1024);
        let fates = fluid.map(|a| (a, fate(&particles.position[a])));
        fates.filter(|(_, fate)| *fate != Fate::Stays).collect()
    }
}

/// Exchanges what was kept with what is `present` from `first` on.
fn exchange<T: Copy>(kept: &mut Vec<T>, present: &mut Vec<T>, first: usize) {
    let rest = present.split_off(first);
    present.extend_from_slice(kept);
    *kept = rest;
}

/// Where a particle is bound.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fate {
    Stays,
    Left,
    ThroughWall(&'static str),
}

impl Fate {
    /// Above an open top a particle stays until it has passed a wall sideways: it may fall back. On any other open side
    /// it has left once it is a kernel support away.
    fn of<const D: usize>(r: &Vector<D>, enclosure: &Enclosure<D>, gravity: &Vector<D>, margin: f64) -> Self {
        let deep = |b: &Aabb<D>| {
            (0..D).map(|d| (r[d] - b.min[d]).min(b.max[d] - r[d])).fold(f64::INFINITY, f64::min)
        };
        if enclosure.boxes.iter().any(|b| deep(b) > enclosure.tolerance) {
            return Self::ThroughWall("box's");
        }
        let Some(tank) = &enclosure.tank else { return Self::Stays };
        let mut behind = None;
        let mut beyond_open = false;
        for d in (0..D).filter(|&d| !tank.periodic[d]) {
            let overshoot = [tank.inner.min[d] - r[d], r[d] - tank.inner.max[d]];
            for (end, overshoot) in overshoot.into_iter().enumerate() {
                let slack = if tank.open[d][end] { 0.0 } else { enclosure.tolerance };
                if overshoot <= slack {
                    continue;
                }
                if !tank.open[d][end] {
                    behind = Some(Self::wall_name(d, end, D));
                    continue;
                }
                beyond_open = true;
                let outward = if end == 0 { -gravity[d] } else { gravity[d] };
                if outward >= 0.0 && overshoot > margin {
                    return Self::Left;
                }
            }
        }
        match behind {
            None => Self::Stays,
            Some(_) if beyond_open => Self::Left,
            Some(wall) => Self::ThroughWall(wall),
        }
    }

    fn wall_name(axis: usize, end: usize, dimension: usize) -> &'static str {
        match (axis, axis == dimension - 1) {
            (_, true) => ["bottom", "top"][end],
            (0, _) => ["left", "right"][end],
            _ => ["front", "back"][end],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::TankShape;

    #[test]
    fn leavers_are_told_from_leaks() {
        let inner = Aabb { min: Vector::<2>::zeros(), max: Vector::<2>::new(1.0, 1.0) };
        let tank = TankShape { inner, open: [[false, true], [false, true]], periodic: [false; 2] };
        let gravity = Vector::<2>::new(0.0, -9.81);
        let block = Aabb { min: Vector::<2>::new(0.2, 0.0), max: Vector::<2>::new(0.4, 0.1) };
        let enclosure = Enclosure { tank: Some(tank), boxes: vec![block], tolerance: 0.005 };
        let fate = |x: f64, y: f64| Fate::of(&Vector::<2>::new(x, y), &enclosure, &gravity, 0.1);
        assert_eq!(fate(0.5, 0.5), Fate::Stays);
        assert_eq!(fate(0.5, 3.0), Fate::Stays, "falls back");
        assert_eq!(fate(-0.01, 3.0), Fate::Left, "over the rim");
        assert_eq!(fate(-0.01, 0.5), Fate::ThroughWall("left"));
        assert_eq!(fate(0.5, -0.01), Fate::ThroughWall("bottom"));
        assert_eq!(fate(0.5, -0.004), Fate::Stays, "before the wall's particles");
        assert_eq!(fate(0.3, 0.05), Fate::ThroughWall("box's"));
        assert_eq!(fate(0.3, 0.097), Fate::Stays);
        assert_eq!(fate(1.05, 0.5), Fate::Stays, "still near");
        assert_eq!(fate(1.2, 0.5), Fate::Left);
    }
}
