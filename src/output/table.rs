//! Tables that grow during a run: CSV with units in the header, first column `time_s`.

use std::fmt::{self, Write as _};
use std::fs::{self, File, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use super::folder::write_atomic;
use crate::{Error, Result};

/// How long a row may wait in memory.
const FLUSH_INTERVAL: Duration = Duration::from_secs(2);
/// How many bytes of rows may wait in memory.
const FLUSH_SIZE: usize = 1 << 16;

/// One entry of a row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Cell<'a> {
    /// A number, printed with the fewest digits that read back as the same double.
    Number(f64),
    /// A count.
    Count(u64),
    /// A word, also where there is nothing to measure: a dry gauge says `dry`, not 0.
    Word(&'a str),
}

impl fmt::Display for Cell<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            // `{:?}` is the shortest text that reads back exactly, with an exponent where that is shorter.
            Self::Number(value) => write!(f, "{value:?}"),
            Self::Count(value) => write!(f, "{value}"),
            // Quoted where it would read as several cells (RFC 4180).
            Self::Word(value) if value.contains([',', '"']) => {
                write!(f, "\"{}\"", value.replace('"', "\"\""))
            }
            Self::Word(value) => f.write_str(value),
        }
    }
}

impl From<f64> for Cell<'_> {
    fn from(value: f64) -> Self {
        Self::Number(value)
    }
}

impl From<u64> for Cell<'_> {
    fn from(value: u64) -> Self {
        Self::Count(value)
    }
}

impl From<usize> for Cell<'_> {
    fn from(value: usize) -> Self {
        Self::Count(value as u64)
    }
}

impl<'a> From<&'a str> for Cell<'a> {
    fn from(value: &'a str) -> Self {
        Self::Word(value)
    }
}

/// Units that columns of a run end with.
const UNITS: [&str; 5] = ["m", "m_per_s", "j", "pa", "n"];

/// The column that records a quantity: of its name, or of its name and a unit.
pub fn column_of<'a>(quantity: &str, columns: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let names = |column: &&str| {
        let unit = column.strip_prefix(quantity).and_then(|rest| rest.strip_prefix('_'));
        *column == quantity || unit.is_some_and(|unit| UNITS.contains(&unit))
    };
    columns.into_iter().find(names)
}

/// A CSV file that only ever grows by whole rows.
#[derive(Debug)]
pub struct Table {
    path: PathBuf,
    file: File,
    columns: usize,
    pending: String,
    flushed: Instant,
}

impl Table {
    /// Starts a table with these columns, named with their units (`time_s`, `front_m`, ...).
    pub fn create(path: &Path, columns: &[impl AsRef<str>]) -> Result<Self> {
        Self::start(path, columns, "")
    }

    /// Continues a table after the rows up to `time` in s; later ones and a torn last one are dropped.
    ///
    /// A table that does not exist is started.
    pub fn resume(path: &Path, columns: &[impl AsRef<str>], time: f64) -> Result<Self> {
        if !path.exists() {
            return Self::create(path, columns);
        }
        let text = fs::read_to_string(path).map_err(|error| Error::io(path, error))?;
        let mut lines = text.split_inclusive('\n').filter(|line| line.ends_with('\n'));
        if lines.next() != Some(&header(columns)?) {
            return Err(Error::Input(format!(
                "{} has other columns than this run writes: resume with the case it was written by",
                path.display()
            )));
        }
        let is_kept = |line: &&str| {
            let first = line.split([',', '\n']).next();
            first.and_then(|cell| cell.parse::<f64>().ok()).is_some_and(|row_time| row_time <= time)
        };
        Self::start(path, columns, &lines.filter(is_kept).collect::<String>())
    }

    /// Adds a row, with one cell for each column.
    pub fn row(&mut self, cells: &[Cell]) -> Result<()> {
        assert_eq!(
            cells.len(),
            self.columns,
            "a row of {} has as many cells as columns",
            self.path.display()
        );
        for (column, cell) in cells.iter().enumerate() {
            let separator = if column == 0 { "" } else { "," };
            write!(self.pending, "{separator}{cell}").expect("writing to a string does not fail");
        }
        self.pending.push('\n');
        if self.pending.len() > FLUSH_SIZE || self.flushed.elapsed() > FLUSH_INTERVAL {
            self.flush()?;
        }
        Ok(())
    }

