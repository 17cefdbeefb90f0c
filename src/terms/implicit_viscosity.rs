//! Laminar viscosity from the end of the step: for liquid so viscous that the explicit limit would collapse the step.
//!
//! With the pair coefficients c_ab < 0 and directions P_ab of [`viscosity`](super::viscosity) (Weiler et al. 2018 for the central form),
//!
//! v_a - dt nu sum_b c_ab P_ab (v_a - v_b) = v'_a                                               (1)
//!
//! for the D components of all liquid together, v' being the velocity that the pressure has left and velocities of solids known. In this order, viscosity
//! last, gravity is balanced by pressure before any of it can be taken for flow. Liquid at rest between walls that hold it would else fall
//! by as much as viscosity lets it in a step, hang on the walls and stream: with viscosity before the pressure a pot of 10 m2/s, 0.8 m wide, had 15 % of its pressure at the
//! bottom and moved at 4.5 cm/s. (With the last pressure in (1), as Van Kan (1986) has it, it stays still, but not if its particles are disordered: a gradient of that
//! pressure is not what the pressure equation has, and errors grow twofold in six steps.) What (1) leaves of divergence the next pressure takes out. The matrix is
//! diagonally dominant, and with the central form symmetric and positive definite: it damps at any step. The error against the
//! exact decay exp(-k dt) of a mode is that of the implicit Euler rule, (k dt)^2 / 2.

use super::viscosity::Form;
use crate::Result;
use crate::case::Slip;
use crate::halo::{Halo, Kinds};
use crate::operators::{Moments, Surroundings};
use crate::particles::{Particles, Vector};
use crate::ppe::{Index, Rows};

/// One system (1) of one rank, D consecutive rows a particle.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct VelocitySystem {
    /// The matrix, without unit.
    pub matrix: Rows,
    /// Right-hand side in m/s.
    pub rhs: Vec<f64>,
    /// In: first guess. Out: velocity in m/s.
    pub velocity: Vec<f64>,
}

/// Solves systems (1).
pub trait VelocitySolve {
    /// Solves `system` in place, or fails with one sentence.
    fn solve(&mut self, system: &mut VelocitySystem) -> Result<()>;
}

/// Assembles systems (1); owns the system and its buffers.
#[derive(Debug, Clone, Default)]
pub struct Assembler {
    /// The system of the last [`assemble`](Self::assemble).
    pub system: VelocitySystem,
    /// Global number of each particle among the liquid of all ranks.
    number_of: Vec<Index>,
    entries: Vec<(Index, f64)>,
}

impl Assembler {
    /// Fills [`system`](Self::system) from the velocities of `particles`; `reach` = dt nu in m2.
    #[allow(clippy::too_many_arguments)]
    pub fn assemble<const D: usize>(
        &mut self,
        particles: &Particles<D>,
        surroundings: &Surroundings<'_, D>,
        moments: &[Moments<D>],
        form: Form,
        slip: Slip,
        halo: &Halo<D>,
        reach: f64,
    ) {
        let fluid = particles.fluid();
        let first = halo.ranks().first_row(fluid.len());
        self.number_of.clear();
        self.number_of.resize(particles.len(), -1);
        for (k, number) in self.number_of[fluid.clone()].iter_mut().enumerate() {
            *number = (first + k) as Index;
        }
        halo.refresh(Kinds::Liquid, particles.originals(), &mut self.number_of);

        let VelocitySystem { matrix, rhs, velocity } = &mut self.system;
        matrix.start.clear();
        matrix.start.push(0);
        matrix.column.clear();
        matrix.value.clear();
        rhs.clear();
        velocity.clear();
        for a in fluid {
            let mut right: Vector<D> = particles.velocity[a];
            velocity.extend(right.iter());
            let pairs = || form.pairs(surroundings, particles, &moments[a], a, slip);
            for pair in pairs().filter(|pair| pair.is_solid) {
                right -= reach * pair.coefficient * pair.along(&particles.velocity[pair.with]);
            }
            for d in 0..D {
                self.entries.clear();
                let mut diagonal = [0.0; D];
                diagonal[d] = 1.0;
                for pair in pairs() {
                    let number = self.number_of[particles.original(pair.with)];
                    for (e, diagonal) in diagonal.iter_mut().enumerate() {
                        let value = reach * pair.coefficient * pair.direction(d, e);
                        if value == 0.0 {
                            continue;
                        }
                        *diagonal -= value;
                        if !pair.is_solid {
                            self.entries.push((number * D as Index + e as Index, value));
                        }
                    }
                }
                let own = self.number_of[a] * D as Index;
                let own = diagonal.iter().enumerate().map(|(e, &value)| (own + e as Index, value));
                self.entries.extend(own.filter(|(_, value)| *value != 0.0));
                self.entries.sort_unstable_by_key(|(column, _)| *column);
                matrix.column.extend(self.entries.iter().map(|(column, _)| column));
                matrix.value.extend(self.entries.iter().map(|(_, value)| value));
                matrix.start.push(matrix.column.len() as Index);
            }
            rhs.extend(right.iter());
        }
    }

