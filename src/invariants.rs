//! What a flow keeps and a discrete one strays from, watched over a run.
//!
//! | | what is measured | each | warns at | stops at |
//! |---|---|---|---|---|
//! | energy | rise of the liquid's energy over an earlier value, less the work done on it, over E | step | 5 % | 100 % |
//! | momentum | of liquid that touches no solid: difference from its first value plus the impulse of gravity, over M U | step | 1 % | |
//! | volume | mean kernel volume of the liquid's inside, over that of the lattice, minus 1 | [`SAMPLE`] steps | 10 % | |
//! | density | largest kernel density (`wcsph`: density) of the inside over that of the lattice, minus 1 | [`SAMPLE`] steps | 50 % | |
//! | divergence | rms of div v of the inside, times the spacing, over U | [`SAMPLE`] steps | 50 % | |
//! | roughness | rms of the pressure's distance from a plane through its neighbours, over the rms pressure; mean over the run | [`SAMPLE`] steps | | |
//!
//! E = M U^2 / 2 is the energy of the liquid of mass M at its start, the potential one above the lowest particle of the scene: no flow
//! has more of it to turn into motion, unless it is put in. The work done on the liquid is that of a shaken tank, -M a . v, and of moving bodies, the
//! opposite of what the liquid does on them. Compressed liquid (`wcsph`) has elastic energy too, and liquid near a wall that repels
//! it the potential of that force. Particles that leave take theirs along. Bounds warn once; where they are exceeded a bound half or
//! twice as large would have warned in nearly the same runs, since flows of good steps stay below a fifth of them.
//!
//! The roughness tells how noisy a scheme's pressures are from particle to particle: for p_a - sum_b W_ab (p_b + r_ab . grad p) / sum_b W_ab,
//! with the exact gradient of [`crate::operators`], any linear pressure gives zero. Only particles of the inside without solid neighbours count.
//!
//! Values that are not finite and speeds out of reach are found in every step by [`crate::simulation`], as are particles behind walls.

use crate::neighbors::{Layout, Neighbors};
use crate::operators::Surroundings;
use crate::particles::{Particles, Vector};
use crate::scheme::{Compressibility, Params, Scheme};
use crate::{Error, Result};
use rayon::prelude::*;

/// Steps between two looks at volume, density and divergence: they take a search and a pass over all pairs, half a step of `wcsph`.
pub const SAMPLE: u64 = 50;
/// Parts that the liquid is looked at in, since all its rows at once would be as much memory as the scheme's own.
const PARTS: usize = 8;

/// Rises of the energy over E at which a run warns and stops.
const ENERGY: [f64; 2] = [0.05, 1.0];
/// A rise of the energy over E within a step that makes an adaptive step worth doing again, where the first bound is passed: the steps
/// of an explicit scheme beyond its limit pass both within a few. At the impact of a splash of 200 particles good ones pass this one too,
/// but not the other.
const JUMP: f64 = 0.01;
/// What momentum, volume, density and divergence warn at.
const BOUNDS: [(&str, f64); 4] = [
    ("the momentum of the free liquid is off by", 0.01),
    ("the volume of the liquid changed by", 0.1),
    ("the density is off by as much as", 0.5),
    ("the divergence of the velocity, times the spacing over the speed of the liquid's energy, is", 0.5),
];

/// The invariants of a run so far; the same on all ranks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Invariants<const D: usize> {
    /// Energy of the liquid in J.
    pub energy: Energy,
    /// Largest difference of a free liquid's momentum, over M U; zero where there are solids.
    pub momentum: f64,
    /// Largest |kernel volume - 1|, with its sign.
    pub volume: f64,
    /// Largest density error of the inside.
    pub density: f64,
    /// Largest rms of the divergence, times spacing over U.
    pub divergence: f64,
    /// Roughness of the pressure, mean of the samples so far.
    pub roughness: f64,
    /// The last of them.
    pub last_roughness: f64,
    /// How many samples had a pressure.
    samples: f64,
    /// Momentum in kg m/s that gravity should have led to.
    expected: Vector<D>,
    /// U in m/s.
    speed: f64,
    /// M in kg, at the start.
    mass: f64,
    /// Energy in J of particles that left since the last step, on this rank.
    left: f64,
    warned: [bool; 5],
}

