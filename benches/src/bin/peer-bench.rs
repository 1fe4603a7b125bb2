//! One workload on the peers' input, one JSON line: what the peers' driver calls.
//!
//! ```text
//! peer-bench WORKLOAD --data DIR [--reps N]
//! ```
//!
//! Each step predicts from (x0, P0) and then updates with the next z; every mean is written; NaN is a lost packet. Loading and the error are outside the
//! timed part.

use fixtrail_core::Belief;
use fixtrail_core::estimators::fms::Align;
use fixtrail_core::estimators::fms::gain::Shape;
use fixtrail_core::estimators::fms::invariant::{InvariantWindow, Model};
use fixtrail_core::kernels::{Axes, Chain, FixedLag, Leap, Packed, Past, Turn, series, smooth};
use fixtrail_core::storage::Fixed;
use fixtrail_lanes::Ranging;
use nalgebra::SMatrix;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

const USAGE: &str = "usage: peer-bench W1|W2|W2L|W3|W4|W4b|W4L|W5|W6|W7 --data DIR [--reps N]";
/// Steps of a track of W2.
const TRACK: usize = 800;
/// Steps that are smoothed.
const SMOOTHED: usize = 200_000;
/// Steps that a fixed lag stands behind the newest.
const LAG: usize = 5;
/// Measurements of a finite-memory window.
const WINDOW: usize = 15;
/// Steps left out of the error at the start of each track.
const SETTLING: usize = 50;

/// A workload's input.
struct Data {
    /// Numbers of the model's file: n, q, A, C, Q, R, x0, P0, row by row.
    model: Vec<f64>,
    z: Vec<f64>,
    truth: Vec<f64>,
}

/// The numbers of a file.
fn numbers(path: &Path) -> Result<Vec<f64>, String> {
    let bytes = std::fs::read(path).map_err(|e| format!("{}: {e}", path.display()))?;
    Ok(bytes.as_chunks::<8>().0.iter().map(|b| f64::from_le_bytes(*b)).collect())
}

impl Data {
    fn read(folder: &Path, name: &str) -> Result<Data, String> {
        let of = |kind: &str| numbers(&folder.join(format!("{name}.{kind}")));
        Ok(Data { model: of("model")?, z: of("z")?, truth: of("x")? })
    }

    fn n(&self) -> usize {
        self.model[0] as usize
    }

    fn q(&self) -> usize {
        self.model[1] as usize
    }

    /// Row `i`, column `j` of the matrix or vector that starts behind `before` numbers.
    fn at(&self, before: usize, cols: usize, i: usize, j: usize) -> f64 {
        self.model[2 + before + i * cols + j]
    }

    /// The chain of one axis: motion, start and the variance of a measurement.
    fn chain<const N: usize>(&self, axis: usize) -> (Leap<f64, N>, Belief<N>, f64) {
        let (n, q) = (self.n(), self.q());
        let (noise, var) = (n * n + q * n, n * n + q * n + n * n);
        let (mean, cov) = (var + q * q, var + q * q + n);
        // States of an axis stand as many apart as there are axes.
        let state = |i: usize| i * q + axis;
        let dt_s = self.at(0, n, state(0), state(1));
        let of = |before: usize| {
            std::array::from_fn::<[f64; N], N, _>(|i| std::array::from_fn(|j| self.at(before, n, state(i), state(j))))
        };
        let p0 = of(cov);
        let start = Belief {
            mean: std::array::from_fn::<f64, N, _>(|i| self.at(mean, 1, state(i), 0)).into(),
            cov: SMatrix::from_fn(|i, j| p0[i][j]),
        };
        (Leap::with_noise(dt_s, &of(noise)), start, self.at(var, q, axis, axis))
    }

    /// The start and Q of the whole state, and the variance of the first component of a measurement.
    fn whole<const N: usize>(&self) -> (Belief<N>, SMatrix<f64, N, N>, f64) {
        let q = self.q();
        let (noise, var) = (N * N + q * N, 2 * N * N + q * N);
        let (mean, cov) = (var + q * q, var + q * q + N);
        let matrix = |before| SMatrix::from_fn(|i, j| self.at(before, N, i, j));
        let mean = std::array::from_fn::<f64, N, _>(|i| self.at(mean, 1, i, 0)).into();
        (Belief { mean, cov: matrix(cov) }, matrix(noise), self.at(var, q, 0, 0))
    }

