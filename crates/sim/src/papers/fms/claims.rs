//! What \[FMS19\] states of its algorithm, held against the gain (14) and the model (15), (16).

use super::experiment::{Design, HEIGHT, INTERVAL_S, LAG, Numbers, STEPS, WINDOW, gain};
use super::{Effort, stream};
use crate::papers::{Entry, Measured, WITHIN, normal};
use fixtrail_core::estimators::diffuse::Diffuse;
use fixtrail_core::models::FmsPaper;
use fixtrail_core::{Belief, Matrix, Row, Vector};

/// Number of states.
const N: usize = 3;
/// Rows of Γ̄.
const ROWS: usize = WINDOW + N;
/// What rounding may leave of an exact identity.
const EXACT: f64 = 1e-9;
/// A ratio of errors below this is a remarkable gain.
const REMARKABLE: f64 = 0.9;
/// A bias below this has settled, metres.
const SETTLED_M: f64 = 1e-3;

/// The statements of section 2, up to the cost.
pub fn of_the_algorithm(design: &Design, effort: &Effort) -> Vec<Entry> {
    let (printed, corrected) = lagged_state(design, effort);
    let ((correlation, at_5), (_, at_1)) = (noise(design, LAG), noise(design, 1));
    let unbiased = bias(design, design.model.c, WINDOW, LAG).unwrap_or(f64::INFINITY);
    let longest = (N..=WINDOW).filter_map(|m| bias(design, design.model.c, m, LAG.min(m - 2))).fold(0.0, f64::max);
    let acceleration_only = bias(design, Vector::from([0.0, 0.0, 1.0]), WINDOW, LAG);
    let (repeated, [fms, kalman]) = (time_invariance(design, effort), outlier(design));
    vec![
        Entry::claim(
            "eq. (5)",
            "the lagged state is A^−d x_i − Ξ̃ U − Λ̃ W",
            printed < EXACT,
            format!("the sign is wrong for Λ̃ as defined: with + Λ̃ W the two sides agree to {corrected:.0e}"),
        )
        .literally(Measured::exact(printed)),
        Entry::claim(
            "eq. (6)",
            "the noise of the joint regression is white",
            correlation < EXACT,
            "its mean is zero, but Λ̄ W spreads each w over many rows: the largest correlation between two rows is given"
                .to_owned(),
        )
        .literally(Measured::exact(correlation)),
        Entry::claim(
            "eq. (7)",
            "Π is positive definite",
            at_5 > 1e-12 && at_1 > 1e-12,
            format!(
                "its smallest eigenvalue, of unit diagonal, is {at_5:.1e} at d = 5 but {} at d = 1: it is definite only if [G, AG, …, \
                 A^{{d−1}}G] has rank 3. The gain is designed here without inverting Π",
                if at_1 > 1e-12 { format!("{at_1:.1e}") } else { "0".to_owned() }
            ),
        )
        .literally(Measured::exact(if at_1 > 1e-12 { at_1 } else { 0.0 })),
        Entry::claim(
            "eq. (11)",
            "filter and smoother are unbiased",
            unbiased < EXACT,
            "largest relative deviation of H Γ̄ from the identity".to_owned(),
        )
        .literally(Measured::exact(unbiased)),
        Entry::claim(
            "Theorem 1",
            "exact for noise-free data (deadbeat), tracking target, M = 3 … 15",
            longest < EXACT,
            "largest relative error of both estimates over all window lengths from n = 3".to_owned(),
        )
        .literally(Measured::exact(longest)),
        Entry::claim(
            "Theorem 1",
            "M ≥ n is enough for that",
            acceleration_only.is_some_and(|v| v < EXACT),
            "not for every system: with C = [0 0 1] a window of 15 shows the acceleration only. The window's observability matrix must \
             have rank n"
                .to_owned(),
        ),
        Entry::claim(
            "section 2",
            "one gain serves all windows (time-invariance)",
            repeated < 1e-6,
            "largest difference, in standard deviations, between the gain designed once and an exact pass over each of 785 windows; \
             true while no measurement is lost"
                .to_owned(),
        )
        .literally(Measured::exact(repeated)),
        Entry::claim(
            "section 2",
            "finite memory makes it robust against temporary uncertainties",
            fms == 0.0 && kalman > 0.0,
            format!(
                "what an outlier has done to the filter is gone after {WINDOW} steps, to the last bit; the Kalman filter keeps {kalman:.1e} \
                 of it at that time"
            ),
        )
        .literally(Measured::exact(fms)),
    ]
}

