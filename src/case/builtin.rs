//! The built-in cases: the files under `cases/`, embedded in the program.

use super::read;

macro_rules! cases {
    ($($name:literal),* $(,)?) => { [$(($name, include_str!(concat!("../../cases/", $name, "/case.toml")))),*] };
}

/// Names and TOML texts, in the order in which they are listed.
const CASES: [(&str, &str); 17] = cases![
    "dam_break_2d",
    "dam_break_3d_fixed",
    "dam_break_3d_open",
    "dam_break_3d_sliding",
    "dam_break_gate",
    "debris",
    "stl_house",
    "still_water_2d",
    "still_water_3d",
    "taylor_green",
    "stretching_drop",
    "rotating_square",
    "standing_wave",
    "sloshing",
    "dam_break_dry_bed",
    "dam_break_wet_bed",
    "patch_test",
];

/// The case that runs when none is named.
pub const DEFAULT: &str = CASES[0].0;

/// All names.
pub fn names() -> impl Iterator<Item = &'static str> {
    CASES.iter().map(|&(name, _)| name)
}

/// The TOML text of a case.
pub fn find(name: &str) -> Option<&'static str> {
    CASES.iter().find(|(known, _)| *known == name).map(|&(_, text)| text)
}

/// Names and one-line descriptions.
pub fn list() -> impl Iterator<Item = (&'static str, String)> {
    CASES.iter().map(|&(name, text)| {
        let case = read::read(text, name, &[]).expect("built-in cases are valid: a test reads each");
        (name, case.description)
    })
}
