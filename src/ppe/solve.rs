//! Solves the pressure equation with PETSc: which method, on which matrix, and what if it fails.
//!
//! **What is solved** is always the full corrected operator, [`PressureSystem::full`]. It is not
//! symmetric near walls and the surface, hence two ways:
//! - Krylov methods for nonsymmetric matrices (`bcgs`, `gmres`, ...) solve it directly, preconditioned
//!   from the right so that the norm they watch is that of the true residual.
//! - A method that needs symmetry (`cg`, `minres`, ... or `icc`, `cholesky`) works on the symmetric
//!   part, as the preconditioner of a flexible GMRES (options `-outer_*`) on the full operator.
//!   `-ksp_rtol`, `-ksp_atol` and `-ksp_max_it` then govern the outer iteration, the inner one stops at
//!   `-ppe_inner_rtol` (0.1), and `-ksp_monitor`, `-ksp_view` show the outer one.
//!
//! Multigrid is built from [`PressureSystem::sparse`], the operator cut at a short radius, unless
//! `-ppe_sparse_pmat no`: fewer entries make a cheaper setup at nearly the same rate.
//!
//! **Figures** behind the defaults: artificial lattice matrices, one rank, rtol 1e-5, right-hand side changed
//! by up to 2 % since the last pressure; iterations and milliseconds of set-up plus solve. Times are single
//! runs, good to a factor of 1.8: orders of magnitude, not a ranking of neighbours in the table.
//!
//! | | 2D, 4,096 rows | 2D, 30,000 rows | 3D, 103,823 rows |
//! |---|---|---|---|
//! | bcgs + ilu, full / sparse | 18 / 23 it, 7 / 6 ms | 17 / 24 it, 47 / 48 ms | 13 / 12 it, 237 / 200 ms |
//! | bcgs + hypre, sparse | 2 it, 5 ms | 2 it, 37 ms | 2 it, 262 ms |
//! | bcgs + hypre, full | 2 it, 9 ms | 2 it, 46 ms | 2 it, 343 ms |
//! | bcgs + hypre, sparse, strong threshold 0.25 | 3 it, 9 ms | 3 it, 49 ms | 2 it, 344 ms |
//! | bcgs + gamg, sparse / full | 3 / 4 it, 12 / 11 ms | 3 / 4 it, 65 / 87 ms | 2 / 3 it, 430 / 539 ms |
//! | bcgs + jacobi | 106 it, 11 ms | 99 it, 76 ms | 45 it, 249 ms |
//! | cg + icc inside fgmres, inner 0.1 / 0.01 | 45 / 67 inner it | 105 / 169 | 47 / 55 |
//!
//! In the flow, the first 33 steps of `dam_break_3d_fixed` at 0.0275 m, one rank, rtol 1e-5; applications of the preconditioner
//! and seconds a step, set-up + iteration:
//!
//! | | applications | s |
//! |---|---|---|
//! | bcgs, symmetric Gauss-Seidel on both ways | 7.1 | 0.166 + 0.096 |
//! | gmres, the same | 5.9 | 0.171 + 0.083 |
//! | gmres, forwards on both ways | 6.6 | 0.171 + 0.069 |
//! | gmres, forwards on both ways, interpolation truncated at 0.1 | 6.6 | 0.146 + 0.067 |
//! | gmres, forwards on both ways, 2 instead of 4 entries of interpolation a row | 7.4 | 0.142 + 0.073 |
//! | gmres, forwards down and backwards up, truncated at 0.1: the default | 6.4 | as forwards on both ways |
//!
//! So a strong threshold of 0.5 serves 2D as well, the sparse matrix pays for multigrid, and a loose inner
//! tolerance costs the fewest inner iterations.
//!
//! `-ppe_tuned no` takes a preconditioner as PETSc ships it, and `-ksp_initial_guess_nonzero no` starts from zero
//! instead of the last pressure: both are there to compare with.
//!
//! **Convergence** is judged by `|b - A x|`, computed after the solve, against `rtol |b|`. A solve that
//! misses it is an event with a [recorded](SolveRecord::fallback) sequel: from zero, `bcgs`, `gmres`,
//! `gmres` + `jacobi` (options `-fallback_*`), then an error. A failed solve never passes in silence.

use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::time::Instant;

use super::{Needs, PressureSolve, PressureSystem, Rows, SolveRecord, saved};
use crate::petsc::{
    BinaryFile, Ksp, Matrix, NullSpace, Options, Session, Tolerances, Vector, captured, nearest,
};
use crate::{Error, Result};

/// Below this many unknowns ILU is the default: on the 3,400 of the 2D dam break it is level with BoomerAMG while the water is
/// calm and about 1.5 times as fast once it splashes, where BoomerAMG needs more iterations after each costly set-up.
const SMALL: usize = 10_000;
/// What the user's `-ksp_rtol`, `-ksp_max_it` override.
const DEFAULT: Tolerances = Tolerances { relative: 1e-5, absolute: 1e-50, divergence: 1e5, iterations: 500 };
/// Where the inner solver stops by default, relative to the outer residual.
const INNER_RELATIVE: f64 = 0.1;
/// Share by which a true residual may miss the limit that its solver watched.
const SLACK: f64 = 1.05;
/// What is asked at most of a direct solver.
const DIRECT_RELATIVE: f64 = 1e-8;
/// Solves in a row when the watched and the true residual differ.
const REFINEMENTS: usize = 3;

