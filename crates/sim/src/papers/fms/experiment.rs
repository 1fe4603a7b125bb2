//! The simulations of \[FMS19, section 3\]: 30 runs of 800 steps of one target whose acceleration has a given shape.
//!
//! ```text
//! p⁺ = p + T v + T²/2 a + T/2 w₁      v⁺ = v + T a + w₁      a: the shape      z = p + noise
//! ```
//!
//! with the T, Q and R of the paper; w₂ is not drawn, as the acceleration is what the shape says. The paper does not print its shapes: the
//! height of 0.2 m/s² is fitted to its Table 2, when things happen is a guess.

use super::{Effort, stream};
use crate::papers::normal;
use fixtrail_core::estimators::fms::Align;
use fixtrail_core::estimators::fms::gain::{Gain, Invariant, Shape as Window};
use fixtrail_core::estimators::kalman::{Robust, predict, update};
use fixtrail_core::models::FmsPaper;
use fixtrail_core::riccati::Lossy;
use fixtrail_core::storage::Fixed;
use fixtrail_core::{Belief, Matrix, Row, Transition, Vector};
use rand_distr::{Distribution, Uniform};
use rand_pcg::Pcg64;

/// T, seconds.
pub const INTERVAL_S: f64 = 2.0;
/// M.
pub const WINDOW: usize = 15;
/// d.
pub const LAG: usize = 5;
/// Runs of one experiment.
pub const RUNS: usize = 30;
/// Steps of one run.
pub const STEPS: usize = 800;
/// Height of the accelerations, m/s²: fitted to Table 2.
pub const HEIGHT: f64 = 0.2;
/// Peak to peak of the random acceleration, m/s², and steps between its knots: fitted to Table 2.
const RANDOM_SPAN: f64 = 0.16;
const KNOTS_APART: usize = 50;
/// Instants after a jump that count as after it.
const AFTER: usize = 30;

/// The rows of Table 2, and the order of every triple here.
pub const ESTIMATORS: [&str; 3] = ["FMS smoother", "FMS filter", "Kalman filter"];

/// How the target accelerates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// 0, `HEIGHT` from step 200, 0 from step 600.
    Step,
    /// Rises from step 200 to 400, then drops to 0.
    Ramp,
    /// Rises from step 200 to 400, falls to step 600.
    Triangle,
    /// Straight between random values every 50 steps.
    Random,
}

impl Shape {
    /// In the order of the figures.
    pub const ALL: [Shape; 4] = [Shape::Step, Shape::Ramp, Shape::Triangle, Shape::Random];

    /// The name in Table 2.
    pub fn name(self) -> &'static str {
        match self {
            Shape::Step => "step",
            Shape::Ramp => "ramp",
            Shape::Triangle => "triangle",
            Shape::Random => "random",
        }
    }

    /// Steps at which the acceleration jumps.
    pub fn jumps(self) -> &'static [usize] {
        match self {
            Shape::Step => &[200, 600],
            Shape::Ramp => &[400],
            Shape::Triangle | Shape::Random => &[],
        }
    }

    /// Returns the acceleration at every step.
    fn acceleration(self, rng: &mut Pcg64) -> Vec<f64> {
        let rise = |i: usize| HEIGHT * (i as f64 - 200.0) / 200.0;
        let of = |f: &dyn Fn(usize) -> f64| (0..STEPS).map(f).collect();
        match self {
            Shape::Step => of(&|i| if (200..600).contains(&i) { HEIGHT } else { 0.0 }),
            Shape::Ramp => of(&|i| if (200..400).contains(&i) { rise(i) } else { 0.0 }),
            Shape::Triangle => of(&|i| match i {
                200..400 => rise(i),
                400..600 => 2.0 * HEIGHT - rise(i),
                _ => 0.0,
            }),
            Shape::Random => {
                let uniform = Uniform::new(0.0, 1.0).expect("0 is below 1");
                let knots: Vec<f64> = (0..=STEPS / KNOTS_APART).map(|_| uniform.sample(rng)).collect();
                let (low, high) = knots.iter().fold((1.0_f64, 0.0_f64), |(l, h), v| (l.min(*v), h.max(*v)));
                let value = |k: f64| RANDOM_SPAN * ((k - low) / (high - low) - 0.5);
                of(&|i| {
                    let (knot, part) = (i / KNOTS_APART, (i % KNOTS_APART) as f64 / KNOTS_APART as f64);
                    value(knots[knot]) * (1.0 - part) + value(knots[knot + 1]) * part
                })
            }
        }
    }
}

