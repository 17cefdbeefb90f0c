//! Rigid bodies: exact mechanics without water, statics, friction, and what a case file may ask of them.

use sphpetsc::bodies::{Bodies, Body, Motion};
use sphpetsc::case::build::{self, Scene};
use sphpetsc::case::{CaseFile, read};
use sphpetsc::neighbors::{Layout, Neighbors};
use sphpetsc::particles::{Particles, Vector};
use sphpetsc::scheme::Params;
use sphpetsc::scheme::wcsph::Wcsph;
use sphpetsc::simulation::{Simulation, StepControl};
use sphpetsc::terms::collision::Collisions;

/// A dry tank; bodies follow.
const DRY: &str = "
name = \"dry\"
dimension = 3
spacing = 0.05
[tank]
min = [0, 0, 0]
max = [4, 1, 2]
open = [\"top\"]
[scheme]
kind = \"wcsph\"
[time]
until = 1
";

fn case(text: &str, sets: &[(&str, &str)]) -> CaseFile {
    let sets: Vec<_> = sets.iter().map(|&(key, value)| (key.to_owned(), value.to_owned())).collect();
    read::read(text, "test.toml", &sets).unwrap()
}

fn simulation<const D: usize>(text: &str, sets: &[(&str, &str)], dt: Option<f64>) -> Simulation<D> {
    let scene = build::scene::<D>(&case(text, sets));
    let method = build::wcsph(&case(text, sets), &scene);
    let Scene { particles, params, enclosure, .. } = scene;
    let scheme = Box::new(Wcsph::new(params.clone(), method, &particles));
    let control = StepControl { fixed: dt, largest: f64::INFINITY };
    let mut simulation =
        Simulation::new(particles, scheme, control, enclosure, params.gravity, params.support());
    simulation.start().unwrap();
    simulation
}

fn body<const D: usize>(simulation: &Simulation<D>) -> &Body<D> {
    &simulation.scheme.bodies().list[0]
}

fn until<const D: usize>(simulation: &mut Simulation<D>, time: f64) {
    while simulation.time < time - 1e-9 {
        simulation.advance().unwrap();
    }
}

fn with(text: &str, body: &str) -> String {
    format!("{text}\n[[body]]\n{body}\n")
}

const BOX: &str = "min = [0.4, 0.4, 0]\nmax = [0.6, 0.6, 0.2]\nmass = 10\nmotion = \"sliding\"";

#[test]
fn a_pushed_box_slides_as_coulomb_has_it() {
    let text = with(DRY, &format!("{BOX}\npush = [50, 0, 0]\n[body.friction]\ncoefficient = 0.3"));
    let mut simulation = simulation::<3>(&text, &[], Some(1e-3));
    until(&mut simulation, 0.5);
    let expected = 0.5 * (50.0 / 10.0 - 0.3 * 9.81) * 0.25;
    let moved = body(&simulation).state.position.x - 0.5;
    // Exact but for rounding.
    assert!((moved / expected - 1.0).abs() < 1e-9, "{moved} instead of {expected}");
}

#[test]
fn a_box_coasts_to_rest_and_stays() {
    let text = with(DRY, &format!("{BOX}\nvelocity = [1.5, 0, 0]\n[body.friction]\ncoefficient = 0.3"));
    let mut simulation = simulation::<3>(&text, &[], Some(1e-3));
    let (time, distance) = (1.5 / (0.3 * 9.81), 1.5_f64.powi(2) / (2.0 * 0.3 * 9.81));
    let mut stopped = 0.0;
    while body(&simulation).state.velocity.x > 0.0 {
        simulation.advance().unwrap();
        stopped = simulation.time;
    }
    let moved = body(&simulation).state.position.x - 0.5;
    // It stops within the step that holds the instant, a 500th of the time.
    assert!((stopped - time).abs() <= 1e-3, "{stopped} instead of {time}");
    assert!((moved / distance - 1.0).abs() < 1e-3, "{moved} instead of {distance}");
    until(&mut simulation, stopped + 0.05);
    assert_eq!(body(&simulation).state.velocity.x, 0.0);
    assert_eq!(body(&simulation).state.position.x - 0.5, moved, "no creep");
}

#[test]
fn friction_as_printed_is_a_force_per_mass() {
    let text = with(DRY, &format!("{BOX}\npush = [3.5, 0, 0]\n[body.friction]\nlaw = \"jian2016\""));
    let mut slides = simulation::<3>(&text, &[], Some(1e-3));
    until(&mut slides, 0.1);
    let expected = 0.5 * (3.5 - 3.0) / 10.0 * 0.01;
    assert!(((body(&slides).state.position.x - 0.5) / expected - 1.0).abs() < 1e-9);
    let mut rests = simulation::<3>(&text, &[("body.push", "[2.9, 0, 0]")], Some(1e-3));
    let place = body(&rests).state.position.x;
    until(&mut rests, 0.1);
    assert_eq!(body(&rests).state.position.x, place);
    assert!((body(&rests).state.loads.friction.x + 2.9).abs() < 1e-12, "it holds as much as it must");
}

#[test]
fn a_ball_falls_and_a_top_keeps_energy_and_angular_momentum() {
    let ball = "shape = \"sphere\"\ncentre = [1, 0.5, 1.5]\nradius = 0.15\ndensity = 500\nmotion = \"free\"";
    let mut falling = simulation::<3>(&with(DRY, ball), &[], Some(2e-3));
    until(&mut falling, 0.4);
    let state = body(&falling).state;
    assert!((1.5 - state.position.z - 0.5 * 9.81 * 0.16).abs() < 1e-9 && state.spin.norm() < 1e-12);

    let top = "min = [0.5, 0.2, 0.8]\nmax = [0.7, 0.6, 0.9]\nmass = 2\nmotion = \"free\"\nspin = [0.3, 0.1, 12]\n\
               locked = [\"x\", \"y\", \"z\"]";
    // About the middle axis of inertia as well, where it tumbles.
    for spin in ["[0.3, 0.1, 12]", "[12, 0.1, 0.2]"] {
        let mut spinning = simulation::<3>(&with(DRY, top), &[("body.spin", spin)], Some(2e-3));
        let (energy, momentum) = (body(&spinning).kinetic_energy(), body(&spinning).state.angular_momentum);
        until(&mut spinning, 2.0);
        let after = body(&spinning);
        assert!((after.kinetic_energy() / energy - 1.0).abs() < 1e-3, "{spin}");
        assert!((after.state.angular_momentum - momentum).norm() / momentum.norm() < 1e-9, "{spin}");
        let turned = after.inertia() * after.state.spin;
        assert!((turned - momentum).norm() / momentum.norm() < 1e-9, "L = I w");
    }
}

#[test]
fn a_free_box_on_a_floor_slides_to_rest_and_does_not_sink() {
    let text = with(
        DRY,
        "min = [0.4, 0.4, 0]\nmax = [0.8, 0.6, 0.1]\nmass = 10\nmotion = \"free\"\nvelocity = [1.5, 0, 0]\n\
         [body.friction]\ncoefficient = 0.3",
    );
    let mut simulation = simulation::<3>(&text, &[], Some(1e-3));
    let (time, distance) = (1.5 / (0.3 * 9.81), 1.5_f64.powi(2) / (2.0 * 0.3 * 9.81));
    let mut stopped = 0.0;
    while body(&simulation).state.velocity.x > 0.0 {
        simulation.advance().unwrap();
        stopped = simulation.time;
    }
    // Within the step that holds the instant.
    assert!((stopped - time).abs() <= 1e-3, "{stopped} instead of {time}");
    until(&mut simulation, 0.7);
    let state = body(&simulation).state;
    let moved = state.position.x - 0.6;
    assert!((moved / distance - 1.0).abs() < 1e-3, "{moved} instead of {distance}");
    // But for a hundredth of what gravity does in a step, which the contact gives and takes.
    assert!(state.velocity.norm() < 0.01 * 9.81 * 1e-3, "{}", state.velocity);
    assert!((state.position.z - 0.05).abs() < 0.01 * 0.05, "{}", state.position);
    // The floor carries it.
    assert!((state.loads.contact.z / 98.1 - 1.0).abs() < 1e-3, "{}", state.loads.contact);
}

#[test]
fn a_pushed_free_box_slides_as_coulomb_has_it() {
    let text = with(
        DRY,
        "min = [0.4, 0.4, 0]\nmax = [0.8, 0.6, 0.1]\nmass = 10\nmotion = \"free\"\npush = [50, 0, 0]\n\
         [body.friction]\ncoefficient = 0.3",
    );
    let mut simulation = simulation::<3>(&text, &[], Some(1e-3));
    until(&mut simulation, 0.5);
    let expected = 0.5 * (50.0 / 10.0 - 0.3 * 9.81) * 0.25;
    let moved = body(&simulation).state.position.x - 0.6;
    assert!((moved / expected - 1.0).abs() < 1e-3, "{moved} instead of {expected}");
}

#[test]
fn a_sliding_box_stops_at_what_stands_in_its_way() {
    let text = with(
        DRY,
        &format!("{BOX}\nvelocity = [1.5, 0, 0]\npush = [20, 0, 0]\n[body.friction]\ncoefficient = 0"),
    );
    let obstacle = ("box", "[{min = [1.4, 0, 0], max = [1.6, 1, 0.4]}]");
    for (sets, face) in [(&[obstacle][..], 1.4), (&[("tank.max", "[1.5, 1, 2]")], 1.5)] {
        let mut simulation = simulation::<3>(&text, sets, Some(1e-3));
        let moves = |simulation: &Simulation<3>| body(simulation).state.position.x + 0.1 < face - 0.01;
        while moves(&simulation) {
            simulation.advance().unwrap();
        }
        // Nothing holds it back on the way: v^2 = v_0^2 + 2 a s.
        let travelled = body(&simulation).state.position.x - 0.5;
        let expected = (1.5_f64.powi(2) + 2.0 * 2.0 * travelled).sqrt();
        assert!((body(&simulation).state.velocity.x / expected - 1.0).abs() < 1e-9);
        let arrived = simulation.time;
        until(&mut simulation, arrived + 0.2);
        let state = body(&simulation).state;
        // Rapier lets solids touch within a hundredth of a spacing.
        assert!((state.position.x + 0.1 - face).abs() < 0.01 * 0.05, "{}", state.position);
        assert!(state.velocity.x.abs() < 1e-4, "{}", state.velocity);
        assert!((state.loads.contact.x / -20.0 - 1.0).abs() < 1e-2, "{}", state.loads.contact);
    }
}

/// All neighbours, and collisions that reach those at the lattice's distance.
fn contacts(particles: &Particles<3>, params: &Params<3>) -> (Neighbors<3>, Collisions) {
    let mut neighbors = Neighbors::default();
    let (kernel, h, layout) = (params.kernel, params.smoothing_length(), Layout::of(particles));
    neighbors.search(kernel, h, &particles.position, &layout, |_| f64::NEG_INFINITY);
    (neighbors, Collisions { distance: 1.2 * params.spacing, restitution: 0.2, mass: params.mass() })
}

#[test]
fn collisions_keep_the_momentum_of_liquid_and_body() {
    let drop = ("fluid.block", "[{min = [0.85, 0.5, 0.9], max = [1, 0.6, 1.05], velocity = [2, 0.3, -0.1]}]");
    let turning = "min = [1, 0.4, 0.8]\nmax = [1.2, 0.6, 1.1]\nmotion = \"free\"";
    for (mass, locked) in
        [("0.1", "[]"), ("10", "[]"), ("1e4", "[]"), ("10", "[\"y\", \"rotation_x\", \"rotation_y\"]")]
    {
        let text = with(DRY, turning);
        let sets = [drop, ("body.mass", mass), ("body.locked", locked)];
        let Scene { mut particles, params, .. } = build::scene::<3>(&case(&text, &sets));
        let mut bodies = params.bodies.clone();
        let (neighbors, collisions) = contacts(&particles, &params);
        let totals = |particles: &Particles<3>, bodies: &Bodies<3>| {
            let Body { mass, state, .. } = &bodies.list[0];
            let of = |a: usize| {
                let (r, v) = (particles.position[a] - state.position, particles.velocity[a]);
                (params.mass() * v, params.mass() * r.cross(&v), 0.5 * params.mass() * v.norm_squared())
            };
            let zero = (Vector::<3>::zeros(), Vector::<3>::zeros(), 0.0);
            let liquid = particles.fluid().map(of).fold(zero, |s, p| (s.0 + p.0, s.1 + p.1, s.2 + p.2));
            let [p, l] = state.hits;
            let moved = bodies.list[0].velocity_after_hits(&state.position);
            // Whatever spins, spins as the points around the centre do.
            let spin = |d: usize| {
                bodies.list[0].velocity_after_hits(&(state.position + Vector::ith(d, 1.0))) - moved
            };
            let w = Vector::<3>::new(spin(1).z, spin(2).x, spin(0).y);
            let energy = 0.5 * mass * moved.norm_squared() + 0.5 * w.dot(&(bodies.list[0].inertia() * w));
            (liquid.0 + p, liquid.1 + l, liquid.2 + energy)
        };
        let before = totals(&particles, &bodies);
        let hits = collisions.apply(&mut particles, &neighbors, &mut bodies, &mut vec![], &mut []);
        let after = totals(&particles, &bodies);
        assert!(hits > 1, "{hits}");
        assert!((after.0 - before.0).norm() < 1e-12 * before.0.norm(), "{mass}: momentum");
        assert!((after.1 - before.1).norm() < 1e-12 * before.1.norm(), "{mass}: angular momentum");
        assert!(after.2 < before.2 * (1.0 + 1e-12), "{mass}: {} J of {} J", after.2, before.2);
    }
}

#[test]
fn walls_receive_what_collisions_take_from_the_liquid() {
    let drop =
        ("fluid.block", "[{min = [0, 0.5, 0.9], max = [0.15, 0.6, 1.05], velocity = [-2, 0.3, -0.1]}]");
    let text = with(DRY, "min = [1, 0.4, 0.8]\nmax = [1.2, 0.6, 1.1]\nmotion = \"free\"\nmass = 10");
    let Scene { mut particles, params, .. } = build::scene::<3>(&case(&text, &[drop]));
    let mut bodies = params.bodies.clone();
    let (neighbors, collisions) = contacts(&particles, &params);
    let momentum = |particles: &Particles<3>| -> Vector<3> {
        particles.fluid().map(|a| params.mass() * particles.velocity[a]).sum()
    };
    let before = momentum(&particles);
    let mut received = vec![Vector::zeros(); particles.walls().len()];
    collisions.apply(&mut particles, &neighbors, &mut bodies, &mut vec![], &mut received);
    let struck = momentum(&particles);
    let impulse: Vector<3> = received.iter().sum();
    assert!(impulse.x < -0.1 * before.norm());
    assert!((impulse - (before - struck)).norm() < 1e-12 * before.norm());
    // Behind the face, and still on its way: both the place and the velocity are mended.
    for a in particles.fluid() {
        particles.position[a].x -= 0.04;
        particles.velocity[a].x = -1.0;
    }
    let before = momentum(&particles);
    received.fill(Vector::zeros());
    let rebounds = collisions.hold(&mut particles, &neighbors, &mut bodies, params.spacing, &mut received);
    let impulse: Vector<3> = received.iter().sum();
    assert!(rebounds > 1 && particles.fluid().all(|a| particles.position[a].x > -1e-12));
    assert!((impulse - (before - momentum(&particles))).norm() < 1e-12 * before.norm());
}

#[test]
fn a_hit_acts_in_the_next_step() {
    let text = with(DRY, "min = [1, 0.4, 1]\nmax = [1.2, 0.6, 1.2]\nmass = 2\nmotion = \"free\"");
    let mut simulation = simulation::<3>(&text, &[], Some(1e-3));
    let impulse = Vector::<3>::new(0.6, 0.0, -0.2);
    let at = Vector::<3>::new(1.0, 0.5, 1.15);
    let arm = at - body(&simulation).state.position;
    simulation.scheme.bodies_mut().list[0].hit(&at, &impulse);
    simulation.advance().unwrap();
    let state = body(&simulation).state;
    let expected = impulse / 2.0 + 1e-3 * Vector::<3>::new(0.0, 0.0, -9.81);
    assert!((state.velocity - expected).norm() < 1e-12, "{}", state.velocity);
    assert!((state.angular_momentum - arm.cross(&impulse)).norm() < 1e-12, "{}", state.angular_momentum);
    assert_eq!(state.hits, [Vector::<3>::zeros(); 2]);
}

#[test]
fn a_gate_follows_its_table() {
    let gate = "min = [1, 0.4, 0]\nmax = [1.2, 0.6, 0.5]\nmotion = \"prescribed\"\n\
                path = [[0, 0, 0, 0], [0.1, 0, 0, 5], [0.2, 0, 0, 5], [0.21, 0, 0, 0]]";
    let mut simulation = simulation::<3>(&with(DRY, gate), &[], Some(1e-3));
    assert!(matches!(body(&simulation).motion, Motion::Prescribed(_)));
    until(&mut simulation, 0.25);
    let risen = body(&simulation).state.position.z - 0.25;
    assert!((risen - (0.25 + 0.5 + 0.025)).abs() < 1e-9, "{risen}");
    assert_eq!(body(&simulation).state.velocity.z, 0.0);
}

#[test]
fn wrong_bodies_are_refused_in_a_sentence() {
    let sliding = with(DRY, BOX);
    let said = |sets: &[(&str, &str)]| {
        let sets: Vec<_> = sets.iter().map(|&(key, value)| (key.to_owned(), value.to_owned())).collect();
        read::read(&sliding, "my.toml", &sets).unwrap_err().to_string()
    };
    for (sets, wanted) in [
        (&[("body.mass", "-1")][..], "body.0.mass is -1: give a finite number > 0 in kg"),
        (&[("body.mass", "0")], "body.0.mass is 0: give a finite number > 0 in kg"),
        (&[("body.min", "[0.4, 0.4, -0.1]")], "body.0 reaches beyond the tank's bottom side: keep it inside"),
        (
            &[("box", "[{min = [0.5, 0, 0], max = [0.7, 1, 0.1]}]")],
            "body.0 overlaps box.0: move or shrink one",
        ),
        (
            &[("fluid.block", "[{min = [0, 0, 0], max = [1, 1, 0.1]}]")],
            "body.0 overlaps fluid.block.0: move one of them, or set immersed = true and liquid makes room",
        ),
        (
            &[("body.max", "[0.45, 0.6, 0.2]")],
            "body.0 is 0.050000 m thin, less than the 2 layers of particles that keep liquid on its sides apart: \
             thicken it, or reduce spacing to 0.025000",
        ),
        (&[("body.motion", "\"prescribed\"")], "body.0.path is missing: give rows of 4 or 7 finite numbers"),
        (&[("body.shape", "\"cone\"")], "body.0.shape is \"cone\": give one of"),
        (&[("body.colour", "\"red\"")], "body.0.colour is no key of a case file"),
        (&[("tank.periodic", "[\"y\"]")], "body.0 is in a scene that repeats itself, which no body can be"),
        (&[("body.shape", "\"stl\"")], "body.0.mesh is missing: give the text of an STL file"),
    ] {
        let found = said(sets);
        assert!(found.lines().any(|line| line.contains(wanted)), "{found}");
    }
    let massless = sliding.replace("mass = 10\n", "");
    let found = read::read(&massless, "my.toml", &[]).unwrap_err().to_string();
    assert_eq!(
        found,
        "my.toml:14: body.0.mass is missing: give a finite number > 0 in kg, or a density in kg/m3"
    );
}

#[test]
fn a_case_with_bodies_is_written_back_as_it_was_read() {
    let mesh = "solid t\nfacet normal 0 0 0\nouter loop\nvertex 0 0 0\nvertex 0 1 0\nvertex 1 0 0\nendloop\nendfacet\n\
                facet normal 0 0 0\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 0 1\nendloop\nendfacet\n\
                facet normal 0 0 0\nouter loop\nvertex 0 0 0\nvertex 0 0 1\nvertex 0 1 0\nendloop\nendfacet\n\
                facet normal 0 0 0\nouter loop\nvertex 1 0 0\nvertex 0 1 0\nvertex 0 0 1\nendloop\nendfacet\nendsolid\n";
    let bodies = [
        BOX.to_owned(),
        "shape = \"sphere\"\ncentre = [1.5, 0.5, 0.5]\nradius = 0.2\ndensity = 500\nmotion = \"free\"\n\
         locked = [\"rotation_x\"]"
            .to_owned(),
        "shape = \"cylinder\"\ncentre = [2.5, 0.5, 0.5]\nradius = 0.2\nlength = 0.4\nalong = \"y\""
            .to_owned(),
        format!("shape = \"stl\"\noffset = [3, 0, 0]\nscale = 0.5\nmesh = '''\n{mesh}'''"),
    ];
    let text = bodies.iter().fold(DRY.to_owned(), |text, body| with(&text, body));
    let first = case(&text, &[]);
    let written = read::write(&first, "");
    assert_eq!(read::read(&written, "again", &[]).unwrap(), first);
    let scene = build::scene::<3>(&first);
    assert_eq!(scene.params.bodies.list.len(), 4);
}