impl<const D: usize> Default for Invariants<D> {
    fn default() -> Self {
        Self {
            energy: Energy::default(),
            momentum: 0.0,
            volume: 0.0,
            density: 0.0,
            divergence: 0.0,
            roughness: 0.0,
            last_roughness: 0.0,
            samples: 0.0,
            expected: Vector::zeros(),
            speed: 0.0,
            mass: 0.0,
            left: 0.0,
            warned: [false; 5],
        }
    }
}

/// The liquid's total energy in J over a run.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Energy {
    /// At the start, zero potential at the origin.
    pub initial: f64,
    /// At present, less the work done on the liquid.
    pub now: f64,
    /// Lowest so far, less the work done on the liquid.
    pub lowest: f64,
    /// Largest rise above an earlier value, less the work done on the liquid.
    pub largest_rise: f64,
    /// Work done on the liquid so far, and energy that left with particles, negative.
    pub input: f64,
}

/// What is summed over the liquid.
struct Sums<const D: usize> {
    energy: f64,
    momentum: Vector<D>,
    mass: f64,
    left: f64,
}

/// What a step did that the energy must know of.
#[derive(Debug, Clone, Copy)]
pub struct Deed<const D: usize> {
    /// Length of the step in s.
    pub dt: f64,
    /// Gravity in m/s2, without the motion of the tank.
    pub gravity: Vector<D>,
    /// Body force per mass in m/s2 that the liquid felt.
    pub body_force: Vector<D>,
}

impl<const D: usize> Invariants<D> {
    /// Those of a flow at its start, its particles shared out.
    pub fn at_start(particles: &Particles<D>, scheme: &dyn Scheme<D>, gravity: &Vector<D>) -> Self {
        let params = scheme.params();
        let sums = Sums::of(particles, params, scheme.compressibility(), gravity, 0.0);
        let depth = particles.position.iter().map(|r| gravity.dot(r)).fold(f64::NEG_INFINITY, f64::max);
        let lowest = params.ranks.max(depth);
        let available = if sums.mass > 0.0 { sums.energy / sums.mass + lowest } else { 0.0 };
        let speed = (2.0 * available.max(0.0)).sqrt();
        let energy =
            Energy { initial: sums.energy, now: sums.energy, lowest: sums.energy, ..Energy::default() };
        Self { energy, expected: sums.momentum, speed, mass: sums.mass, ..Self::default() }
    }

    /// Takes note of a particle that leaves.
    pub fn let_go(&mut self, r: &Vector<D>, v: &Vector<D>, mass: f64, gravity: &Vector<D>) {
        self.left += mass * (0.5 * v.norm_squared() - gravity.dot(r));
    }

    /// Looks at the state after step number `step`.
    ///
    /// # Errors
    /// [`Error::Run`] if the liquid has gained more energy than any fall could give it.
    pub fn watch(
        &mut self,
        step: u64,
        particles: &Particles<D>,
        scheme: &dyn Scheme<D>,
        deed: &Deed<D>,
    ) -> Result<()> {
        let params = scheme.params();
        let sums = Sums::of(particles, params, scheme.compressibility(), &deed.gravity, self.left);
        self.left = 0.0;
        let bodies = scheme.bodies().list.iter();
        let on_bodies: f64 = bodies
            .map(|body| {
                let (state, loads) = (&body.state, &body.state.loads);
                // In the middle of the step: so it is what a free body gains, however light.
                let velocity = state.velocity - 0.5 * deed.dt * state.acceleration;
                let spin = state.spin - 0.5 * deed.dt * state.angular_acceleration;
                loads.liquid.dot(&velocity) + loads.torque.dot(&spin)
            })
            .sum();
        let energy = &mut self.energy;
        energy.input +=
            deed.dt * ((deed.body_force - deed.gravity).dot(&sums.momentum) - on_bodies) - sums.left;
        let own = sums.energy - energy.input;
        energy.now = own;
        energy.lowest = energy.lowest.min(own);
        energy.largest_rise = energy.largest_rise.max(own - energy.lowest);

        self.expected += deed.dt * sums.mass * deed.body_force;
        if particles.solids() == 0 && sums.mass > 0.0 {
            let off = (sums.momentum - self.expected).norm() / (sums.mass * self.speed);
            self.momentum = self.momentum.max(off);
        }
        if step % SAMPLE == 1 {
            self.sample(particles, scheme);
        }
        self.judge(step)
    }

