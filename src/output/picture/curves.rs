//! Curves: values over time, and errors over run times.

use std::path::Path;

use plotters::element::{Circle, Cross, PathElement};
use plotters::style::text_anchor::{HPos, VPos};
use plotters::style::{BLACK, Color, RGBColor};

use super::{Area, Axes, Drawn, Place, dots, letters, number, small_letters, ticks, write_png};
use crate::Result;

const SIZE: (i32, i32) = (960, 600);
const TITLE: i32 = 18;
const LEGEND: i32 = 52;
const PLOT: Place = Place { left: 100, top: 80, width: 830, height: 455 };

/// Okabe & Ito (2008): told apart with any colour vision.
const COLORS: [RGBColor; 6] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
];

/// Values over time.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Name in the legend.
    pub label: String,
    /// Times in s and values; a value that is no number is a gap.
    pub points: Vec<(f64, f64)>,
    /// How it is drawn.
    pub style: Style,
}

/// How a series is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Style {
    /// A line, for what was computed.
    Line,
    /// Black circles, for what was measured.
    Points,
}

/// Draws series over each other as a PNG file; labels hold their units.
///
/// # Errors
/// [`Error::Io`](crate::Error::Io) if the file cannot be written.
pub fn series_plot(path: &Path, title: &str, x_label: &str, y_label: &str, series: &[Series]) -> Result<()> {
    // What was computed gives the span of time, gaps included: so all gauges of a run share their axis, and a measurement
    // that went on for longer does not press it into a corner.
    let lines = || series.iter().filter(|s| s.style == Style::Line || series.len() == 1);
    let (x_low, x_high) = bounds(lines().flat_map(|s| &s.points).map(|p| p.0).filter(|x| x.is_finite()));
    let shown = |&&(x, y): &&(f64, f64)| (x_low..=x_high).contains(&x) && y.is_finite();
    let (y_low, y_high) = bounds(series.iter().flat_map(|s| s.points.iter().filter(shown)).map(|p| p.1));
    let margin = 0.05 * (y_high - y_low);
    // Zero is a natural floor: no margin below it.
    let y_low = if y_low == 0.0 { 0.0 } else { y_low - margin };
    let axes = Axes {
        x: (x_low, x_high),
        y: (y_low, y_high + margin),
        marks: (ticks(x_low, x_high, 8), ticks(y_low, y_high + margin, 7)),
        names: (x_label, y_label),
        label: number,
        grid: true,
        place: PLOT,
    };
    write_png(path, SIZE, |area| {
        heading(
            area,
            title,
            series.iter().zip(series_colors(series)).map(|(s, c)| (s.label.as_str(), s.style, c)),
        )?;
        axes.draw(area)?;
        for (s, color) in series.iter().zip(series_colors(series)) {
            for run in s.points.split(|point| !shown(&point)) {
                let run: Vec<_> = run.iter().map(|p| axes.dot(*p)).collect();
                match s.style {
                    Style::Line => area.draw(&PathElement::new(run, color.stroke_width(4)))?,
                    Style::Points => {
                        for at in run {
                            area.draw(&Circle::new(at, dots(3), color.stroke_width(2)))?;
                        }
                    }
                }
            }
        }
        Ok(())
    })
}

/// Lines take the colours in turn; what was measured is black.
fn series_colors(series: &[Series]) -> impl Iterator<Item = RGBColor> {
    let mut colors = COLORS.iter().cycle();
    series.iter().map(move |s| match s.style {
        Style::Line => *colors.next().expect("a cycle does not end"),
        Style::Points => BLACK,
    })
}

/// Points in a plane with logarithmic axes.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    /// Name in the legend.
    pub label: String,
    /// Points from left to right.
    pub marks: Vec<Mark>,
    /// Whether a line joins them.
    pub joined: bool,
}

/// A point with a note beside it.
#[derive(Debug, Clone, PartialEq)]
pub struct Mark {
    /// Place to the right, > 0.
    pub x: f64,
    /// Place up, > 0; none: there is no value, and a cross at the upper edge says so.
    pub y: Option<f64>,
    /// What stands beside it.
    pub note: String,
}