/// Krylov methods that need a symmetric matrix.
const SYMMETRIC_KRYLOV: &[&str] = &[
    "cg", "groppcg", "pipecg", "pipecg2", "pipecgrr", "pipelcg", "pipeprcg", "fcg", "pipefcg", "cr",
    "pipecr", "minres", "symmlq", "nash", "stcg", "gltr", "qcg",
];
/// Preconditioners that need a symmetric matrix.
const SYMMETRIC_PRECONDITIONERS: &[&str] = &["icc", "cholesky"];
/// Krylov methods that can watch the true residual, preconditioned from the right.
const RIGHT: &[&str] =
    &["gmres", "fgmres", "lgmres", "dgmres", "pgmres", "pipefgmres", "bcgs", "cgs", "tfqmr", "gcr"];
/// Preconditioners that gain from the sparse matrix.
const MULTIGRID: &[&str] = &["hypre", "gamg", "ml", "hmg"];
/// BoomerAMG as pressure matrices like it, all of it pinned: PETSc's and hypre's own defaults differ
/// and change. Gauss-Seidel forwards on the way down and backwards on the way up makes a symmetric cycle, so that `cg`
/// may use it, at half the cost of a symmetric sweep on each way; one V-cycle is one application.
///
/// Two levels of aggressive coarsening: on `dam_break_3d_fixed` at 0.0183 m a solve takes 4.9 iterations with one level, 6.1 with two, 7.1
/// with three, but set-up costs more than iterations: with two it takes 0.9 of the time with one on one rank and 0.83 on two, once the
/// liquid splashes 0.94; with three 0.92 and 1.0. In 2D two are level with one. Without any it takes two and a half times as long.
const BOOMERAMG: &[(&str, &str)] = &[
    ("coarsen_type", "HMIS"),
    ("interp_type", "ext+i"),
    ("P_max", "4"),
    ("strong_threshold", "0.5"),
    ("agg_nl", "2"),
    ("truncfactor", "0.1"),
    ("relax_type_down", "SOR/Jacobi"),
    ("relax_type_up", "backward-SOR/Jacobi"),
    ("relax_type_coarse", "Gaussian-elimination"),
    ("grid_sweeps_all", "1"),
    ("cycle_type", "V"),
    ("max_iter", "1"),
    ("tol", "0"),
];
/// Options of ours in PETSc's database.
const OWN_OPTIONS: &[&str] = &["ppe_sparse_pmat", "ppe_inner_rtol", "ppe_tuned"];
/// Prefixes of solvers that come into play only when needed.
const LATE_PREFIXES: &[&str] = &["outer_", "fallback_", "null_", "viscous_"];

/// The pressure solver of a run.
pub struct PressureSolver {
    session: Rc<Session>,
    plan: Plan,
    method: Option<Method>,
    /// The last problem, for other right-hand sides.
    last: Option<Problem>,
}

/// A method as chosen, by PETSc's names.
#[derive(Debug, Clone, PartialEq)]
struct Plan {
    ksp: String,
    pc: String,
    /// Works on the symmetric part, inside an outer iteration.
    nested: bool,
    /// Preconditioner from the sparse matrix.
    sparse: bool,
}

/// A plan as PETSc objects, kept over the steps.
struct Method {
    name: String,
    solver: Ksp,
    outer: Option<Ksp>,
    tolerances: Tolerances,
    /// Applies the preconditioner once: takes no first guess.
    once: bool,
    /// Preconditioner from the sparse matrix.
    sparse: bool,
    /// Unknowns it was last used for, in all and on this rank; it serves one size only.
    size: Option<(usize, usize)>,
}

/// A pressure system as PETSc objects.
struct Problem {
    full: Matrix,
    symmetric: Option<Matrix>,
    sparse: Option<Matrix>,
    /// `full` as a preconditioner's matrix, where it is itself singular.
    full_pinned: Option<Matrix>,
    rhs: Vector,
    rhs_norm: f64,
    guess: Vector,
    constants: Option<NullSpace>,
    unknowns: usize,
}

/// How the chosen method did on a system, without the fallback chain.
#[derive(Debug, Clone)]
pub struct Trial {
    /// Iterations, true residual, reason and times, fallback never.
    pub record: SolveRecord,
    /// Whether the true residual is within the tolerance.
    pub accepted: bool,
    /// The pressure it came to, in Pa.
    pub pressure: Vec<f64>,
    /// Entries of all levels of a multigrid, or of the factors, over those of the matrix it was made from; none where
    /// PETSc does not tell.
    pub complexity: Option<f64>,
}

/// How one method did on one problem.
struct Attempt {
    pressure: Vector,
    iterations: usize,
    inner_iterations: usize,
    reason: String,
    residual: f64,
    accepted: bool,
}

