//! Pictures: whole PNG files that show what they are given, for any scene.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use sphpetsc::output::picture::curves::{Curve, Mark, Series, Style, loglog_plot, series_plot};
use sphpetsc::output::picture::particles::{Scene, particle_picture};
use sphpetsc::particles::Vector;

struct Picture {
    width: usize,
    height: usize,
    pixels: Vec<[u8; 3]>,
}

impl Picture {
    fn read(path: &Path) -> Self {
        let mut reader = png::Decoder::new(BufReader::new(File::open(path).unwrap())).read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut bytes).unwrap();
        let pixels = bytes.as_chunks::<3>().0.to_vec();
        let (width, height) = (info.width as usize, info.height as usize);
        assert_eq!(pixels.len(), width * height, "three channels");
        Self { width, height, pixels }
    }

    fn count(&self, color: [u8; 3]) -> usize {
        self.pixels.iter().filter(|pixel| **pixel == color).count()
    }
}

const DEEP: [u8; 3] = [68, 1, 84];
const BRIGHT: [u8; 3] = [253, 231, 37];
const WALL: [u8; 3] = [165, 165, 165];

#[test]
fn a_flat_scene_shows_its_pressures_and_walls_true_to_scale() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("t.png");
    let fluid: Vec<_> = (0..200)
        .map(|k| Vector::<2>::new(0.05 + 0.1 * f64::from(k % 20), 0.05 + 0.1 * f64::from(k / 20)))
        .collect();
    let pressure: Vec<_> = fluid.iter().map(|r| if r.y < 0.5 { 1000.0 } else { 0.0 }).collect();
    let walls: Vec<_> = (0..20).map(|k| Vector::<2>::new(0.05 + 0.1 * f64::from(k), -0.05)).collect();
    let tank = Some((Vector::<2>::zeros(), Vector::<2>::new(2.0, 1.0)));
    let scene =
        Scene { title: "a title", fluid: &fluid, pressure: &pressure, walls: &walls, spacing: 0.1, tank };
    particle_picture(&path, &scene).unwrap();
    let picture = Picture::read(&path);
    // 2.3 x 1.3 m in a plot of 820 pixels across, and the margins around it.
    assert_eq!((picture.width, picture.height), (820 + 220, 463 + 115));
    let [deep, bright, wall] = [DEEP, BRIGHT, WALL].map(|color| picture.count(color) as f64);
    // Both halves of the liquid are equally large; the colour bar has a little of each colour.
    assert!(deep > 40_000.0 && (deep / bright - 1.0).abs() < 0.05, "{deep} {bright}");
    assert!((wall / (deep / 5.0) - 1.0).abs() < 0.2, "{wall}");
}

#[test]
fn a_scene_in_space_shows_a_slice_and_a_view() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("t.png");
    let fluid: Vec<_> = (0..1000)
        .map(|k| 0.1 * Vector::<3>::new(f64::from(k % 10), f64::from(k / 10 % 10), f64::from(k / 100)))
        .map(|r| r.add_scalar(0.05))
        .collect();
    let pressure: Vec<_> = fluid.iter().map(|r| 1e4 * (0.95 - r.z)).collect();
    let walls = [Vector::<3>::new(1.5, 0.5, 0.05), Vector::<3>::new(-0.05, 0.5, 0.05)];
    let tank = Some((Vector::<3>::zeros(), Vector::<3>::new(2.0, 1.0, 1.0)));
    let scene = Scene { title: "", fluid: &fluid, pressure: &pressure, walls: &walls, spacing: 0.1, tank };
    particle_picture(&path, &scene).unwrap();
    let picture = Picture::read(&path);
    assert!(picture.height > 900, "two panels: {}", picture.height);
    assert!(picture.count([176, 140, 104]) > 50, "what stands in the tank is seen from outside");
    assert!(picture.count(WALL) > 50, "walls are seen in the slice");
    assert!(picture.count(DEEP) > 5000 && picture.count(BRIGHT) > 1000);
}

