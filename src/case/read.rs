//! Case files in and out: TOML text to a proven [`CaseFile`] ([`read()`]) and back ([`write()`]).
//!
//! Every key is asked for once, through a `Reader` that notes what is wrong and goes on with a stand-in, so that one
//! answer lists all problems of a file. Stand-ins for numbers are NaN, which no later comparison finds fault with:
//! comparisons here ask "is it wrong?", never "is it not right?".

use std::cell::RefCell;
use std::sync::Arc;

use clap::ValueEnum;
use toml_edit::{Document, Item, TableLike, Value};

use super::{
    Arrival, Axis, BlockForm, Body, BodyFriction, BodyMotion, BodyShape, CaseFile, ExactSolution, Fluid,
    FluidBlock, Motion, Normalise, OutputParams, Probe, Profile, Reference, SchemeKind, SchemeParams, Side,
    Slip, SolidBox, Tank, TimeParams,
};
use crate::bodies::friction::Law;
use crate::form::{Mesh, Point};
use crate::output::{bodies, quantities, table};
use crate::{Error, Result};

/// More particles than this are taken for a mistake in the spacing.
const MOST_PARTICLES: f64 = 2e9;

/// Reads and proves a case: `origin` names it in messages, `overrides` are the `--set KEY=VALUE` of the user.
///
/// # Errors
/// [`Error::Input`] with one line for each problem: what, where, and what to do.
pub fn read(text: &str, origin: &str, overrides: &[(String, String)]) -> Result<CaseFile> {
    read_variant(text, origin, None, overrides)
}

/// [`read()`] of a variant that the case itself describes.
///
/// A table `[variant.NAME]` holds keys of the case file as they stand in the file, and tables named like a scheme with keys
/// for that scheme alone. They replace those of the case, those of the scheme come after the others, and `overrides` last.
///
/// # Errors
/// As [`read()`]; and for a variant that the case does not have.
pub fn read_variant(
    text: &str,
    origin: &str,
    variant: Option<&str>,
    overrides: &[(String, String)],
) -> Result<CaseFile> {
    let document = Document::parse(text).map_err(|error| {
        let line = error.span().map_or(1, |span| line_of(text, span.start));
        let message = error.message().trim().replace('\n', ", ");
        Error::Input(format!("{origin}:{line}: not valid TOML: {message}: correct this line"))
    })?;
    let mut root = document.as_item().clone();
    let mut problems = Vec::new();
    let mut overridden = Vec::new();
    let of_variant = match variant {
        Some(name) => changes_of_variant(&root, name, origin, overrides)?,
        None => vec![],
    };
    let labelled = of_variant
        .iter()
        .map(|(key, value)| (format!("--variant {}", variant.unwrap_or_default()), key, value));
    for (label, key, value) in
        labelled.chain(overrides.iter().map(|(key, value)| (format!("--set {key}"), key, value)))
    {
        match set(&mut root, key, value) {
            Ok(path) => overridden.push((path, label)),
            Err(sentence) => {
                overridden.push((key.clone(), label));
                problems.push(Problem { path: key.clone(), sentence });
            }
        }
    }

    let noted = RefCell::new(problems);
    let mut reader = Reader::new(root.as_table_like(), String::new(), 0, &noted);
    reader.dimension = reader.whole("dimension", 2, 3).required() as usize;
    let mut case = read_case(&reader);
    reader.item("variant"); // what was asked of it is in the case by now
    reader.item("run"); // how a run was made: for people, not for us
    reader.reject_unknown();
    // A shorter run than the file's simply does not reach its later snapshots.
    let overridden_key = |key: &str| overrides.iter().any(|(changed, _)| changed == key);
    if overridden_key("time.until") && !overridden_key("output.snapshots") {
        case.output.snapshots.retain(|time| *time <= case.time.until);
    }
    let mut problems = noted.into_inner();
    prove(&case, &mut problems);

    if problems.is_empty() {
        return Ok(case);
    }
    let mut lines: Vec<_> = problems
        .into_iter()
        .map(|Problem { path, sentence }| {
            let (start, added) = place(&root, &path);
            let typed = overridden
                .iter()
                .rfind(|(changed, _)| is_within(&path, changed) || added && is_within(changed, &path));
            match (typed, start) {
                (Some((_, label)), _) => (0, format!("{label}: {sentence}")),
                (None, None) => (0, format!("{origin}: {sentence}")),
                (None, Some(start)) => {
                    let line = line_of(text, start);
                    (line, format!("{origin}:{line}: {sentence}"))
                }
            }
        })
        .collect();
    lines.sort_by_key(|&(line, _)| line);
    Err(Error::Input(lines.into_iter().map(|(_, line)| line).collect::<Vec<_>>().join("\n")))
}

/// Dotted keys and values that make a case the variant `name` of itself, with the scheme that it then has.
fn changes_of_variant(
    root: &Item,
    name: &str,
    origin: &str,
    overrides: &[(String, String)],
) -> Result<Vec<(String, String)>> {
    let variants = root.get("variant").and_then(Item::as_table_like);
    let Some(variant) = variants.and_then(|all| all.get(name)).and_then(Item::as_table_like) else {
        let known: Vec<_> = variants.into_iter().flat_map(TableLike::iter).map(|(known, _)| known).collect();
        let advice = match nearest(name, known.iter().copied()) {
            Some(near) => format!("did you mean {near}?"),
            None if known.is_empty() => "it has none, leave --variant out".to_owned(),
            None => format!("use one of {}", known.join(", ")),
        };
        return Err(Error::Input(format!("--variant {name}: {origin} has no such variant: {advice}")));
    };
    let is_scheme = |key: &str| SchemeKind::from_str(key, false).is_ok();
    let mut changes = vec![];
    for (key, item) in variant.iter().filter(|(key, _)| !is_scheme(key)) {
        flatten(key.to_owned(), item, &mut changes);
    }
    let kind_in = |list: &[(String, String)]| {
        let last = list.iter().rev().find(|(key, _)| key == "scheme.kind");
        last.map(|(_, value)| value.trim().trim_matches(['"', '\'']).to_owned())
    };
    let in_file = root.get("scheme").and_then(|scheme| scheme.get("kind")).and_then(Item::as_str);
    let kind = kind_in(overrides).or(kind_in(&changes)).or(in_file.map(str::to_owned));
    let kind = kind.unwrap_or_else(|| SchemeParams::default().kind.name());
    for (key, item) in variant.get(&kind).and_then(Item::as_table_like).into_iter().flat_map(TableLike::iter)
    {
        flatten(key.to_owned(), item, &mut changes);
    }
    Ok(changes)
}

/// Adds the values under `item` with their dotted keys.
fn flatten(key: String, item: &Item, values: &mut Vec<(String, String)>) {
    match item.as_table_like() {
        Some(table) => {
            for (below, item) in table.iter() {
                flatten(format!("{key}.{below}"), item, values);
            }
        }
        None => values.push((key, item.to_string())),
    }
}

/// The case as TOML with all defaults written out, under `header` as comment lines; [`read`] gives it back equal.
///
/// A table `[run]` may be appended: it records how a run was made, and [`read`] passes over it.
pub fn write(case: &CaseFile, header: &str) -> String {
    let mut text: String = header.lines().map(|line| format!("# {line}\n")).collect();
    text += &toml::to_string(case).expect("a case file is plain data");
    text
}

/// The candidate most like a mistyped word, if any is near.
pub fn nearest<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    candidates
        .into_iter()
        .map(|candidate| (strsim::jaro_winkler(word, candidate), candidate))
        .filter(|&(likeness, _)| likeness > 0.8)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, candidate)| candidate)
}

/// Something wrong at a dotted path like `fluid.block.0.max`.
struct Problem {
    path: String,
    sentence: String,
}

impl Problem {
    /// The sentence is the path and what is wrong with it.
    fn new(path: impl Into<String>, complaint: &str) -> Self {
        let path = path.into();
        Self { sentence: format!("{path} {complaint}"), path }
    }
}

fn line_of(text: &str, offset: usize) -> usize {
    text.as_bytes()[..offset].iter().filter(|&&byte| byte == b'\n').count() + 1
}

/// True for a path itself and all below it.
fn is_within(path: &str, above: &str) -> bool {
    path.strip_prefix(above).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
}

/// Where the item at `path` starts in the text, or else the table that lacks it; and whether an override added it.
fn place(root: &Item, path: &str) -> (Option<usize>, bool) {
    let mut item = root;
    let mut start = None;
    for segment in path.split('.') {
        let Some(next) = child(item, segment) else { return (start, false) };
        item = next;
        start = item.span().map(|span| span.start).or(start);
    }
    (start, item.span().is_none())
}

fn child<'a>(item: &'a Item, segment: &str) -> Option<&'a Item> {
    match segment.parse::<usize>() {
        Ok(index) if !item.is_table_like() => item.get(index),
        _ => item.get(segment),
    }
}