    /// Root mean square position error, the first steps of each track left out.
    fn rmse(&self, estimates: &[f64], steps: usize) -> f64 {
        let n = self.n();
        // One axis, or the plane.
        let axes = if n == 3 { 1 } else { 2 };
        let (mut sum, mut count) = (0.0, 0);
        for (k, (e, x)) in estimates.chunks(n).zip(self.truth.chunks(n)).enumerate() {
            if k % steps >= SETTLING.min(steps - 1) {
                sum += (0..axes).map(|i| (e[i] - x[i]).powi(2)).sum::<f64>();
                count += 1;
            }
        }
        (sum / f64::from(count)).sqrt()
    }
}

/// Estimates, and nanoseconds per step of every timed piece.
struct Timed {
    estimates: Vec<f64>,
    ns: Vec<f64>,
    seconds: Vec<f64>,
}

/// Runs `all` as often as told.
fn whole(reps: usize, len: usize, n: usize, mut all: impl FnMut(&mut [f64])) -> Timed {
    let mut timed = Timed { estimates: vec![0.0; len], ns: Vec::new(), seconds: Vec::new() };
    for _ in 0..reps {
        let start = Instant::now();
        all(&mut timed.estimates);
        timed.seconds.push(start.elapsed().as_secs_f64());
        black_box(&timed.estimates);
    }
    timed.ns = timed.seconds.iter().map(|s| s * 1e9 / (len / n) as f64).collect();
    timed
}