/// The model, and what is designed for it once.
pub struct Design {
    /// (15) and (16).
    pub model: FmsPaper,
    /// A and G Q Gᵀ.
    pub leap: Transition<3>,
    /// The gain (14) of filter and smoother, for measurements in units of their standard deviation.
    pub gain: Gain<3, Fixed<WINDOW>>,
    /// Covariance of the Kalman filter's prediction in the steady state.
    pub steady: Matrix<3, 3>,
    /// And of its estimate with the newest measurement.
    pub filtered: Matrix<3, 3>,
}

impl Design {
    /// For the paper's numbers.
    pub fn new() -> Design {
        let model = FmsPaper::new(INTERVAL_S);
        let motion = model.motion();
        let leap = Transition { next: Vector::zeros(), f: motion.a, q: motion.q };
        let gain = gain(&leap, model.c / model.r.sqrt(), WINDOW, LAG).expect("15 positions determine three states");
        let system = Lossy::new(&motion.a, &motion.q, &[model.c], &[model.r]).expect("the variance is positive");
        let steady = system.upper_bound(1.0).expect("the position shows all three states");
        Design { model, leap, gain, steady, filtered: system.filtered(&steady, 1.0) }
    }

    /// Standard deviations of the position error that theory foretells, for [`ESTIMATORS`].
    pub fn deviations(&self) -> [f64; 3] {
        let sd = |b: &Option<Belief<3>>| b.as_ref().map_or(f64::NAN, |b| b.cov[(0, 0)].sqrt());
        [sd(&self.gain.joint.lagged), sd(&self.gain.joint.filter), self.steady[(0, 0)].sqrt()]
    }

    /// Returns x̂_i and x̂_{i−d} from the measurements of a full window.
    pub fn estimate(&self, window: &[f64]) -> (Vector<3>, Vector<3>) {
        let mut white = [0.0; WINDOW];
        for (w, z) in white.iter_mut().zip(window) {
            *w = z / self.model.r.sqrt();
        }
        self.gain.apply(&white, &[])
    }

    /// The Kalman filter's step from one prediction to the next.
    pub fn kalman(&self, prior: &Belief<3>, z: f64) -> Belief<3> {
        let row = Row { h: self.model.c, residual: z - prior.mean[0], var: self.model.r };
        let (posterior, _) = update(prior, &[row], Robust::None).expect("the variance is that of a steady state");
        predict(&posterior, &Transition { next: self.leap.f * posterior.mean, ..self.leap })
    }

    /// The Kalman filter's start: the first state is known to be 0.
    pub fn start(&self) -> Belief<3> {
        Belief { mean: Vector::zeros(), cov: self.steady }
    }
}

/// Designs the gain in the paper's alignment; nothing when a full window does not determine the states.
pub fn gain(leap: &Transition<3>, row: Vector<3>, window: usize, lag: usize) -> Option<Gain<3, Fixed<WINDOW>>> {
    let shape = Window { window, lag, align: Align::Predicted };
    Gain::design(&Invariant { leap, rows: &[row], b: &[] }, shape).ok().flatten()
}

/// What the figures show of one experiment; the first entry is that of step [`WINDOW`].
pub struct Curves {
    /// Root mean square of the position error over the runs.
    pub rms: Vec<[f64; 3]>,
    /// Magnitude of the mean of the position error over the runs.
    pub of_mean: Vec<[f64; 3]>,
    /// Position error of the first run.
    pub single: Vec<[f64; 3]>,
    /// Acceleration of the first run as estimated; that of the smoother is [`LAG`] steps older.
    pub acceleration: Vec<[f64; 3]>,
    /// What it is, at every step from 0.
    pub truth: Vec<f64>,
}