/// What section 3 says of the simulations; `numbers` are those of the experiments with a step, and with a ramp.
pub fn of_the_simulations(design: &Design, numbers: &[(&str, Vec<Numbers>)]) -> Vec<Entry> {
    const MEAN: &str = "magnitude of the mean error over the 30 runs";
    let ratio = |of: &[Numbers], f: &dyn Fn(&Numbers) -> f64| Measured::of(&of.iter().map(f).collect::<Vec<_>>());
    let below = |m: &Measured, limit: f64| m.mean + WITHIN * m.se < limit;
    let mut out = Vec::new();
    for (name, of) in numbers {
        let (whole, read) = (ratio(of, &|n| n.rms[1] / n.rms[2]), ratio(of, &|n| n.of_mean[1] / n.of_mean[2]));
        out.push(
            Entry::claim(
                "Table 2",
                &format!("FMS filter below Kalman filter, {name}"),
                below(&whole, 1.0),
                "ratio of the two over the whole run: averaging errors before taking magnitudes hides noise and exposes bias, which favours the window"
                    .to_owned(),
            )
            .literally(whole)
            .holds_read_as(MEAN, read, below(&read, 1.0)),
        );
    }
    for (name, of) in numbers {
        let after = ratio(of, &|n| n.rms_after[1] / n.rms_after[2]);
        let read = ratio(of, &|n| n.of_mean_after[1] / n.of_mean_after[2]);
        out.push(
            Entry::claim(
                "section 3",
                &format!("FMS filter outperforms Kalman filter when the acceleration suddenly changes, {name}"),
                below(&after, 1.0),
                "ratio of root mean square errors over the 30 steps after a jump".to_owned(),
            )
            .literally(after),
        );
        out.push(
            Entry::claim(
                "section 3",
                &format!("remarkably smaller error there, {name}"),
                below(&after, REMARKABLE),
                "the same ratio; below 0.9 counts as remarkable".to_owned(),
            )
            .literally(after)
            .holds_read_as(MEAN, read, below(&read, REMARKABLE)),
        );
    }
    let [fms, kalman] = settling(design);
    out.push(
        Entry::claim(
            "section 3",
            "at constant acceleration the error of the FMS filter converges much faster",
            2 * fms <= kalman,
            format!(
                "after a jump of 0.2 m/s² its bias is below 1 mm after {fms} steps, the Kalman filter's after {kalman}"
            ),
        )
        .literally(Measured::exact(fms as f64)),
    );
    let [smoother, filter, _] = design.deviations();
    out.push(
        Entry::claim(
            "section 1",
            "with a delay d the smoother is more accurate than the filter",
            smoother < filter,
            format!(
                "standard deviations {smoother:.4} m and {filter:.4} m. Most of that is the step from predicting x_i (z_i is not used) to \
                 estimating with a measurement at hand: a Kalman filter that uses z_i has {:.4} m",
                design.filtered[(0, 0)].sqrt()
            ),
        )
        .literally(Measured::exact(smoother / filter)),
    );
    out
}