impl PressureSolver {
    /// Chooses by the user's PETSc options, and what they leave open by `size`, the number of unknowns to expect.
    /// A run gives the number of its fluid particles at the start, so that a resumed run chooses alike.
    ///
    /// # Errors
    /// [`Error::Input`] for a Krylov method or preconditioner that PETSc does not have.
    pub fn new(session: Rc<Session>, size: usize) -> Result<Self> {
        session.options().check_types()?;
        let plan = Plan::choose(&session, size)?;
        Ok(Self { session, plan, method: None, last: None })
    }

    /// Tries the chosen method on a system, every object afresh, and says how that went, be it well or not.
    ///
    /// # Errors
    /// [`Error::Input`] for options that do not work or that nothing read, [`Error::Petsc`] and [`Error::Run`] for a
    /// method that fails altogether.
    pub fn trial(&mut self, system: &PressureSystem) -> Result<Trial> {
        let clock = Instant::now();
        let mut problem = Problem::new(&self.session, system)?;
        let mut record = SolveRecord { unknowns: problem.unknowns, ..SolveRecord::default() };
        if let Some(reason) = problem.trivial()? {
            record.reason = reason.into();
            let pressure = vec![0.0; system.rhs.len()];
            return Ok(Trial { record, accepted: true, pressure, complexity: None });
        }
        record.nonzeros = problem.full.nonzeros()?;
        self.method = None;
        self.prepare(&mut problem)?;
        record.setup_s = clock.elapsed().as_secs_f64();
        let Some((_, attempt)) = self.attempt(0, &problem, &mut record)? else {
            return Err(Error::Run("there is no method to try".into()));
        };
        let attempt = attempt?;
        self.prove_read(&problem)?;
        let mut pressure = system.pressure.clone();
        attempt.pressure.read(&mut pressure)?;
        let complexity = self.complexity(&problem)?;
        Ok(Trial { record, accepted: attempt.accepted, pressure, complexity })
    }

    /// What PETSc says of the preconditioner in force; hypre says it only in print.
    fn complexity(&self, problem: &Problem) -> Result<Option<f64>> {
        let Some(method) = &self.method else { return Ok(None) };
        let options = self.session.options();
        if !self.plan.is_boomeramg(options) {
            return method.solver.complexity();
        }
        let name = boomeramg("", "print_statistics");
        options.set_default(&name, "1")?;
        let said = captured(|| {
            let mut method = Method::new(&self.session, &self.plan)?;
            method.set_up(problem)
        });
        options.unset_default(&name)?;
        Ok(operator_complexity(&said?))
    }

    /// Names options that nothing has read, and the nearest valid one, asked from PETSc itself.
    fn prove_read(&self, problem: &Problem) -> Result<()> {
        let options = self.session.options();
        let unused: Vec<String> = options
            .unused()?
            .into_iter()
            .filter(|name| !LATE_PREFIXES.iter().any(|prefix| name.starts_with(prefix)))
            .collect();
        if unused.is_empty() {
            return Ok(());
        }
        let plan = &self.plan;
        let mut valid = options.offered(|prefix| {
            let mut probe = Ksp::new(&self.session, prefix)?;
            probe.set_types(&plan.ksp, &plan.pc)?;
            probe.set_from_options()?;
            let matrix = problem.symmetric.as_ref().unwrap_or(&problem.full);
            probe.set_operators(matrix, problem.symmetric_pmat().unwrap_or(matrix))?;
            probe.set_up()
        })?;
        valid.extend(OWN_OPTIONS.iter().map(|name| (*name).into()));
        let complaints = unused.iter().map(|name| {
            let hint = nearest(name, valid.iter().map(String::as_str))
                .map_or_else(|| "see -help".into(), |near| format!("did you mean -{near}?"));
            format!("-{name}: {} + {} reads no such option; {hint}", plan.ksp, plan.pc)
        });
        Err(Error::Input(complaints.collect::<Vec<_>>().join("\n")))
    }

    /// Decides and builds the method once; drops the sparse matrix where it is not wanted.
    fn prepare(&mut self, problem: &mut Problem) -> Result<()> {
        let is_new = self.method.as_ref().is_none_or(|method| !method.serves(&self.plan, problem.size()));
        if self.session.any(is_new) {
            self.method = Some(Method::new(&self.session, &self.plan).map_err(wrong_options)?);
        }
        if !self.plan.sparse {
            problem.sparse = None;
        }
        Ok(())
    }