/// Puts a value at a dotted key of the document, and returns the path of the value it changed.
fn set(root: &mut Item, key: &str, value: &str) -> std::result::Result<String, String> {
    let value = value.trim();
    let value = value.parse::<Value>().unwrap_or_else(|_| Value::from(value));
    let mut item = root;
    let mut path = Vec::new();
    // Problems of a list are found at the list, not at its elements.
    let mut changed = String::new();
    for segment in key.split('.') {
        if segment.is_empty() {
            return Err(format!("{key:?} is no key: write it like fluid.density"));
        }
        // One entry alone needs no number.
        let is_one = item.as_array_of_tables().is_some_and(|tables| tables.len() == 1);
        if is_one && segment.parse::<usize>().is_err() {
            path.push("0");
            item = item.get_mut(0).expect("there is one");
        }
        let above = path.join(".");
        path.push(segment);
        if !item.is_array() {
            changed = path.join(".");
        }
        item = match item {
            Item::Table(_) | Item::None | Item::Value(Value::InlineTable(_)) => &mut item[segment],
            Item::ArrayOfTables(_) | Item::Value(Value::Array(_)) => {
                segment.parse::<usize>().ok().and_then(|index| item.get_mut(index)).ok_or_else(|| {
                    format!("there is no {above}.{segment}: give the number of an entry of {above}, from 0")
                })?
            }
            Item::Value(_) => return Err(format!("{above} is a single value: leave out .{segment}")),
        };
    }
    *item = Item::Value(value);
    Ok(changed)
}

/// A value in words that fit into a sentence.
fn shown(item: &Item) -> String {
    match item {
        Item::Value(Value::Float(value)) => format!("{:?}", value.value()),
        Item::Value(Value::Integer(value)) => value.value().to_string(),
        Item::Value(Value::Boolean(value)) => value.value().to_string(),
        Item::Value(Value::Datetime(value)) => value.value().to_string(),
        Item::Value(Value::String(value)) => format!("{:?}", value.value()),
        Item::Value(Value::Array(values)) => {
            let values: Vec<_> = values.iter().map(|value| shown(&Item::Value(value.clone()))).collect();
            format!("[{}]", values.join(", "))
        }
        Item::Value(Value::InlineTable(_)) | Item::Table(_) => "a table".to_owned(),
        Item::ArrayOfTables(_) => "a list of tables".to_owned(),
        Item::None => "empty".to_owned(),
    }
}

/// The numbers that a key may hold.
#[derive(Clone, Copy)]
enum Range {
    Any,
    Positive,
    NotNegative,
    Within(f64, f64),
    /// Above the first, up to the second.
    Above(f64, f64),
}

impl Range {
    fn contains(self, value: f64) -> bool {
        value.is_finite()
            && match self {
                Self::Any => true,
                Self::Positive => value > 0.0,
                Self::NotNegative => value >= 0.0,
                Self::Within(low, high) => (low..=high).contains(&value),
                Self::Above(low, high) => value > low && value <= high,
            }
    }

    fn wanted(self, unit: &str) -> String {
        let number = match self {
            Self::Any => "a finite number".to_owned(),
            Self::Positive => "a finite number > 0".to_owned(),
            Self::NotNegative => "a finite number >= 0".to_owned(),
            Self::Within(low, high) => format!("a number from {low} to {high}"),
            Self::Above(low, high) => format!("a number > {low} and <= {high}"),
        };
        if unit.is_empty() { number } else { format!("{number} in {unit}") }
    }
}

/// One table of the file, read key by key.
struct Reader<'a> {
    table: Option<&'a dyn TableLike>,
    /// Path of the table with a dot behind it; empty for the file itself.
    path: String,
    /// Components of a vector; 0 while unknown.
    dimension: usize,
    problems: &'a RefCell<Vec<Problem>>,
    /// Keys asked for so far: all that this table may hold.
    known: RefCell<Vec<&'static str>>,
}

/// What a table holds under one key.
struct Field<'r, T> {
    reader: &'r Reader<'r>,
    key: &'static str,
    wanted: String,
    value: Option<T>,
    stand_in: T,
}

impl<T> Field<'_, T> {
    fn required(self) -> T {
        self.value.unwrap_or_else(|| {
            self.reader.note(self.key, &format!("is missing: give {}", self.wanted));
            self.stand_in
        })
    }

    fn or(self, default: T) -> T {
        self.value.unwrap_or(default)
    }

    fn optional(self) -> Option<T> {
        self.value
    }
}

impl<'a> Reader<'a> {
    fn new(
        table: Option<&'a dyn TableLike>,
        path: String,
        dimension: usize,
        problems: &'a RefCell<Vec<Problem>>,
    ) -> Self {
        Self { table, path, dimension, problems, known: RefCell::default() }
    }

    fn note(&self, key: &str, complaint: &str) {
        let path = format!("{}{}", self.path, key.escape_debug());
        self.problems.borrow_mut().push(Problem::new(path, complaint));
    }

    fn item(&self, key: &'static str) -> Option<&'a Item> {
        let mut known = self.known.borrow_mut();
        if !known.contains(&key) {
            known.push(key);
        }
        self.table?.get(key)
    }

    fn reject_unknown(&self) {
        let known = self.known.borrow();
        for (key, _) in self.table.into_iter().flat_map(TableLike::iter) {
            if !known.contains(&key) {
                let advice = match nearest(key, known.iter().copied()) {
                    Some(near) => format!("did you mean {}{near}?", self.path),
                    None => format!("use one of {}", known.join(", ")),
                };
                self.note(key, &format!("is no key of a case file: {advice}"));
            }
        }
    }

    /// The one way to a value: `parse` returns none for what is not `wanted`.
    fn field<T: Clone>(
        &self,
        key: &'static str,
        wanted: String,
        stand_in: T,
        parse: impl FnOnce(&Item) -> Option<T>,
    ) -> Field<'_, T> {
        let value = self.item(key).map(|item| {
            parse(item).unwrap_or_else(|| {
                self.note(key, &format!("is {}: give {wanted}", shown(item)));
                stand_in.clone()
            })
        });
        Field { reader: self, key, wanted, value, stand_in }
    }

