//! A simulation's state in a checkpoint: everything the rest of a run depends on, bit for bit.

use super::checkpoint::{Reader, Writer};
use crate::invariants::Invariants;
use crate::particles::Vector;
use crate::simulation::{Simulation, Totals};
use crate::{Error, Result};

/// Everything the rest of the run depends on.
pub fn save<const D: usize>(simulation: &Simulation<D>, writer: &mut Writer) {
    let flat =
        |vectors: &[Vector<D>]| -> Vec<f64> { vectors.iter().flat_map(|v| v.iter().copied()).collect() };
    let (particles, owned) = (&simulation.particles, simulation.particles.owned());
    let t = &simulation.totals;
    let counts = [
        t.clipped,
        t.collisions,
        t.left,
        t.through_walls,
        t.iterations,
        t.most_iterations,
        t.fallbacks,
        t.retries,
    ];
    writer
        .f64("time", &[simulation.time, simulation.dt, simulation.caution])
        .u64("step", &[simulation.step])
        .u64("totals", &counts)
        .f64("invariants", &simulation.invariants.state())
        .f64("scheme", &simulation.scheme.state())
        .u64("id", &particles.id[..owned])
        .f64("position", &flat(&particles.position[..owned]))
        .f64("velocity", &flat(&particles.velocity[..owned]))
        .f64("pressure", &particles.pressure[..owned]);
    if !simulation.scheme.bodies().is_empty() {
        writer.f64("bodies", &simulation.scheme.bodies().state());
    }
}

/// Goes on from a saved state of the same case.
pub fn restore<const D: usize>(simulation: &mut Simulation<D>, reader: &Reader) -> Result<()> {
    let vectors = |name: &str| -> Result<Vec<Vector<D>>> {
        Ok(reader.f64(name)?.chunks_exact(D).map(Vector::from_column_slice).collect())
    };
    let foreign = || {
        Error::Input("the checkpoint belongs to another case or another version: start the run afresh".into())
    };
    let solids = simulation.particles.solids();
    let (position, velocity) = (vectors("position")?, vectors("velocity")?);
    let (pressure, id) = (reader.f64("pressure")?.to_vec(), reader.u64("id")?.to_vec());
    let same = [velocity.len(), pressure.len(), id.len()].iter().all(|n| *n == position.len());
    if !same || position.len() < solids || id[..solids] != simulation.particles.id[..solids] {
        return Err(foreign());
    }
    let &[time, dt, caution] = reader.f64("time")? else { return Err(foreign()) };
    let &[step] = reader.u64("step")? else { return Err(foreign()) };
    let &[clipped, collisions, left, through_walls, iterations, most_iterations, fallbacks, retries] =
        reader.u64("totals")?
    else {
        return Err(foreign());
    };
    simulation.totals =
        Totals { clipped, collisions, left, through_walls, iterations, most_iterations, fallbacks, retries };
    simulation.caution = caution;
    simulation.invariants = Invariants::from_state(reader.f64("invariants")?).ok_or_else(foreign)?;
    (simulation.time, simulation.dt, simulation.step) = (time, dt, step);
    // Ghosts are those of the arrays that go.
    simulation.particles.drop_ghosts();
    simulation.particles.position = position;
    simulation.particles.velocity = velocity;
    simulation.particles.pressure = pressure;
    simulation.particles.id = id;
    if !simulation.scheme.bodies().is_empty() {
        simulation.scheme.bodies_mut().set_state(reader.f64("bodies")?).ok_or_else(foreign)?;
        simulation.scheme.bodies().clone().place(&mut simulation.particles, true);
    }
    simulation.share_out();
    simulation.scheme.halo_mut().forget_slabs();
    simulation.feel_last_step();
    simulation.scheme.set_state(reader.f64("scheme")?).ok_or_else(foreign)
}
