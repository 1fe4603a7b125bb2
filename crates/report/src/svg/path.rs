//! Path data: coordinates with one decimal, breaks where there is nothing to draw.

use super::Scale;
use core::fmt::Write;

fn place(out: &mut String, command: char, x: f64, y: f64) {
    out.push(command);
    for (i, v) in [x, y].into_iter().enumerate() {
        let rounded = (v * 10.0).round() / 10.0;
        // Writing to a string cannot fail.
        let _ = write!(out, "{}{}", if i == 0 { "" } else { " " }, rounded + 0.0);
    }
}

fn finite(x: f64, y: f64) -> bool {
    x.is_finite() && y.is_finite()
}

/// A polyline through `points`, broken at `None`.
pub fn line(points: &[Option<(f64, f64)>], x: Scale, y: Scale) -> String {
    let mut out = String::new();
    let mut pen = 'M';
    for point in points {
        match point.map(|(a, b)| (x.at(a), y.at(b))).filter(|(a, b)| finite(*a, *b)) {
            Some((a, b)) => {
                place(&mut out, pen, a, b);
                pen = 'L';
            }
            None => pen = 'M',
        }
    }
    out
}

/// Filled bands between (x, low) and (x, high), broken at `None`.
pub fn area(points: &[Option<(f64, f64, f64)>], x: Scale, y: Scale) -> String {
    let mut out = String::new();
    for run in points.split(Option::is_none) {
        let run: Vec<_> = run
            .iter()
            .flatten()
            .map(|(a, low, high)| (x.at(*a), y.at(*low), y.at(*high)))
            .filter(|(a, low, high)| finite(*a, *low) && high.is_finite())
            .collect();
        if run.len() < 2 {
            continue;
        }
        for (i, (a, low, _)) in run.iter().enumerate() {
            place(&mut out, if i == 0 { 'M' } else { 'L' }, *a, *low);
        }
        for (a, _, high) in run.iter().rev() {
            place(&mut out, 'L', *a, *high);
        }
        out.push('Z');
    }
    out
}

/// Points as strokes of no length, to be drawn with round ends.
pub fn dots(points: &[(f64, f64)], x: Scale, y: Scale) -> String {
    let mut out = String::new();
    for (a, b) in points.iter().map(|(a, b)| (x.at(*a), y.at(*b))).filter(|(a, b)| finite(*a, *b)) {
        place(&mut out, 'M', a, b);
        out.push_str("h0");
    }
    out
}

/// Horizontal strokes at height `y` over the intervals, joined where they are less than half a unit apart.
pub fn bars(intervals: impl IntoIterator<Item = (f64, f64)>, x: Scale, y: f64) -> String {
    let mut out = String::new();
    let mut open: Option<(f64, f64)> = None;
    let mut put = |(from, to): (f64, f64)| {
        place(&mut out, 'M', from, y);
        // At least one unit wide, or a lone packet would not be seen.
        let _ = write!(out, "h{}", ((to - from).max(1.0) * 10.0).round() / 10.0);
    };
    for (from, to) in intervals {
        let (from, to) = (x.at(from), x.at(to).min(x.to));
        if !finite(from, to) {
            continue;
        }
        open = match open {
            Some((start, end)) if from <= end + 0.5 => Some((start, end.max(to))),
            Some(done) => {
                put(done);
                Some((from, to))
            }
            None => Some((from, to)),
        };
    }
    if let Some(done) = open {
        put(done);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unit() -> Scale {
        Scale::linear([0.0, 100.0], [0.0, 100.0])
    }

    #[test]
    fn lines_break_where_there_is_nothing_to_draw() {
        let points = [Some((0.0, 1.0)), Some((1.25, 2.0)), None, Some((f64::NAN, 1.0)), Some((3.0, 4.0))];
        assert_eq!(line(&points, unit(), unit()), "M0 1L1.3 2M3 4");
    }

    #[test]
    fn areas_close_and_single_points_have_none() {
        let points = [Some((0.0, 1.0, 2.0)), Some((5.0, 1.0, 3.0)), None, Some((7.0, 0.0, 1.0))];
        assert_eq!(area(&points, unit(), unit()), "M0 1L5 1L5 3L0 2Z");
    }

    #[test]
    fn bars_join_neighbours_and_show_holes() {
        let intervals = [(0.0, 10.0), (10.2, 20.0), (30.0, 30.1), (95.0, 120.0)];
        assert_eq!(bars(intervals, unit(), 8.0), "M0 8h20M30 8h1M95 8h5");
        assert_eq!(dots(&[(1.0, 2.0), (f64::INFINITY, 0.0)], unit(), unit()), "M1 2h0");
    }
}
