//! The stored particles as a film: quantised, as differences between instants, deflated.
//!
//! Every particle that is ever there has a place of its own in all frames, liquid first. A frame is planes of bytes, low and
//! high of each coordinate, then pressure and speed as places in a colour table; each byte plane of a pair is that of the
//! 16-bit difference from the frame before. A particle that is not there has the first coordinate [`ABSENT`].

use std::collections::BTreeMap;
use std::io::{self, Write as _};
use std::panic;
use std::path::{Path, PathBuf};

use base64::Engine as _;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use rayon::prelude::*;
use serde::Serialize;

use super::BASE64;
use crate::case::CaseFile;
use crate::output::picture::color::ColorScale;
use crate::output::vtk::{self, Stored};
use crate::particles::Kind;
use crate::{Error, Result};

/// Bytes of the film at most: 4 MB as base64, which leaves a page below 5 MB.
const BUDGET: usize = 3_000_000;
/// Particles over all frames at most: no more would fit, at two bytes each.
const LIMIT: usize = BUDGET / 2;
/// Frames to be kept where there are so many: then particles are left out.
const FEWEST_FRAMES: usize = 40;
/// First coordinate of a particle that is not there.
const ABSENT: u16 = u16::MAX;

/// A film, ready for the page.
#[derive(Debug, Serialize)]
pub struct Movie {
    dimension: usize,
    times: Vec<f64>,
    /// Places of a frame, and how many of them are liquid.
    slots: usize,
    fluid: usize,
    /// Place of coordinate 0 in m, and the length of one unit.
    origin: [f64; 3],
    unit: f64,
    /// Diameter at which particles are drawn, in m.
    diameter: f64,
    tank: Option<[Vec<f64>; 2]>,
    colors: [Colors; 2],
    note: String,
    film: String,
}

/// Values of a quantity and their colours.
#[derive(Debug, Serialize)]
struct Colors {
    name: &'static str,
    unit: &'static str,
    low: f64,
    high: f64,
    /// 256 times red, green, blue.
    palette: String,
}

/// Which of the stored frames and particles are shown: every so many.
struct Thinning {
    frames: usize,
    particles: u64,
}

/// One instant: what is shown of it, by place.
struct Frame {
    particles: BTreeMap<Place, Seen>,
}

/// Walls after the liquid, each by number.
type Place = (bool, u64);

struct Seen {
    position: [f32; 3],
    values: [f32; 2],
}

/// The film of the particles stored in the folder of a run, if there are any.
pub fn of_run(folder: &Path, case: &CaseFile) -> Result<Option<Movie>> {
    let stored = vtk::snapshots(&folder.join("particles.pvd"))?;
    let Some((_, first)) = stored.first() else { return Ok(None) };
    let mut thinning = Thinning { frames: 1, particles: 1 };
    let all = stored.len() * quietly(|| vtk::read_vtp(first))?.ids.len();
    if all > LIMIT {
        thinning.grow(all as f64 / LIMIT as f64, stored.len());
    }
    loop {
        let (times, files): (Vec<f64>, Vec<&PathBuf>) =
            stored.iter().step_by(thinning.frames).map(|(time, file)| (*time, file)).unzip();
        let read = |file: &&PathBuf| Ok(Frame::of(&vtk::read_vtp(file)?, case, &thinning));
        let frames: Vec<Frame> = quietly(|| files.par_iter().map(read).collect::<Result<_>>())?;
        let (movie, size) = movie(&frames, times, case, &thinning, thinning.note(stored.len()))
            .map_err(|error| Error::io(folder, error))?;
        if size <= BUDGET {
            return Ok(Some(movie));
        }
        thinning.grow(size as f64 / BUDGET as f64, stored.len());
    }
}

/// vtkio panics on some damaged files, and [`vtk::read_vtp`] makes errors of that: they are no defect of this program, and
/// the user need not hear of them twice.
fn quietly<T>(read: impl FnOnce() -> T) -> T {
    let hook = panic::take_hook();
    panic::set_hook(Box::new(|_| {}));
    let found = read();
    panic::set_hook(hook);
    found
}

impl Thinning {
    /// Leaves out more, by a factor above 1.
    fn grow(&mut self, excess: f64, stored: usize) {
        let wanted = (self.frames as f64 * excess).ceil();
        self.frames = (wanted as usize).min((stored / FEWEST_FRAMES).max(self.frames));
        self.particles *= (wanted / self.frames as f64).ceil() as u64;
    }

    fn keeps(&self, id: u64) -> bool {
        // Numbers follow the lattice: every so many of them would be planes.
        (id.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 32).is_multiple_of(self.particles)
    }

    fn note(&self, stored: usize) -> String {
        let frames = match self.frames {
            1 => format!("All {stored} stored instants"),
            n => format!("One of every {n} of the {stored} stored instants"),
        };
        match self.particles {
            1 => frames + ".",
            n => format!("{frames}, about one of {n} particles, drawn larger."),
        }
    }
}

