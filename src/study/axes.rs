//! What a study varies: its axes, typed or from a study file, and the points that they span.
//!
//! A study file is TOML. `case` names the case, `description` and `measure` are as on the command line; then come axes
//! (`schemes`, `spacings`, `steps`, `tolerances`, `solvers`, and `[vary]` with a list for any key of the case file) and what
//! all runs share (`variant`, `until`, `[set]`). Each `[[group]]` with a `name` has axes and settings of its own above those.
//! What is typed on the command line replaces what the file says, in every group.

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use serde::Deserialize;

use crate::case::{CaseFile, SchemeKind};
use crate::cli::{CaseArgs, RunArgs, StudyArgs};
use crate::lab::sets::OptionSet;
use crate::output::comparison::References;
use crate::{Error, Result, run};

/// Spacings of a study that varies nothing else, in spacings of its case: halving twice shows an order, and the finest run
/// takes as long as the case alone.
const SPACINGS: [f64; 3] = [4.0, 2.0, 1.0];

macro_rules! studies {
    ($($name:literal),* $(,)?) => { [$(($name, include_str!(concat!("../../cases/studies/", $name, ".toml")))),*] };
}

/// Names and TOML texts of the built-in studies, in the order in which they are listed.
pub const STUDIES: [(&str, &str); 10] = studies![
    "paper_comparison",
    "paper_comparison_3d",
    "sliding_box",
    "convergence_taylor_green",
    "convergence_stretching_drop",
    "convergence_standing_wave",
    "laplacian",
    "tolerance",
    "sparse_matrix",
    "time_step",
];

/// What one group of runs varies and shares.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Axes {
    schemes: Vec<String>,
    spacings: Vec<f64>,
    steps: Vec<f64>,
    tolerances: Vec<f64>,
    solvers: Vec<String>,
    vary: toml::Table,
    variant: Option<String>,
    until: Option<f64>,
    set: toml::Table,
}

/// A whole study, before its runs are proven.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Outline {
    /// One line on what it is about.
    pub description: String,
    /// The case.
    pub case: Option<String>,
    /// The error measure to show.
    pub measure: Option<String>,
    /// Its own name, where it comes from a file.
    pub name: Option<String>,
    groups: Vec<(Option<String>, Axes)>,
}

/// One run of a study.
#[derive(Debug)]
pub struct Point {
    /// The group it belongs to, in a study that has groups.
    pub group: Option<String>,
    /// Name of the scheme.
    pub scheme: String,
    /// Particle spacing in m.
    pub spacing: f64,
    /// Fixed time step in s, where it is varied.
    pub step: Option<f64>,
    /// Tolerance of the pressure equation, where it is varied.
    pub tolerance: Option<f64>,
    /// PETSc options, where they are varied.
    pub solver: Option<String>,
    /// Keys of the case file with their values, where they are varied.
    pub vary: Vec<(String, String)>,
    /// What the points of its curve differ in.
    pub along: Along,
    /// Its folder.
    pub folder: PathBuf,
    /// The run.
    pub args: RunArgs,
    /// Arguments of the program that does it or what is left of it; none: it is done.
    pub start: Option<RunArgs>,
}

/// The axis that a curve runs along.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Along {
    /// Particle spacing.
    Spacing,
    /// Time step.
    Step,
    /// Tolerance of the pressure equation.
    Tolerance,
}

impl Outline {
    /// Of a study file, its own or built in, or of what was typed.
    ///
    /// # Errors
    /// [`Error::Input`] for a file that cannot be read or has keys of no use.
    pub fn of(args: &StudyArgs) -> Result<Self> {
        let typed = Axes::typed(args)?;
        let name = args.common.case.as_deref().unwrap_or_default();
        let builtin = STUDIES.iter().find(|(known, _)| *known == name).map(|(_, text)| (*text).to_owned());
        let text = match builtin {
            Some(text) => Some(text),
            // A case file is no study: only this one names a case.
            None if name.ends_with(".toml") => std::fs::read_to_string(name).ok(),
            None => None,
        };
        let table =
            text.and_then(|text| text.parse::<toml::Table>().ok()).filter(|table| table.contains_key("case"));
        let Some(table) = table else {
            return Ok(Self {
                case: args.common.case.clone(),
                groups: vec![(None, typed)],
                ..Self::default()
            });
        };
        let mut outline = Self::read(table).map_err(|why| Error::Input(format!("study {name}: {why}")))?;
        outline.name = Path::new(name).file_stem().map(|stem| stem.to_string_lossy().into_owned());
        outline.groups.iter_mut().for_each(|(_, axes)| axes.replace(&typed));
        Ok(outline)
    }

