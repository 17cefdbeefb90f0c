//! From a pressure to a colour.

use plotters::style::RGBColor;

/// Viridis (Smith & van der Walt 2015), nine of its colours: perceptually uniform, readable in grey.
const VIRIDIS: [[u8; 3]; 9] = [
    [68, 1, 84],
    [71, 44, 122],
    [59, 81, 139],
    [44, 113, 142],
    [33, 144, 141],
    [39, 173, 129],
    [92, 200, 99],
    [170, 220, 50],
    [253, 231, 37],
];

/// From blue over light grey to red, after ColorBrewer's RdBu: the sign of a pressure shows.
const BLUE_RED: [[u8; 3]; 7] = [
    [33, 102, 172],
    [103, 169, 207],
    [178, 208, 224],
    [225, 225, 225],
    [240, 190, 165],
    [239, 138, 98],
    [178, 24, 43],
];

/// Share of the largest pressures above which negative ones count.
const SUCTION: f64 = 0.05;

/// Which pressures in Pa the colours stand for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ColorScale {
    pub low: f64,
    pub high: f64,
}

impl ColorScale {
    /// From 0 to the 99.5th percentile, so that one wild particle does not make all others look alike; symmetric about 0
    /// where suction matters.
    pub fn of(pressures: impl IntoIterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = pressures.into_iter().filter(|p| p.is_finite()).collect();
        sorted.sort_by(f64::total_cmp);
        let percentile = |share: f64| {
            let last = sorted.len().saturating_sub(1) as f64;
            sorted.get((share * last).round() as usize).copied().unwrap_or(0.0)
        };
        let (low, high) = (percentile(0.005), percentile(0.995));
        let range = if low < -SUCTION * high.abs() && low < 0.0 {
            let most = high.max(-low);
            Self { low: -most, high: most }
        } else {
            Self { low: 0.0, high }
        };
        // No pressure anywhere: any range shows that.
        if range.high - range.low > 1e-9 { range } else { Self { low: 0.0, high: 1.0 } }
    }

    /// Colour of a pressure in Pa; those beyond the ends look like the ends.
    pub fn color(&self, pressure: f64) -> RGBColor {
        let share = (pressure - self.low) / (self.high - self.low);
        if self.low < 0.0 { between(&BLUE_RED, share) } else { between(&VIRIDIS, share) }
    }
}

/// Linear interpolation between colours at equal distances.
fn between(colors: &[[u8; 3]], share: f64) -> RGBColor {
    let at = share.clamp(0.0, 1.0) * (colors.len() - 1) as f64;
    let (below, above) = (at.floor() as usize, at.ceil() as usize);
    let mix = |channel: usize| {
        let [from, to] = [below, above].map(|k| f64::from(colors[k][channel]));
        (from + (to - from) * at.fract()).round() as u8
    };
    RGBColor(mix(0), mix(1), mix(2))
}

/// The same colour, darker.
pub(super) fn darker(RGBColor(r, g, b): RGBColor) -> RGBColor {
    let [r, g, b] = [r, g, b].map(|c| (u16::from(c) * 7 / 10) as u8);
    RGBColor(r, g, b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_ignore_wild_particles_and_fit_any_field() {
        let mut field: Vec<f64> = (0..=1000).map(f64::from).collect();
        field.push(1e9);
        assert_eq!(ColorScale::of(field), ColorScale { low: 0.0, high: 996.0 });
        assert_eq!(ColorScale::of([-50.0, 0.0, 100.0]), ColorScale { low: -100.0, high: 100.0 });
        assert_eq!(ColorScale::of([-1.0, 0.0, 100.0]), ColorScale { low: 0.0, high: 100.0 });
        for flat in [&[][..], &[0.0], &[f64::NAN, f64::INFINITY]] {
            assert_eq!(ColorScale::of(flat.iter().copied()), ColorScale { low: 0.0, high: 1.0 });
        }
        assert_eq!(ColorScale::of([7.0, 7.0]), ColorScale { low: 0.0, high: 7.0 });
        assert_eq!(ColorScale::of([-7.0]), ColorScale { low: -7.0, high: 7.0 });
    }

    #[test]
    fn ends_have_the_end_colours() {
        let scale = ColorScale { low: 0.0, high: 10.0 };
        assert_eq!(scale.color(-1.0), RGBColor(68, 1, 84));
        assert_eq!(scale.color(0.0), scale.color(-1.0));
        assert_eq!(scale.color(99.0), RGBColor(253, 231, 37));
        assert_eq!(ColorScale { low: -1.0, high: 1.0 }.color(0.0), RGBColor(225, 225, 225));
    }
}
