//! Properties of the discrete operators on tanks of water, in 2D and 3D.

use sphpetsc::boundary::DummyWalls;
use sphpetsc::case::{KernelKind, LaplacianKind, build, read};
use sphpetsc::halo::Halo;
use sphpetsc::kernel::{LatticeSums, Smoothing, WendlandC2};
use sphpetsc::neighbors::{Layout, Neighbors};
use sphpetsc::operators::{Moments, Surroundings};
use sphpetsc::particles::{Matrix, Particles, Vector};
use sphpetsc::ppe::matrix::{Assembler, Inputs, NO_ROW};
use sphpetsc::ppe::{Needs, source::Source};
use sphpetsc::scheme::Params;
use sphpetsc::terms::surface;

/// Spacing in m.
const DX: f64 = 0.05;
/// Still water level in m, half a spacing above the top row.
const LEVEL: f64 = 0.5;

/// A tank of water or, without walls, a free block, surveyed as the scheme does it.
struct Water<const D: usize> {
    params: Params<D>,
    particles: Particles<D>,
    neighbors: Neighbors<D>,
    active: Vec<bool>,
    moments: Vec<Moments<D>>,
    surface: Vec<f64>,
    walls: DummyWalls<D>,
    lattice: LatticeSums,
}

impl<const D: usize> Water<D> {
    fn in_tank(jitter: f64) -> Self {
        Self::new("[tank]\nmin = MIN\nmax = TOP\nopen = [\"top\"]\n", jitter)
    }

    fn free(jitter: f64) -> Self {
        Self::new("", jitter)
    }

    fn new(tank: &str, jitter: f64) -> Self {
        let corner = |up: f64| {
            let mut r = [0.4; D];
            r[D - 1] = up;
            format!("{r:?}")
        };
        let text = format!(
            "name = \"water\"\ndimension = {D}\nspacing = {DX}\n[[fluid.block]]\nmin = MIN\nmax = WATER\n{tank}\
             [scheme]\nkind = \"{}\"\njitter = {jitter}\n[time]\nuntil = 1.0\n",
            if tank.is_empty() { "patch_test" } else { "isph_df" }
        );
        let text = text.replace("MIN", &format!("{:?}", [0.0; D]));
        let text = text.replace("WATER", &corner(LEVEL)).replace("TOP", &corner(0.8));
        let case = read::read(&text, "test", &[]).unwrap();
        let build::Scene { particles, params, .. } = build::scene::<D>(&case);
        assert_eq!(params.kernel, KernelKind::WendlandC2);
        let lattice = params.lattice_sums();
        let smoothing = Smoothing::<D, WendlandC2>::new(params.smoothing_length());
        let (solids, volume) = (particles.solids(), DX.powi(D as i32));
        let mut neighbors = Neighbors::default();
        let first_layer = |a| if particles.walls().contains(&a) { f64::NEG_INFINITY } else { f64::INFINITY };
        let support = params.support();
        neighbors.update(
            &particles.position[..solids],
            &Layout::without_ghosts(solids, solids),
            &smoothing,
            support,
            first_layer,
        );
        let walls =
            DummyWalls::new(&particles, &neighbors, &lattice, volume, params.density * params.gravity);
        let wet = |a| walls.threshold(&particles, a);
        neighbors.update(&particles.position, &Layout::of(&particles), &smoothing, support, wet);
        let mut active = vec![];
        walls.mark_active(&particles, &neighbors, &Halo::default(), &mut active);
        let mut water =
            Self { params, particles, neighbors, active, moments: vec![], surface: vec![], walls, lattice };
        let around = water.around();
        let moments: Vec<_> = (0..water.particles.len()).map(|a| around.moments(a)).collect();
        let solved = |a: usize| water.active[a] && !water.particles.dummies().contains(&a);
        let weight = |a: usize| if solved(a) { surface::weight(&moments[a]) } else { 0.0 };
        water.surface = (0..moments.len()).map(weight).collect();
        water.moments = moments;
        water
    }

    fn around(&self) -> Surroundings<'_, D> {
        let Self { particles, neighbors, active, .. } = self;
        Surroundings { position: &particles.position, neighbors, active, volume: DX.powi(D as i32) }
    }

    /// Wet walls and liquid.
    fn solved(&self) -> impl Iterator<Item = usize> + '_ {
        self.particles.walls().chain(self.particles.fluid()).filter(|&a| self.active[a])
    }

    fn field(&self, of: impl Fn(&Vector<D>) -> f64) -> Vec<f64> {
        self.particles.position.iter().map(of).collect()
    }
}

/// A direction without symmetries.
fn slope<const D: usize>() -> Vector<D> {
    Vector::from_fn(|d, _| [1.3, -0.7, 2.1][d])
}

