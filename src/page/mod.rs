//! One HTML page of a run, a study or a solver laboratory, which needs no network and no other file.
//!
//! What is shown is gathered here as data (`Page`); `assets/page.js` makes the page of it, and uPlot (MIT, its licence
//! beside it) draws the plots. All text from files travels as JSON without a `<` and is shown as text, never as HTML.

mod lab;
mod movie;
mod plots;
mod recorded;
mod sheet;
mod study;

use std::fs;
use std::io::Write as _;
use std::path::Path;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD as BASE64;
use serde::Serialize;
use serde_json::Value;

use crate::cli::{self, ReportArgs};
use crate::output::write_atomic;
use crate::{Error, Result};
use movie::Movie;
use plots::Plot;

/// The page's name in the folder.
const FILE: &str = "report.html";
/// Tells a page of this program from a file of somebody else.
const GENERATOR: &str = r#"<meta name="generator" content="sphpetsc">"#;
/// Pictures shown at most: each has some 100 kB.
const PICTURES: usize = 12;

/// Everything the page shows, from top to bottom.
#[derive(Debug, Serialize)]
struct Page {
    title: String,
    description: String,
    /// Whether all went as asked, and how it ended.
    good: bool,
    ended: String,
    /// Key figures: name and value.
    figures: Vec<(String, String)>,
    sections: Vec<Section>,
    written_by: String,
}

/// A heading with what stands below it.
#[derive(Debug, Serialize)]
struct Section {
    heading: String,
    notes: Vec<String>,
    parts: Vec<Part>,
}

#[derive(Debug, Serialize)]
#[serde(tag = "part", rename_all = "snake_case")]
enum Part {
    Table(Table),
    Plots {
        plots: Vec<Plot>,
    },
    Pictures {
        pictures: Vec<Picture>,
    },
    Movie {
        movie: Box<Movie>,
    },
    /// A text that opens on demand.
    Text {
        summary: String,
        text: String,
    },
}

/// Cells are numbers, words, or null where there is nothing.
#[derive(Debug, Serialize)]
struct Table {
    head: Vec<String>,
    rows: Vec<Vec<Value>>,
    /// Column drawn as bars too.
    bars: Option<usize>,
    /// Page that a row's last cell leads to.
    links: Vec<Option<String>>,
}

#[derive(Debug, Serialize)]
struct Picture {
    name: String,
    png: String,
}

/// Writes the page of the folder of a run, a study or a laboratory into it.
///
/// # Errors
/// [`Error::Input`] for a folder of neither and for files that are damaged, before anything is written.
pub fn write(args: &ReportArgs) -> Result<()> {
    let folder = &args.folder;
    let page = match () {
        () if !folder.is_dir() => {
            return Err(Error::Input(format!(
                "there is no folder {}: name that of a run, a study or a solver laboratory, like out/dam_break_2d",
                folder.display()
            )));
        }
        () if folder.join("study.csv").is_file() => study::page(folder)?,
        () if folder.join("solvers.csv").is_file() => lab::page(folder)?,
        () if folder.join("summary.json").is_file() => recorded::page(folder)?,
        () => {
            return Err(Error::Input(format!(
                "{} has none of summary.json, study.csv and solvers.csv: name the folder of a run that has ended, of a study or of a solver laboratory",
                folder.display()
            )));
        }
    };
    let path = folder.join(FILE);
    prove_ours(&path)?;
    let html = html(&page);
    write_atomic(&path, |file| file.write_all(html.as_bytes()))?;
    let size = html.len() as f64 / 1e6;
    if args.quiet { Ok(()) } else { cli::print(&format!("{}, {size:.1} MB\n", path.display())) }
}

/// A page of ours may be replaced, nothing else.
fn prove_ours(path: &Path) -> Result<()> {
    match fs::read(path) {
        Ok(text) if !text.windows(GENERATOR.len()).any(|part| part == GENERATOR.as_bytes()) => {
            Err(Error::Input(format!(
                "{} is no page of this program: move it away, it will not be replaced",
                path.display()
            )))
        }
        _ => Ok(()),
    }
}

fn html(page: &Page) -> String {
    let data = serde_json::to_string(page).expect("a page has no maps with keys that are no text");
    // Inside JSON strings only; so no text can end the script.
    let data = data.replace('<', "\\u003c");
    let title = page.title.replace('&', "&amp;").replace('<', "&lt;");
    let parts = [
        ("{title}", title.as_str()),
        ("{generator}", GENERATOR),
        ("{uplot.css}", include_str!("assets/uPlot.min.css")),
        ("{page.css}", include_str!("assets/page.css")),
        ("{uplot.js}", include_str!("assets/uPlot.iife.min.js")),
        ("{player.js}", include_str!("assets/player.js")),
        ("{page.js}", include_str!("assets/page.js")),
        ("{data}", &data),
    ];
    // In the order of the template, each once: what is put in is not searched again.
    let mut rest = include_str!("assets/page.html");
    let mut text = String::new();
    for (name, part) in parts {
        let (before, after) = rest.split_once(name).expect("the template has all parts in order");
        text += before;
        text += part;
        rest = after;
    }
    text + rest
}

/// Reads a JSON file of a run.
fn read_json(path: &Path) -> Result<Value> {
    let text = fs::read(path).map_err(|error| Error::unreadable(path, &error))?;
    serde_json::from_slice(&text).map_err(|error| Error::unreadable(path, &error))
}

/// The picture files named; of many, as many as a page bears.
fn pictures(heading: &str, files: &[std::path::PathBuf]) -> Result<Option<Section>> {
    if files.is_empty() {
        return Ok(None);
    }
    let stride = files.len().div_ceil(PICTURES);
    let mut shown = Vec::new();
    for path in files.iter().rev().step_by(stride) {
        let bytes = fs::read(path).map_err(|error| Error::unreadable(path, &error))?;
        if !bytes.starts_with(b"\x89PNG") {
            return Err(Error::unreadable(path, &"no PNG"));
        }
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        shown.push(Picture { name, png: BASE64.encode(bytes) });
    }
    shown.reverse();
    let notes = match stride {
        1 => vec![],
        _ => vec![format!("{} of {} pictures, evenly chosen.", shown.len(), files.len())],
    };
    Ok(Some(Section { heading: heading.into(), notes, parts: vec![Part::Pictures { pictures: shown }] }))
}