    fn read(mut table: toml::Table) -> std::result::Result<Self, String> {
        let mut text = |key: &str| match table.remove(key) {
            None => Ok(None),
            Some(toml::Value::String(text)) => Ok(Some(text)),
            Some(_) => Err(format!("{key} is no text")),
        };
        let (case, measure, description) = (text("case")?, text("measure")?, text("description")?);
        let groups = match table.remove("group") {
            None => vec![],
            Some(toml::Value::Array(groups)) => groups,
            Some(_) => return Err("write groups as [[group]]".into()),
        };
        let axes = |table: toml::Table| table.try_into::<Axes>().map_err(|error| error.message().to_owned());
        let mut read = vec![];
        for group in groups {
            let toml::Value::Table(mut group) = group else { return Err("write groups as [[group]]".into()) };
            let Some(toml::Value::String(name)) = group.remove("name") else {
                return Err("a [[group]] needs a name".into());
            };
            let mut whole = table.clone();
            whole.extend(group);
            read.push((Some(name), axes(whole)?));
        }
        if read.is_empty() {
            read.push((None, axes(table)?));
        }
        let description = description.unwrap_or_default();
        Ok(Self { description, case, measure, name: None, groups: read })
    }

    /// All runs, proven, each with what is left to do of it; the folder is `out`.
    ///
    /// # Errors
    /// [`Error::Input`] for what is wrong with any of them.
    pub fn points(&self, args: &StudyArgs, out: &Path) -> Result<Vec<Point>> {
        let mut points: Vec<Point> = Vec::new();
        for (group, axes) in &self.groups {
            let common = CaseArgs { case: self.case.clone(), ..args.common.clone() };
            for point in axes.points(common, group.as_deref(), args, out)? {
                if !points.iter().any(|other| other.folder == point.folder) {
                    points.push(point);
                }
            }
        }
        Ok(points)
    }

    /// What the first run is based on, for names and sentences.
    ///
    /// # Errors
    /// [`Error::Input`] for what is wrong with the case.
    pub fn case_file(&self, args: &StudyArgs) -> Result<CaseFile> {
        let common = CaseArgs { case: self.case.clone(), ..args.common.clone() };
        let base = self.groups.first().map(|(_, axes)| axes.base(common));
        base.unwrap_or_default().load_case()
    }
}

impl Axes {
    fn typed(args: &StudyArgs) -> Result<Self> {
        let name = |kind: &SchemeKind| kind.name().to_owned();
        let mut vary = toml::Table::new();
        for (key, values) in &args.vary {
            let values = separate(values).into_iter().map(toml::Value::String).collect();
            vary.insert(key.clone(), toml::Value::Array(values));
        }
        for line in &args.solvers {
            OptionSet::parse(line)?;
        }
        Ok(Self {
            schemes: args.schemes.iter().map(name).collect(),
            spacings: args.spacings.clone(),
            steps: args.steps.clone(),
            tolerances: args.tolerances.clone(),
            solvers: args.solvers.clone(),
            vary,
            ..Self::default()
        })
    }

    /// What was typed wins.
    fn replace(&mut self, typed: &Self) {
        fn take<T: Clone>(own: &mut Vec<T>, typed: &[T]) {
            if !typed.is_empty() {
                *own = typed.to_vec();
            }
        }
        take(&mut self.schemes, &typed.schemes);
        take(&mut self.spacings, &typed.spacings);
        take(&mut self.steps, &typed.steps);
        take(&mut self.tolerances, &typed.tolerances);
        take(&mut self.solvers, &typed.solvers);
        self.vary.extend(typed.vary.clone());
    }

    /// A run with all settings and without axes; what was typed comes last and wins.
    fn base(&self, mut common: CaseArgs) -> RunArgs {
        common.variant = common.variant.or_else(|| self.variant.clone());
        common.until = common.until.or(self.until);
        let own = self.set.iter().map(|(key, value)| (key.clone(), value.to_string()));
        common.set = own.chain(common.set).collect();
        RunArgs { common, ..RunArgs::default() }
    }

