//! The built-in cases: the files under `cases/`, embedded in the program.

use super::read;

macro_rules! cases {
    ([$($name:literal),* $(,)?], extreme [$($extreme:literal),* $(,)?]) => { [
        $(($name, include_str!(concat!("../../cases/", $name, "/case.toml"))),)*
        $(($extreme, include_str!(concat!("../../cases/extreme/", $extreme, ".toml"))),)*
    ] };
}

/// Names and TOML texts, in the order in which they are listed.
const CASES: [(&str, &str); 43] = cases!(
    [
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
    ],
    extreme [
        "closed_tank",
        "closed_tank_3d",
        "cloud",
        "cloud_3d",
        "colliding_columns",
        "colliding_columns_3d",
        "draining_tank",
        "draining_tank_3d",
        "drop_impact",
        "drop_impact_3d",
        "heavy_body",
        "heavy_body_3d",
        "light_body",
        "light_body_3d",
        "meeting_particles",
        "meeting_particles_3d",
        "single_particle",
        "single_particle_3d",
        "slit_jet",
        "slit_jet_3d",
        "tall_column",
        "tall_column_3d",
        "thin_film",
        "thin_film_3d",
        "waterfall",
        "waterfall_3d",
    ]
);

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
