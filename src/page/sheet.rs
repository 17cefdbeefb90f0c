//! Tables of a run, read strictly: a page must not show what a damaged file happens to say.

use std::path::Path;

use serde_json::Value;

use crate::{Error, Result};

/// Words that stand where there is nothing to measure.
const NOTHING: [&str; 2] = ["dry", "none"];

/// A CSV file.
pub struct Sheet {
    file: std::path::PathBuf,
    /// Names of the columns.
    pub head: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Sheet {
    /// Reads a table whose rows are all as long as its head.
    pub fn read(path: &Path) -> Result<Self> {
        let damaged = |error: csv::Error| Error::unreadable(path, &error);
        let mut reader = csv::Reader::from_path(path).map_err(damaged)?;
        let cells = |row: &csv::StringRecord| row.iter().map(str::to_owned).collect::<Vec<_>>();
        let head = cells(reader.headers().map_err(damaged)?);
        if head.is_empty() {
            return Err(Error::unreadable(path, &"it is empty"));
        }
        let rows = reader.records().map(|row| Ok(cells(&row.map_err(damaged)?)));
        Ok(Self { file: path.to_owned(), rows: rows.collect::<Result<_>>()?, head })
    }

    /// The numbers of a column; none where there is nothing to measure, or no such column.
    pub fn numbers(&self, name: &str) -> Result<Option<Vec<Option<f64>>>> {
        let Some(column) = self.head.iter().position(|known| known == name) else { return Ok(None) };
        let number = |(k, row): (usize, &Vec<String>)| match row[column].parse() {
            Ok(value) => Ok(Some(value).filter(|value: &f64| value.is_finite())),
            Err(_) if NOTHING.contains(&&*row[column]) => Ok(None),
            Err(_) => {
                let what = format!("line {} has no number under {name}", k + 2);
                Err(Error::unreadable(&self.file, &what))
            }
        };
        self.rows.iter().enumerate().map(number).collect::<Result<_>>().map(Some)
    }

    /// All rows as numbers and words.
    pub fn values(&self) -> Vec<Vec<Value>> {
        let value = |cell: &String| match cell.parse::<f64>() {
            Ok(number) => number.into(),
            Err(_) if NOTHING.contains(&cell.as_str()) => Value::Null,
            Err(_) => cell.as_str().into(),
        };
        self.rows.iter().map(|row| row.iter().map(value).collect()).collect()
    }
}