/// The numbers of one experiment.
#[derive(Clone, Copy, Debug)]
pub struct Numbers {
    /// Time mean of the root mean square over the runs.
    pub rms: [f64; 3],
    /// Time mean of the magnitude of the mean over the runs.
    pub of_mean: [f64; 3],
    /// The two over the 30 instants after each jump; 0 without jumps.
    pub rms_after: [f64; 3],
    /// See `rms_after`.
    pub of_mean_after: [f64; 3],
}

/// Runs experiment `number` of a shape.
pub fn experiment(design: &Design, effort: &Effort, shape: Shape, number: usize) -> Curves {
    let instants = STEPS - WINDOW;
    let mut rng = stream(effort, shape as u64, number, RUNS);
    let truth = shape.acceleration(&mut rng);
    let mut squares = vec![[0.0; 3]; instants];
    let mut sums = vec![[0.0; 3]; instants];
    let (mut single, mut acceleration) = (Vec::new(), Vec::new());
    for run in 0..RUNS {
        let mut rng = stream(effort, shape as u64, number, run);
        let (states, z) = target(design, &truth, &mut rng);
        let mut kalman = design.start();
        for i in 0..STEPS {
            if i >= WINDOW {
                let (filter, smoother) = design.estimate(&z[i - WINDOW..i]);
                let errors =
                    [smoother[0] - states[i - LAG][0], filter[0] - states[i][0], kalman.mean[0] - states[i][0]];
                for (j, e) in errors.into_iter().enumerate() {
                    squares[i - WINDOW][j] += e * e;
                    sums[i - WINDOW][j] += e;
                }
                if run == 0 {
                    single.push(errors);
                    acceleration.push([smoother[2], filter[2], kalman.mean[2]]);
                }
            }
            kalman = design.kalman(&kalman, z[i]);
        }
    }
    let rms = squares.iter().map(|s| s.map(|v| (v / RUNS as f64).sqrt())).collect();
    let of_mean = sums.iter().map(|s| s.map(|v| (v / RUNS as f64).abs())).collect();
    Curves { rms, of_mean, single, acceleration, truth }
}

/// States and measurements of one run.
fn target(design: &Design, acceleration: &[f64], rng: &mut Pcg64) -> (Vec<Vector<3>>, Vec<f64>) {
    let mut noise = |var: f64| normal(rng) * var.sqrt();
    let mut x = Vector::<3>::zeros();
    let (mut states, mut z) = (Vec::with_capacity(STEPS), Vec::with_capacity(STEPS));
    for a in acceleration {
        x[2] = *a;
        states.push(x);
        z.push(x[0] + noise(design.model.r));
        x = design.leap.f * x + design.model.g.column(0) * noise(design.model.q[(0, 0)]);
    }
    (states, z)
}

impl Curves {
    /// The numbers of Table 2, and those after the jumps of `shape`.
    pub fn numbers(&self, shape: Shape) -> Numbers {
        let mean = |values: &mut dyn Iterator<Item = [f64; 3]>| {
            let (mut sum, mut count) = ([0.0; 3], 0.0_f64);
            for v in values {
                (0..3).for_each(|j| sum[j] += v[j]);
                count += 1.0;
            }
            sum.map(|s| s / count.max(1.0))
        };
        // The state first differs in the step after the jump.
        let after = || shape.jumps().iter().flat_map(|jump| jump + 1..=jump + AFTER).map(|i| i - WINDOW);
        Numbers {
            rms: mean(&mut self.rms.iter().copied()),
            of_mean: mean(&mut self.of_mean.iter().copied()),
            rms_after: mean(&mut after().map(|i| self.rms[i].map(|v| v * v))).map(f64::sqrt),
            of_mean_after: mean(&mut after().map(|i| self.of_mean[i])),
        }
    }
}
