//! Figures 1–4 of \[FMS19\]: three plots for each shape of the acceleration, the first in two readings.

use super::Effort;
use super::experiment::{Design, ESTIMATORS, LAG, RUNS, Shape, WINDOW, experiment};
use crate::papers::{Curve, Figure, FigureKind};

/// Our curves for the figure of a shape: those of its first experiment.
pub fn figures(design: &Design, effort: &Effort, shape: Shape) -> Vec<Figure> {
    let curves = experiment(design, effort, shape, 0);
    let place = format!("Figure {}", shape as usize + 1);
    let name = shape.name();
    let triples = |values: &[[f64; 3]]| -> Vec<Curve> {
        ESTIMATORS
            .iter()
            .enumerate()
            .map(|(j, name)| curve(name, values.iter().enumerate().map(|(i, v)| [(i + WINDOW) as f64, v[j]])))
            .collect()
    };
    let [smoother, filter, kalman] = design.deviations();
    let figure = |part: &str, caption: String, y: &str, curves: Vec<Curve>| Figure {
        place: format!("{place}, {part}"),
        caption,
        x: "step i".to_owned(),
        y: y.to_owned(),
        kind: FigureKind::Lines,
        curves,
    };
    let mut acceleration = vec![curve("truth", curves.truth.iter().enumerate().map(|(i, a)| [i as f64, *a]))];
    for (j, name) in ESTIMATORS.iter().enumerate() {
        let delay = if j == 0 { LAG } else { 0 };
        let points = curves.acceleration.iter().enumerate().map(|(i, a)| [(i + WINDOW - delay) as f64, a[j]]);
        acceleration.push(curve(name, points));
    }
    vec![
        figure(
            "first plot",
            format!(
                "Root mean square over {RUNS} runs of the position error, {name} acceleration: the plot by the letter of the text. It \
                 stays near the standard deviations that theory foretells, {smoother:.3}, {filter:.3} and {kalman:.3} m, and rises after a \
                 jump."
            ),
            "RMS position error [m]",
            triples(&curves.rms),
        ),
        figure(
            "first plot, another reading",
            format!(
                "Magnitude of the mean position error over the same {RUNS} runs. Its time means are the numbers of Table 2; if the paper's \
                 first plot stays below about 0.2 m away from the jumps, this is what was plotted."
            ),
            "|mean position error| [m]",
            triples(&curves.of_mean),
        ),
        figure(
            "second plot",
            format!(
                "Position error of one run. With the model, Q and R of the paper 95 of 100 errors of the FMS filter are within ±{:.2} m, of \
                 the smoother within ±{:.2} m, while the acceleration is constant.",
                1.96 * filter,
                1.96 * smoother
            ),
            "position error [m]",
            triples(&curves.single),
        ),
        figure(
            "third plot",
            format!(
                "The acceleration as estimated in one run; the smoother's estimate, {LAG} steps late, stands at its own time."
            ),
            "acceleration [m/s²]",
            acceleration,
        ),
    ]
}

fn curve(name: &str, points: impl Iterator<Item = [f64; 2]>) -> Curve {
    Curve { name: name.to_owned(), points: points.collect(), joined: true }
}