    /// Whether the liquid, above the bound already, gained more energy in one step than a good one gives it.
    pub fn jumped_from(&self, before: &Self) -> bool {
        let whole = self.available();
        let Energy { now, lowest, .. } = self.energy;
        whole > 0.0 && now - lowest > ENERGY[0] * whole && now - before.energy.now > JUMP * whole
    }

    /// Volume, density, divergence and roughness of the liquid's inside.
    fn sample(&mut self, particles: &Particles<D>, scheme: &dyn Scheme<D>) {
        let (fields, params) = (scheme.fields(), scheme.params());
        let (mut count, mut volume, mut square) = (0.0, 0.0, 0.0);
        let (mut rough, mut pressure) = (0.0, 0.0);
        let mut density = 0.0_f64;
        let is_inside = |a: usize| {
            fields.surface.get(a).is_some_and(|s| *s <= 0.0)
                && fields.crowding.get(a).is_some_and(|c| *c > 0.0)
        };
        let (layout, fluid) = (Layout::of(particles).with_solids_blind_to_solids(), particles.fluid());
        let mut neighbors = Neighbors::default();
        for part in fluid.clone().step_by(fluid.len().div_ceil(PARTS).max(1)) {
            let part = part..(part + fluid.len().div_ceil(PARTS)).min(fluid.end);
            let wanted =
                |a| if part.contains(&a) && is_inside(a) { f64::NEG_INFINITY } else { f64::INFINITY };
            let (kernel, h) = (params.kernel, params.smoothing_length());
            neighbors.search(kernel, h, &particles.position, &layout, wanted);
            let surroundings = Surroundings {
                position: &particles.position,
                neighbors: &neighbors,
                active: fields.active,
                volume: params.volume(),
            };
            let of = |a: usize| {
                let moments = surroundings.moments(a);
                let divergence = surroundings.divergence(a, &particles.velocity, &moments);
                let distance = match neighbors.has_solids(a) {
                    true => None,
                    false => surroundings.distance_from_plane(a, &particles.pressure, &moments),
                };
                (a, divergence, distance)
            };
            // Summed up in one order: sums must not depend on the threads.
            let inside = part.into_par_iter().with_min_len(256).filter(|a| is_inside(*a));
            for (a, divergence, distance) in inside.map(of).collect::<Vec<_>>() {
                if let Some(distance) = distance {
                    rough += distance * distance;
                    pressure += particles.pressure[a].powi(2);
                }
                count += 1.0;
                volume += 1.0 / fields.crowding[a];
                square += divergence * divergence;
                density = density.max((fields.crowding[a] - 1.0).abs());
            }
        }
        let sums = params.ranks.sums(&[count, volume, square, rough, pressure]);
        let &[count, volume, square, rough, pressure] = &sums[..] else { return };
        self.density = self.density.max(params.ranks.max(density));
        if count > 0.0 {
            let change = volume / count - 1.0;
            if change.abs() > self.volume.abs() {
                self.volume = change;
            }
            self.divergence = self.divergence.max((square / count).sqrt() * params.spacing / self.speed);
        }
        if pressure > 0.0 {
            self.samples += 1.0;
            self.last_roughness = (rough / pressure).sqrt();
            self.roughness += (self.last_roughness - self.roughness) / self.samples;
        }
    }