    /// Step 0 is the chosen method, the rest the fallback chain; `None` after its end.
    fn attempt(
        &mut self,
        step: usize,
        problem: &Problem,
        record: &mut SolveRecord,
    ) -> Result<Option<(String, Result<Attempt>)>> {
        let (plan, Some(method)) = (&self.plan, &mut self.method) else { return Ok(None) };
        let limit = method.tolerances;
        let strong = Plan::default_pc(&self.session, problem.unknowns, false)?;
        let mut fallback = |ksp: &str, pc: &str, iterations| {
            let tolerances = Tolerances { iterations, divergence: 1e10, ..limit };
            let mut method = Method::fallback(&self.session, ksp, pc, tolerances)?;
            let outcome = method.run(problem, false, record);
            Ok(Some((method.name, outcome)))
        };
        match step {
            0 => {
                let from_guess = self.session.options().bool("ksp_initial_guess_nonzero")?.unwrap_or(true);
                let outcome = method.run(problem, from_guess, record);
                let name = method.name.clone();
                Ok(Some((name, outcome)))
            }
            1 => {
                // Afresh: PETSc leaves the objects of a failed call in an unknown state.
                *method = Method::new(&self.session, plan)?;
                let outcome = method.run(problem, false, record);
                Ok(Some((format!("{} from zero", method.name), outcome)))
            }
            2 => fallback("bcgs", &strong, DEFAULT.iterations),
            3 => fallback("gmres", &strong, DEFAULT.iterations),
            4 => fallback("gmres", "jacobi", 5000),
            _ => Ok(None),
        }
    }

    /// Solves `problem`, begun at `clock`, into `pressure`, and keeps it.
    fn solve_problem(
        &mut self,
        mut problem: Problem,
        clock: Instant,
        pressure: &mut [f64],
    ) -> Result<SolveRecord> {
        let mut record = SolveRecord { unknowns: problem.unknowns, ..SolveRecord::default() };
        if let Some(reason) = problem.trivial()? {
            pressure.fill(0.0);
            return Ok(SolveRecord { reason: reason.into(), ..record });
        }
        record.nonzeros = problem.full.nonzeros()?;
        self.prepare(&mut problem)?;
        record.setup_s = clock.elapsed().as_secs_f64();

        let mut failures = Vec::new();
        for step in 0.. {
            let Some((name, outcome)) = self.attempt(step, &problem, &mut record)? else { break };
            match outcome {
                Ok(attempt) if attempt.accepted => {
                    attempt.pressure.read(pressure)?;
                    record.fallback =
                        (!failures.is_empty()).then(|| format!("{name}, after {}", failures.join(", then ")));
                    self.last = Some(problem);
                    return Ok(record);
                }
                Ok(a) => failures.push(format!(
                    "{name} stopped with {} ({} iterations, residual {:.1e})",
                    a.reason, a.iterations, a.residual
                )),
                Err(Error::Petsc(said)) => failures.push(format!("{name} failed: {said}")),
                Err(other) => return Err(other),
            }
        }
        let limit = self.method.as_ref().map_or(DEFAULT.relative, |m| m.tolerances.relative);
        Err(Error::Run(format!(
            "the pressure equation did not converge: {} unknowns, {} iterations, residual {:.1e}, limit {limit:.1e}; \
             {}; try -pc_type hypre, a larger -ksp_rtol or a smaller time step",
            record.unknowns,
            record.iterations,
            record.residual,
            failures.join(", then ")
        )))
    }
}

impl PressureSolve for PressureSolver {
    fn needs(&self) -> Needs {
        Needs { symmetric: self.plan.nested, sparse: self.plan.sparse, uncorrected: false }
    }

    /// Solves the sample once to find options that do not work or that nothing reads. The sample keeps its pressure.
    fn check(&mut self, sample: &PressureSystem) -> Result<()> {
        let mut problem = Problem::new(&self.session, sample)?;
        if problem.trivial()?.is_some() {
            return Ok(());
        }
        self.prepare(&mut problem)?;
        // Not to converge on a sample is no matter of options.
        if let Some((_, outcome)) = self.attempt(0, &problem, &mut SolveRecord::default())? {
            outcome.map_err(wrong_options)?;
        }
        self.prove_read(&problem)
    }

    /// Solves from the last pressure to the new one; after an error `system.pressure` is as before.
    fn solve(&mut self, system: &mut PressureSystem) -> Result<SolveRecord> {
        let clock = Instant::now();
        // The last matrices go before new ones come: they are much of the memory.
        self.last = None;
        if let Some(method) = &mut self.method {
            method.release()?;
        }
        let problem = Problem::new(&self.session, system)?;
        self.solve_problem(problem, clock, &mut system.pressure)
    }

    fn solve_again(
        &mut self,
        system: &PressureSystem,
        rhs: &[f64],
        pressure: &mut Vec<f64>,
    ) -> Result<SolveRecord> {
        let clock = Instant::now();
        let problem = match self.last.take() {
            Some(last) if last.constants.is_none() => {
                let rhs = Vector::from_slice(&self.session, rhs)?;
                let guess = Vector::from_slice(&self.session, pressure)?;
                Problem { rhs_norm: rhs.norm()?, rhs, guess, ..last }
            }
            // A right-hand side of its own to be made consistent.
            _ => {
                let (rhs, pressure) = (rhs.to_vec(), pressure.clone());
                Problem::new(&self.session, &PressureSystem { rhs, pressure, ..system.clone() })?
            }
        };
        self.solve_problem(problem, clock, pressure)
    }