    /// Hands all rows to the operating system; call it at the end and before a checkpoint.
    pub fn flush(&mut self) -> Result<()> {
        let written = self.file.write_all(self.pending.as_bytes());
        // Also after an error: part of it is in the file, and a second copy would be worse.
        self.pending.clear();
        self.flushed = Instant::now();
        written.map_err(|error| Error::io(&self.path, error))
    }

    fn start(path: &Path, columns: &[impl AsRef<str>], rows: &str) -> Result<Self> {
        let header = header(columns)?;
        write_atomic(path, |file| {
            file.write_all(header.as_bytes())?;
            file.write_all(rows.as_bytes())
        })?;
        let file = OpenOptions::new().append(true).open(path).map_err(|error| Error::io(path, error))?;
        Ok(Self {
            path: path.to_owned(),
            file,
            columns: columns.len(),
            pending: String::new(),
            flushed: Instant::now(),
        })
    }
}

impl Drop for Table {
    /// Keeps the rows of a run that ends early; [`Table::flush`] is the one that reports errors.
    fn drop(&mut self) {
        let _ = self.flush();
    }
}

fn header(columns: &[impl AsRef<str>]) -> Result<String> {
    let columns: Vec<_> = columns.iter().map(AsRef::as_ref).collect();
    match columns.iter().find(|name| name.is_empty() || name.contains([',', '"', '\n', '\r'])) {
        Some(name) => {
            Err(Error::Input(format!("{name:?} cannot name a column: use letters, digits and underscores")))
        }
        None => Ok(columns.join(",") + "\n"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const COLUMNS: [&str; 3] = ["time_s", "height_m", "iterations"];

    #[test]
    fn numbers_read_back_exactly_and_dry_is_a_word() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("probes.csv");
        let values = [0.1 + 0.2, f64::MIN_POSITIVE, 1e300, -0.0, 1.0 / 3.0];
        let mut table = Table::create(&path, &COLUMNS).unwrap();
        for value in values {
            table.row(&[value.into(), "dry".into(), 7_u64.into()]).unwrap();
        }
        table.flush().unwrap();
        let text = fs::read_to_string(&path).unwrap();
        let mut lines = text.lines();
        assert_eq!(lines.next(), Some("time_s,height_m,iterations"));
        for (line, value) in lines.zip(values) {
            let cells: Vec<_> = line.split(',').collect();
            assert_eq!(cells[0].parse::<f64>().unwrap().to_bits(), value.to_bits());
            assert_eq!(cells[1..], ["dry", "7"]);
        }
    }

    #[test]
    fn resuming_drops_later_and_torn_rows() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("history.csv");
        fs::write(&path, "time_s,height_m,iterations\n0.0,1.0,1\n0.1,1.0,2\n0.2,1.0,3\n0.0").unwrap();
        let mut table = Table::resume(&path, &COLUMNS, 0.1).unwrap();
        table.row(&[0.15.into(), 2.0.into(), 4_u64.into()]).unwrap();
        drop(table);
        let expected = "time_s,height_m,iterations\n0.0,1.0,1\n0.1,1.0,2\n0.15,2.0,4\n";
        assert_eq!(fs::read_to_string(&path).unwrap(), expected);
    }

    #[test]
    fn resuming_with_other_columns_is_refused_and_leaves_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("history.csv");
        fs::write(&path, "time_s,front_m\n0.0,1.0\n").unwrap();
        let message = Table::resume(&path, &COLUMNS, 1.0).unwrap_err().to_string();
        assert!(message.contains("other columns"), "{message}");
        assert_eq!(fs::read_to_string(&path).unwrap(), "time_s,front_m\n0.0,1.0\n");
        assert!(matches!(Table::create(&path, &["time_s", "a,b"]), Err(Error::Input(_))));
    }

    #[test]
    fn a_missing_table_is_started_on_resume() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new.csv");
        Table::resume(&path, &COLUMNS, 1.0).unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "time_s,height_m,iterations\n");
    }

    #[test]
    fn quantities_are_found_with_and_without_unit() {
        let columns = ["front_m", "kinetic_energy_j", "p1_left_pa", "p1_pa", "box_x_n", "particles"];
        assert_eq!(column_of("front", columns), Some("front_m"));
        assert_eq!(column_of("front_m", columns), Some("front_m"));
        assert_eq!(column_of("particles", columns), Some("particles"));
        assert_eq!(column_of("p1", columns), Some("p1_pa"), "not that of another gauge");
        assert_eq!(column_of("box_x", columns), Some("box_x_n"));
        assert_eq!(column_of("fro", columns), None);
    }
}