    fn points(
        &self,
        common: CaseArgs,
        group: Option<&str>,
        args: &StudyArgs,
        out: &Path,
    ) -> Result<Vec<Point>> {
        let base = self.base(common);
        let case = base.load_case()?;
        let schemes = match self.schemes.is_empty() {
            true => vec![case.scheme.kind],
            false => self.schemes.iter().map(|name| scheme(name)).collect::<Result<_>>()?,
        };
        let mut spacings = self.spacings.clone();
        if spacings.is_empty() {
            let alone = self.steps.is_empty()
                && self.tolerances.is_empty()
                && self.solvers.is_empty()
                && self.vary.is_empty();
            spacings =
                if alone { SPACINGS.map(|share| share * case.spacing).into() } else { vec![case.spacing] };
        }
        // The coarsest first: it is the fastest to show that something is wrong.
        let coarse_first = |values: &[f64]| {
            let mut values = values.to_vec();
            values.sort_by(|a, b| b.total_cmp(a));
            values.dedup();
            values
        };
        let (spacings, steps) = (coarse_first(&spacings), coarse_first(&self.steps));
        let tolerances = coarse_first(&self.tolerances);
        let along = match () {
            () if spacings.len() > 1 => Along::Spacing,
            () if steps.len() > 1 => Along::Step,
            () if tolerances.len() > 1 => Along::Tolerance,
            () => Along::Spacing,
        };
        let mut points = vec![];
        for kind in schemes {
            // A scheme that solves no system takes no part in what its solver is given.
            let (solvers, tolerances) = match kind.solves() {
                true => (optional(&self.solvers), optional(&tolerances)),
                false => (vec![None], vec![None]),
            };
            for solver in &solvers {
                for vary in combinations(&self.vary)? {
                    for &tolerance in &tolerances {
                        for &step in &optional(&steps) {
                            for &spacing in &spacings {
                                let mut point = Point {
                                    group: group.map(str::to_owned),
                                    scheme: kind.name().to_owned(),
                                    spacing,
                                    step,
                                    tolerance,
                                    solver: solver.clone(),
                                    vary: vary.clone(),
                                    along,
                                    folder: PathBuf::new(),
                                    args: base.clone(),
                                    start: None,
                                };
                                point.complete(kind, args, out)?;
                                points.push(point);
                            }
                        }
                    }
                }
            }
        }
        Ok(points)
    }
}

impl Point {
    /// Gives the run its arguments and its folder, proves it, and finds out what is left to do of it.
    fn complete(&mut self, kind: SchemeKind, study: &StudyArgs, out: &Path) -> Result<()> {
        let run = &mut self.args;
        (run.method.scheme, run.method.spacing) = (Some(kind), Some(self.spacing));
        let set = &mut run.common.set;
        set.extend(self.step.map(|step| ("time.step".to_owned(), format!("{step:?}"))));
        set.extend(self.vary.iter().cloned());
        if let Some(line) = &self.solver {
            let options = OptionSet::parse(line)?;
            if options.uncorrected {
                set.push(("scheme.laplacian".into(), "shao_lo".into()));
            }
            run.common.petsc.extend(options.petsc);
        }
        if let Some(tolerance) = self.tolerance {
            run.common.petsc.extend(["-ksp_rtol".into(), format!("{tolerance:?}")]);
        }
        let case = run.load_case()?;
        let run = run.clone();
        if kind == SchemeKind::PatchTest {
            return Err(Error::Input(
                "a study compares flows, and patch_test has none: run it by itself, it refines on its own"
                    .into(),
            ));
        }
        if (case.scheme.kind, case.spacing) != (kind, self.spacing) {
            return Err(Error::Input(
                "--set names a spacing or a scheme, which a study varies: use --spacings and --schemes"
                    .into(),
            ));
        }
        References::read(&case, &run.reference_files(&case)?)?;
        self.folder = out.join("runs").join(self.folder_name());
        self.start = run::left_to_do(run, &case, &self.folder, study.force)?;
        Ok(())
    }