    fn describe(&self) -> String {
        let plan = &self.plan;
        let options = self.session.options();
        // As typed: before the first solve there is no method that could be asked.
        let relative = options.given("ksp_rtol").unwrap_or_else(|| format!("{:.0e}", DEFAULT.relative));
        let iterations = options.given("ksp_max_it").unwrap_or_else(|| DEFAULT.iterations.to_string());
        let on = if plan.nested { " on the symmetric part inside fgmres" } else { "" };
        let from = if plan.sparse {
            "the sparse matrix"
        } else if plan.nested {
            "the symmetric part"
        } else {
            "the full matrix"
        };
        let mut text = format!(
            "{} + {}{on}, preconditioner from {from}; residual {relative} of the right-hand side, at most {iterations} iterations",
            plan.ksp, plan.pc
        );
        if plan.is_boomeramg(options) && is_tuned(options).unwrap_or(true) {
            let values = boomeramg_defaults(options, "").map(|(name, value)| {
                let given = options.given(&boomeramg("", name).to_lowercase());
                format!("{name} {}", given.as_deref().unwrap_or(value))
            });
            text += &format!("\nBoomerAMG: {}", values.collect::<Vec<_>>().join(", "));
        }
        text
    }

    /// Writes the system in PETSc's binary format, as [`saved`] says.
    fn save(&self, system: &PressureSystem, folder: &Path, name: &str) -> Result<PathBuf> {
        let path = folder.join(format!("{name}.petsc"));
        let file = BinaryFile::create(&self.session, &path)?;
        let rows = |rows: &Rows| file.matrix(&matrix(&self.session, rows)?);
        let values = |values: &[f64]| file.vector(&Vector::from_slice(&self.session, values)?);
        rows(&system.full)?;
        values(&system.rhs)?;
        values(&system.pressure)?;
        rows(&system.sparse)?;
        rows(&system.symmetric)?;
        rows(&system.uncorrected)?;
        values(&system.uncorrected_rhs)?;
        values(&saved::marks(&system.floating, system.rhs.len()))?;
        Ok(path)
    }
}

impl Plan {
    /// What the user's options say; where they say nothing, by size.
    fn choose(session: &Session, unknowns: usize) -> Result<Self> {
        let options = session.options();
        let is_one_of =
            |name: &str, list: &[&str]| options.given(name).is_some_and(|v| list.contains(&v.as_str()));
        let nested = is_one_of("ksp_type", SYMMETRIC_KRYLOV)
            || ["pc_type", "sub_pc_type"].iter().any(|name| is_one_of(name, SYMMETRIC_PRECONDITIONERS));
        let pc = match options.given("pc_type") {
            Some(pc) => pc,
            None => Self::default_pc(session, unknowns, nested)?,
        };
        let multigrid = MULTIGRID.contains(&pc.as_str());
        let ksp = options.given("ksp_type").unwrap_or_else(|| {
            match (nested, multigrid) {
                (true, _) => "cg",
                // A few costly applications: `bcgs` takes them in pairs and overshoots.
                (false, true) => "gmres",
                // Many cheap ones: a short recursion.
                (false, false) => "bcgs",
            }
            .into()
        });
        let sparse = options.bool("ppe_sparse_pmat")?.unwrap_or(multigrid && is_tuned(options)?);
        Ok(Self { ksp, pc, nested, sparse })
    }

    /// ILU (ICC) for few unknowns, multigrid for many. PETSc factorises on one rank only; on several
    /// each factorises its own block.
    fn default_pc(session: &Session, unknowns: usize, symmetric: bool) -> Result<String> {
        let name = match (unknowns < SMALL, session.size() > 1) {
            (true, true) => "bjacobi",
            (true, false) if symmetric => "icc",
            (true, false) => "ilu",
            (false, _) if Options::preconditioner_types()?.iter().any(|t| t == "hypre") => "hypre",
            (false, _) => "gamg",
        };
        Ok(name.into())
    }

    fn is_boomeramg(&self, options: &Options) -> bool {
        self.pc == "hypre" && options.given("pc_hypre_type").is_none_or(|kind| kind == "boomeramg")
    }
}

impl Method {
    /// The chosen method, under the user's own options.
    fn new(session: &Rc<Session>, plan: &Plan) -> Result<Self> {
        let options = session.options();
        let mut solver = Ksp::new(session, "")?;
        solver.set_types(&plan.ksp, &plan.pc)?;
        set_defaults(options, "", &plan.pc)?;
        solver.set_tolerances(DEFAULT)?;
        let side_is_open = options.given("ksp_pc_side").is_none() && options.given("ksp_norm_type").is_none();
        if side_is_open && !plan.nested && RIGHT.contains(&plan.ksp.as_str()) {
            solver.set_right_preconditioning()?;
        }
        let mut method = Self {
            name: format!("{}+{}", plan.ksp, plan.pc),
            tolerances: DEFAULT,
            once: matches!(plan.ksp.as_str(), "preonly" | "none") && !plan.nested,
            sparse: plan.sparse,
            solver,
            outer: None,
            size: None,
        };
        if plan.nested {
            method.nest(session)?
        } else {
            method.solver.set_from_options()?
        }
        method.tolerances = method.outer.as_ref().unwrap_or(&method.solver).tolerances()?;
        if plan.nested {
            let relative = options.real("ppe_inner_rtol")?.unwrap_or(INNER_RELATIVE);
            method.solver.set_tolerances(Tolerances { relative, ..DEFAULT })?;
        }
        Ok(method)
    }