macro_rules! in_2d_and_3d {
    ($($name:ident: $test:ident,)*) => {
        mod plane { $(#[test] fn $name() { super::$test::<2>(); })* }
        mod space { $(#[test] fn $name() { super::$test::<3>(); })* }
    };
}

in_2d_and_3d! {
    linear_fields_have_no_laplacian: linear_laplacian,
    gradients_of_linear_fields_are_exact: linear_gradient,
    symmetric_gradients_are_pair_forces: pair_forces,
    divergence_of_linear_velocities: linear_divergence,
    a_pure_strain_is_no_compression: shape_correction,
    pairs_know_each_other: pair_symmetry,
    the_top_row_is_the_surface: surface_of_a_lattice,
    still_water_is_an_exact_solution: still_water,
    a_peak_stands_above_a_plane: rough_field,
}

fn linear_laplacian<const D: usize>() {
    let water = Water::<D>::in_tank(0.2);
    let around = water.around();
    let p = water.field(|r| 5.0 + slope::<D>().dot(r));
    let (mut walls, mut tops) = (0, 0);
    for a in water.solved() {
        let Some(b) = water.moments[a].correction() else { continue };
        let along = b.tr_mul(&water.moments[a].defect);
        let size: f64 =
            around.active(a).map(|(b, r, vf)| (2.0 * vf * (1.0 + r.dot(&along)) * (p[a] - p[b])).abs()).sum();
        // Round-off of some fifty terms is below 1e-13 of their sum; the project's bound leaves room for bad B.
        let residue = around.corrected_laplacian(a, &p, &water.moments[a]).abs();
        assert!(residue <= 1e-10 * size, "particle {a}: {residue:e} of {size:e}");
        walls += usize::from(water.particles.walls().contains(&a));
        tops += usize::from(water.surface[a] > 0.5);
    }
    assert!(walls > 10 && tops > 5, "walls {walls} and surface {tops} take part");
}

fn linear_gradient<const D: usize>() {
    let water = Water::<D>::in_tank(0.2);
    let p = water.field(|r| 5.0 + slope::<D>().dot(r));
    for a in water.solved() {
        let Some(b) = water.moments[a].correction() else { continue };
        let error = b * water.around().difference_gradient(a, &p) - slope::<D>();
        // B amplifies round-off (1e-16 p / dx = 1e-14) by less than ten.
        assert!(error.norm() < 1e-12, "particle {a}: {error}");
        let distance = water.around().distance_from_plane(a, &p, &water.moments[a]).unwrap();
        assert!(distance.abs() < 1e-12, "particle {a}: {distance} off the plane");
    }
}

fn rough_field<const D: usize>() {
    // On a lattice a peak of one particle stands above a plane by its height, its neighbours below one by their share of it.
    let water = Water::<D>::free(0.0);
    let middle = water.particles.fluid().min_by(|&a, &b| {
        let off = |a: usize| (water.particles.position[a] - Vector::repeat(0.2)).norm();
        off(a).total_cmp(&off(b))
    });
    let peak = middle.unwrap();
    let mut p = water.field(|_| 5.0);
    p[peak] += 2.0;
    let around = water.around();
    let distance = |a: usize| around.distance_from_plane(a, &p, &water.moments[a]).unwrap();
    assert!((distance(peak) - 2.0).abs() < 1e-12, "{}", distance(peak));
    let row = water.neighbors.row(peak);
    let nearest = row.iter().map(|(b, ..)| b).min_by(|&a, &b| {
        let off = |a: usize| (water.particles.position[a] - water.particles.position[peak]).norm();
        off(a).total_cmp(&off(b))
    });
    assert!((-1.0..-0.05).contains(&distance(nearest.unwrap())));
}

fn pair_forces<const D: usize>() {
    let water = Water::<D>::free(0.2);
    let p = water.field(|r| (7.0 * slope::<D>().dot(r)).sin());
    let forces: Vec<_> = water.solved().map(|a| water.around().symmetric_gradient(a, &p)).collect();
    let (total, size) = (forces.iter().sum::<Vector<D>>(), forces.iter().map(|f| f.norm()).sum::<f64>());
    // Each pair cancels but for the order of summation.
    assert!(total.norm() < 1e-13 * size, "{total} of {size}");
}

fn linear_divergence<const D: usize>() {
    let water = Water::<D>::in_tank(0.2);
    let around = water.around();
    let tilt = Matrix::<D>::from_fn(|i, j| [0.3, -1.1, 0.8, 0.5, 1.7, -0.4, 0.9, -0.6, 1.2][3 * i + j]);
    let moved = |m: Matrix<D>| -> Vec<_> { water.particles.position.iter().map(|r| m * r).collect() };
    let (any, spin) = (moved(tilt), moved(tilt - tilt.transpose()));
    for a in water.solved() {
        let moments = &water.moments[a];
        // Round-off of sums of order 1, with |r| / dx = 16 lost to cancellation and B up to 3.
        let of = |v: &[Vector<D>], moments: &Moments<D>| around.divergence(a, v, moments);
        if moments.correction().is_some() {
            assert!((of(&any, moments) - tilt.trace()).abs() < 1e-11);
            assert!(of(&spin, moments).abs() < 1e-11, "a rotation has no divergence");
        }
        let plain = (tilt * moments.matrix).trace();
        assert!((of(&any, &Moments::default()) - plain).abs() < 1e-12, "without B the difference form");
    }
}

fn shape_correction<const D: usize>() {
    let water = Water::<D>::in_tank(0.2);
    let around = water.around();
    let tilt = Matrix::<D>::from_fn(|i, j| [0.3, -1.1, 0.8, 0.5, 1.7, -0.4, 0.9, -0.6, 1.2][3 * i + j]);
    let strain = tilt - Matrix::from_diagonal_element(tilt.trace() / D as f64);
    let strained = |a: usize, shape: &Matrix<D>| -> f64 {
        around.active(a).map(|(_, r, vf)| -vf * (strain * r).dot(&(shape * r))).sum()
    };
    let (mut corrected, mut off) = (0, 0.0_f64);
    for a in water.solved() {
        let shape = water.moments[a].shape_correction();
        // Good supports only: poor ones take a share of it.
        if water.moments[a].filling() > 0.85 * D as f64 {
            let full = Moments { matrix: shape, ..Moments::default() }.filling();
            assert!((full - D as f64).abs() < 1e-12, "a determinant of 1, not {full}");
            assert!(strained(a, &shape).abs() < 1e-11, "{}", strained(a, &shape));
            corrected += 1;
            off = off.max(strained(a, &Matrix::identity()).abs());
        }
    }
    assert!(corrected > 50 && off > 0.1, "{corrected} corrected, {off} without");
    assert_eq!(Moments::<D>::default().shape_correction(), Matrix::<D>::identity());
}

fn pair_symmetry<const D: usize>() {
    let water = Water::<D>::in_tank(0.2);
    for a in water.solved() {
        for (b, w, f) in water.neighbors.row(a).iter() {
            if water.neighbors.row(b).index.is_empty() {
                assert!(b < water.particles.solids(), "only dummies and dry walls keep no list");
                continue;
            }
            let back = water.neighbors.row(b).iter().find(|(c, ..)| *c == a);
            assert_eq!(back, Some((a, w, f)), "grad W_ab = -grad W_ba to the last bit");
        }
    }
}

fn surface_of_a_lattice<const D: usize>() {
    let water = Water::<D>::in_tank(0.0);
    for a in water.solved() {
        let is_top = (water.particles.position[a][D - 1] - (LEVEL - 0.5 * DX)).abs() < 1e-9;
        let weight = if is_top { 1.0 } else { 0.0 };
        assert_eq!(water.surface[a], weight, "particle {a} at {}", water.particles.position[a]);
    }
    let top_walls = water.particles.walls().filter(|&a| water.surface[a] == 1.0).count();
    assert!(top_walls > 0 && top_walls < water.particles.walls().len());
}

/// p = rho g (H - y) with H half a spacing above the top row solves the rows of liquid, walls and surface alike.
fn still_water<const D: usize>() {
    let water = Water::<D>::in_tank(0.0);
    let (around, dt) = (water.around(), 1e-3);
    let predicted = vec![dt * water.params.gravity; water.particles.len()];
    let source: Vec<_> = (0..water.particles.len())
        .map(|a| {
            let divergence = around.divergence(a, &predicted, &water.moments[a]);
            Source::Blended { gamma: 0.0, tau: 0.0 }.of(divergence, 0.0, water.surface[a] > 0.5, dt)
        })
        .collect();
    let mut assembler = Assembler::default();
    let inputs = Inputs {
        particles: &water.particles,
        surroundings: around,
        moments: &water.moments,
        surface: &water.surface,
        source: &source,
        walls: &water.walls,
        lattice: &water.lattice,
        density: water.params.density,
        spacing: DX,
        laplacian: LaplacianKind::Schwaiger,
        bodies: None,
    };
    assembler.assemble(&inputs, &Halo::default(), Needs::default());
    let weight = water.params.density * -water.params.gravity[D - 1];
    let p: Vec<_> = (assembler.particle_of.iter())
        .map(|&a| weight * (LEVEL - water.particles.position[a as usize][D - 1]))
        .collect();
    let system = &assembler.system;
    for (k, product) in system.full.multiply(&p).into_iter().enumerate() {
        let size: f64 = system.full.row(k).map(|(c, v)| (v * p[c]).abs()).sum();
        let particle = assembler.particle_of[k] as usize;
        // Some fifty terms that cancel to the right-hand side.
        assert!(
            (product - system.rhs[k]).abs() <= 1e-12 * size,
            "particle {particle} at {}: {product:e}, {:e}",
            water.particles.position[particle],
            system.rhs[k]
        );
    }
    assert!(assembler.row_of[..water.particles.walls().end].iter().any(|&row| row != NO_ROW));
}