    fn folder_name(&self) -> String {
        let mut name = self.group.as_deref().map_or(String::new(), |group| slug(group) + "-");
        name += &format!("{}-{:?}", self.scheme, self.spacing);
        let mut add = |part: Option<String>| name += &part.map_or(String::new(), |part| format!("-{part}"));
        add(self.step.map(|step| format!("dt{step:?}")));
        add(self.tolerance.map(|tolerance| format!("rtol{tolerance:?}")));
        add(self.solver.as_ref().map(|line| slug(line)));
        for (key, value) in &self.vary {
            add(Some(slug(&format!("{}={value}", key.rsplit('.').next().unwrap_or(key)))));
        }
        name
    }

    /// What a curve is called: all that its points share and that differs between curves.
    pub fn curve(&self) -> String {
        let mut parts = vec![self.scheme.to_uppercase()];
        parts.extend(self.group.clone());
        parts.extend(self.solver.clone().map(|line| line.replace("-ksp_type ", "").replace("-pc_type ", "")));
        parts.extend(self.vary.iter().map(|(key, value)| {
            format!("{} {}", key.rsplit('.').next().unwrap_or(key), value.trim_matches('"'))
        }));
        let spacing = (self.along != Along::Spacing).then(|| format!("{} m", self.spacing));
        let step = self.step.filter(|_| self.along != Along::Step).map(|step| format!("dt {step} s"));
        let tolerance =
            self.tolerance.filter(|_| self.along != Along::Tolerance).map(|t| format!("rtol {t:e}"));
        parts.extend([spacing, step, tolerance].into_iter().flatten());
        parts.join(", ")
    }

    /// Where it lies on its curve.
    pub fn place(&self) -> f64 {
        match self.along {
            Along::Spacing => self.spacing,
            Along::Step => self.step.unwrap_or(f64::NAN),
            Along::Tolerance => self.tolerance.unwrap_or(f64::NAN),
        }
    }

    /// That place in words.
    pub fn note(&self) -> String {
        match self.along {
            Along::Spacing => format!("{} m", self.spacing),
            Along::Step => format!("dt {} s", self.place()),
            Along::Tolerance => format!("rtol {:e}", self.place()),
        }
    }

    /// Whether both solve the same equations by the same method, at whatever resolution.
    pub fn is_kin(&self, other: &Self) -> bool {
        let method = |point: &Self| {
            (point.group.clone(), point.scheme.clone(), point.solver.clone(), point.vary.clone())
        };
        method(self) == method(other)
    }

    /// Finer comes first: spacing, then time step, then tolerance.
    pub fn fineness(&self) -> [f64; 3] {
        [self.spacing, self.step.unwrap_or(0.0), self.tolerance.unwrap_or(0.0)]
    }
}

fn scheme(name: &str) -> Result<SchemeKind> {
    SchemeKind::from_str(name, false).map_err(|_| {
        let known: Vec<_> = SchemeKind::value_variants().iter().map(|kind| kind.name()).collect();
        Error::Input(format!("schemes: there is no {name:?}: choose from {}", known.join(", ")))
    })
}

/// The values, or the one case of none.
fn optional<T: Clone>(values: &[T]) -> Vec<Option<T>> {
    if values.is_empty() { vec![None] } else { values.iter().cloned().map(Some).collect() }
}

/// Every way to take one value of each key.
fn combinations(vary: &toml::Table) -> Result<Vec<Vec<(String, String)>>> {
    let mut all = vec![vec![]];
    for (key, values) in vary {
        let Some(values) = values.as_array().filter(|values| !values.is_empty()) else {
            return Err(Error::Input(format!("vary {key}: write a list of values")));
        };
        let typed = |value: &toml::Value| match value {
            toml::Value::String(text) => text.clone(),
            other => other.to_string(),
        };
        let with = |one: &Vec<(String, String)>, value: &toml::Value| {
            one.iter().cloned().chain([(key.clone(), typed(value))]).collect()
        };
        all = all.iter().flat_map(|one| values.iter().map(move |value| with(one, value))).collect();
    }
    Ok(all)
}