    /// Puts an outer iteration around the solver and gives it the user's tolerances.
    fn nest(&mut self, session: &Rc<Session>) -> Result<()> {
        let options = session.options();
        for (name, _) in options.all_given() {
            if ["ksp_monitor", "ksp_view", "ksp_converged_reason"].iter().any(|shown| name.starts_with(shown))
            {
                options.rename(&name, &format!("outer_{name}"))?;
            }
        }
        self.solver.set_from_options()?;
        let mut outer = Ksp::new(session, "outer_")?;
        outer.set_types("fgmres", "ksp")?;
        outer.set_restart(100)?;
        outer.set_inner(&self.solver)?;
        outer.set_tolerances(self.solver.tolerances()?)?;
        // Reads the inner solver's options again, hence the inner tolerances come later.
        outer.set_from_options()?;
        self.outer = Some(outer);
        Ok(())
    }

    /// A method of the fallback chain, which the user reaches as `-fallback_*`.
    fn fallback(session: &Rc<Session>, ksp: &str, pc: &str, tolerances: Tolerances) -> Result<Self> {
        let mut solver = Ksp::new(session, "fallback_")?;
        solver.set_types(ksp, pc)?;
        set_defaults(session.options(), "fallback_", pc)?;
        solver.set_tolerances(tolerances)?;
        solver.set_right_preconditioning()?;
        solver.set_restart(100)?;
        solver.set_from_options()?;
        let (ksp, pc) = solver.types()?;
        Ok(Self {
            name: format!("{ksp}+{pc}"),
            tolerances: solver.tolerances()?,
            solver,
            outer: None,
            once: false,
            sparse: false,
            size: None,
        })
    }

    /// Whether it can take another system: of the same size only, and PETSc's own multigrids keep
    /// coarse grids whose sizes change with the pattern.
    fn serves(&self, plan: &Plan, asked: (usize, usize)) -> bool {
        let own_multigrid = plan.pc != "hypre" && MULTIGRID.contains(&plan.pc.as_str());
        self.size.is_none_or(|size| size == asked && !own_multigrid)
    }

    /// Solves and judges by the true residual; adds to the record what it cost.
    fn run(&mut self, problem: &Problem, from_guess: bool, record: &mut SolveRecord) -> Result<Attempt> {
        let clock = Instant::now();
        self.size = Some(problem.size());
        self.set_up(problem)?;
        record.setup_s += clock.elapsed().as_secs_f64();
        let clock = Instant::now();
        let attempt = self.iterate(problem, from_guess && !self.once);
        record.solve_s += clock.elapsed().as_secs_f64();
        let attempt = attempt?;
        record.iterations += attempt.iterations;
        record.inner_iterations += attempt.inner_iterations;
        record.residual = attempt.residual;
        record.reason.clone_from(&attempt.reason);
        Ok(attempt)
    }

    fn set_up(&mut self, problem: &Problem) -> Result<()> {
        if let Some(outer) = &mut self.outer {
            let matrix = problem.symmetric.as_ref().ok_or_else(|| {
                Error::Run(format!(
                    "{} needs the symmetric part of the pressure matrix, which was not assembled",
                    self.name
                ))
            })?;
            // The set-up hands the outer Pmat to the inner solver as both its matrices; afterwards the
            // inner one gets its own, and its preconditioner stays since its Pmat does.
            let pmat = problem.symmetric_pmat().unwrap_or(matrix);
            outer.set_operators(&problem.full, pmat)?;
            outer.set_up()?;
            self.solver.set_operators(matrix, pmat)
        } else {
            let pmat = if self.sparse { problem.sparse.as_ref() } else { None };
            self.solver.set_operators(&problem.full, pmat.unwrap_or(problem.full_pmat()))?;
            self.solver.set_up()
        }
    }

    /// Lets go of the matrices of the last system.
    fn release(&mut self) -> Result<()> {
        self.outer.as_mut().map_or(Ok(()), Ksp::release_operators)?;
        self.solver.release_operators()
    }