fn run(workload: &str, folder: &Path, reps: usize) -> Result<String, String> {
    let base = match workload {
        "W4" | "W4L" | "W6" | "W7" => "W1",
        "W4b" => "W3",
        "W1" | "W2" | "W2L" | "W3" | "W5" => workload,
        _ => return Err(format!("there is no workload `{workload}`")),
    };
    let mut data = Data::read(folder, base)?;
    let (n, q) = (data.n(), data.q());
    let steps = match workload {
        "W2" | "W2L" => TRACK,
        "W4" | "W4b" | "W4L" => SMOOTHED.min(data.z.len() / q),
        _ => data.z.len() / q,
    };
    if workload.starts_with("W4") {
        data.z.truncate(steps * q);
        data.truth.truncate(steps * n);
    }
    let len = data.z.len() / q * n;
    let timed = match workload {
        "W1" => {
            let (leap, start, var) = data.chain::<3>(0);
            whole(reps, len, n, |out| {
                series(&Chain::of(&start), &leap, var, &data.z, out.as_chunks_mut::<3>().0);
            })
        }
        "W2" | "W2L" => {
            let (leap, start, var) = data.chain::<3>(0);
            let problem = fixtrail_lanes::Problem { leap, var, start };
            whole(reps, len, n, |out| fixtrail_lanes::filter(&problem, &data.z, steps, out))
        }
        "W3" => {
            // Both axes are alike: one covariance.
            let ((leap, x, var), (_, y, _)) = (data.chain::<2>(0), data.chain::<2>(1));
            let start = Axes { means: [x.mean.into(), y.mean.into()], cov: Chain::of(&x).cov };
            whole(reps, len, n, |out| {
                let mut belief = start;
                for (z, out) in data.z.as_chunks::<2>().0.iter().zip(out.as_chunks_mut::<4>().0) {
                    belief = belief.predict(&leap).update(z, var);
                    let [[x, vx], [y, vy]] = belief.means;
                    *out = [x, y, vx, vy];
                }
            })
        }
        "W4" => {
            let (leap, start, var) = data.chain::<3>(0);
            let mut past = vec![Past::EMPTY; steps];
            whole(reps, len, n, |out| {
                smooth(&Chain::of(&start), &leap, var, &data.z, &mut past, out.as_chunks_mut::<3>().0);
            })
        }
        "W4b" => {
            let chains = [data.chain::<2>(0), data.chain::<2>(1)];
            let mut past = vec![Past::EMPTY; steps];
            let (mut z, mut means) = (vec![0.0; steps], vec![[0.0; 2]; steps]);
            whole(reps, len, n, |out| {
                for (axis, (leap, start, var)) in chains.iter().enumerate() {
                    for (z, all) in z.iter_mut().zip(data.z.as_chunks::<2>().0) {
                        *z = all[axis];
                    }
                    smooth(&Chain::of(start), leap, *var, &z, &mut past, &mut means);
                    for (mean, out) in means.iter().zip(out.as_chunks_mut::<4>().0) {
                        (out[axis], out[axis + 2]) = (mean[0], mean[1]);
                    }
                }
            })
        }
        "W4L" => {
            let (leap, start, var) = data.chain::<3>(0);
            whole(reps, len, n, |out| {
                let mut lagged = FixedLag::<3, LAG>::new(&Chain::of(&start));
                let (out, _) = out.as_chunks_mut::<3>();
                for (k, z) in data.z.iter().enumerate() {
                    lagged.push(&leap, var, *z);
                    // The last few have no measurements that far behind: they are as filtered.
                    out[k] = lagged.filtered().mean;
                    if k >= LAG {
                        out[k - LAG] = lagged.mean().unwrap_or_default();
                    }
                }
            })
        }
        "W5" => {
            let (start, q, var) = data.whole::<5>();
            let motion = Turn::with_noise(data.at(0, 5, 0, 1), &q);
            let anchors = numbers(&folder.join("W5.anchors"))?;
            let (anchors_m, _) = anchors.as_chunks::<2>();
            let problem = Ranging { motion, anchors_m, var };
            whole(reps, len, n, |out| fixtrail_lanes::range(&problem, &[Packed::of(&start)], &data.z, steps, out))
        }
        "W7" => {
            let (_, w, var) = data.whole::<3>();
            let a = SMatrix::from_fn(|i, j| data.at(0, 3, i, j));
            let c = std::array::from_fn::<f64, 3, _>(|i| data.at(9, 3, 0, i)).into();
            let model = Model { a: &a, w: &w, b: &[], c: &[c], r: &[var] };
            let shape = Shape { window: WINDOW, lag: 0, align: Align::Predicted };
            let window = InvariantWindow::<3, Fixed<{ 2 * WINDOW }>>::new(&model, shape).map_err(|e| e.to_string())?;
            let designed = window.gain().ok_or("the window does not determine the state")?;
            let gain: [[f64; 3]; WINDOW] = std::array::from_fn(|j| designed.z[j].0.into());
            // From the measurements before it: the first windows are not whole, and the last measurement is in none.
            let series = &data.z[..steps - 1];
            whole(reps, len, n, |out| {
                fixtrail_lanes::convolve(&gain, series, &mut out.as_chunks_mut::<3>().0[WINDOW..])
            })
        }
        _ => {
            // One step at a time, state in memory.
            let (leap, start, var) = data.chain::<3>(0);
            whole(reps, len, n, |out| {
                let mut belief = Chain::of(&start);
                for (z, out) in data.z.iter().zip(out.as_chunks_mut::<3>().0) {
                    let next = black_box(&belief).predict(&leap).checked_update(*z, var);
                    belief = next.map_or(belief, |(next, _)| next);
                    *out = belief.mean;
                }
            })
        }
    };
    let rmse = data.rmse(&timed.estimates, steps);
    let quantile = |values: &[f64], p: f64| {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        sorted[((sorted.len() - 1) as f64 * p).round() as usize]
    };
    Ok(format!(
        "{{\"peer\":\"ours\",\"version\":\"{}\",\"workload\":\"{workload}\",\"steps\":{},\"seconds\":{:.6},\"ns_per_step\":{:.3},\"ns_p5\":{:.3},\"rmse\":{rmse:.8}}}",
        env!("CARGO_PKG_VERSION"),
        len / n,
        quantile(&timed.seconds, 0.5),
        quantile(&timed.ns, 0.5),
        quantile(&timed.ns, 0.05),
    ))
}

fn main() -> ExitCode {
    let (mut workload, mut folder, mut reps) = (None, PathBuf::from("."), 5);
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--data" => folder = args.next().map_or(folder, PathBuf::from),
            "--reps" => reps = args.next().and_then(|n| n.parse().ok()).filter(|n| *n > 0).unwrap_or(reps),
            // Options of other peers.
            other if other.starts_with("--") => {}
            other => workload = Some(other.to_owned()),
        }
    }
    let Some(workload) = workload else {
        eprintln!("{USAGE}");
        return ExitCode::from(2);
    };
    match run(&workload, &folder, reps) {
        Ok(line) => {
            println!("{line}");
            ExitCode::SUCCESS
        }
        Err(message) => {
            eprintln!("{message}\n{USAGE}");
            ExitCode::from(2)
        }
    }
}
