//! What the laboratory found: table, CSV, picture, choice.

use std::io::Write as _;
use std::path::Path;

use serde_json::json;

use super::System;
use super::row::Row;
use super::sets::OptionSet;
use crate::output::picture::curves::{Curve, Mark, loglog_plot};
use crate::output::{Cell, aligned, pareto, write_atomic};
use crate::{Error, Result};

/// Stands in tables where there is no number.
const NONE: &str = "none";
/// Share by which a residual may miss what was asked.
const SLACK: f64 = 1.05;

/// One set on one system.
pub struct Entry {
    /// What the system is called.
    pub system: String,
    /// Its flow time in s.
    pub time: Option<f64>,
    /// Root mean square divergence that the corrected velocity keeps, in 1/s.
    pub divergence: Option<f64>,
    /// All that the trial told.
    pub row: Row,
}

/// One set on all systems.
pub struct Tried {
    /// The options.
    pub set: OptionSet,
    /// A row a system.
    pub entries: Vec<Entry>,
}

impl Tried {
    /// Rows come in the order of the systems.
    pub fn new(set: OptionSet, rows: Vec<Row>, systems: &[System]) -> Self {
        Self { set, entries: systems.iter().zip(rows).map(|(system, row)| system.entry(row)).collect() }
    }

    /// Whether all systems were solved to the set's own tolerance.
    pub fn solved(&self) -> bool {
        self.entries.iter().all(|entry| entry.row.converged && entry.row.failure.is_none())
    }

    /// Set-up and iteration of all systems, in s.
    pub fn total_s(&self) -> f64 {
        self.sum(Row::total_s)
    }

    fn sum(&self, of: impl Fn(&Row) -> f64) -> f64 {
        self.entries.iter().map(|entry| of(&entry.row)).sum()
    }

    /// The largest of what is known of all systems.
    fn largest(&self, of: impl Fn(&Entry) -> Option<f64>) -> Option<f64> {
        let known: Option<Vec<f64>> = self.entries.iter().map(of).collect();
        known?.into_iter().reduce(f64::max)
    }

    fn error(&self) -> Option<f64> {
        self.largest(|entry| entry.row.pressure_error)
    }

    /// Time and pressure error, of a set that solves all.
    fn place(&self) -> Option<(f64, f64)> {
        self.solved().then(|| Some((self.total_s(), self.error()?)))?
    }

    /// Why a set is no solver of these systems, by the first system that it misses.
    fn cause(&self) -> Option<String> {
        let missed = self.entries.iter().find(|entry| !entry.row.converged || entry.row.failure.is_some())?;
        let row = &missed.row;
        let why = row.failure.clone().unwrap_or_else(|| {
            let residual = row.residual.map_or("no number".to_owned(), |residual| format!("{residual:.1e}"));
            format!("{}, {} iterations, residual {residual}", row.reason, row.iterations)
        });
        Some(format!("{}: {why}", missed.system))
    }
}

/// The fastest first, sets that do not solve all last.
pub fn sort(tried: &mut [Tried]) {
    tried.sort_by(|a, b| a.solved().cmp(&b.solved()).reverse().then(a.total_s().total_cmp(&b.total_s())));
}

fn fronts(tried: &[Tried]) -> Vec<bool> {
    pareto::front(&tried.iter().map(Tried::place).collect::<Vec<_>>())
}

/// The fastest set that reaches `relative` on every system of Eq. (3).
pub fn chosen(tried: &[Tried], relative: f64) -> Option<&Tried> {
    let serves = |tried: &&Tried| {
        let residual = tried.largest(|entry| entry.row.residual);
        !tried.set.uncorrected && tried.solved() && residual.is_some_and(|r| r <= SLACK * relative)
    };
    tried.iter().filter(serves).min_by(|a, b| a.total_s().total_cmp(&b.total_s()))
}

/// A row a set and system.
pub fn write_csv(path: &Path, tried: &[Tried]) -> Result<()> {
    let mut text = String::from(
        "options,system,time_s,unknowns,nonzeros,converged,reason,iterations,inner_iterations,setup_s,solve_s,total_s,\
         complexity,memory_mb,residual,pressure_error,divergence_1_per_s,pareto,failure\n",
    );
    for (one, best) in tried.iter().zip(fronts(tried)) {
        for Entry { system, time, divergence, row } in &one.entries {
            let number = |value: Option<f64>| value.map_or(Cell::Word(NONE), Cell::Number).to_string();
            let word = |text: &str| Cell::Word(if text.is_empty() { NONE } else { text }).to_string();
            let yes = |is: bool| if is { "yes" } else { "no" }.to_owned();
            // What a failed trial did not come to is no zero.
            let known = |value: f64| number(row.failure.is_none().then_some(value));
            let cells = [
                word(&one.set.line),
                word(system),
                number(*time),
                row.unknowns.to_string(),
                row.nonzeros.to_string(),
                yes(row.converged),
                word(&row.reason),
                row.iterations.to_string(),
                row.inner_iterations.to_string(),
                known(row.setup_s),
                known(row.solve_s),
                known(row.total_s()),
                number(row.complexity),
                number(row.memory_mb),
                number(row.residual),
                number(row.pressure_error),
                number(*divergence),
                yes(best),
                word(row.failure.as_deref().unwrap_or_default()),
            ];
            text += &(cells.join(",") + "\n");
        }
    }
    write_atomic(path, |file| file.write_all(text.as_bytes()))
}