    fn iterate(&mut self, problem: &Problem, from_guess: bool) -> Result<Attempt> {
        let asked = self.tolerances;
        let relative = if self.once { asked.relative.max(DIRECT_RELATIVE) } else { asked.relative };
        let limit = (relative * problem.rhs_norm).max(asked.absolute);
        let inner_before = self.inner_iterations()?;
        let mut pressure = problem.first_guess(from_guess)?;
        let mut attempt_iterations = 0;
        let mut tolerances = asked;
        for solve in 1.. {
            let solver = self.outer.as_mut().unwrap_or(&mut self.solver);
            solver.set_tolerances(tolerances)?;
            solver.set_guess_nonzero(!self.once && (from_guess || solve > 1))?;
            let report = solver.solve(&problem.rhs, &mut pressure)?;
            attempt_iterations += report.iterations;
            let residual = problem.full.residual_norm(&pressure, &problem.rhs)?;
            let accepted = residual <= SLACK * limit;
            // A solver that watches another norm, or whose recursion drifted, stops short of the true
            // limit: it goes on from where it is, asked for as much more as is missing.
            let refine =
                !accepted && report.converged && !self.once && solve < REFINEMENTS && residual.is_finite();
            if !refine {
                if let Some(constants) = &problem.constants {
                    constants.remove(&mut pressure)?;
                }
                return Ok(Attempt {
                    pressure,
                    iterations: attempt_iterations,
                    inner_iterations: self.inner_iterations()? - inner_before,
                    reason: report.reason,
                    residual: residual / problem.rhs_norm,
                    accepted,
                });
            }
            tolerances.relative *= 0.5 * limit / residual;
        }
        unreachable!("the loop ends by its return")
    }

    fn inner_iterations(&self) -> Result<usize> {
        if self.outer.is_some() { self.solver.total_iterations() } else { Ok(0) }
    }
}

impl Problem {
    fn new(session: &Rc<Session>, system: &PressureSystem) -> Result<Self> {
        let rhs = Vector::from_slice(session, &system.rhs)?;
        let unknowns = rhs.size()?;
        let is_filled = |rows: &Rows| rows.start.len() == system.rhs.len() + 1;
        let filled = |rows: &Rows| is_filled(rows).then(|| matrix(session, rows)).transpose();
        // Each set of unknowns without a surface is held at one of them for the preconditioner's sake:
        // a singular one would blow up the constant, a pinned one differs from the operator in rank one.
        let pinned = |rows: &Rows| {
            (is_filled(rows) && !system.floating.is_empty())
                .then(|| matrix(session, &pin(rows, system)))
                .transpose()
        };
        let auxiliary = |rows: &Rows| match pinned(rows)? {
            Some(pinned) => Ok(Some(pinned)),
            None => filled(rows),
        };
        let mut problem = Self {
            full: matrix(session, &system.full)?,
            symmetric: auxiliary(&system.symmetric)?,
            sparse: auxiliary(&system.sparse)?,
            full_pinned: pinned(&system.full)?,
            rhs_norm: rhs.norm()?,
            rhs,
            guess: Vector::from_slice(session, &system.pressure)?,
            constants: None,
            unknowns,
        };
        if unknowns > 0 && problem.rhs_norm.is_finite() {
            problem.attach_null_spaces(session, &system.floating)?;
        }
        Ok(problem)
    }

    /// Unknowns in all and on this rank.
    fn size(&self) -> (usize, usize) {
        (self.unknowns, self.rhs.local_size())
    }

    /// Why there is nothing to iterate on, if so.
    fn trivial(&self) -> Result<Option<&'static str>> {
        match (self.unknowns, self.rhs_norm) {
            (0, _) => Ok(Some("NO_UNKNOWNS")),
            (_, norm) if !norm.is_finite() => {
                Err(Error::Run("the source of the pressure equation is not a number; the flow has blown up: try a smaller time step".into()))
            }
            (_, 0.0) => Ok(Some("ZERO_SOURCE")),
            _ => Ok(None),
        }
    }

    fn full_pmat(&self) -> &Matrix {
        self.full_pinned.as_ref().unwrap_or(&self.full)
    }

    fn symmetric_pmat(&self) -> Option<&Matrix> {
        self.sparse.as_ref().or(self.symmetric.as_ref())
    }

    fn first_guess(&self, from_last: bool) -> Result<Vector> {
        let mut guess = self.guess.duplicate()?;
        if !from_last {
            guess.fill(0.0)?;
        }
        Ok(guess)
    }

    /// Sets of unknowns without a surface: pressure is known up to a constant on each. The full
    /// operator is not symmetric, so what a right-hand side must be orthogonal to, its left null
    /// vectors `y`, are not those constants `c`: they solve `A^T (c - y) = A^T c`, a solvable system
    /// with a small right-hand side.
    fn attach_null_spaces(&mut self, session: &Rc<Session>, floating: &[Vec<u32>]) -> Result<()> {
        if floating.is_empty() {
            return Ok(());
        }
        let local = self.rhs.local_size();
        let mut ones = vec![0.0; local];
        floating.iter().flatten().for_each(|&row| ones[row as usize] = 1.0);
        let constants = null_space(session, floating, &ones)?;

        let transpose = self.full.transpose()?;
        let c = Vector::from_slice(session, &ones)?;
        let mut b = Vector::zeros(session, local)?;
        transpose.multiply(&c, &mut b)?;
        let mut left = Vector::zeros(session, local)?;
        if b.norm()? > f64::EPSILON * transpose.norm()? {
            let mut ksp = Ksp::new(session, "null_")?;
            let pc = if session.size() > 1 { "bjacobi" } else { "ilu" };
            ksp.set_types("gmres", pc)?;
            set_defaults(session.options(), "null_", pc)?;
            ksp.set_restart(200)?;
            ksp.set_right_preconditioning()?;
            ksp.set_tolerances(Tolerances { relative: 1e-9, iterations: 2000, ..DEFAULT })?;
            ksp.set_from_options()?;
            ksp.set_operators(&transpose, &self.full_pmat().transpose()?)?;
            ksp.solve(&b, &mut left)?;
        }
        left.scale_and_add(-1.0, &c)?;
        let mut values = vec![0.0; local];
        left.read(&mut values)?;
        let left = null_space(session, floating, &values)?;

        self.full.set_null_space(&constants)?;
        self.full.set_transpose_null_space(&left)?;
        left.remove(&mut self.rhs)?;
        let before = std::mem::replace(&mut self.rhs_norm, self.rhs.norm()?);
        if self.rhs_norm <= 1e-14 * before {
            self.rhs_norm = 0.0;
        }
        self.constants = Some(constants);
        Ok(())
    }
}