impl Frame {
    fn of(stored: &Stored, case: &CaseFile, thinning: &Thinning) -> Self {
        let mut particles = BTreeMap::new();
        for (a, &id) in stored.ids.iter().enumerate() {
            let is_wall = stored.kind[a] != Kind::Fluid as u8;
            let position: [f64; 3] = std::array::from_fn(|d| stored.positions[3 * a + d]);
            if thinning.keeps(id) && (!is_wall || is_shown(&position, case)) {
                let v = &stored.velocity[3 * a..3 * a + 3];
                let speed = v.iter().map(|v| v * v).sum::<f64>().sqrt();
                let values = [stored.pressure[a] as f32, speed as f32];
                particles.insert((is_wall, id), Seen { position: position.map(|x| x as f32), values });
            }
        }
        Self { particles }
    }
}

/// In 3D the tank's own walls would hide everything.
fn is_shown(wall: &[f64; 3], case: &CaseFile) -> bool {
    let Some(tank) = case.tank.as_ref().filter(|_| case.dimension == 3) else { return true };
    (0..3).all(|d| tank.min[d] < wall[d] && (wall[d] < tank.max[d] || d == 2))
}

/// The film and the number of its bytes.
fn movie(
    frames: &[Frame],
    times: Vec<f64>,
    case: &CaseFile,
    thinning: &Thinning,
    note: String,
) -> io::Result<(Movie, usize)> {
    let places: BTreeMap<Place, ()> =
        frames.iter().flat_map(|frame| frame.particles.keys().map(|place| (*place, ()))).collect();
    let places: Vec<Place> = places.into_keys().collect();
    let seen = || frames.iter().flat_map(|frame| &frame.particles);
    let bound = |d: usize, pick: fn(f32, f32) -> f32, start: f32| {
        f64::from(seen().map(|(_, seen)| seen.position[d]).fold(start, pick))
    };
    let mut low = [0, 1, 2].map(|d| bound(d, f32::min, f32::INFINITY));
    let high = [0, 1, 2].map(|d| bound(d, f32::max, f32::NEG_INFINITY));
    if places.is_empty() {
        low = [0.0; 3];
    }
    let extent = (0..3).map(|d| high[d] - low[d]).fold(case.spacing, f64::max);
    let unit = extent / f64::from(ABSENT - 1);
    let liquid = || seen().filter(|((is_wall, _), _)| !is_wall);
    let scales = [0, 1].map(|k| ColorScale::of(liquid().map(|(_, seen)| f64::from(seen.values[k]))));
    let film = encode(frames, &places, case.dimension, (&low, unit), &scales)?;
    let names = [("pressure", "Pa"), ("speed", "m/s")];
    let colors = [0, 1].map(|k| Colors {
        name: names[k].0,
        unit: names[k].1,
        low: scales[k].low,
        high: scales[k].high,
        palette: BASE64.encode(palette(&scales[k])),
    });
    let movie = Movie {
        dimension: case.dimension,
        times,
        slots: places.len(),
        fluid: places.iter().filter(|(is_wall, _)| !is_wall).count(),
        origin: low,
        unit,
        diameter: case.spacing * (thinning.particles as f64).powf(1.0 / case.dimension as f64),
        tank: case.tank.as_ref().map(|tank| [tank.min.clone(), tank.max.clone()]),
        colors,
        note,
        film: BASE64.encode(&film),
    };
    Ok((movie, film.len()))
}

fn palette(scale: &ColorScale) -> Vec<u8> {
    let color = |k: u16| scale.color(scale.low + (scale.high - scale.low) * f64::from(k) / 255.0);
    (0..256).map(color).flat_map(|color| [color.0, color.1, color.2]).collect()
}

fn encode(
    frames: &[Frame],
    places: &[Place],
    dimension: usize,
    (low, unit): (&[f64; 3], f64),
    scales: &[ColorScale; 2],
) -> io::Result<Vec<u8>> {
    let mut film = ZlibEncoder::new(Vec::new(), Compression::new(6));
    let mut before = vec![[0_u16; 3]; places.len()];
    for frame in frames {
        let seen: Vec<Option<&Seen>> = places.iter().map(|place| frame.particles.get(place)).collect();
        for d in 0..dimension {
            let now = seen.iter().zip(&before).map(|(seen, before)| match seen {
                Some(seen) => ((f64::from(seen.position[d]) - low[d]) / unit).round() as u16,
                None if d == 0 => ABSENT,
                None => before[d],
            });
            let now: Vec<u16> = now.collect();
            let steps =
                now.iter().zip(&before).map(|(now, before)| now.wrapping_sub(before[d]).to_le_bytes());
            let (lows, highs): (Vec<u8>, Vec<u8>) = steps.map(|[low, high]| (low, high)).unzip();
            film.write_all(&lows)?;
            film.write_all(&highs)?;
            before.iter_mut().zip(now).for_each(|(before, now)| before[d] = now);
        }
        for (k, scale) in scales.iter().enumerate() {
            let share = |value: f32| (f64::from(value) - scale.low) / (scale.high - scale.low);
            let place = |seen: &Option<&Seen>| seen.map_or(0, |s| (255.0 * share(s.values[k])).round() as u8);
            film.write_all(&seen.iter().map(place).collect::<Vec<_>>())?;
        }
    }
    film.finish()
}