/// The table on the terminal: a row a set, over all systems.
pub fn text(tried: &[Tried]) -> String {
    let heads = [
        "options",
        "",
        "iterations",
        "setup, s",
        "solve, s",
        "complexity",
        "memory, MB",
        "residual",
        "pressure error",
        "divergence, 1/s",
    ];
    let mut rows = vec![heads.map(str::to_owned).to_vec()];
    for (one, best) in tried.iter().zip(fronts(tried)) {
        let counts = one.entries.iter().map(|entry| match entry.row.inner_iterations {
            0 => entry.row.iterations.to_string(),
            inner => format!("{}:{inner}", entry.row.iterations),
        });
        let number = |value: Option<f64>, show: fn(f64) -> String| value.map_or("-".to_owned(), show);
        let short: fn(f64) -> String = |value| format!("{value:.1e}");
        rows.push(vec![
            one.set.line.clone(),
            if best { "*" } else { "" }.into(),
            counts.collect::<Vec<_>>().join(" "),
            format!("{:.3}", one.sum(|row| row.setup_s)),
            format!("{:.3}", one.sum(|row| row.solve_s)),
            number(one.largest(|entry| entry.row.complexity), |value| format!("{value:.2}")),
            number(one.largest(|entry| entry.row.memory_mb), |value| format!("{value:.0}")),
            number(one.largest(|entry| entry.row.residual), short),
            number(one.error(), short),
            number(one.largest(|entry| entry.divergence), short),
        ]);
    }
    let lines = aligned::lines(&rows, 2);
    let causes = std::iter::once(None).chain(tried.iter().map(Tried::cause));
    let mut text: String = lines
        .into_iter()
        .zip(causes)
        .map(|(line, cause)| {
            line + &cause.map_or(String::new(), |cause| format!("  failed at {cause}")) + "\n"
        })
        .collect();
    let systems = tried.first().map_or(vec![], |one| {
        let name = |entry: &Entry| match entry.time {
            Some(time) => format!("{} ({time:.3} s, {} unknowns)", entry.system, entry.row.unknowns),
            None => entry.system.clone(),
        };
        one.entries.iter().map(name).collect()
    });
    text += &format!("\nsystems        {}\n", systems.join(", "));
    text += "               iterations a system (outer:inner); times are sums, all else the largest of the systems\n";
    text += "               * no other set is better in both time and pressure error\n";
    text
}

/// Pressure error over time: the Pareto-best by their options, the rest as points.
pub fn write_picture(path: &Path, name: &str, tried: &[Tried]) -> Result<()> {
    let fronts = fronts(tried);
    let mark = |one: &Tried, note: String| {
        let (x, y) = one.place()?;
        // The direct solution has no error against itself.
        Some(Mark { x, y: Some(y.max(f64::EPSILON)), note })
    };
    let of = |best: bool| tried.iter().zip(&fronts).filter(move |(_, is)| **is == best).map(|(one, _)| one);
    let best = of(true).filter_map(|one| mark(one, short(&one.set.line))).collect();
    let rest = of(false).filter_map(|one| mark(one, String::new())).collect();
    let curves = [
        Curve { label: "best".into(), marks: best, joined: true },
        Curve { label: "other sets".into(), marks: rest, joined: false },
    ];
    let title = format!("{name}: pressure error over solver time");
    loglog_plot(path, &title, "set-up and iteration, s", "pressure error", &curves)
}

/// A set in a few letters: values alone, without what all have.
fn short(line: &str) -> String {
    let words = line.split(' ').filter(|word| !matches!(*word, "-ksp_type" | "-pc_type" | "--set"));
    words
        .map(|word| word.trim_start_matches("-pc_hypre_boomeramg_").trim_start_matches('-'))
        .collect::<Vec<_>>()
        .join(" ")
}

/// solvers.json: what was chosen, for scripts and pages.
pub fn write_choice(path: &Path, name: &str, chosen: Option<&Tried>, tried: &[Tried]) -> Result<()> {
    let failed = tried.iter().filter(|one| !one.solved()).count();
    let json = json!({
        "case": name,
        "version": env!("CARGO_PKG_VERSION"),
        "sets": tried.len(),
        "sets_that_fail": failed,
        "chosen": chosen.map(|one| one.set.line.as_str()),
        "chosen_s": chosen.map(Tried::total_s),
    });
    let text = serde_json::to_string_pretty(&json).map_err(|error| Error::Run(error.to_string()))?;
    write_atomic(path, |file| file.write_all(text.as_bytes()))
}