/// The rows with the diagonal doubled at one row of each floating set.
fn pin(rows: &Rows, system: &PressureSystem) -> Rows {
    let mut pinned = rows.clone();
    for row in system.floating.iter().filter_map(|set| set.first()).map(|&row| row as usize) {
        let entries = rows.start[row] as usize..rows.start[row + 1] as usize;
        let diagonal = entries.into_iter().find(|&k| rows.column[k] as usize == system.first_row + row);
        diagonal.into_iter().for_each(|k| pinned.value[k] *= 2.0);
    }
    pinned
}

/// One unit vector for each set of rows: `values` there, zero elsewhere.
fn null_space(session: &Rc<Session>, sets: &[Vec<u32>], values: &[f64]) -> Result<NullSpace> {
    let mut basis = Vec::with_capacity(sets.len());
    for set in sets {
        let mut part = vec![0.0; values.len()];
        set.iter().for_each(|&row| part[row as usize] = values[row as usize]);
        let mut vector = Vector::from_slice(session, &part)?;
        vector.scale(1.0 / vector.norm()?)?;
        basis.push(vector);
    }
    NullSpace::new(session, &basis)
}

fn matrix(session: &Rc<Session>, rows: &Rows) -> Result<Matrix> {
    // A rank without unknowns may have left its rows empty altogether.
    let start = if rows.start.is_empty() { &[0][..] } else { &rows.start };
    Matrix::from_rows(session, start, &rows.column, &rows.value)
}

/// `-ppe_tuned no` leaves preconditioners as PETSc ships them: its defaults, made from the full matrix.
fn is_tuned(options: &Options) -> Result<bool> {
    Ok(options.bool("ppe_tuned")?.unwrap_or(true))
}

/// The operator complexity in what BoomerAMG prints of its set-up: a line `operator = 2.35`.
fn operator_complexity(printed: &str) -> Option<f64> {
    let after =
        |line: &str| line.trim().strip_prefix("operator")?.trim().strip_prefix('=')?.trim().parse().ok();
    printed.lines().find_map(after)
}

/// Defaults that go with a preconditioner, each overridden by the user's own.
fn set_defaults(options: &Options, prefix: &str, pc: &str) -> Result<()> {
    match pc {
        _ if prefix.is_empty() && !is_tuned(options)? => Ok(()),
        "hypre"
            if options.given(&format!("{prefix}pc_hypre_type")).is_none_or(|kind| kind == "boomeramg") =>
        {
            boomeramg_defaults(options, prefix)
                .try_for_each(|(name, value)| options.set_default(&boomeramg(prefix, name), value))
        }
        // Keeps the factors of a positive definite matrix positive definite.
        "icc" => options.set_default(&format!("{prefix}pc_factor_shift_type"), "positive_definite"),
        // A floating set of unknowns ends in a zero pivot.
        "ilu" => options.set_default(&format!("{prefix}pc_factor_shift_type"), "nonzero"),
        "bjacobi" => options.set_default(&format!("{prefix}sub_pc_factor_shift_type"), "nonzero"),
        _ => Ok(()),
    }
}

/// [`BOOMERAMG`] but for what a smoother given for all sweeps replaces: PETSc would let those of one way win over it.
fn boomeramg_defaults(options: &Options, prefix: &str) -> impl Iterator<Item = (&'static str, &'static str)> {
    let one_for_all = options.given(&boomeramg(prefix, "relax_type_all")).is_some();
    let replaced = move |name: &str| one_for_all && matches!(name, "relax_type_down" | "relax_type_up");
    BOOMERAMG.iter().copied().filter(move |(name, _)| !replaced(name))
}

fn boomeramg(prefix: &str, name: &str) -> String {
    format!("{prefix}pc_hypre_boomeramg_{name}")
}

/// What PETSc rejects while it reads options or sets up for the first time is the user's to mend.
fn wrong_options(error: Error) -> Error {
    match error {
        Error::Petsc(said) => Error::Input(format!("these PETSc options do not work: {said}")),
        other => other,
    }
}
