//! Pictures that need no other program: particles coloured by pressure ([`particles`]), curves ([`curves`]), and which of
//! them a run leaves ([`gallery`]). They are PNG files, which every viewer, browser and text processor shows.
//!
//! `plotters` draws into memory with its bitmap backend, and its text comes from a font inside this program: Noto Sans
//! (SIL Open Font License, crate `notosans`), read by `ab_glyph`. So no font library and no installed font is needed, and a
//! picture looks the same on a cluster node as on a desk.

pub(crate) mod color;
pub mod curves;
pub mod gallery;
pub mod particles;

use std::error::Error as StdError;
use std::path::Path;
use std::sync::Once;

use plotters::backend::BitMapBackend;
use plotters::coord::Shift;
use plotters::drawing::{DrawingArea, IntoDrawingArea};
use plotters::element::PathElement;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{
    BLACK, Color, FontStyle, FontTransform, IntoFont, RGBColor, TextStyle, WHITE, register_font,
};

use super::folder::write_atomic;
use crate::{Error, Result};

/// Drawn dots along each side of a pixel: their mean makes edges and letters smooth.
const DOTS: i32 = 2;
/// Height of letters in pixels.
const LETTERS: i32 = 20;
const GRID: RGBColor = RGBColor(225, 225, 225);

type Area<'a> = DrawingArea<BitMapBackend<'a>, Shift>;
type Drawn = std::result::Result<(), Box<dyn StdError>>;

/// Draws a picture of `width` x `height` pixels and writes it as `path`. Inside, lengths are in dots: see [`dots`].
fn write_png(path: &Path, (width, height): (i32, i32), draw: impl FnOnce(&Area) -> Drawn) -> Result<()> {
    load_font();
    let failed = |error: Box<dyn StdError>| Error::io(path, std::io::Error::other(error.to_string()));
    let (wide, high) = (dots(width), dots(height));
    let mut canvas = vec![0; 3 * (wide * high) as usize];
    {
        let area = BitMapBackend::with_buffer(&mut canvas, (wide as u32, high as u32)).into_drawing_area();
        area.fill(&WHITE).map_err(|error| failed(error.into()))?;
        draw(&area).map_err(failed)?;
    }
    let pixels = shrink(&canvas, width as usize, height as usize);
    write_atomic(path, |file| {
        let mut encoder = png::Encoder::new(file, width as u32, height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&pixels)?;
        Ok(writer.finish()?)
    })
}

/// Dots in this many pixels.
const fn dots(pixels: i32) -> i32 {
    DOTS * pixels
}

/// Each pixel is the mean of its dots.
fn shrink(canvas: &[u8], width: usize, height: usize) -> Vec<u8> {
    let n = DOTS as usize;
    let mut pixels = Vec::with_capacity(3 * width * height);
    for y in 0..height {
        for x in 0..width {
            for channel in 0..3 {
                let dot = |k: usize| canvas[3 * ((n * y + k / n) * n * width + n * x + k % n) + channel];
                let sum: usize = (0..n * n).map(|k| usize::from(dot(k))).sum();
                pixels.push(((sum + n * n / 2) / (n * n)) as u8);
            }
        }
    }
    pixels
}

fn load_font() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let loaded = register_font("sans-serif", FontStyle::Normal, notosans::REGULAR_TTF);
        assert!(loaded.is_ok(), "the font inside the program is readable");
    });
}

/// Letters of the usual size, placed with `across` and `down` at their point.
fn letters(across: HPos, down: VPos) -> TextStyle<'static> {
    TextStyle::from(("sans-serif", dots(LETTERS)).into_font()).pos(Pos::new(across, down))
}

/// Smaller letters in a colour, for notes.
fn small_letters(color: &RGBColor) -> TextStyle<'_> {
    ("sans-serif", dots(LETTERS - 2)).into_font().color(color)
}

/// A rectangle in pixels.
#[derive(Debug, Clone, Copy)]
struct Place {
    left: i32,
    top: i32,
    width: i32,
    height: i32,
}

/// A plot's axes: where they lie, what they span, and what stands beside them.
struct Axes<'a> {
    place: Place,
    x: (f64, f64),
    y: (f64, f64),
    marks: (Vec<f64>, Vec<f64>),
    names: (&'a str, &'a str),
    /// How the numbers at the marks are written.
    label: fn(f64) -> String,
    grid: bool,
}