#[test]
fn suction_has_a_colour_of_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("t.png");
    let fluid = [Vector::<2>::new(0.0, 0.0), Vector::<2>::new(1.0, 1.0)];
    let scene =
        Scene { title: "", fluid: &fluid, pressure: &[-10.0, 10.0], walls: &[], spacing: 0.5, tank: None };
    particle_picture(&path, &scene).unwrap();
    let picture = Picture::read(&path);
    assert!(picture.count([33, 102, 172]) > 1000 && picture.count([178, 24, 43]) > 1000);
}

#[test]
fn scenes_without_content_are_drawn_too() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("t.png");
    let nan = Vector::<2>::repeat(f64::NAN);
    let tank = Some((Vector::<2>::zeros(), Vector::<2>::new(0.001, 8.0)));
    for (fluid, pressure, tank) in [
        (&[][..], &[][..], None),
        (&[], &[], tank),
        (&[nan, nan], &[f64::NAN, 1.0], None),
        (&[Vector::<2>::repeat(0.3)], &[f64::INFINITY], None),
        (&[Vector::<2>::repeat(0.3), Vector::<2>::repeat(0.4)], &[5.0, 5.0], tank),
    ] {
        let scene = Scene { title: "x", fluid, pressure, walls: &[], spacing: 0.1, tank };
        particle_picture(&path, &scene).unwrap();
        Picture::read(&path);
    }
    let empty = Scene::<3> { title: "", fluid: &[], pressure: &[], walls: &[], spacing: 0.1, tank: None };
    particle_picture(&path, &empty).unwrap();
    Picture::read(&path);
}

#[test]
fn curves_show_lines_points_and_gaps() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("curve.png");
    let wave = |k: i32| if (40..60).contains(&k) { f64::NAN } else { (0.1 * f64::from(k)).sin() };
    let line: Vec<_> = (0..100).map(|k| (f64::from(k), wave(k))).collect();
    let points = line.iter().step_by(10).copied().collect();
    let series = [
        Series { label: "computed".into(), points: line, style: Style::Line },
        Series { label: "measured".into(), points, style: Style::Points },
    ];
    series_plot(&path, "title", "time, s", "value, m", &series).unwrap();
    let picture = Picture::read(&path);
    assert_eq!((picture.width, picture.height), (960, 600));
    assert!(picture.count([0, 114, 178]) > 400, "{}", picture.count([0, 114, 178]));
    // The gap is empty: 166 pixels of the 830 across hold nothing but grid.
    let colored = |x: usize| (80..530).any(|y| picture.pixels[960 * y + x] == [0, 114, 178]);
    assert!((445..580).all(|x| !colored(x)) && (110..400).filter(|x| colored(*x)).count() > 100);

    for points in [vec![], vec![(0.0, f64::NAN)], vec![(0.0, 0.0)], vec![(1.0, 5.0), (2.0, 5.0)]] {
        let series = [Series { label: String::new(), points, style: Style::Line }];
        series_plot(&path, "", "", "", &series).unwrap();
        Picture::read(&path);
    }
}

#[test]
fn errors_over_run_times_are_drawn_with_failures() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("study.png");
    let mark = |x: f64, y: Option<f64>| Mark { x, y, note: format!("{x}") };
    let curves = [
        Curve {
            label: "one".into(),
            marks: vec![mark(1.0, Some(0.1)), mark(8.0, Some(0.03)), mark(60.0, None)],
            joined: true,
        },
        Curve { label: "two".into(), marks: vec![mark(2.0, Some(0.0)), mark(0.0, Some(0.1))], joined: false },
    ];
    loglog_plot(&path, "title", "time, s", "error", &curves).unwrap();
    assert!(Picture::read(&path).count([0, 114, 178]) > 300);
    loglog_plot(&path, "", "", "", &[]).unwrap();
    Picture::read(&path);
}