    /// E in J.
    fn available(&self) -> f64 {
        0.5 * self.mass * self.speed * self.speed
    }

    fn judge(&mut self, step: u64) -> Result<()> {
        let whole = self.available();
        // Where nothing moves or falls at the start, nothing tells what is much.
        if whole == 0.0 {
            return Ok(());
        }
        let rise = self.energy.largest_rise / whole;
        if rise > ENERGY[1] {
            return Err(Error::Run(format!(
                "the liquid has gained {:.3e} J that nothing gave it, as much as it had at its start: try a smaller time step \
                 (--set time.step=... or time.courant=...)",
                self.energy.largest_rise
            )));
        }
        let found = [self.momentum, self.volume.abs(), self.density, self.divergence];
        let all = std::iter::once((
            ("the liquid has gained energy that nothing gave it, of what it had at its start", ENERGY[0]),
            rise,
        ))
        .chain(BOUNDS.into_iter().zip(found));
        for (((what, bound), value), warned) in all.zip(&mut self.warned) {
            if value > bound && !*warned {
                *warned = true;
                log::warn!("step {step}: {what} {:.1} % (bound {:.0} %)", 100.0 * value, 100.0 * bound);
            }
        }
        Ok(())
    }

    /// As numbers, for checkpoints.
    pub fn state(&self) -> Vec<f64> {
        let mut copy = *self;
        copy.numbers().iter().map(|number| **number).chain(self.expected.iter().copied()).collect()
    }

    /// Back from [`state`](Self::state); `None` if it is none.
    pub fn from_state(state: &[f64]) -> Option<Self> {
        let mut invariants = Self::default();
        let numbers = invariants.numbers();
        let (found, expected) = state.split_at_checked(numbers.len())?;
        numbers.into_iter().zip(found).for_each(|(number, found)| *number = *found);
        let expected: &[f64; D] = expected.try_into().ok()?;
        invariants.expected = Vector::from_column_slice(expected);
        Some(invariants)
    }

    /// What a state holds before the expected momentum.
    fn numbers(&mut self) -> [&mut f64; 14] {
        let energy = &mut self.energy;
        [
            &mut energy.initial,
            &mut energy.now,
            &mut energy.lowest,
            &mut energy.largest_rise,
            &mut energy.input,
            &mut self.momentum,
            &mut self.volume,
            &mut self.density,
            &mut self.divergence,
            &mut self.roughness,
            &mut self.last_roughness,
            &mut self.samples,
            &mut self.speed,
            &mut self.mass,
        ]
    }
}

impl<const D: usize> Sums<D> {
    fn of(
        particles: &Particles<D>,
        params: &Params<D>,
        compressibility: Option<Compressibility>,
        gravity: &Vector<D>,
        left: f64,
    ) -> Self {
        let (fluid, mass) = (particles.fluid(), params.mass());
        let (mut squares, mut momentum, mut moment) = (0.0, Vector::<D>::zeros(), Vector::<D>::zeros());
        for (v, r) in particles.velocity[fluid.clone()].iter().zip(&particles.position[fluid.clone()]) {
            squares += v.norm_squared();
            momentum += v;
            moment += r;
        }
        // Of a liquid that is compressed: p^2 / (2 rho^2 c^2) per mass.
        let elastic = compressibility.map_or(0.0, |Compressibility { sound_speed, .. }| {
            let pressures = particles.pressure[fluid.clone()].iter();
            pressures.map(|p| (p / (params.density * sound_speed)).powi(2)).sum()
        });
        let at_walls = compressibility.map_or(0.0, |compressibility| compressibility.wall_potential);
        let energy = mass * (0.5 * (squares + elastic) - gravity.dot(&moment)) + at_walls;
        let mut local = vec![energy, mass * fluid.len() as f64, left];
        local.extend(momentum.iter().map(|p| mass * p));
        let whole = params.ranks.sums(&local);
        Self {
            energy: whole[0],
            mass: whole[1],
            left: whole[2],
            momentum: Vector::from_column_slice(&whole[3..]),
        }
    }
}
