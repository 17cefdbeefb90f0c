//! Curves of a page: thinned to what a screen shows, their peaks kept.

use std::collections::BTreeSet;

use serde::Serialize;

/// Intervals of a curve, each with its least and its largest value.
pub const INTERVALS: usize = 400;

/// One plot.
#[derive(Debug, Serialize)]
pub struct Plot {
    pub title: String,
    pub x: String,
    pub y: String,
    /// Both axes logarithmic.
    pub log: bool,
    pub curves: Vec<Curves>,
}

/// Columns over the same places.
#[derive(Debug, Serialize)]
pub struct Curves {
    x: Vec<f64>,
    labels: Vec<String>,
    columns: Vec<Vec<Option<f64>>>,
    /// Single points, for what was measured.
    dots: bool,
    /// What stands beside each point.
    notes: Vec<String>,
}

impl Curves {
    /// Lines through all rows that show at the size of a screen.
    pub fn lines(x: &[Option<f64>], columns: Vec<(String, Vec<Option<f64>>)>) -> Self {
        Self::thinned(x, columns, INTERVALS)
    }

    /// Lines through rows of so many intervals, those of their least and largest values.
    pub fn thinned(x: &[Option<f64>], columns: Vec<(String, Vec<Option<f64>>)>, intervals: usize) -> Self {
        let kept = kept_rows(x.len(), &columns, intervals);
        let kept: Vec<usize> = kept.into_iter().filter(|&k| x[k].is_some()).collect();
        let thinned =
            |column: &[Option<f64>]| kept.iter().map(|&k| column[k].map(|y| rounded(y, 5))).collect();
        Self {
            x: kept.iter().filter_map(|&k| x[k]).map(|x| rounded(x, 7)).collect(),
            columns: columns.iter().map(|(_, column)| thinned(column)).collect(),
            labels: columns.into_iter().map(|(label, _)| label).collect(),
            dots: false,
            notes: vec![],
        }
    }

    /// Single points.
    pub fn dots(label: &str, points: &[(f64, f64)]) -> Self {
        Self {
            x: points.iter().map(|(x, _)| *x).collect(),
            labels: vec![label.to_owned()],
            columns: vec![points.iter().map(|(_, y)| Some(*y)).collect()],
            dots: true,
            notes: vec![],
        }
    }

    /// A line with a note beside each point, from left to right.
    pub fn noted(label: &str, mut points: Vec<(f64, f64, String)>) -> Self {
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        Self {
            x: points.iter().map(|point| point.0).collect(),
            labels: vec![label.to_owned()],
            columns: vec![points.iter().map(|point| Some(point.1)).collect()],
            dots: false,
            notes: points.into_iter().map(|point| point.2).collect(),
        }
    }

    /// Single points with a note beside each.
    pub fn scattered(label: &str, points: Vec<(f64, f64, String)>) -> Self {
        Self { dots: true, ..Self::noted(label, points) }
    }
}

/// Of each interval of rows the first, the first gap, and the least and largest of each column; and the last row.
fn kept_rows(count: usize, columns: &[(String, Vec<Option<f64>>)], intervals: usize) -> BTreeSet<usize> {
    let length = count.div_ceil(intervals).max(1);
    let mut kept: BTreeSet<usize> = (0..count).step_by(length).chain(count.checked_sub(1)).collect();
    for start in (0..count).step_by(length) {
        for (_, column) in columns {
            let rows = || (start..count.min(start + length)).filter_map(|k| Some((k, column[k]?)));
            kept.extend(rows().min_by(|a, b| a.1.total_cmp(&b.1)).map(|row| row.0));
            kept.extend(rows().max_by(|a, b| a.1.total_cmp(&b.1)).map(|row| row.0));
            kept.extend((start..count.min(start + length)).find(|&k| column[k].is_none()));
        }
    }
    kept
}

/// So many digits, which a page shows and a file need not exceed.
fn rounded(value: f64, digits: usize) -> f64 {
    format!("{value:.*e}", digits - 1).parse().unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thinning_keeps_peaks_and_gaps() {
        let x: Vec<_> = (0..10_000).map(|k| Some(f64::from(k))).collect();
        let mut y = vec![Some(1.0); 10_000];
        y[7_777] = Some(9.0);
        y[3_333] = None;
        let curves = Curves::lines(&x, vec![("y".into(), y)]);
        assert!(curves.x.len() < 4 * INTERVALS);
        let at = |x: f64| curves.x.iter().position(|known| *known == x).map(|k| curves.columns[0][k]);
        assert_eq!(at(7_777.0), Some(Some(9.0)));
        assert_eq!(at(3_333.0), Some(None));
        assert_eq!((at(0.0), at(9_999.0)), (Some(Some(1.0)), Some(Some(1.0))));
    }
}