    fn number(&self, key: &'static str, range: Range, unit: &str) -> Field<'_, f64> {
        self.field(key, range.wanted(unit), f64::NAN, |item| {
            float(item).filter(|&value| range.contains(value))
        })
    }

    fn numbers(&self, key: &'static str, range: Range, unit: &str) -> Field<'_, Vec<f64>> {
        let wanted = format!("a list of numbers, each {}", range.wanted(unit));
        self.field(key, wanted, Vec::new(), |item| {
            floats(item).filter(|values| values.iter().all(|&value| range.contains(value)))
        })
    }

    fn vector(&self, key: &'static str, unit: &str) -> Field<'_, Vec<f64>> {
        let dimension = self.dimension;
        let wanted = match dimension {
            0 => format!("a list of finite numbers in {unit}, one for each dimension"),
            _ => format!("a list of {dimension} finite numbers in {unit}"),
        };
        self.field(key, wanted, vec![f64::NAN; dimension], |item| {
            floats(item).filter(|values| {
                (dimension == 0 || values.len() == dimension) && values.iter().all(|value| value.is_finite())
            })
        })
    }

    /// An integer; 0 stands in for a bad one.
    fn whole(&self, key: &'static str, low: i64, high: i64) -> Field<'_, i64> {
        let wanted = match high {
            i64::MAX => format!("a whole number >= {low}"),
            _ => format!("a whole number from {low} to {high}"),
        };
        self.field(key, wanted, 0, |item| item.as_integer().filter(|value| (low..=high).contains(value)))
    }

    fn flag(&self, key: &'static str) -> Field<'_, bool> {
        self.field(key, "true or false".to_owned(), false, Item::as_bool)
    }

    /// One line of text.
    fn text(&self, key: &'static str, meaning: &str) -> Field<'_, String> {
        self.field(key, format!("{meaning}, one line of text in quotes"), String::new(), |item| {
            item.as_str().filter(|text| !text.contains(char::is_control)).map(str::to_owned)
        })
    }

    /// A word that serves as a file name, a column title and an option's argument alike.
    fn name(&self, key: &'static str) -> Field<'_, String> {
        let wanted = "a name of letters, digits, - and _ in quotes".to_owned();
        let fits =
            |text: &&str| !text.is_empty() && text.chars().all(|c| c.is_alphanumeric() || "-_".contains(c));
        self.field(key, wanted, String::new(), |item| item.as_str().filter(fits).map(str::to_owned))
    }

    /// A name for an entry of a list by its place there, from 1.
    fn numbered(&self, what: &str) -> String {
        let place = self.path.split('.').filter_map(|part| part.parse::<usize>().ok()).next_back();
        format!("{what}{}", place.map_or(0, |place| place + 1))
    }

    fn variant<T: ValueEnum>(&self, key: &'static str) -> Field<'_, T> {
        self.field(key, variants::<T>(), T::value_variants()[0].clone(), variant)
    }

    fn variant_list<T: ValueEnum>(&self, key: &'static str) -> Field<'_, Vec<T>> {
        self.field(key, format!("a list of {}", variants::<T>()), Vec::new(), |item| {
            items(item)?.iter().map(variant).collect()
        })
    }

    /// Reads the table under `key`; where there is none, an empty one.
    fn section<T>(&self, key: &'static str, read: impl FnOnce(&Reader) -> T) -> T {
        let item = self.item(key);
        let table = item.and_then(Item::as_table_like);
        let noted = self.problems.borrow().len();
        let value = self.inside(table, key, read);
        if let (Some(item), None) = (item, table) {
            // What it lacks as a table is beside the point.
            self.problems.borrow_mut().truncate(noted);
            self.note(key, &format!("is {}: write it as one table [{}{key}]", shown(item), self.path));
        }
        value
    }

    /// Reads the table under `key`, if there is one.
    fn optional_section<T>(&self, key: &'static str, read: impl FnOnce(&Reader) -> T) -> Option<T> {
        self.item(key).map(|_| self.section(key, read))
    }

    /// Reads all tables of the list under `key`.
    fn sections<T>(&self, key: &'static str, read: impl Fn(&Reader) -> T) -> Vec<T> {
        let Some(item) = self.item(key) else { return Vec::new() };
        let tables = match item {
            Item::ArrayOfTables(tables) => Some(tables.iter().map(|table| table as &dyn TableLike).collect()),
            Item::Value(Value::Array(values)) => values
                .iter()
                .map(|value| value.as_inline_table().map(|table| table as &dyn TableLike))
                .collect::<Option<Vec<_>>>(),
            _ => None,
        };
        if tables.is_none() {
            let advice = format!("write it as [[{}{key}]], once for each", self.path);
            self.note(key, &format!("is {}: {advice}", shown(item)));
        }
        let tables = tables.into_iter().flatten().enumerate();
        tables.map(|(index, table)| self.inside(Some(table), &format!("{key}.{index}"), &read)).collect()
    }

    fn inside<T>(&self, table: Option<&dyn TableLike>, key: &str, read: impl FnOnce(&Reader) -> T) -> T {
        let reader = Reader::new(table, format!("{}{key}.", self.path), self.dimension, self.problems);
        let value = read(&reader);
        reader.reject_unknown();
        value
    }
}

fn float(item: &Item) -> Option<f64> {
    item.as_float().or_else(|| item.as_integer().map(|value| value as f64))
}

fn floats(item: &Item) -> Option<Vec<f64>> {
    items(item)?.iter().map(float).collect()
}

fn items(item: &Item) -> Option<Vec<Item>> {
    Some(item.as_array()?.iter().cloned().map(Item::Value).collect())
}

fn variant<T: ValueEnum>(item: &Item) -> Option<T> {
    T::from_str(item.as_str()?, false).ok()
}

/// All names of an enum, for a sentence.
fn variants<T: ValueEnum>() -> String {
    let names = T::value_variants().iter().filter_map(T::to_possible_value);
    format!("one of {}", names.map(|value| format!("{:?}", value.get_name())).collect::<Vec<_>>().join(", "))
}

fn read_case(r: &Reader) -> CaseFile {
    let gravity = r.vector("gravity", "m/s2").or(CaseFile::default_gravity(r.dimension));
    let weightless = gravity.iter().all(|g| *g == 0.0);
    let scheme = r.section("scheme", |r| read_scheme(r, weightless));
    let time = r.section("time", |r| read_time(r, &scheme));
    CaseFile {
        name: r.name("name").required(),
        description: r.text("description", "what the case shows").or(String::new()),
        dimension: r.dimension,
        spacing: r.number("spacing", Range::Positive, "m").required(),
        gravity,
        seed: r.whole("seed", 0, i64::MAX).or(0).unsigned_abs(),
        fluid: r.section("fluid", read_fluid),
        tank: r.optional_section("tank", read_tank),
        motion: r.optional_section("motion", read_motion).flatten(),
        boxes: r.sections("box", |r| SolidBox {
            name: r.name("name").or(r.numbered("box")),
            min: r.vector("min", "m").required(),
            max: r.vector("max", "m").required(),
        }),
        bodies: r.sections("body", read_body),
        exact: r.optional_section("exact", read_exact),
        scheme,
        output: r.section("output", |r| read_output(r, time.until)),
        time,
        probes: r.sections("probe", read_probe),
        references: r.sections("reference", read_reference),
        profile: r.optional_section("profile", |r| Profile {
            name: r.name("name").required(),
            source: r.text("source", "a citation").required(),
            file: r.text("file", "the name of a data file").optional(),
            time_column: r.text("time_column", "the title of a column").required(),
            x_column: r.text("x_column", "the title of a column").required(),
            height_column: r.text("height_column", "the title of a column").required(),
            delay: r.number("delay", Range::Any, "s").or(0.0),
            size: r.number("size", Range::Positive, "m").required(),
        }),
        arrivals: r.sections("arrival", |r| Arrival {
            quantity: r.name("quantity").required(),
            level: r.number("level", Range::Any, "the quantity's SI unit").required(),
            expected_time: r.number("expected_time", Range::Positive, "s").optional(),
            reference: r.name("reference").optional(),
            source: r.text("source", "a citation").required(),
        }),
    }
}

fn read_fluid(r: &Reader) -> Fluid {
    Fluid {
        density: r.number("density", Range::Positive, "kg/m3").or(Fluid::DENSITY),
        kinematic_viscosity: r
            .number("kinematic_viscosity", Range::NotNegative, "m2/s")
            .or(Fluid::KINEMATIC_VISCOSITY),
        blocks: r.sections("block", |r| FluidBlock {
            min: r.vector("min", "m").required(),
            max: r.vector("max", "m").required(),
            shape: r.variant("shape").or(BlockForm::default()),
            velocity: r.vector("velocity", "m/s").or(vec![0.0; r.dimension]),
            rotation: r.number("rotation", Range::Any, "rad/s").or(0.0),
        }),
    }
}

fn read_body(r: &Reader) -> Body {
    const SHAPES: [&str; 4] = ["box", "sphere", "cylinder", "stl"];
    let shape = r.field("shape", format!("one of {SHAPES:?}"), SHAPES[0], |item| {
        SHAPES.into_iter().find(|&shape| item.as_str() == Some(shape))
    });
    let zeros = vec![0.0; r.dimension];
    let shape = match shape.or(SHAPES[0]) {
        "sphere" => BodyShape::Sphere {
            centre: r.vector("centre", "m").required(),
            radius: r.number("radius", Range::Positive, "m").required(),
        },
        "cylinder" => BodyShape::Cylinder {
            centre: r.vector("centre", "m").required(),
            radius: r.number("radius", Range::Positive, "m").required(),
            length: r.number("length", Range::Positive, "m").required(),
            along: r.variant("along").or(Axis::Z),
        },
        "stl" => read_stl(r),
        _ => BodyShape::Box { min: r.vector("min", "m").required(), max: r.vector("max", "m").required() },
    };
    let motion = r.variant("motion").or(BodyMotion::default());
    let turns = if r.dimension == 2 { 1 } else { 3 };
    let spin =
        r.field("spin", format!("a list of {turns} finite numbers in rad/s"), vec![0.0; turns], |item| {
            floats(item).filter(|spin| spin.len() == turns && spin.iter().all(|x| x.is_finite()))
        });
    let columns = 1 + r.dimension;
    let wanted = format!(
        "rows of {columns} or {} finite numbers, a time in s, a velocity in m/s and an angular one in rad/s, times ascending",
        columns + turns
    );
    let path = r.field("path", wanted, vec![], |item| {
        let rows = items(item)?.iter().map(floats).collect::<Option<Vec<_>>>()?;
        let is_row = |row: &Vec<f64>| {
            [columns, columns + turns].contains(&row.len()) && row.iter().all(|value| value.is_finite())
        };
        let ascends = rows.windows(2).all(|pair| pair[0].first() < pair[1].first());
        (!rows.is_empty() && rows.iter().all(is_row) && ascends).then_some(rows)
    });
    let path = if motion == BodyMotion::Prescribed { path.required() } else { path.or(vec![]) };
    let body = Body {
        name: r.name("name").or(r.numbered("body")),
        shape,
        immersed: r.flag("immersed").or(false),
        mass: r.number("mass", Range::Positive, "kg").optional(),
        density: r.number("density", Range::Positive, "kg/m3").optional(),
        motion,
        axis: r.variant("axis").or(Axis::X),
        locked: r.variant_list("locked").or(vec![]),
        velocity: r.vector("velocity", "m/s").or(zeros.clone()),
        spin: spin.or(vec![0.0; turns]),
        push: r.vector("push", "N").or(zeros),
        path,
        friction: r.section("friction", |r| BodyFriction {
            law: r.variant("law").or(Law::default()),
            coefficient: r.number("coefficient", Range::NotNegative, "").or(0.3),
            uplift: r.flag("uplift").or(true),
        }),
    };
    match (body.mass, body.density) {
        (None, None) if matches!(motion, BodyMotion::Free | BodyMotion::Sliding) => {
            r.note("mass", "is missing: give a finite number > 0 in kg, or a density in kg/m3");
        }
        (Some(_), Some(_)) => r.note("density", "stands beside a mass: leave one of them out"),
        _ => {}
    }
    body
}

fn read_stl(r: &Reader) -> BodyShape {
    let file = r.text("file", "the name of an STL file").optional();
    let mesh = r.field("mesh", "the text of an STL file".to_owned(), String::new(), |item| {
        item.as_str().map(str::to_owned)
    });
    let mesh = mesh.optional();
    let scale = r.number("scale", Range::Positive, "m").or(1.0);
    let offset = r.vector("offset", "m").or(vec![0.0; r.dimension]);
    let key = if file.is_some() { "file" } else { "mesh" };
    let bytes = match (&file, &mesh) {
        (Some(_), Some(_)) => Err("stands beside a file: leave one of them out".to_owned()),
        (Some(file), None) => {
            std::fs::read(file).map_err(|error| format!("{file:?} cannot be read ({error}): correct it"))
        }
        (None, Some(mesh)) => Ok(mesh.clone().into_bytes()),
        (None, None) => {
            Err("is missing: give the text of an STL file, or the name of one as file".to_owned())
        }
    };
    let place = Point::from_fn(|d, _| offset.get(d).copied().unwrap_or(0.0));
    let triangles = bytes.and_then(|bytes| Mesh::read(&bytes, scale, place));
    let triangles = triangles.map_err(|sentence| r.note(key, &sentence)).ok().map(Arc::new);
    BodyShape::Stl { file, mesh, scale, offset, triangles }
}

fn read_tank(r: &Reader) -> Tank {
    Tank {
        min: r.vector("min", "m").required(),
        max: r.vector("max", "m").required(),
        open: r.variant_list("open").or(Vec::new()),
        periodic: r.variant_list("periodic").or(Vec::new()),
        slip: r.variant("slip").or(Slip::default()),
    }
}

/// `None` after a problem has been noted.
fn read_motion(r: &Reader) -> Option<Motion> {
    let columns = 1 + r.dimension;
    let wanted =
        format!("rows of {columns} finite numbers, a time in s and accelerations in m/s2, times ascending");
    let table = r.field("acceleration", wanted, vec![], |item| {
        let rows = items(item)?.iter().map(floats).collect::<Option<Vec<_>>>()?;
        let is_row = |row: &Vec<f64>| row.len() == columns && row.iter().all(|value| value.is_finite());
        let ascends = rows.windows(2).all(|pair| pair[0].first() < pair[1].first());
        (!rows.is_empty() && rows.iter().all(is_row) && ascends).then_some(rows)
    });
    let sine = r.optional_section("sine", |r| Motion::Sine {
        axis: r.variant("axis").required(),
        amplitude: r.number("amplitude", Range::Any, "m").required(),
        period: r.number("period", Range::Positive, "s").required(),
    });
    match (table.optional(), sine) {
        (Some(rows), None) => Some(Motion::Acceleration(rows)),
        (None, Some(sine)) => Some(sine),
        (Some(_), Some(_)) => {
            r.note("sine", "stands beside a table of accelerations: leave one of them out");
            None
        }
        (None, None) => {
            let complaint =
                "is missing: give rows [t, ax, ...] of a time in s and accelerations in m/s2, or a sine";
            r.note("acceleration", complaint);
            None
        }
    }
}

fn read_scheme(r: &Reader, weightless: bool) -> SchemeParams {
    let kind = r.variant("kind").or(SchemeParams::default().kind);
    let default = SchemeParams::of(kind, r.dimension, weightless);
    SchemeParams {
        kind,
        kernel: r.variant("kernel").or(default.kernel),
        smoothing_ratio: r
            .number("smoothing_ratio", Range::Within(1.0, 2.0), "spacings")
            .or(default.smoothing_ratio),
        laplacian: r.variant("laplacian").or(default.laplacian),
        sound_speed: r.number("sound_speed", Range::Positive, "m/s").optional(),
        artificial_viscosity: r
            .number("artificial_viscosity", Range::Within(0.0, 1.0), "")
            .or(default.artificial_viscosity),
        velocity_smoothing: r
            .number("velocity_smoothing", Range::Within(0.0, 1.0), "")
            .or(default.velocity_smoothing),
        density_diffusion: r.variant("density_diffusion").or(default.density_diffusion),
        density_diffusion_coefficient: r
            .number("density_diffusion_coefficient", Range::Within(0.0, 1.0), "")
            .or(default.density_diffusion_coefficient),
        acoustic_damper: r.number("acoustic_damper", Range::Within(0.0, 2.0), "").or(default.acoustic_damper),
        stepping: r.variant("stepping").or(default.stepping),
        source: r.variant("source").or(default.source),
        density_relaxation: r
            .number("density_relaxation", Range::Within(0.0, 1.0), "")
            .or(default.density_relaxation),
        shifting: r.number("shifting", Range::NotNegative, "").or(default.shifting),
        clip_negative_pressure: r.flag("clip_negative_pressure").or(default.clip_negative_pressure),
        collision_distance: r
            .number("collision_distance", Range::Within(0.0, 1.0), "spacings")
            .or(default.collision_distance),
        collision_restitution: r
            .number("collision_restitution", Range::Within(0.0, 1.0), "")
            .or(default.collision_restitution),
        coupling: r.variant("coupling").or(default.coupling),
        jitter: r.number("jitter", Range::Within(0.0, 0.5), "spacings").or(default.jitter),
    }
}

fn read_time(r: &Reader, scheme: &SchemeParams) -> TimeParams {
    TimeParams {
        until: r.number("until", Range::NotNegative, "s").required(),
        step: r.number("step", Range::Positive, "s").optional(),
        courant: r.number("courant", Range::Above(0.0, 10.0), "").or(TimeParams::courant_of(scheme)),
        step_max: r.number("step_max", Range::Positive, "s").optional(),
    }
}

fn read_output(r: &Reader, until: f64) -> OutputParams {
    let default = OutputParams::for_run(until);
    OutputParams {
        particles: r.number("particles", Range::NotNegative, "s").or(default.particles),
        snapshots: r.numbers("snapshots", Range::NotNegative, "s").or(default.snapshots),
        samples: r.number("samples", Range::NotNegative, "s").or(default.samples),
        gauges: r.number("gauges", Range::NotNegative, "s").or(default.gauges),
        checkpoint: r.number("checkpoint", Range::NotNegative, "s").or(default.checkpoint),
    }
}

/// What to give for a name that is none of `known`.
fn one_of(known: &[&str], none: &str) -> String {
    if known.is_empty() { none.to_owned() } else { format!("give one of {}", known.join(", ")) }
}

fn read_probe(r: &Reader) -> Probe {
    const KINDS: [&str; 3] = ["pressure", "height", "force"];
    let kind =
        r.field("kind", format!("one of {:?}, {:?}, {:?}", KINDS[0], KINDS[1], KINDS[2]), "", |item| {
            KINDS.into_iter().find(|&kind| item.as_str() == Some(kind))
        });
    let kind = kind.required();
    let name = r.name("name").required();
    if kind == "force" {
        return Probe::Force { name, on: r.name("on").required() };
    }
    let position = r.vector("position", "m").required();
    if kind == "height" {
        return Probe::Height { name, position };
    }
    let filter = r.number("filter", Range::Positive, "s").optional();
    Probe::Pressure { name, position, filter, body: r.name("body").optional() }
}

fn read_exact(r: &Reader) -> ExactSolution {
    const SOLUTIONS: [&str; 5] = ["taylor_green", "stretching_drop", "standing_wave", "sloshing", "ritter"];
    let solution = r.field("solution", format!("one of {SOLUTIONS:?}"), SOLUTIONS[0], |item| {
        SOLUTIONS.into_iter().find(|&solution| item.as_str() == Some(solution))
    });
    match solution.required() {
        "taylor_green" => {
            ExactSolution::TaylorGreen { speed: r.number("speed", Range::Positive, "m/s").required() }
        }
        "stretching_drop" => {
            ExactSolution::StretchingDrop { rate: r.number("rate", Range::Positive, "1/s").required() }
        }
        "ritter" => ExactSolution::Ritter,
        "sloshing" => ExactSolution::Sloshing { mode: read_mode(r) },
        _ => ExactSolution::StandingWave {
            amplitude: r.number("amplitude", Range::Positive, "m").required(),
            mode: read_mode(r),
        },
    }
}

fn read_mode(r: &Reader) -> u32 {
    u32::try_from(r.whole("mode", 1, 1000).or(1)).unwrap_or(1)
}

fn read_reference(r: &Reader) -> Reference {
    let windows = r.field("windows", "a list of windows [from, until] in s".to_owned(), vec![], |item| {
        let windows = items(item)?.iter().map(floats).collect::<Option<Vec<_>>>()?;
        let is_window = |w: &Vec<f64>| matches!(w[..], [from, until] if 0.0 <= from && from < until);
        windows.iter().all(is_window).then_some(windows)
    });
    let normalise = "\"mean\", \"max\" or a number > 0 in SI units".to_owned();
    Reference {
        name: r.name("name").required(),
        source: r.text("source", "a citation").required(),
        file: r.text("file", "the name of a data file").optional(),
        quantity: r.name("quantity").required(),
        time_column: r.text("time_column", "the title of a column").required(),
        time_unit: r.number("time_unit", Range::Positive, "s").or(1.0),
        value_column: r.text("value_column", "the title of a column").required(),
        value_unit: r.number("value_unit", Range::Positive, "SI units").or(1.0),
        value_min: r.number("value_min", Range::Any, "the file's unit").optional(),
        normalise: r
            .field("normalise", normalise, Normalise::Mean, |item| match (item.as_str(), float(item)) {
                (Some("mean"), _) => Some(Normalise::Mean),
                (Some("max"), _) => Some(Normalise::Max),
                (_, Some(size)) if Range::Positive.contains(size) => Some(Normalise::By(size)),
                _ => None,
            })
            .or(Normalise::Mean),
        windows: windows.or(vec![]),
        grid: r.number("grid", Range::Positive, "s").optional(),
        shift_max: r.number("shift_max", Range::NotNegative, "s").optional(),
        mean: r.number("mean", Range::Positive, "s").optional(),
        noise: r.number("noise", Range::Positive, "s").optional(),
    }
}

/// A cuboid of the scene, with the path it was read from.
struct Cuboid<'a> {
    path: String,
    min: &'a [f64],
    max: &'a [f64],
}

impl<'a> Cuboid<'a> {
    fn new(path: impl Into<String>, min: &'a [f64], max: &'a [f64]) -> Self {
        Self { path: path.into(), min, max }
    }

    fn sides(&self) -> impl Iterator<Item = (f64, f64)> {
        self.min.iter().copied().zip(self.max.iter().copied())
    }

    fn overlaps(&self, other: &Self, tolerance: f64) -> bool {
        self.sides().zip(other.sides()).all(|((min, max), (other_min, other_max))| {
            max - other_min > tolerance && other_max - min > tolerance
        })
    }

    /// Particles that fill it with `layers` more on each side.
    fn particles(&self, spacing: f64, layers: f64) -> f64 {
        self.sides().map(|(min, max)| ((max - min) / spacing).round() + 2.0 * layers).product()
    }
}

/// The axis along which a cuboid leaves the other one, if it does, and whether at its higher end.
fn beyond(cuboid: &Cuboid, other: &Cuboid, tolerance: f64) -> Option<(usize, bool)> {
    cuboid.sides().zip(other.sides()).enumerate().find_map(|(axis, ((min, max), (low, high)))| {
        match (low - min > tolerance, max - high > tolerance) {
            (true, _) => Some((axis, false)),
            (_, true) => Some((axis, true)),
            _ => None,
        }
    })
}

/// Names of the lower and the upper side along an axis; the last axis points up.
fn side_names(axis: usize, dimension: usize) -> (&'static str, &'static str) {
    match axis {
        _ if axis + 1 == dimension => ("bottom", "top"),
        0 => ("left", "right"),
        _ => ("front", "back"),
    }
}

/// What is wrong between values that are each right by themselves.
fn prove(case: &CaseFile, problems: &mut Vec<Problem>) {
    let blocks = case.fluid.blocks.iter().enumerate();
    let boxes = case.boxes.iter().enumerate();
    let extents: Vec<[Vec<f64>; 2]> = case.bodies.iter().map(|body| body.shape.extent()).collect();
    let proof = Proof {
        case,
        tolerance: 1e-6 * case.spacing,
        blocks: blocks.map(|(i, b)| Cuboid::new(format!("fluid.block.{i}"), &b.min, &b.max)).collect(),
        boxes: boxes.map(|(i, b)| Cuboid::new(format!("box.{i}"), &b.min, &b.max)).collect(),
        bodies: extents
            .iter()
            .enumerate()
            .map(|(i, [min, max])| Cuboid::new(format!("body.{i}"), min, max))
            .collect(),
        tank: case.tank.as_ref().map(|tank| Cuboid::new("tank", &tank.min, &tank.max)),
    };
    proof.extents(problems);
    proof.places(problems);
    proof.overlaps(problems);
    proof.bodies(problems);
    proof.particles(problems);
    proof.open_sides(problems);
    proof.periodic_axes(problems);
    proof.probes(problems);
    proof.names(problems);
    proof.forces(problems);
    proof.comparisons(problems);
    proof.times(problems);
    proof.liquid(problems);
    proof.sound(problems);
    proof.motion(problems);
    proof.surfaces(problems);
}

/// The scene as far as its parts must fit together; each method notes what does not.
struct Proof<'a> {
    case: &'a CaseFile,
    /// Decimal fractions that should be equal may differ by a rounding error.
    tolerance: f64,
    blocks: Vec<Cuboid<'a>>,
    boxes: Vec<Cuboid<'a>>,
    bodies: Vec<Cuboid<'a>>,
    tank: Option<Cuboid<'a>>,
}

impl Proof<'_> {
    /// Liquid and solids.
    fn contents(&self) -> impl Iterator<Item = &Cuboid<'_>> {
        self.blocks.iter().chain(&self.boxes)
    }

    fn extents(&self, problems: &mut Vec<Problem>) {
        let spacing = self.case.spacing;
        for cuboid in self.contents().chain(&self.tank) {
            for (axis, (min, max)) in cuboid.sides().enumerate() {
                let advice = if min >= max {
                    "give max > min".to_owned()
                } else if ((max - min) / spacing).round() < 1.0 {
                    format!("no particle fits at spacing {spacing:?}, enlarge it or reduce spacing")
                } else {
                    continue;
                };
                let (low, high) = side_names(axis, self.case.dimension);
                let complaint = format!("is {max:?} where min is {min:?} ({low} to {high}): {advice}");
                problems.push(Problem::new(format!("{}.max", cuboid.path), &complaint));
                break; // one axis says enough
            }
        }
    }

    fn places(&self, problems: &mut Vec<Problem>) {
        let Some(tank) = &self.tank else { return };
        for cuboid in self.contents() {
            for (axis, ((min, max), (tank_min, tank_max))) in cuboid.sides().zip(tank.sides()).enumerate() {
                let (low, high) = side_names(axis, self.case.dimension);
                let ends = [
                    ("min", min, low, tank_min, tank_min - min),
                    ("max", max, high, tank_max, max - tank_max),
                ];
                for (end, value, side, limit, _) in ends.into_iter().filter(|end| end.4 > self.tolerance) {
                    let complaint = format!(
                        "reaches {value:?}, beyond the tank's {side} side at {limit:?}: keep it inside"
                    );
                    problems.push(Problem::new(format!("{}.{end}", cuboid.path), &complaint));
                }
            }
        }
    }

    fn bodies(&self, problems: &mut Vec<Problem>) {
        let CaseFile { spacing, scheme, dimension, tank, .. } = self.case;
        // Liquid on both sides of a thinner one would feel each other through it.
        let cells = (scheme.kernel.support() * scheme.smoothing_ratio - 1.0 - 1e-9).ceil().max(1.0);
        for (index, (cuboid, body)) in self.bodies.iter().zip(&self.case.bodies).enumerate() {
            let mut note = |key: &str, complaint: String| {
                problems.push(Problem::new(format!("body.{index}{key}"), &complaint));
            };
            if matches!(body.shape, BodyShape::Stl { .. } | BodyShape::Cylinder { .. }) && *dimension == 2 {
                note(".shape", "is one that only 3D has: use box or sphere".to_owned());
            }
            if let Some((min, max)) = cuboid.sides().find(|(min, max)| min >= max) {
                note(".max", format!("is {max:?} where min is {min:?}: give max > min"));
                continue;
            }
            let thinnest = cuboid.sides().map(|(min, max)| max - min).fold(f64::INFINITY, f64::min);
            if (thinnest / spacing).round() < cells {
                note(
                    "",
                    format!(
                        "is {thinnest:.6} m thin, less than the {cells} layers of particles that keep liquid on its \
                         sides apart: thicken it, or reduce spacing to {:.6}",
                        thinnest / cells
                    ),
                );
            }
            let beyond = self.tank.as_ref().and_then(|tank| beyond(cuboid, tank, self.tolerance));
            if let Some((axis, higher)) = beyond {
                let (low, high) = side_names(axis, *dimension);
                let side = if higher { high } else { low };
                note("", format!("reaches beyond the tank's {side} side: keep it inside"));
            }
            for other in self.boxes.iter().chain(&self.bodies[..index]) {
                if cuboid.overlaps(other, self.tolerance) {
                    note("", format!("overlaps {}: move or shrink one of them", other.path));
                }
            }
            for block in
                self.blocks.iter().filter(|block| !body.immersed && cuboid.overlaps(block, self.tolerance))
            {
                note(
                    "",
                    format!(
                        "overlaps {}: move one of them, or set immersed = true and liquid makes room",
                        block.path
                    ),
                );
            }
            if tank.as_ref().is_some_and(|tank| !tank.periodic.is_empty()) {
                note(
                    "",
                    "is in a scene that repeats itself, which no body can be: leave tank.periodic out"
                        .to_owned(),
                );
            }
            if body.motion == BodyMotion::Sliding && body.axis as usize >= *dimension {
                note(".axis", "is z, which only 3D has: use x or y".to_owned());
            }
            if self.case.boxes.iter().any(|solid| solid.name == body.name)
                || self.case.bodies[..index].iter().any(|other| other.name == body.name)
            {
                note(".name", format!("is {:?}, which another solid has: give another name", body.name));
            }
        }
    }

    fn overlaps(&self, problems: &mut Vec<Problem>) {
        for (index, cuboid) in self.contents().enumerate() {
            for other in self.contents().take(index).filter(|other| cuboid.overlaps(other, self.tolerance)) {
                let complaint = format!("overlaps {}: move or shrink one of them", other.path);
                problems.push(Problem::new(&cuboid.path, &complaint));
            }
        }
    }

    fn particles(&self, problems: &mut Vec<Problem>) {
        let spacing = self.case.spacing;
        let inside: f64 = self.contents().map(|cuboid| cuboid.particles(spacing, 0.0)).sum();
        let walls = |tank: &Cuboid| tank.particles(spacing, 3.0) - tank.particles(spacing, 0.0);
        // The maximum drops the NaN of two infinite numbers.
        let particles = inside + self.tank.as_ref().map_or(0.0, walls).max(0.0);
        if particles > MOST_PARTICLES {
            let advice = "enlarge it, or check that lengths are in m";
            let complaint = format!("of {spacing:?} m makes {particles:.1e} particles: {advice}");
            problems.push(Problem::new("spacing", &complaint));
        }
    }

    fn open_sides(&self, problems: &mut Vec<Problem>) {
        let open = self.case.tank.iter().flat_map(|tank| &tank.open);
        for side in open.filter(|side| self.case.dimension == 2 && matches!(side, Side::Front | Side::Back)) {
            let complaint =
                format!("names {}, which only 3D has: use left, right, bottom or top", side.name());
            problems.push(Problem::new("tank.open", &complaint));
        }
    }

    fn periodic_axes(&self, problems: &mut Vec<Problem>) {
        let (Some(tank), Some(cuboid)) = (&self.case.tank, &self.tank) else { return };
        let scheme = &self.case.scheme;
        // Nearer than this a particle would meet its own image, or another particle twice.
        let shortest = 2.0 * scheme.kernel.support() * scheme.smoothing_ratio * self.case.spacing;
        for axis in &tank.periodic {
            let complaint = match cuboid.sides().nth(*axis as usize) {
                None => "names z, which only 3D has: use x or y".to_owned(),
                Some((min, max)) if max - min < shortest => format!(
                    "repeats the scene every {:?} m, less than two kernel supports ({shortest:.6} m): enlarge the \
                     tank or reduce spacing",
                    max - min
                ),
                Some(_) => continue,
            };
            problems.push(Problem::new("tank.periodic", &complaint));
        }
    }

    fn probes(&self, problems: &mut Vec<Problem>) {
        for (index, probe) in self.case.probes.iter().enumerate() {
            let Some(position) = probe.position() else { continue };
            let point = Cuboid::new(format!("probe.{index}.position"), position, position);
            let beyond = |tank: &Cuboid| {
                point
                    .sides()
                    .zip(tank.sides())
                    .any(|((x, _), (min, max))| (min - x).max(x - max) > self.tolerance)
            };
            if self.tank.as_ref().is_some_and(beyond) {
                let complaint = format!("{position:?} is outside the tank: move it inside");
                problems.push(Problem::new(&point.path, &complaint));
            }
            // A sensor drawn a little below the face it sits on still measures.
            for solid in self.boxes.iter().filter(|solid| point.overlaps(solid, 0.5 * self.case.spacing)) {
                let complaint = format!("{position:?} is inside {}: move it to where liquid is", solid.path);
                problems.push(Problem::new(&point.path, &complaint));
            }
        }
    }

    fn names(&self, problems: &mut Vec<Problem>) {
        let probes = self.case.probes.iter().map(Probe::name);
        let profiles = self.case.profile.iter().map(|profile| profile.name.as_str());
        let references = self.case.references.iter().map(|reference| reference.name.as_str()).chain(profiles);
        let boxes = self.case.boxes.iter().map(|solid| solid.name.as_str());
        let indices =
            [("box", repeated(boxes)), ("probe", repeated(probes)), ("reference", repeated(references))];
        for (kind, index) in
            indices.iter().flat_map(|(kind, list)| list.iter().map(move |index| (kind, index)))
        {
            let complaint = format!("is taken by an earlier {kind}: give another name");
            problems.push(Problem::new(format!("{kind}.{index}.name"), &complaint));
        }
    }

    /// Names of solids that force probes may be on.
    fn solids(&self) -> Vec<&str> {
        let sides = Side::value_variants().iter().filter(|side| {
            let exists = self.case.dimension > 2 || !matches!(side, Side::Front | Side::Back);
            exists && self.case.tank.as_ref().is_some_and(|tank| !tank.open.contains(side))
        });
        let walls = self.case.tank.as_ref().map(|_| Probe::ALL_WALLS);
        let boxes = self.case.boxes.iter().map(|solid| solid.name.as_str());
        boxes.chain(sides.map(|side| side.name())).chain(walls).collect()
    }

    fn forces(&self, problems: &mut Vec<Problem>) {
        let solids = self.solids();
        let reserved = |name: &str| name == Probe::ALL_WALLS || Side::from_str(name, false).is_ok();
        for (index, solid) in self.case.boxes.iter().enumerate().filter(|(_, solid)| reserved(&solid.name)) {
            let complaint = format!("is {:?}, which names walls of the tank: give another name", solid.name);
            problems.push(Problem::new(format!("box.{index}.name"), &complaint));
        }
        let bodies: Vec<_> = self.case.bodies.iter().map(|body| body.name.as_str()).collect();
        for (index, probe) in self.case.probes.iter().enumerate() {
            if let Some(body) = probe.rides_on().filter(|name| !name.is_empty() && !bodies.contains(name)) {
                let advice = one_of(&bodies, "there is none, leave the key out");
                let complaint = format!("is {body:?}, which is no body of this case: {advice}");
                problems.push(Problem::new(format!("probe.{index}.body"), &complaint));
            }
            let Probe::Force { on, .. } = probe else { continue };
            if !on.is_empty() && !solids.contains(&on.as_str()) {
                let advice = one_of(&solids, "there is no box and no tank, leave the probe out");
                let complaint = format!("is {on:?}, which is no solid of this case: {advice}");
                problems.push(Problem::new(format!("probe.{index}.on"), &complaint));
            }
        }
    }

    /// Whether a run records what references and arrivals ask for, and whether those fit together.
    fn comparisons(&self, problems: &mut Vec<Problem>) {
        let CaseFile { references, arrivals, probes, dimension, .. } = self.case;
        let history = quantities::history::<2>().map(|(name, _)| name.to_owned());
        let columns: Vec<String> =
            history.into_iter().chain(probes.iter().flat_map(|probe| probe.columns(*dimension))).collect();
        let columns = [columns, bodies::force_columns(self.case), bodies::columns(self.case)].concat();
        let asked = references.iter().map(|reference| &reference.quantity).enumerate();
        let watched = arrivals.iter().map(|arrival| &arrival.quantity).enumerate();
        let all = asked.map(|(i, q)| ("reference", i, q)).chain(watched.map(|(i, q)| ("arrival", i, q)));
        for (kind, index, quantity) in all {
            let names = || columns.iter().map(String::as_str);
            if !quantity.is_empty() && table::column_of(quantity, names()).is_none() {
                let known = names().collect::<Vec<_>>().join(", ");
                let complaint =
                    format!("is {quantity:?}, which no run of this case records: use one of {known}");
                problems.push(Problem::new(format!("{kind}.{index}.quantity"), &complaint));
            }
        }
        for (index, reference) in references.iter().enumerate() {
            if reference.grid.is_none() && (reference.mean.is_some() || reference.noise.is_some()) {
                let complaint = "is missing, and mean and noise need it: give a step in s like 0.001";
                problems.push(Problem::new(format!("reference.{index}.grid"), complaint));
            }
        }
        for (index, arrival) in arrivals.iter().enumerate() {
            let path = |key: &str| format!("arrival.{index}.{key}");
            match (&arrival.reference, arrival.expected_time) {
                (None, None) => {
                    let complaint = "is missing: give it in s, or name a reference whose data tell it";
                    problems.push(Problem::new(path("expected_time"), complaint));
                }
                (Some(name), _) if !references.iter().any(|reference| reference.name == *name) => {
                    let complaint = format!("is {name:?}: give the name of a reference of this case");
                    problems.push(Problem::new(path("reference"), &complaint));
                }
                _ => {}
            }
        }
    }

    fn times(&self, problems: &mut Vec<Problem>) {
        let until = self.case.time.until;
        for time in self.case.output.snapshots.iter().filter(|&&time| time > until) {
            let advice = "leave it out or raise time.until";
            let complaint = format!("names {time:?} s, after the end at {until:?} s: {advice}");
            problems.push(Problem::new("output.snapshots", &complaint));
        }
    }

    fn liquid(&self, problems: &mut Vec<Problem>) {
        let is_dry = self.blocks.is_empty()
            && self.bodies.is_empty()
            && self.case.scheme.kind != SchemeKind::PatchTest;
        let is_noted = problems.iter().any(|problem| is_within(&problem.path, "fluid.block"));
        if is_dry && !is_noted {
            let complaint = "is missing: give at least one [[fluid.block]] with min and max";
            problems.push(Problem::new("fluid.block", complaint));
        }
    }
}

impl Proof<'_> {
    /// An axis that exists, and a tank that moves where the solution needs one.
    fn motion(&self, problems: &mut Vec<Problem>) {
        match (&self.case.motion, &self.case.exact) {
            (Some(Motion::Sine { axis, .. }), _) if *axis as usize >= self.case.dimension => {
                let complaint = "is z, which only 3D has: use x or y";
                problems.push(Problem::new("motion.sine.axis", complaint));
            }
            (None, Some(ExactSolution::Sloshing { .. }))
                if !problems.iter().any(|p| is_within(&p.path, "motion")) =>
            {
                let complaint = "is missing, and nothing sloshes without it: give acceleration or sine";
                problems.push(Problem::new("motion", complaint));
            }
            (_, Some(ExactSolution::Sloshing { mode })) if mode % 2 == 0 => {
                let complaint = format!("is {mode}: give an odd number, shaking excites no even mode");
                problems.push(Problem::new("exact.mode", &complaint));
            }
            _ => {}
        }
    }

    fn surfaces(&self, problems: &mut Vec<Problem>) {
        if self.case.profile.is_some() && self.case.dimension > 2 {
            let complaint = "is a line, which only 2D has for a surface: leave it out";
            problems.push(Problem::new("profile", complaint));
        }
        if self.case.exact == Some(ExactSolution::Ritter) && self.case.dimension > 2 {
            let complaint = "is \"ritter\", which is known in 2D: set dimension = 2";
            problems.push(Problem::new("exact.solution", complaint));
        }
    }

    /// A speed of sound follows from a fall or from a first motion.
    fn sound(&self, problems: &mut Vec<Problem>) {
        let compressible = matches!(self.case.scheme.kind, SchemeKind::Wcsph | SchemeKind::WcsphMonaghan);
        let motion = |block: &FluidBlock| block.velocity.iter().any(|v| *v != 0.0) || block.rotation != 0.0;
        let falls = self.case.gravity.iter().any(|g| *g != 0.0);
        let moves = self.case.exact.is_some() || self.case.fluid.blocks.iter().any(motion);
        if compressible && !falls && !moves && self.case.scheme.sound_speed.is_none() {
            let complaint =
                "is missing: nothing moves or falls here that it could follow from, give it in m/s";
            problems.push(Problem::new("scheme.sound_speed", complaint));
        }
    }
}

/// Indices of names that an earlier entry has; empty names stand in for bad ones and do not count.
fn repeated<'a>(names: impl Iterator<Item = &'a str>) -> Vec<usize> {
    let names: Vec<_> = names.collect();
    (0..names.len())
        .filter(|&index| !names[index].is_empty() && names[..index].contains(&names[index]))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::{KernelKind, LaplacianKind, builtin};

    const SMALL: &str = r#"
name = "small"
dimension = 2
spacing = 0.1
[[fluid.block]]
min = [0, 0]
max = [1, 1]
[tank]
min = [0, 0]
max = [2, 2]
[time]
until = 1
"#;

    fn pairs(sets: &[(&str, &str)]) -> Vec<(String, String)> {
        sets.iter().map(|&(key, value)| (key.to_owned(), value.to_owned())).collect()
    }

    fn small(sets: &[(&str, &str)]) -> CaseFile {
        read(SMALL, "small.toml", &pairs(sets)).unwrap()
    }

    fn problems(text: &str, sets: &[(&str, &str)]) -> Vec<String> {
        let error = read(text, "my.toml", &pairs(sets)).unwrap_err();
        assert!(matches!(error, Error::Input(_)));
        error.to_string().lines().map(str::to_owned).collect()
    }

    /// The only problem of the small case with overrides.
    fn problem(sets: &[(&str, &str)]) -> String {
        let found = problems(SMALL, sets);
        assert_eq!(found.len(), 1, "{found:#?}");
        found[0].clone()
    }

    #[test]
    fn variants_of_built_in_cases_read_with_every_scheme() {
        for (name, text) in builtin::names().map(|name| (name, builtin::find(name).unwrap())) {
            let document = Document::parse(text).unwrap();
            let variants = document.get("variant").and_then(Item::as_table_like);
            for (variant, _) in variants.into_iter().flat_map(TableLike::iter) {
                for kind in SchemeKind::value_variants() {
                    let sets = [("scheme.kind".to_owned(), kind.name())];
                    read_variant(text, name, Some(variant), &sets).unwrap();
                }
            }
        }
    }

    #[test]
    fn built_in_cases_read_and_survive_a_round_trip() {
        for name in builtin::names() {
            let case = read(builtin::find(name).unwrap(), name, &[]).unwrap();
            assert_eq!(case.name, name);
            assert!(!case.description.is_empty());
            let text = write(&case, "line one\nline two")
                + "\n[run]\nversion = \"0\"\noptions = [\"-ksp_type\", \"cg\"]\n";
            assert!(text.starts_with("# line one\n# line two\n"));
            assert_eq!(read(&text, "run.toml", &[]).unwrap(), case, "{text}");
        }
    }

    #[test]
    fn every_field_survives_a_round_trip() {
        let mut case = small(&[("seed", "9223372036854775807"), ("gravity", "[0.5, -1e-300]")]);
        case.description = "quotes \" and umlauts \u{fc}".to_owned();
        case.tank.as_mut().unwrap().open = vec![Side::Left, Side::Right, Side::Bottom, Side::Top];
        case.tank.as_mut().unwrap().slip = Slip::None;
        case.boxes =
            vec![SolidBox { name: "pier".to_owned(), min: vec![1.5, 0.0], max: vec![1.7, 1.0 / 3.0] }];
        case.fluid.blocks[0].velocity = vec![1e22, -0.1];
        case.time.step = Some(1.0 / 3.0);
        case.time.step_max = Some(f64::MIN_POSITIVE);
        case.output.snapshots = vec![0.1 + 0.2, 0.0];
        case.probes = vec![
            Probe::Pressure {
                name: "p1".to_owned(),
                position: vec![0.0, 0.1],
                filter: Some(0.01),
                body: case.bodies.first().map(|body| body.name.clone()),
            },
            Probe::Force { name: "f".to_owned(), on: "pier".to_owned() },
            Probe::Height { name: "h1".to_owned(), position: vec![1.0, 0.0] },
        ];
        let reference = |name: &str, normalise| Reference {
            name: name.to_owned(),
            source: "s".to_owned(),
            file: Some("data.csv".to_owned()),
            quantity: "p1".to_owned(),
            time_column: "t".to_owned(),
            time_unit: 2.0,
            value_column: "p".to_owned(),
            value_unit: 3.0,
            value_min: Some(-1.0),
            normalise,
            windows: vec![vec![0.35, 2.0], vec![0.0, 5.0]],
            grid: Some(0.001),
            shift_max: Some(0.03),
            mean: Some(0.01),
            noise: Some(0.02),
        };
        case.references = vec![
            reference("a", Normalise::Max),
            reference("b", Normalise::By(0.55)),
            reference("c", Normalise::Mean),
        ];
        case.arrivals = vec![Arrival {
            quantity: "f_y".to_owned(),
            level: 1.0,
            expected_time: None,
            reference: Some("b".to_owned()),
            source: "s".to_owned(),
        }];
        for kernel in KernelKind::value_variants() {
            for laplacian in LaplacianKind::value_variants() {
                for kind in SchemeKind::value_variants() {
                    case.scheme = SchemeParams {
                        kind: *kind,
                        kernel: *kernel,
                        laplacian: *laplacian,
                        jitter: 0.3,
                        ..SchemeParams::default()
                    };
                    assert_eq!(read(&write(&case, ""), "run.toml", &[]).unwrap(), case);
                }
            }
        }
    }

    #[test]
    fn defaults_fill_what_is_left_out() {
        let case = small(&[]);
        assert_eq!(case.gravity, [0.0, -9.81]);
        assert_eq!((case.fluid.density, case.fluid.kinematic_viscosity), (1000.0, 1e-6));
        assert_eq!(case.fluid.blocks[0].velocity, [0.0, 0.0]);
        assert_eq!(case.scheme, SchemeParams::default());
        let smoothing_ratio = |kind: &str, gravity: &str| {
            small(&[("scheme.kind", kind), ("gravity", gravity)]).scheme.smoothing_ratio
        };
        assert_eq!(smoothing_ratio("isph_di", "[0.0, -9.81]"), 1.2);
        assert_eq!(smoothing_ratio("isph_di", "[0.0, 0.0]"), 2.0);
        assert_eq!(smoothing_ratio("isph_df", "[0.0, 0.0]"), 1.2);
        assert_eq!(case.time, TimeParams { until: 1.0, step: None, courant: 0.35, step_max: None });
        assert_eq!(case.output, OutputParams::for_run(1.0));
        assert_eq!(case.output.particles, 1.0 / 80.0);
        assert_eq!((case.seed, case.tank.unwrap().slip), (0, Slip::Free));
    }

    #[test]
    fn overrides_reach_every_kind_of_key() {
        let case = small(&[
            ("spacing", "5e-2"),
            ("fluid.block.0.max", "[0.5, 0.25]"),
            ("fluid.block.0.max.1", "0.75"),
            ("scheme.kernel", "quintic"),
            ("scheme.clip_negative_pressure", "true"),
            ("tank.open", "[\"top\"]"),
            ("name", "other"),
            ("time.step", "1"),
        ]);
        assert_eq!(case.spacing, 0.05);
        assert_eq!(case.fluid.blocks[0].max, [0.5, 0.75]);
        assert_eq!(case.scheme.kernel, KernelKind::Quintic);
        assert!(case.scheme.clip_negative_pressure);
        assert_eq!(case.tank.unwrap().open, [Side::Top]);
        assert_eq!((case.name.as_str(), case.time.step), ("other", Some(1.0)));
    }

    #[test]
    fn a_variant_changes_keys_by_scheme_and_the_user_has_the_last_word() {
        let text = format!(
            "{SMALL}\n[variant.fine]\nspacing = 0.05\ntime.step = 1e-3\n[variant.fine.wcsph]\ntime.step = 1e-4\n"
        );
        let read =
            |sets: &[(&str, &str)]| read_variant(&text, "my.toml", Some("fine"), &pairs(sets)).unwrap();
        let found = |case: CaseFile| (case.spacing, case.time.step);
        assert_eq!(found(read(&[])), (0.05, Some(1e-3)));
        assert_eq!(found(read(&[("scheme.kind", "wcsph")])), (0.05, Some(1e-4)));
        assert_eq!(found(read(&[("scheme.kind", "wcsph"), ("time.step", "2e-4")])), (0.05, Some(2e-4)));
        assert_eq!(found(super::read(&text, "my.toml", &[]).unwrap()), (0.1, None));
        let sentence = |name| read_variant(&text, "my.toml", Some(name), &[]).unwrap_err().to_string();
        assert_eq!(sentence("fin"), "--variant fin: my.toml has no such variant: did you mean fine?");
        let text = text.replace("1e-3", "-1");
        assert_eq!(
            read_variant(&text, "my.toml", Some("fine"), &[]).unwrap_err().to_string(),
            "--variant fine: time.step is -1: give a finite number > 0 in s"
        );
    }

    #[test]
    fn a_motion_is_proven() {
        let rows = "[[0, 0, 0], [1, 0.5, 0]]";
        let table = small(&[("motion.acceleration", rows)]);
        assert_eq!(table.motion, Some(Motion::Acceleration(vec![vec![0.0; 3], vec![1.0, 0.5, 0.0]])));
        let sine = "{axis = 'x', amplitude = 0.1, period = 2}";
        for case in [table, small(&[("motion.sine", sine)])] {
            assert_eq!(super::read(&write(&case, ""), "run.toml", &[]).unwrap(), case);
        }
        for (sets, wanted) in [
            (
                &[("motion.acceleration", "[[1, 0, 0], [0, 0, 0]]")][..],
                "motion.acceleration is [[1, 0, 0], [0, 0, 0]]: give rows of 3 finite numbers",
            ),
            (&[("motion.acceleration", "[[1, 0]]")], "give rows of 3 finite numbers"),
            (&[("motion", "{}")], "motion.acceleration is missing: give rows"),
            (&[("motion.acceleration", rows), ("motion.sine", sine)], "motion.sine stands beside a table"),
            (
                &[("motion.sine", "{axis = 'z', amplitude = 0.1, period = 2}")],
                "motion.sine.axis is z, which only 3D has",
            ),
            (&[("exact", "{solution = 'sloshing'}")], "motion is missing, and nothing sloshes without it"),
            (
                &[("exact", "{solution = 'sloshing', mode = 2}"), ("motion.sine", sine)],
                "exact.mode is 2: give an odd number",
            ),
        ] {
            let found = problem(sets);
            assert!(found.contains(wanted), "{found}");
        }
    }

    #[test]
    fn a_bad_override_is_named_by_its_key() {
        for (key, value, wanted) in [
            ("spacing", "-1", "--set spacing: spacing is -1: give a finite number > 0 in m"),
            ("spacing", "wide", "--set spacing: spacing is \"wide\": give a finite number > 0 in m"),
            ("spacng", "1", "--set spacng: spacng is no key of a case file: did you mean spacing?"),
            ("spacing.x", "1", "--set spacing.x: spacing is a single value: leave out .x"),
            (
                "fluid.block.1.max",
                "1",
                "--set fluid.block.1.max: there is no fluid.block.1: give the number of an entry of fluid.block, from 0",
            ),
            (
                "fluid.block.0.max.1",
                "nan",
                "--set fluid.block.0.max.1: fluid.block.0.max is [1, NaN]: give a list of 2 finite numbers in m",
            ),
            (
                "fluid.block.0.max.1",
                "3",
                "--set fluid.block.0.max.1: fluid.block.0.max reaches 3.0, beyond the tank's top side at 2.0: keep it inside",
            ),
            (
                "fluid..density",
                "1",
                "--set fluid..density: \"fluid..density\" is no key: write it like fluid.density",
            ),
            (
                "new.key",
                "1",
                "--set new.key: new is no key of a case file: use one of dimension, gravity, scheme, time, name, description, \
                 spacing, seed, fluid, tank, motion, box, body, exact, output, probe, reference, profile, arrival, \
                 variant, run",
            ),
            ("fluid", "1", "--set fluid: fluid is 1: write it as one table [fluid]"),
        ] {
            let found = problems(SMALL, &[(key, value)]);
            assert_eq!(found[0], wanted);
        }
    }

    #[test]
    fn all_problems_come_in_one_answer_with_their_lines() {
        let text = "\
name = \"a b\"
dimension = 2
[fluid]
kinematic_viscosity = nan
densty = 1000.0
[[fluid.block]]
min = [0.0, 0.0]
max = [0.2, 0.4, 0.6]
[tank]
min = [0, 0]
[time]
until = -1.0
[scheme]
kernel = \"wendland\"
";
        assert_eq!(
            problems(text, &[]),
            [
                "my.toml: spacing is missing: give a finite number > 0 in m",
                "my.toml:1: name is \"a b\": give a name of letters, digits, - and _ in quotes",
                "my.toml:4: fluid.kinematic_viscosity is NaN: give a finite number >= 0 in m2/s",
                "my.toml:5: fluid.densty is no key of a case file: did you mean fluid.density?",
                "my.toml:8: fluid.block.0.max is [0.2, 0.4, 0.6]: give a list of 2 finite numbers in m",
                "my.toml:9: tank.max is missing: give a list of 2 finite numbers in m",
                "my.toml:12: time.until is -1.0: give a finite number >= 0 in s",
                "my.toml:14: scheme.kernel is \"wendland\": give one of \"wendland_c2\", \"cubic_spline\", \"quintic\"",
            ]
        );
    }

    #[test]
    fn geometry_is_proven() {
        for (sets, wanted) in [
            (
                &[("fluid.block.0.max", "[1, 0]")][..],
                "fluid.block.0.max is 0.0 where min is 0.0 (bottom to top): give max > min",
            ),
            (
                &[("fluid.block.0.min", "[0.96, 0]")],
                "(left to right): no particle fits at spacing 0.1, enlarge it or reduce spacing",
            ),
            (&[("fluid.block.0.min", "[-0.1, 0]")], "beyond the tank's left side at 0.0"),
            (&[("box", "[{min = [0.9, 0], max = [1.2, 0.2]}]")], "box.0 overlaps fluid.block.0"),
            (
                &[("box", "[{min = [1.9, 0], max = [2.2, 0.2]}]")],
                "box.0.max reaches 2.2, beyond the tank's right side",
            ),
            (&[("fluid.block", "[]")], "fluid.block is missing"),
            (&[("spacing", "1e-9")], "particles: enlarge it"),
            (&[("spacing", "5e-324")], "particles: enlarge it"),
            (&[("tank.open", "[\"front\"]")], "tank.open names front, which only 3D has"),
            (
                &[("probe", "[{kind = 'height', name = 'h', position = [3, 0]}]")],
                "probe.0.position [3.0, 0.0] is outside the tank",
            ),
            (
                &[("probe", "[{kind = 'force', name = 'f', on = 'top'}]"), ("tank.open", "['top']")],
                "probe.0.on is \"top\", which is no solid of this case: give one of left, right, bottom, walls",
            ),
            (
                &[("probe", "[{kind = 'pressure', name = 'p', position = [0, 0], body = 'raft'}]")],
                "probe.0.body is \"raft\", which is no body of this case: there is none, leave the key out",
            ),
            (
                &[("probe", "[{kind = 'pressure', name = 'p', position = [0, 0], filter = -1}]")],
                "probe.0.filter is -1: give a finite number > 0 in s",
            ),
            (
                &[("box", "[{name = 'left', min = [1.5, 0], max = [1.7, 0.2]}]")],
                "box.0.name is \"left\", which names walls of the tank",
            ),
            (
                &[("arrival", "[{quantity = 'front', level = 1, source = 's'}]")],
                "arrival.0.expected_time is missing: give it in s, or name a reference",
            ),
            (
                &[("arrival", "[{quantity = 'frnt', level = 1, source = 's', expected_time = 1}]")],
                "arrival.0.quantity is \"frnt\", which no run of this case records: use one of front_m,",
            ),
            (
                &[(
                    "reference",
                    "[{name = 'r', source = 's', quantity = 'front', time_column = 't', value_column = 'x', windows = [[2, 1]]}]",
                )],
                "reference.0.windows is [[2, 1]]: give a list of windows [from, until] in s",
            ),
            (&[("output.snapshots", "[0.5, 2]")], "names 2.0 s, after the end at 1.0 s"),
            (&[("scheme.smoothing_ratio", "0.9")], "give a number from 1 to 2 in spacings"),
            (&[("dimension", "4")], "dimension is 4: give a whole number from 2 to 3"),
        ] {
            let found = problem(sets);
            assert!(found.contains(wanted), "{found}");
        }
        // Touching, and a snapped length, are fine.
        small(&[("box", "[{min = [1, 0], max = [1.2, 0.2]}]"), ("fluid.block.0.max", "[0.97, 1]")]);
    }

    #[test]
    fn names_of_probes_differ() {
        let text = format!(
            "{SMALL}\n[[probe]]\nkind = \"height\"\nname = \"h\"\nposition = [1, 0]\n[[probe]]\nkind = \"pressure\"\nname = \"h\"\nposition = [0, 0]\n"
        );
        assert_eq!(
            problems(&text, &[]),
            ["my.toml:20: probe.1.name is taken by an earlier probe: give another name"]
        );
    }

    #[test]
    fn broken_toml_is_one_sentence_with_a_line() {
        for text in
            ["name = \"x\"\nspacing = \n", "name = \"x\"\nname = \"y\"\n", "a = 1\n[b\n", "a = 1\n\u{7}"]
        {
            let found = problems(text, &[]);
            assert_eq!(found.len(), 1, "{found:?}");
            assert!(found[0].starts_with("my.toml:2: not valid TOML: "), "{found:?}");
        }
    }
}