/// Values between commas; those inside brackets and quotes belong to a value.
fn separate(text: &str) -> Vec<String> {
    let (mut depth, mut quoted) = (0, false);
    let mut values = vec![String::new()];
    for letter in text.chars() {
        match letter {
            '"' => quoted = !quoted,
            '[' | '{' if !quoted => depth += 1,
            ']' | '}' if !quoted => depth -= 1,
            ',' if depth == 0 && !quoted => {
                values.push(String::new());
                continue;
            }
            _ => {}
        }
        values.last_mut().expect("there is one from the start").push(letter);
    }
    values.into_iter().map(|value| value.trim().to_owned()).collect()
}

/// A text as part of a file name: letters and digits kept; a checksum makes long ones unique.
fn slug(text: &str) -> String {
    let kept: String = text
        .chars()
        .map(|letter| if letter.is_ascii_alphanumeric() || "._=+".contains(letter) { letter } else { '_' })
        .collect();
    match kept.len() {
        0..=32 if kept == text => kept,
        _ => format!("{}_{:08x}", &kept[..kept.len().min(24)], crc32fast::hash(text.as_bytes())),
    }
}

/// Names and one-line descriptions of the built-in studies.
pub fn list() -> String {
    let width = STUDIES.iter().map(|(name, _)| name.len()).max().unwrap_or(0);
    let line = |(name, text): &(&str, &str)| {
        let table = text.parse::<toml::Table>().expect("built-in studies are valid: a test reads each");
        format!("{name:width$}  {}\n", table["description"].as_str().unwrap_or_default())
    };
    STUDIES.iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_separated_outside_brackets() {
        assert_eq!(separate("0, 2"), ["0", "2"]);
        assert_eq!(separate("[0,1],[2,3]"), ["[0,1]", "[2,3]"]);
        assert_eq!(separate(r#""a,b",c"#), [r#""a,b""#, "c"]);
    }

    #[test]
    fn every_built_in_study_is_valid_and_has_several_runs() {
        for (name, _) in STUDIES {
            let mut args = StudyArgs::default();
            args.common.case = Some(name.into());
            let outline = Outline::of(&args).unwrap();
            assert!(!outline.description.is_empty(), "{name}");
            let points =
                outline.points(&args, Path::new("nowhere")).unwrap_or_else(|error| panic!("{name}: {error}"));
            assert!(points.len() > 1, "{name}");
        }
        assert_eq!(list().lines().count(), STUDIES.len());
    }

    #[test]
    fn axes_span_all_their_combinations() {
        let args = StudyArgs {
            schemes: vec![SchemeKind::IsphDf, SchemeKind::Wcsph],
            spacings: vec![0.02, 0.04],
            tolerances: vec![1e-3, 1e-5],
            vary: vec![("scheme.shifting".into(), "0,2".into())],
            ..StudyArgs::default()
        };
        let outline = Outline::of(&args).unwrap();
        let points = outline.points(&args, Path::new("nowhere")).unwrap();
        // 2 spacings x 2 values; tolerances for the scheme that solves.
        assert_eq!(points.iter().filter(|point| point.scheme == "isph_df").count(), 8);
        assert_eq!(points.iter().filter(|point| point.scheme == "wcsph").count(), 4);
        assert!(points[0].spacing > points[1].spacing && points[0].curve() == points[1].curve());
        assert!(points.iter().all(|point| point.args.load_case().is_ok()));
        assert_eq!(points[0].folder, Path::new("nowhere/runs/isph_df-0.04-rtol0.001-shifting=0"));
    }

    #[test]
    fn groups_add_to_what_all_share() {
        let text = "case = 'dam_break_2d'\nspacings = [0.04]\nuntil = 0.1\n[[group]]\nname = 'a'\n[[group]]\nname = 'b'\n\
                    schemes = ['wcsph']\nspacings = [0.02, 0.04]\n[group.set]\n'scheme.alpha' = 0.1";
        let outline = Outline::read(text.parse().unwrap()).unwrap();
        assert_eq!(outline.groups.len(), 2);
        assert_eq!(outline.groups[0].1.spacings, [0.04]);
        assert_eq!((outline.groups[1].1.spacings.len(), outline.groups[1].1.until), (2, Some(0.1)));
        for wrong in ["case = 1", "case = 'x'\ncolour = 3", "case = 'x'\n[[group]]\nspacings = [1.0]"] {
            assert!(Outline::read(wrong.parse().unwrap()).is_err(), "{wrong}");
        }
    }
}
