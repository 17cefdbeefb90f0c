//! The scenes that all benchmarks share: a dam break in 2D and still water in 3D, at their own spacings.

use sphpetsc::case::build::{self, Scene};
use sphpetsc::case::{CaseFile, builtin, read};
use sphpetsc::scheme::isph::Method;

/// The 2D scene.
pub const PLANE: &str = "dam_break_2d";
/// The 3D scene.
pub const SPACE: &str = "still_water_3d";

/// A built-in case as particles, at its own spacing or another in m, and its ISPH method.
pub fn scene<const D: usize>(name: &str, spacing: Option<f64>) -> (Scene<D>, Method) {
    let case = case(name, spacing);
    let scene = build::scene(&case);
    let method = build::isph(&case, &scene);
    (scene, method)
}

fn case(name: &str, spacing: Option<f64>) -> CaseFile {
    let sets: Vec<_> =
        spacing.map(|spacing| ("spacing".to_owned(), spacing.to_string())).into_iter().collect();
    read::read(builtin::find(name).expect("a built-in case"), name, &sets).expect("a valid case")
}
