//! Fewer points, same picture.

/// Most columns that a chart over time tells apart.
const COLUMNS: usize = 500;

/// Keeps of the points in each of [`COLUMNS`] equal intervals of x the first, last, lowest and highest: peaks and gaps
/// (`None`) survive.
///
/// Points come in order of x; short series are returned as they are.
pub fn envelope(points: Vec<Option<(f64, f64)>>) -> Vec<Option<(f64, f64)>> {
    if points.len() <= 2 * COLUMNS {
        return points;
    }
    let xs = || points.iter().flatten().map(|p| p.0);
    let (Some(first), Some(last)) = (xs().next(), xs().next_back()) else { return Vec::new() };
    let column = |x: f64| ((x - first) / (last - first).max(f64::MIN_POSITIVE) * COLUMNS as f64) as usize;
    let mut out = Vec::new();
    let mut start = 0;
    while start < points.len() {
        let Some((x, _)) = points[start] else {
            if out.last().is_some_and(Option::is_some) {
                out.push(None);
            }
            start += 1;
            continue;
        };
        let len = points[start..].iter().take_while(|p| p.is_some_and(|p| column(p.0) == column(x))).count();
        let run = &points[start..start + len];
        let by_value = |a: &&Option<(f64, f64)>, b: &&Option<(f64, f64)>| {
            a.map_or(0.0, |p| p.1).total_cmp(&b.map_or(0.0, |p| p.1))
        };
        let index = |found: Option<&Option<(f64, f64)>>| {
            found.and_then(|f| run.iter().position(|p| core::ptr::eq(p, f))).unwrap_or(0)
        };
        let mut keep = [0, index(run.iter().min_by(by_value)), index(run.iter().max_by(by_value)), len - 1].to_vec();
        keep.sort_unstable();
        keep.dedup();
        out.extend(keep.into_iter().map(|i| run[i]));
        start += len;
    }
    out
}

/// The outer edge of a band (x, low, high) in each of [`COLUMNS`] intervals of x.
pub fn envelope_band(points: Vec<Option<(f64, f64, f64)>>) -> Vec<Option<(f64, f64, f64)>> {
    if points.len() <= 2 * COLUMNS {
        return points;
    }
    let size = points.len().div_ceil(COLUMNS);
    points
        .chunks(size)
        .map(|run| run.iter().flatten().copied().reduce(|a, b| (a.0, a.1.min(b.1), a.2.max(b.2))))
        .collect()
}

/// Drops points that are within a third of a drawing unit of the last one kept (they do not move a line visibly), and of the
/// rest keeps about `max`, evenly.
///
/// The first and the last point stay, and so do gaps (`None`).
pub fn thinned(points: &[Option<(f64, f64)>], max: usize) -> Vec<Option<(f64, f64)>> {
    let mut out: Vec<Option<(f64, f64)>> = Vec::new();
    for p in points {
        match (p, out.last()) {
            (None, None | Some(None)) => {}
            (Some((x, y)), Some(Some((kx, ky)))) if (x - kx).hypot(y - ky) < 1.0 / 3.0 => {}
            _ => out.push(*p),
        }
    }
    let every = out.len().div_ceil(max.max(1));
    if every > 1 {
        out = out
            .into_iter()
            .enumerate()
            .filter(|(i, p)| p.is_none() || i.is_multiple_of(every))
            .map(|(_, p)| p)
            .collect();
    }
    // A trail ends where it ends.
    if let Some(last) = points.last().filter(|p| p.is_some() && out.last() != Some(*p)) {
        out.push(*last);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn envelope_keeps_a_single_peak_and_gaps_of_a_long_series() {
        let mut points: Vec<_> = (0..100_000).map(|i| Some((f64::from(i), 1.0))).collect();
        points[61_234] = Some((61_234.0, 9.0));
        points[70_000] = None;
        let kept = envelope(points);
        assert!(kept.len() <= 4 * (COLUMNS + 2), "{}", kept.len());
        assert!(kept.contains(&Some((61_234.0, 9.0))) && kept.contains(&None));
        assert_eq!((kept[0], *kept.last().unwrap()), (Some((0.0, 1.0)), Some((99_999.0, 1.0))));
    }

    #[test]
    fn band_covers_every_point_of_its_column() {
        let points: Vec<_> = (0..10_000).map(|i| Some((f64::from(i), -f64::from(i % 7), f64::from(i % 5)))).collect();
        let kept = envelope_band(points);
        assert!(kept.len() <= COLUMNS && kept.iter().all(|p| p.is_some_and(|p| p.1 == -6.0 && p.2 == 4.0)));
    }

    #[test]
    fn thinning_bounds_the_number_and_keeps_ends() {
        let points: Vec<_> = (0..50_000).map(|i| Some((f64::from(i) * 0.01, f64::from(i % 100)))).collect();
        let kept = thinned(&points, 1000);
        assert!((500..=1001).contains(&kept.len()), "{}", kept.len());
        assert_eq!((kept[0], kept.last()), (points[0], points.last()));
    }
}
