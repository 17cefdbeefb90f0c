//! The whole scene at one moment, as those see it who look: particles and fields of all ranks, gathered on the first.
//!
//! Looking costs what gathering costs, and the memory of the whole scene on the first rank. What gauges on walls read is not
//! known there: that is for all ranks to read together.

use super::{Compressibility, Fields, Params, Scheme, Stages, StepReport};
use crate::bodies::Bodies;
use crate::halo::{Halo, Kinds};
use crate::parallel::{Packed, Ranks};
use crate::particles::{Fluid, Particles, Vector};
use crate::{Error, Result};
use std::path::Path;

/// What a scheme knows, without the ability to go on.
pub struct Still<const D: usize> {
    params: Params<D>,
    halo: Halo<D>,
    crowding: Vec<f64>,
    surface: Vec<f64>,
    state: Vec<f64>,
    compressibility: Option<Compressibility>,
    stages: Stages,
    bodies: Bodies<D>,
}

/// One particle on its way to the first rank: number if it is a solid, state, crowding, surface weight.
type Record<const D: usize> = (Option<usize>, Fluid<D>, f64, f64);

const fn width(dimension: usize) -> usize {
    2 * dimension + 5
}

impl<const D: usize> Still<D> {
    /// Gathers the `particles` of all ranks, which `scheme` advances; liquid comes sorted by id. `None` on all ranks but the
    /// first.
    pub fn gather(scheme: &dyn Scheme<D>, particles: &Particles<D>) -> Option<(Particles<D>, Self)> {
        let (fields, halo, params) = (scheme.fields(), scheme.halo(), scheme.params());
        let held = (0..particles.owned()).filter(|&a| halo.holds(a));
        let mut message = Vec::with_capacity(held.clone().count() * width(D));
        for a in held {
            let number = Some(a).filter(|a| *a < particles.solids());
            // A failing state may have outgrown its fields.
            let crowding = fields.crowding.get(a).copied().unwrap_or(1.0);
            let surface = fields.surface.get(a).copied().unwrap_or(0.0);
            pack(&(number, particles.fluid_particle(a), crowding, surface), &mut message);
        }
        let parts = params.ranks.gather(message);
        if !params.ranks.is_first() {
            return None;
        }
        let records = parts.iter().flat_map(|part| part.chunks_exact(width(D))).map(unpack);
        let (solids, mut liquid): (Vec<Record<D>>, Vec<Record<D>>) =
            records.partition(|(number, ..)| number.is_some());
        liquid.sort_unstable_by_key(|(_, (.., id), ..)| *id);
        let mut whole = particles.clone();
        whole.retain_fluid(|_| false);
        whole.take_in(liquid.iter().map(|(_, particle, ..)| *particle));
        let count = whole.len();
        let mut still = Self {
            params: Params { ranks: Ranks::default(), ..params.clone() },
            halo: Halo::new(params.periodic, params.support()),
            crowding: vec![1.0; count],
            surface: vec![0.0; count],
            state: scheme.state(),
            compressibility: scheme.compressibility(),
            stages: scheme.stages().clone(),
            bodies: scheme.bodies().clone(),
        };
        let first = whole.solids();
        let numbered = liquid.into_iter().enumerate().map(|(k, record)| (first + k, record));
        let solids = solids.into_iter().filter_map(|record| Some((record.0?, record)));
        for (a, (_, (_, velocity, pressure, _), crowding, surface)) in solids.chain(numbered) {
            (whole.velocity[a], whole.pressure[a]) = (velocity, pressure);
            (still.crowding[a], still.surface[a]) = (crowding, surface);
        }
        still.add_ghosts(&mut whole);
        Some((whole, still))
    }

    /// Ghosts, with their fields.
    fn add_ghosts(&mut self, whole: &mut Particles<D>) {
        self.halo.renew(whole);
        for field in [&mut self.crowding, &mut self.surface] {
            field.resize(whole.len(), 0.0);
            self.halo.refresh(Kinds::All, whole.originals(), field);
        }
    }
}

fn pack<const D: usize>(record: &Record<D>, message: &mut Vec<f64>) {
    let (number, (position, velocity, pressure, id), crowding, surface) = record;
    message.push(number.map_or(-1.0, |number| number as f64));
    [position, velocity].into_iter().for_each(|vector| vector.pack(message));
    message.extend([*pressure, *id as f64, *crowding, *surface]);
}

fn unpack<const D: usize>(words: &[f64]) -> Record<D> {
    let number = (words[0] >= 0.0).then_some(words[0] as usize);
    let vector = |k: usize| Vector::unpack(&words[1 + k * D..1 + (k + 1) * D]);
    let rest = &words[1 + 2 * D..];
    (number, (vector(0), vector(1), rest[0], rest[1] as u64), rest[2], rest[3])
}

impl<const D: usize> Scheme<D> for Still<D> {
    fn step(&mut self, _: &mut Particles<D>, _: f64) -> Result<StepReport> {
        Err(Error::Run("a scene that was gathered to be looked at cannot go on".into()))
    }

    fn start(&mut self, _: &mut Particles<D>) -> Result<()> {
        Ok(())
    }

    fn params(&self) -> &Params<D> {
        &self.params
    }

    fn halo(&self) -> &Halo<D> {
        &self.halo
    }

    fn halo_mut(&mut self) -> &mut Halo<D> {
        &mut self.halo
    }

    fn set_gravity(&mut self, gravity: Vector<D>) {
        self.params.gravity = gravity;
    }

    fn max_dt(&self, _: &Particles<D>) -> f64 {
        f64::INFINITY
    }

    fn state(&self) -> Vec<f64> {
        self.state.clone()
    }

    fn set_state(&mut self, state: &[f64]) -> Option<()> {
        self.state = state.to_vec();
        Some(())
    }

    fn fields(&self) -> Fields<'_, D> {
        Fields { crowding: &self.crowding, surface: &self.surface, ..Fields::none() }
    }

    fn save_system(&self, _: &Path, _: &str) -> Result<()> {
        Ok(())
    }

    fn compressibility(&self) -> Option<Compressibility> {
        self.compressibility
    }

    fn stages(&self) -> &Stages {
        &self.stages
    }

    fn bodies(&self) -> &Bodies<D> {
        &self.bodies
    }

    fn bodies_mut(&mut self) -> &mut Bodies<D> {
        &mut self.bodies
    }
}