/// Table 1 for n = 3 states, M = 15, d = 5, one measurement component.
pub fn of_the_cost(design: &Design) -> Vec<Entry> {
    use crate::papers::Verdict::NotReproducible;
    let scalars = design.gain.z.len();
    let fms = (2 * N * scalars) as f64;
    let kalman = steady_multiplications(N, LAG) as f64;
    let place = "Table 1";
    let exact = |n: usize| Measured::exact(n as f64);
    vec![
        Entry::number(place, "multiplications of the FMS filter, n × M", (45.0, 0), NotReproducible)
            .literally(exact(N * scalars))
            .because(format!("additions, {} of them, are not counted", N * (scalars - 1))),
        Entry::number(place, "multiplications of the FMS smoother, n × M", (45.0, 0), NotReproducible)
            .literally(exact(N * scalars))
            .because("filter and smoother together need twice that"),
        Entry::number(place, "flops of the fixed-lag Kalman smoother, 4n³ + 8n² + 6n + 1", (199.0, 0), NotReproducible)
            .read_as("gains computed once, as those of the FMS are: n² + 2n + nd", Measured::exact(kalman))
            .because(
                "the formula is that of a textbook and does not depend on d; it charges for gains at every step, which are constants for \
                 this system",
            ),
        Entry::number(place, "memory shifts of the FMS, M − 1", (14.0, 0), NotReproducible)
            .literally(exact(scalars - 1))
            .because("none with a ring buffer"),
        Entry::number(place, "memory of the FMS, M", (15.0, 0), NotReproducible)
            .literally(exact(scalars))
            .because(format!("the gains need {} numbers more", 2 * N * scalars)),
        Entry::number(place, "memory of the fixed-lag Kalman smoother, d", (5.0, 0), NotReproducible)
            .literally(exact(LAG))
            .because("d innovations"),
        Entry::claim(
            "section 2",
            "FMS filter and smoother need much less computation than the fixed-lag Kalman smoother",
            fms < kalman,
            format!("{fms} multiplications for both estimates against {kalman} with the gains of the steady state"),
        )
        .literally(Measured::exact(fms / kalman)),
    ]
}

/// Multiplications per step of a Kalman filter and fixed-lag smoother with constant gains, one measured component that is a state:
/// A x has n² entries, K e has n, and each of d + 1 smoothed states adds n for K_j e of which the filter's is K e itself.
fn steady_multiplications(n: usize, lag: usize) -> usize {
    n * n + n + n * (lag + 1)
}

/// Largest deviation of the estimates from x_i and x_{i−d} for noise-free data of unit first states, relative to the largest entry of the
/// state; nothing when the window does not determine them.
fn bias(design: &Design, c: Vector<3>, window: usize, lag: usize) -> Option<f64> {
    let gain = gain(&design.leap, c, window, lag)?;
    let mut worst: f64 = 0.0;
    for j in 0..N {
        let mut states = vec![Vector::<3>::zeros()];
        states[0][j] = 1.0;
        (0..window).for_each(|i| states.push(design.leap.f * states[i]));
        let z: Vec<f64> = states[..window].iter().map(|x| c.dot(x)).collect();
        let (filter, smoother) = gain.apply(&z, &[]);
        for (estimate, i) in [(filter, window), (smoother, window - lag)] {
            worst = worst.max((estimate - states[i]).amax() / states[i].amax());
        }
    }
    Some(worst)
}

/// `A^−k`: A is that of an interval, its inverse that of the interval backwards.
fn backwards(steps: usize) -> Matrix<3, 3> {
    FmsPaper::new(-INTERVAL_S * steps as f64).a
}

/// Largest correlation between two rows of the noise of (6), and the smallest eigenvalue of its covariance Π scaled to unit diagonal.
fn noise(design: &Design, lag: usize) -> (f64, f64) {
    let mut spread = Matrix::<ROWS, { 2 * WINDOW }>::zeros();
    for column in 0..WINDOW {
        for row in 0..=column {
            let block = -(backwards(column - row + 1) * design.model.g);
            spread.fixed_view_mut::<1, 2>(row, 2 * column).copy_from(&block.row(0));
        }
        if column >= WINDOW - lag {
            let block = -(backwards(column + lag - WINDOW + 1) * design.model.g);
            spread.fixed_view_mut::<3, 2>(WINDOW, 2 * column).copy_from(&block);
        }
    }
    let mut scaled = spread;
    for column in 0..2 * WINDOW {
        let var = design.model.q[(column % 2, column % 2)];
        (0..ROWS).for_each(|row| scaled[(row, column)] *= var);
    }
    let mut pi = scaled * spread.transpose();
    (0..WINDOW).for_each(|i| pi[(i, i)] += design.model.r);
    let correlations = Matrix::<ROWS, ROWS>::from_fn(|i, j| pi[(i, j)] / (pi[(i, i)] * pi[(j, j)]).sqrt());
    let apart = |i: usize, j: usize| if i == j { 0.0 } else { correlations[(i, j)].abs() };
    let largest = (0..ROWS).flat_map(|i| (0..ROWS).map(move |j| apart(i, j))).fold(0.0, f64::max);
    (largest, correlations.symmetric_eigenvalues().min())
}

