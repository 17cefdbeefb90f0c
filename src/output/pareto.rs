//! Which of many points are best: nobody is better in everything.

/// For each point (cost, error) whether no other costs as little and errs as little. None: it has no place.
pub fn front(points: &[Option<(f64, f64)>]) -> Vec<bool> {
    let beats = |a: &(f64, f64), b: &(f64, f64)| a.0 <= b.0 && a.1 <= b.1 && a != b;
    let known = || points.iter().flatten().filter(|(x, y)| x.is_finite() && y.is_finite());
    let is_best = |point: &Option<(f64, f64)>| {
        point.is_some_and(|p| p.0.is_finite() && p.1.is_finite() && !known().any(|other| beats(other, &p)))
    };
    points.iter().map(is_best).collect()
}

#[cfg(test)]
mod tests {
    use super::front;

    #[test]
    fn the_best_are_those_that_nobody_beats() {
        let points = [(1.0, 9.0), (2.0, 5.0), (2.0, 6.0), (3.0, 5.0), (4.0, 1.0)].map(Some);
        assert_eq!(front(&points), [true, true, false, false, true]);
        assert_eq!(
            front(&[None, Some((1.0, f64::NAN)), Some((1.0, 1.0)), Some((1.0, 1.0))]),
            [false, false, true, true]
        );
        assert!(front(&[]).is_empty());
    }
}