impl Axes<'_> {
    /// Where a point lies in the picture, in dots.
    fn dot(&self, (x, y): (f64, f64)) -> (i32, i32) {
        let Place { left, top, width, height } = self.place;
        let across = f64::from(dots(width)) * (x - self.x.0) / (self.x.1 - self.x.0);
        let up = f64::from(dots(height)) * (y - self.y.0) / (self.y.1 - self.y.0);
        (dots(left) + across.round() as i32, dots(top + height) - up.round() as i32)
    }

    /// Plotters' own axes choose their marks by themselves, which is no help for logarithms and narrow plots.
    fn draw(&self, area: &Area) -> Drawn {
        let Place { left, top, width, height } = self.place;
        let [(x0, y0), (x1, y1)] =
            [(left, top + height), (left + width, top)].map(|(x, y)| (dots(x), dots(y)));
        let line = |from, to, style| area.draw(&PathElement::new([from, to], style));
        let (grid, ink) = (GRID.stroke_width(2), BLACK.stroke_width(2));
        for &mark in &self.marks.0 {
            let (x, _) = self.dot((mark, self.y.0));
            if self.grid {
                line((x, y0), (x, y1), grid)?;
            }
            line((x, y0), (x, y0 + dots(5)), ink)?;
            area.draw_text(&(self.label)(mark), &letters(HPos::Center, VPos::Top), (x, y0 + dots(9)))?;
        }
        for &mark in &self.marks.1 {
            let (_, y) = self.dot((self.x.0, mark));
            if self.grid {
                line((x0, y), (x1, y), grid)?;
            }
            line((x0 - dots(5), y), (x0, y), ink)?;
            area.draw_text(&(self.label)(mark), &letters(HPos::Right, VPos::Center), (x0 - dots(9), y))?;
        }
        line((x0, y0), (x1, y0), ink)?;
        line((x0, y0), (x0, y1), ink)?;
        let (middle_x, middle_y) = ((x0 + x1) / 2, (y0 + y1) / 2);
        area.draw_text(self.names.0, &letters(HPos::Center, VPos::Top), (middle_x, y0 + dots(33)))?;
        let upwards = letters(HPos::Center, VPos::Top).transform(FontTransform::Rotate270);
        area.draw_text(self.names.1, &upwards, (x0 - dots(80), middle_y))?;
        Ok(())
    }
}

/// A tick label: no trailing zeros, an exponent where there would be many leading ones.
fn number(value: f64) -> String {
    let size = value.abs();
    if size < 1e-12 {
        return "0".into();
    }
    if !(1e-3..1e6).contains(&size) {
        let text = format!("{value:.2e}");
        let (digits, exponent) = text.split_once('e').expect("an exponent was asked for");
        return format!("{}e{exponent}", digits.trim_end_matches('0').trim_end_matches('.'));
    }
    let digits = (6 - size.log10().floor() as i32).clamp(0, 9) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text }
}

/// Round numbers between `low` and `high`, about `count` of them.
fn ticks(low: f64, high: f64, count: usize) -> Vec<f64> {
    let raw = (high - low) / count as f64;
    let power = 10f64.powf(raw.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|step| *step >= raw * 0.999);
    let step = step.unwrap_or(10.0 * power);
    let (first, last) = ((low / step - 1e-9).ceil() as i64, (high / step + 1e-9).floor() as i64);
    (first..=last).map(|k| k as f64 * step).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_short() {
        for (value, wanted) in [
            (0.0, "0"),
            (0.1 + 0.2, "0.3"),
            (3924.0, "3924"),
            (-12.5, "-12.5"),
            (2e-5, "2e-5"),
            (1.5e7, "1.5e7"),
            (100_000.0, "100000"),
        ] {
            assert_eq!(number(value), wanted);
        }
    }

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(
            ticks(0.0, 1.0, 5).iter().map(|t| number(*t)).collect::<Vec<_>>().join(" "),
            "0 0.2 0.4 0.6 0.8 1"
        );
        assert_eq!(ticks(-0.013, 0.8, 4).first().map(|t| number(*t)).unwrap(), "0");
        assert!(ticks(3.0, 3923.0, 6).iter().all(|t| (3.0..=3923.0).contains(t)));
    }
}