/// Largest relative deviation between the two sides of (5), as printed and with the other sign, for a path with random w.
fn lagged_state(design: &Design, effort: &Effort) -> (f64, f64) {
    let mut rng = stream(effort, 100, 0, 0);
    let mut x = Vector::<3>::repeat(1.0);
    let (mut lagged, mut w_part) = (x, Vector::<3>::zeros());
    for k in 0..WINDOW {
        if k == WINDOW - LAG {
            lagged = x;
        }
        let w: Vector<3> = design.model.g * Vector::<2>::from_fn(|_, _| normal(&mut rng));
        if k >= WINDOW - LAG {
            // Λ̃ W: blocks −A⁻¹G … −A^−d G.
            w_part -= backwards(k + LAG + 1 - WINDOW) * w;
        }
        x = design.leap.f * x + w;
    }
    let deviation = |side: Vector<3>| (lagged - side).amax() / lagged.amax();
    (deviation(backwards(LAG) * x - w_part), deviation(backwards(LAG) * x + w_part))
}

/// Largest difference between the gain and an exact pass over each window of a run, in standard deviations of the filter's position.
fn time_invariance(design: &Design, effort: &Effort) -> f64 {
    let mut rng = stream(effort, 101, 0, 0);
    let z: Vec<f64> = (0..STEPS).map(|_| normal(&mut rng)).collect();
    let sd = design.deviations()[1];
    let pass = |window: &[f64]| {
        let mut pass = Diffuse::start();
        for z in window {
            let row = Row { h: design.model.c, residual: *z, var: design.model.r };
            pass.update(&row).ok()?;
            pass.leap(&design.leap.f, &Vector::zeros(), &design.leap.q);
        }
        pass.solve().filter
    };
    let difference = |window: &[f64]| {
        pass(window).map_or(f64::INFINITY, |exact| (exact.mean[0] - design.estimate(window).0[0]).abs() / sd)
    };
    z.windows(WINDOW).map(difference).fold(0.0, f64::max)
}

/// What an outlier of 1 m leaves in the FMS filter and in the Kalman filter, 15 steps after its last use.
fn outlier(design: &Design) -> [f64; 2] {
    let at = 20;
    let z: Vec<f64> = (0..=at + WINDOW).map(|i| if i == at { 1.0 } else { 0.0 }).collect();
    let kalman = z.iter().fold(design.start(), |belief, z| design.kalman(&belief, *z));
    [design.estimate(&z[at + 1..]).0[0].abs(), kalman.mean[0].abs()]
}

/// Steps after a jump of the acceleration from which on the bias stays below 1 mm: FMS filter and Kalman filter.
fn settling(design: &Design) -> [usize; 2] {
    let (jump, steps) = (WINDOW, 200);
    let mut x = Vector::<3>::zeros();
    let (mut states, mut z) = (Vec::new(), Vec::new());
    for i in 0..steps {
        x[2] = if i >= jump { HEIGHT } else { 0.0 };
        states.push(x);
        z.push(x[0]);
        x = design.leap.f * x;
    }
    let mut last = [0; 2];
    let mut kalman: Belief<3> = design.start();
    for i in 0..steps {
        if i >= WINDOW {
            let estimates = [design.estimate(&z[i - WINDOW..i]).0[0], kalman.mean[0]];
            for (last, estimate) in last.iter_mut().zip(estimates) {
                if (estimate - states[i][0]).abs() >= SETTLED_M {
                    *last = i - jump;
                }
            }
        }
        kalman = design.kalman(&kalman, z[i]);
    }
    last.map(|l| l + 1)
}