/// Draws curves with two logarithmic axes as a PNG file. Places that are not above 0 cannot be shown and are left out.
///
/// # Errors
/// [`Error::Io`](crate::Error::Io) if the file cannot be written.
pub fn loglog_plot(path: &Path, title: &str, x_label: &str, y_label: &str, curves: &[Curve]) -> Result<()> {
    let log = |value: f64| Some(value.log10()).filter(|log| log.is_finite());
    let marks = || curves.iter().flat_map(|curve| &curve.marks);
    let (x_low, x_high) = bounds(marks().filter_map(|mark| log(mark.x)));
    let (y_low, y_high) = bounds(marks().filter_map(|mark| log(mark.y?)));
    // Room for notes at the right and above, and at least one round number on each axis.
    let x = (x_low - 0.22, x_high + 0.22 + 0.22 * (x_high - x_low));
    let y = (y_low - 0.22, y_high + 0.22 + 0.1 * (y_high - y_low));
    let axes = Axes {
        x,
        y,
        marks: (log_ticks(x), log_ticks(y)),
        names: (x_label, y_label),
        label: |log| number(10f64.powf(log)),
        grid: true,
        place: PLOT,
    };
    let colored = || curves.iter().zip(COLORS.iter().cycle());
    write_png(path, SIZE, |area| {
        heading(area, title, colored().map(|(curve, c)| (curve.label.as_str(), Style::Line, *c)))?;
        axes.draw(area)?;
        for (k, (curve, color)) in colored().enumerate() {
            let at = |mark: &Mark| Some(axes.dot((log(mark.x)?, log(mark.y?)?)));
            let line: Vec<_> = curve.marks.iter().filter_map(at).collect();
            if curve.joined {
                area.draw(&PathElement::new(line, color.stroke_width(4)))?;
            }
            for mark in &curve.marks {
                if let Some((x, y)) = at(mark) {
                    area.draw(&Circle::new((x, y), dots(5), color.filled()))?;
                    // Notes of every second curve stand below: points of two schemes are often close.
                    let lift = if k % 2 == 0 { -22 } else { 8 };
                    area.draw_text(&mark.note, &small_letters(color), (x + dots(8), y + dots(lift)))?;
                } else if let (Some(x), None) = (log(mark.x), mark.y) {
                    let (x, y) = axes.dot((x, axes.y.1));
                    let y = y + dots(12 + 20 * k as i32);
                    area.draw(&Cross::new((x, y), dots(5), color.stroke_width(4)))?;
                    area.draw_text(&mark.note, &small_letters(color), (x + dots(10), y - dots(9)))?;
                }
            }
        }
        Ok(())
    })
}

/// 1, 2, 5, 10, ... between the logarithms `low` and `high`; only powers of ten where those are many. As logarithms.
fn log_ticks((low, high): (f64, f64)) -> Vec<f64> {
    let steps: &[f64] = if high - low > 2.5 { &[1.0] } else { &[1.0, 2.0, 5.0] };
    let powers = low.floor() as i32..=high.ceil() as i32;
    let all = powers.flat_map(|k| steps.iter().map(move |m| f64::from(k) + m.log10()));
    all.filter(|tick| (low..=high).contains(tick)).collect()
}

/// Least and largest of some numbers, never the same.
fn bounds(values: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let low = values.clone().fold(f64::INFINITY, f64::min);
    let high = values.fold(f64::NEG_INFINITY, f64::max);
    match (low, high) {
        (low, high) if low > high => (0.0, 1.0),
        (low, high) if high - low > 1e-12 * high.abs().max(low.abs()) && high - low > 1e-300 => (low, high),
        (0.0, _) => (0.0, 1.0),
        (same, _) => (same - 0.1 * same.abs(), same + 0.1 * same.abs()),
    }
}

/// Title, and below it what each curve is.
fn heading<'a>(area: &Area, title: &str, curves: impl Iterator<Item = (&'a str, Style, RGBColor)>) -> Drawn {
    let middle = dots(PLOT.left + PLOT.width / 2);
    area.draw_text(title, &letters(HPos::Center, VPos::Top), (middle, dots(TITLE)))?;
    let mut x = dots(PLOT.left);
    let y = dots(LEGEND + 9);
    for (label, style, color) in curves {
        match style {
            Style::Line => {
                area.draw(&PathElement::new(
                    [(x, y), (x + dots(26), y)],
                    color.stroke_width(dots(2) as u32),
                ))?;
            }
            Style::Points => area.draw(&Circle::new((x + dots(13), y), dots(3), color.stroke_width(2)))?,
        }
        let letters = letters(HPos::Left, VPos::Center);
        area.draw_text(label, &letters, (x + dots(34), y))?;
        x += dots(34 + 24) + area.estimate_text_size(label, &letters)?.0 as i32;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_are_never_empty() {
        for values in [&[][..], &[0.0], &[3.0], &[-3.0, -3.0], &[1.0, 2.0], &[1e-9, 2e-9]] {
            let (low, high) = bounds(values.iter().copied());
            assert!(low < high && low.is_finite() && high.is_finite(), "{values:?}: {low} {high}");
        }
    }

    #[test]
    fn logarithmic_axes_have_round_numbers() {
        let labels =
            |range| log_ticks(range).iter().map(|t| number(10f64.powf(*t))).collect::<Vec<_>>().join(" ");
        assert_eq!(labels((-1.0, 1.0)), "0.1 0.2 0.5 1 2 5 10");
        assert_eq!(labels((-3.1, 1.5)), "1e-3 0.01 0.1 1 10".replace("1e-3", "0.001"));
        for start in 0..20 {
            let low = f64::from(start) / 7.0;
            assert!(!log_ticks((low, low + 0.44)).is_empty());
        }
    }
}
