//! The scenes that all benchmarks share: a dam break in 2D and still water in 3D, at their own spacings.

#![allow(dead_code, reason = "no benchmark takes all of them")]

use sphpetsc::case::build::{self, Scene};
use sphpetsc::case::{CaseFile, builtin, read};

/// The 2D scene.
pub const PLANE: &str = "dam_break_2d";
/// The 3D scene.
pub const SPACE: &str = "still_water_3d";

/// A built-in case with some of its keys set, and as particles.
pub fn scene<const D: usize>(name: &str, sets: &[(&str, String)]) -> (CaseFile, Scene<D>) {
    let sets: Vec<_> = sets.iter().map(|(key, value)| ((*key).to_owned(), value.clone())).collect();
    let case = read::read(builtin::find(name).expect("a built-in case"), name, &sets).expect("a valid case");
    let scene = build::scene(&case);
    (case, scene)
}