    /// The solved velocities of the liquid, in the order of its particles.
    pub fn velocities<const D: usize>(&self) -> impl Iterator<Item = Vector<D>> + '_ {
        self.system.velocity.chunks_exact(D).map(Vector::from_column_slice)
    }
}

/// Solves systems (1) with PETSc, by default with `bcgs` and PETSc's own preconditioner: options `-viscous_*`.
#[cfg(feature = "petsc")]
pub struct VelocitySolver {
    session: std::rc::Rc<crate::petsc::Session>,
}

#[cfg(feature = "petsc")]
impl VelocitySolver {
    /// Tolerances: a residual of 1e-8 of the velocities is far below what the pressure equation leaves of them.
    const TOLERANCES: crate::petsc::Tolerances =
        crate::petsc::Tolerances { relative: 1e-8, absolute: 1e-50, divergence: 1e5, iterations: 2000 };
    /// How much of the right-hand side the true residual may be at most.
    const ACCEPTED: f64 = 1e-5;
    /// Methods in turn.
    const METHODS: [&str; 2] = ["bcgs", "gmres"];

    /// A solver within a PETSc session.
    pub fn new(session: std::rc::Rc<crate::petsc::Session>) -> Self {
        Self { session }
    }
}

#[cfg(feature = "petsc")]
impl VelocitySolve for VelocitySolver {
    fn solve(&mut self, system: &mut VelocitySystem) -> Result<()> {
        use crate::petsc::{Ksp, Matrix, Vector};
        let VelocitySystem { matrix, rhs, velocity } = system;
        let matrix = Matrix::from_rows(&self.session, &matrix.start, &matrix.column, &matrix.value)?;
        let rhs = Vector::from_slice(&self.session, rhs)?;
        let size = rhs.norm()?;
        if size == 0.0 {
            velocity.fill(0.0);
            return Ok(());
        }
        let mut residual = f64::INFINITY;
        let mut iterations = 0;
        for method in Self::METHODS {
            let mut solution = Vector::from_slice(&self.session, velocity)?;
            let mut solver = Ksp::new(&self.session, "viscous_")?;
            let preconditioner = if self.session.size() > 1 { "bjacobi" } else { "ilu" };
            solver.set_types(method, preconditioner)?;
            solver.set_tolerances(Self::TOLERANCES)?;
            solver.set_guess_nonzero(true)?;
            solver.set_from_options()?;
            solver.set_operators(&matrix, &matrix)?;
            iterations += solver.solve(&rhs, &mut solution)?.iterations;
            residual = matrix.residual_norm(&solution, &rhs)?;
            if residual <= Self::ACCEPTED * size {
                solution.read(velocity)?;
                return Ok(());
            }
        }
        Err(crate::Error::Run(format!(
            "the implicit viscosity did not converge: {iterations} iterations, residual {:.1e} of the velocities: try \
             -viscous_pc_type hypre or a smaller time step",
            residual / size
        )))
    }
}
