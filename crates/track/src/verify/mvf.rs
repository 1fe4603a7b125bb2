//! The packet-loss filters' vectors: linear filters behind a holding receiver, the extended filter on a turning target, the turn itself.

use super::json::Json;
use super::run::{LinearRun, packet, unpacked};
use super::{Comparison, Quantity, Scale};
use crate::anchors::Anchors;
use crate::dims::with_size;
use crate::error::{BuildError, StepError};
use crate::mat::Mat;
use crate::model::{HeldRows, LinearModel, Motion, Sensing, square};
use crate::packet::Packet;
use crate::pipeline::{Pipeline, Until};
use crate::registry::MAX_HELD;
use crate::spec::{ArrivalSpec, Duplicates, EstimatorSpec, Hold, LinearSpec, LinearStep, LinkSpec, Prior, Receiver};
use crate::tracker::Step;
use crate::trackers::LaggedMode;
use crate::trail::Trail;
use fixtrail_core::estimators::augmented::{Sensed, Shown};
use fixtrail_core::estimators::emvf::{Emvf, Options, Variant};
use fixtrail_core::estimators::kalman::{self, Robust};
use fixtrail_core::estimators::lmmse::{Lmmse, Spread};
use fixtrail_core::estimators::lmvf::Lmvf;
use fixtrail_core::linalg::Lu;
use fixtrail_core::models::CoordinatedTurn;
use fixtrail_core::{Belief, Matrix, Row, Transition, Vector, sensors};

/// The file's tolerance: `|a − b| ≤ abs + rel |b|`, and a looser `rel` for the quantities of some runs.
struct Tolerance {
    abs: f64,
    rel: f64,
}

impl Tolerance {
    fn of(root: &Json<'_>, run: &str) -> Result<Self, BuildError> {
        let at = root.get("tolerance")?;
        let rel = at.optional(&format!("rel_{run}")).map_or_else(|| at.get("rel"), Ok)?.number()?;
        Ok(Self { abs: at.get("abs")?.number()?, rel })
    }

    fn compare(&self, name: String) -> Comparison {
        Comparison::new(&name, Scale::Mixed { floor: self.abs / self.rel }, self.rel)
    }
}

/// Numbers of a scalar, vector or matrix, row by row.
fn flat(at: &Json<'_>) -> Result<Vec<f64>, BuildError> {
    if at.value.is_number() {
        return Ok(vec![at.number()?]);
    }
    let mut out = Vec::new();
    for entry in at.list()? {
        out.extend(flat(&entry)?);
    }
    Ok(out)
}

/// As [`flat`] of a list whose unknown entries are null and left out.
pub(super) fn flat_known(at: &Json<'_>) -> Result<Vec<f64>, BuildError> {
    match at.value.as_array() {
        Some(all) if all.iter().all(serde_json::Value::is_null) => Ok(Vec::new()),
        _ => flat(at),
    }
}

/// Compares one list of named values per step with the file's steps; the file's step i stands for instant i + 1.
fn compare_steps(
    name: &str,
    tolerance: &Tolerance,
    theirs: &Json<'_>,
    ours: &[Vec<(&str, Vec<f64>)>],
) -> Result<Vec<Quantity>, BuildError> {
    let steps = theirs.list()?;
    if steps.len() > ours.len() {
        return Err(theirs.fail(format!("has {} steps, expected at most {}", steps.len(), ours.len())));
    }
    let mut out = Vec::new();
    let keys: Vec<&str> = ours.first().map(|step| step.iter().map(|(key, _)| *key).collect()).unwrap_or_default();
    for (column, key) in keys.iter().enumerate() {
        let mut compared = tolerance.compare(format!("{name}.{key}"));
        for (step, ours) in steps.iter().zip(ours) {
            compared.add(&ours[column].1, &flat(&step.get(key)?)?);
        }
        out.push(compared.done());
    }
    Ok(out)
}

/// The top left `rows × cols` of a matrix, row by row.
fn block<const R: usize, const C: usize>(m: &Matrix<R, C>, rows: usize, cols: usize) -> Vec<f64> {
    (0..rows).flat_map(|i| (0..cols).map(move |j| (i, j))).map(|at| m[at]).collect()
}

/// A linear run behind the paper's receiver.
struct Run {
    /// The values that were shown.
    shown: LinearRun,
    /// The values that were measured.
    z: Vec<Vec<f64>>,
    came: Vec<bool>,
    arrival: Vec<f64>,
}

impl Run {
    fn read(root: &Json<'_>) -> Result<Run, BuildError> {
        let system = root.get("system")?;
        let list = |key: &str| system.get(key)?.list();
        let (a, b, q, c, r) = (list("A")?, list("B")?, list("Q")?, list("C")?, list("R")?);
        let n = a.first().ok_or_else(|| system.fail("has no step"))?.matrix()?.rows;
        let mut steps = Vec::with_capacity(c.len());
        for k in 0..c.len() {
            // A, B and Q lead from an instant to the next: the last instant has none.
            let at = k.min(a.len() - 1);
            let get =
                |list: &[Json<'_>]| list.get(at).ok_or_else(|| system.fail("has lists of different lengths"))?.matrix();
            steps.push(LinearStep {
                a: get(&a)?,
                b: Mat { rows: n, cols: 0, data: Vec::new() },
                g: get(&b)?,
                c: c[k].matrix()?,
                q: get(&q)?,
                r: r.get(k).ok_or_else(|| system.fail("has too few R"))?.matrix()?,
            });
        }
        let fits = |s: &LinearStep| {
            (s.a.rows, s.a.cols, s.g.rows, s.c.cols) == (n, n, n, n)
                && (s.q.rows, s.q.cols) == (s.g.cols, s.g.cols)
                && (s.c.rows, s.r.rows, s.r.cols) == (steps[0].c.rows, s.c.rows, s.c.rows)
        };
        if !steps.iter().all(fits) || n > crate::spec::MAX_STATE || steps[0].c.rows > crate::spec::MAX_MEASUREMENT {
            return Err(system.fail("has matrices that do not fit together, or too many states or measurements"));
        }
        let prior = Prior {
            mean: system.get("m0")?.numbers()?,
            cov: system.get("P0")?.shaped(n, n)?,
            second_moment: Some(system.get("S0")?.shaped(n, n)?),
        };
        if prior.mean.len() != n {
            return Err(system.fail(format!("has an m0 of {} entries, expected {n}", prior.mean.len())));
        }
        let rows = |key: &str| root.get(key)?.list()?.iter().map(Json::numbers).collect::<Result<Vec<_>, _>>();
        let (y, z) = (rows("y")?, rows("z")?);
        let packets = y.iter().enumerate().map(|(k, y)| packet(k, y.iter().map(|v| Some(*v)).collect(), Vec::new()));
        let packets: Vec<Packet> = packets.collect();
        if packets.len() != steps.len() || z.len() != steps.len() {
            return Err(root.fail(format!("has {} y and {} z for {} instants", y.len(), z.len(), steps.len())));
        }
        Ok(Run {
            shown: LinearRun {
                spec: LinearSpec { base: steps[0].clone(), sequence: steps, prior: Some(prior) },
                packets,
            },
            z,
            came: root.get("gamma")?.numbers()?.iter().map(|g| *g != 0.0).collect(),
            arrival: system.get("p")?.numbers()?,
        })
    }

    fn held_link(&self) -> LinkSpec {
        LinkSpec {
            receiver: Receiver::Unstamped { hold: Hold::Paper },
            arrival: Some(ArrivalSpec::List(self.arrival.clone())),
            duplicates: Duplicates::Keep,
        }
    }

    /// The measurements as they were made, those of `lost` instants absent; z_0 is never used.
    fn measured(&self, lost: impl Fn(usize) -> bool) -> LinearRun {
        let row = |(k, z): (usize, &Vec<f64>)| {
            packet(k, z.iter().map(|v| (k > 0 && !lost(k)).then_some(*v)).collect(), Vec::new())
        };
        LinearRun { spec: self.shown.spec.clone(), packets: self.z.iter().enumerate().map(row).collect() }
    }

    /// x̂ and P at every instant as a receiver knows them that is told when the paper's late values were sensed.
    fn buffered(&self) -> Result<Vec<Quantities>, BuildError> {
        let fail = |e: StepError| BuildError::new("vectors", None, Some("kf_buffer_paper_channel"), e.to_string());
        let link = LinkSpec { receiver: Receiver::Stamped { late_s: Some(3.0) }, ..LinkSpec::default() };
        let spec = self.shown.spec(EstimatorSpec::Kalman, link);
        let mut pipeline = Pipeline::new(&spec, &Anchors::default(), LaggedMode::Own)?;
        let mut settled = Trail::new(self.shown.spec.base.a.rows, false);
        let mut out = Vec::new();
        let mut known = vec![false; self.z.len()];
        for k in 1..self.z.len() {
            let sensed = if self.came[k] {
                k
            } else if self.came[k - 1] {
                k - 1
            } else {
                k.saturating_sub(2)
            };
            // z_0 is used already.
            if sensed > 0 && !std::mem::replace(&mut known[sensed], true) {
                let z = self.z[sensed].iter().map(|v| Some(*v)).collect();
                pipeline.push(packet(sensed, z, Vec::new()), &mut settled).map_err(fail)?;
            }
            let mut trail = Trail::new(settled.n(), false);
            pipeline.now(Until::Row(k as u64), &mut trail).map_err(fail)?;
            out.push(estimate(&trail, trail.len() - 1));
        }
        Ok(out)
    }
}

/// Numbers by their names.
type Quantities = Vec<(&'static str, Vec<f64>)>;

fn estimate(trail: &Trail, row: usize) -> Quantities {
    let mean = trail.mean(row).map(<[f64]>::to_vec).unwrap_or_default();
    vec![("xhat", mean), ("P", unpacked(trail, row).unwrap_or_default())]
}

fn estimates(trail: &Trail) -> Vec<Quantities> {
    (1..trail.len()).map(|row| estimate(trail, row)).collect()
}

/// `linear`: the paper's filter, the exact one, and Kalman filters that know more.
pub(super) fn linear(root: &Json<'_>) -> Result<Vec<Quantity>, BuildError> {
    let run = Run::read(root)?;
    let expected = root.get("expected")?;
    let tolerance = Tolerance::of(root, "")?;
    let mut out = Vec::new();
    let mut compare = |key: &str, ours: &[Vec<(&str, Vec<f64>)>]| {
        compare_steps(key, &tolerance, &expected.get(key)?, ours).map(|found| out.extend(found))
    };
    let (lmvf, lmmse) = inside(&run)?;
    compare("lmvf_theorem1", &lmvf)?;
    compare("lmmse_exact", &lmmse)?;
    let held = |estimator| run.shown.track_link(estimator, run.held_link(), LaggedMode::Own);
    for square_root in [false, true] {
        compare("lmvf_theorem1", &estimates(&held(EstimatorSpec::Lmvf { square_root })?))?;
    }
    let exact = estimates(&held(EstimatorSpec::Lmmse)?);
    compare("lmmse_exact", &exact)?;
    compare("lmmse_bruteforce_first", &exact)?;
    let kalman = |data: LinearRun| data.track(EstimatorSpec::Kalman, LaggedMode::Own);
    compare("kf_known_gamma_skip", &estimates(&kalman(run.measured(|k| !run.came[k]))?))?;
    compare("kf_all_z", &estimates(&kalman(run.measured(|_| false))?))?;
    compare("kf_buffer_paper_channel", &run.buffered()?)?;
    Ok(out)
}

type Steps = Vec<Quantities>;

/// What the filters form on the way, from the core.
fn inside(run: &Run) -> Result<(Steps, Steps), BuildError> {
    with_size!(run.shown.spec.base.a.rows, N => inside_sized::<N>(run), Ok((Vec::new(), Vec::new())))
}

fn inside_sized<const N: usize>(run: &Run) -> Result<(Steps, Steps), BuildError> {
    const M: usize = MAX_HELD;
    let fail = |e: fixtrail_core::StepError| BuildError::new("vectors", None, Some("lmvf"), e.to_string());
    let (n, m) = (N, run.shown.spec.base.c.rows);
    let model = LinearModel::<N>::new(&run.shown.spec.sequence);
    let prior = run.shown.spec.prior.as_ref().ok_or_else(|| fail(fixtrail_core::StepError::SecondMoment))?;
    let belief = Belief { mean: Vector::<N>::from_fn(|i, _| prior.mean[i]), cov: square::<N>(&prior.cov) };
    let second: Matrix<N, N> = prior.second_moment.as_ref().map(square).unwrap_or(belief.cov);
    let sense = |k: usize, x: &Vector<N>| {
        let mut rows = HeldRows::default();
        model.held(&Step::new(k as u64, None, std::slice::from_ref(&run.shown.packets[k])), x, &mut rows);
        let sensed = Sensed {
            expected: Vector::<M>::from_fn(|i, _| rows.expected.get(i).copied().unwrap_or(0.0)),
            h: Matrix::<M, N>::from_fn(|i, j| rows.h.get(i).map_or(0.0, |h| h[j])),
            r: Matrix::<M, M>::from_fn(|i, j| match (i < m && j < m, i == j) {
                (true, _) => rows.r[i * m + j],
                (false, true) => 1.0,
                (false, false) => 0.0,
            }),
        };
        let mut shown = Shown::<M>::nothing();
        for (i, value) in rows.values.iter().enumerate() {
            shown.y[i] = value.unwrap_or(0.0);
            shown.seen[i] = value.is_some();
        }
        (sensed, shown)
    };
    let (first, _) = sense(0, &belief.mean);
    let mut lmvf = Lmvf::start(&belief, &second, &first, false);
    let mut lmmse = Lmmse::start(&belief, &first, Hold::Paper, Spread::Unconditional);
    let (mut paper, mut exact) = (Steps::new(), Steps::new());
    for k in 1..run.shown.packets.len() {
        let p = run.arrival[k.min(run.arrival.len() - 1)];
        let leap_from = |x: &Vector<N>| model.leap(k as u64 - 1, 0.0, &Vector::zeros(), x);

        let leap = leap_from(&lmvf.belief().mean);
        let (sensed, shown) = sense(k, &leap.next);
        let used = lmvf.step(&leap, &sensed, &shown, p).map_err(fail)?;
        let f = leap.f - used.gain * used.j;
        paper.push(vec![
            ("J", block(&used.j, m, n)),
            ("D", block(&used.d, m, m)),
            ("K", block(&used.gain, n, m)),
            ("F", block(&f, n, n)),
            ("S", block(lmvf.second_moment(), n, n)),
        ]);

        let leap = leap_from(&lmmse.joint().x);
        let (sensed, shown) = sense(k, &leap.next);
        let found = lmmse.step(&leap, &sensed, &shown, p).map_err(fail)?;
        let j = lmmse.joint();
        let wide = |x: &Matrix<N, M>, z: &Matrix<M, M>, d: &Matrix<M, M>| {
            let mut rows = block(x, n, m);
            rows.extend(block(z, m, m));
            rows.extend(block(d, m, m));
            rows
        };
        let parts: [&dyn Fn(usize) -> f64; 3] = [&|i| j.x[i], &|i| j.z[i], &|i| j.d[i]];
        let sizes = [n, m, m];
        let place = |i: usize| {
            if i < n {
                (0, i)
            } else if i < n + m {
                (1, i - n)
            } else {
                (2, i - n - m)
            }
        };
        let cov = |a: usize, b: usize| {
            let ((pa, i), (pb, k)) = (place(a.min(b)), place(a.max(b)));
            match (pa, pb) {
                (0, 0) => j.xx[(i, k)],
                (0, 1) => j.xz[(i, k)],
                (0, _) => j.xd[(i, k)],
                (1, 1) => j.zz[(i, k)],
                (1, _) => j.zd[(i, k)],
                _ => j.dd[(i, k)],
            }
        };
        let all = n + 2 * m;
        exact.push(vec![
            ("ypred", found.y.as_slice()[..m].to_vec()),
            ("Se", block(&found.cov, m, m)),
            ("K", wide(&found.gain.x, &found.gain.z, &found.gain.d)),
            ("X", (0..3).flat_map(|p| (0..sizes[p]).map(move |i| (p, i))).map(|(p, i)| parts[p](i)).collect()),
            ("Sigma", (0..all * all).map(|e| cov(e / all, e % all)).collect()),
        ]);
    }
    Ok((paper, exact))
}

/// One run of `emvf` vectors: ranges to one sensor at a time from a turning target.
struct Turning {
    sensors: Vec<[f64; 3]>,
    chosen: Vec<usize>,
    dt_s: Vec<f64>,
    var: f64,
    turn_var: f64,
    arrival: Vec<f64>,
    z: Vec<f64>,
    came: Vec<bool>,
    prior: Belief<5>,
    second: Matrix<5, 5>,
}

impl Turning {
    fn read(root: &Json<'_>) -> Result<Turning, BuildError> {
        let inputs = root.get("inputs")?;
        let sensor = |at: &Json<'_>| match at.numbers()?.as_slice() {
            [x, y] => Ok([*x, *y, 0.0]),
            other => Err(at.fail(format!("has {} coordinates, expected 2", other.len()))),
        };
        let sensors: Vec<[f64; 3]> = inputs.get("sensors")?.list()?.iter().map(sensor).collect::<Result<_, _>>()?;
        let chosen: Vec<usize> = inputs.get("j")?.list()?.iter().map(Json::count).collect::<Result<_, _>>()?;
        let mean = inputs.get("m0")?.numbers()?;
        let numbers = |key: &str| inputs.get(key)?.numbers();
        let found = Turning {
            chosen,
            dt_s: numbers("dt")?,
            var: inputs.get("R")?.number()?,
            turn_var: inputs.get("W44")?.number()?,
            arrival: numbers("p")?,
            z: numbers("z")?,
            came: numbers("gamma")?.iter().map(|g| *g != 0.0).collect(),
            prior: Belief {
                mean: Vector::from_fn(|i, _| mean.get(i).copied().unwrap_or(0.0)),
                cov: square(&inputs.get("P0")?.shaped(5, 5)?),
            },
            second: square(&inputs.get("S0")?.shaped(5, 5)?),
            sensors,
        };
        let rows = found.z.len();
        let lengths = [found.chosen.len(), found.arrival.len(), found.came.len(), found.dt_s.len() + 1];
        if lengths.iter().any(|len| *len != rows)
            || found.chosen.iter().any(|j| *j >= found.sensors.len())
            || mean.len() != 5
        {
            return Err(inputs.fail("has lists that do not fit together"));
        }
        Ok(found)
    }

    fn leap(&self, k: usize, x: &Vector<5>) -> Result<Transition<5>, BuildError> {
        let motion = CoordinatedTurn::new([0.0; 2], 0.0)
            .map_err(|e| BuildError::new("vectors", None, Some("emvf"), e.to_string()))?;
        let mut leap = motion.leap(x, self.dt_s[k]);
        // The paper's noise does not grow with the interval.
        leap.q[(4, 4)] = self.turn_var;
        Ok(leap)
    }

    fn row(&self, k: usize, x: &Vector<5>, value: f64) -> Row<5> {
        sensors::range(x, 2, self.sensors[self.chosen[k]], None, value, self.var)
    }

    fn sensed(&self, k: usize, x: &Vector<5>) -> Sensed<5, 1> {
        let row = self.row(k, x, 0.0);
        Sensed { expected: Vector::from([-row.residual]), h: row.h.transpose(), r: Matrix::from([[self.var]]) }
    }

    /// What the receiver shows at k; after two losses the value before them, or 0.
    fn shown(&self, k: usize, after_two: impl Fn(usize) -> f64) -> f64 {
        match (self.came[k], self.came[k - 1]) {
            (true, _) => self.z[k],
            (false, true) => self.z[k - 1],
            (false, false) => after_two(k),
        }
    }

    /// `unused`: whether the value after two losses is not used; what the filter would have made of it is reported all the same.
    fn extended(&self, options: Options, after_two: impl Fn(usize) -> f64, unused: bool) -> Result<Steps, BuildError> {
        let fail = |e: fixtrail_core::StepError| BuildError::new("vectors", None, Some("emvf"), e.to_string());
        let mut filter = Emvf::start(&self.prior, &self.second, &self.sensed(0, &self.prior.mean), options);
        let mut out = Steps::new();
        for k in 1..self.z.len() {
            let leap = self.leap(k - 1, &filter.belief().mean)?;
            let sensed = self.sensed(k, &leap.next);
            let y = self.shown(k, &after_two);
            let mut next = filter;
            let used = next.step(&leap, &sensed, &Shown::all(Vector::from([y])), self.arrival[k]).map_err(fail)?;
            if unused && !self.came[k] && !self.came[k - 1] {
                next = filter;
                next.step(&leap, &sensed, &Shown::nothing(), self.arrival[k]).map_err(fail)?;
            }
            filter = next;
            let belief = filter.belief();
            out.push(vec![
                ("xpred", leap.next.as_slice().to_vec()),
                ("hpred", vec![sensed.expected[0]]),
                ("H", vec![sensed.h[(0, 0)], sensed.h[(0, 1)]]),
                ("y", vec![y]),
                ("J", block(&used.j, 1, 5)),
                ("D", vec![used.d[(0, 0)]]),
                ("K", block(&used.gain, 5, 1)),
                ("innovation", vec![used.innovation[0]]),
                ("xhat", belief.mean.as_slice().to_vec()),
                ("P", block(&belief.cov, 5, 5)),
                ("S", block(filter.second_moment(), 5, 5)),
            ]);
        }
        Ok(out)
    }

    /// An extended Kalman filter that takes `y(k)` for z_k; a row without it is a loss it knows of.
    ///
    /// `restart`: the file's steps, from each of which the next is taken. A filter that takes old values for new ones is thrown about by
    /// them: rounding the mean once a step, as double precision must, moves its covariance forty steps later by 1e-6. Step by step the
    /// same arithmetic is compared, and that amplification is not.
    fn kalman(&self, y: impl Fn(usize) -> Option<f64>, restart: Option<&Json<'_>>) -> Result<Steps, BuildError> {
        let fail = |e: fixtrail_core::StepError| BuildError::new("vectors", None, Some("emvf"), e.to_string());
        let mut belief = self.prior;
        let mut out = Steps::new();
        let restart = restart.map_or_else(|| Ok(Vec::new()), Json::list)?;
        for k in 1..self.z.len() {
            if let Some(before) = k.checked_sub(2).and_then(|i| restart.get(i)) {
                let (mean, cov) = (before.get("xhat")?.numbers()?, before.get("P")?.shaped(5, 5)?);
                belief = Belief {
                    mean: Vector::from_fn(|i, _| mean.get(i).copied().unwrap_or(f64::NAN)),
                    cov: square(&cov),
                };
            }
            let leap = self.leap(k - 1, &belief.mean)?;
            let prior = kalman::predict(&belief, &leap);
            let expected = self.sensed(k, &leap.next).expected[0];
            let row = y(k).map(|y| self.row(k, &leap.next, y));
            (belief, _) = kalman::update(&prior, row.as_slice(), Robust::None).map_err(fail)?;
            out.push(vec![
                ("xpred", leap.next.as_slice().to_vec()),
                ("hpred", vec![expected]),
                ("xhat", belief.mean.as_slice().to_vec()),
                ("P", block(&belief.cov, 5, 5)),
            ]);
        }
        Ok(out)
    }
}

/// `emvf`: Theorem 2 in its variants, and extended Kalman filters fed with what is shown.
pub(super) fn extended(root: &Json<'_>) -> Result<Vec<Quantity>, BuildError> {
    let run = Turning::read(root)?;
    let expected = root.get("expected")?;
    let options = |variant, range_mixture| Options { variant, range_mixture };
    let two_before = |k: usize| run.z[k - 2];
    let runs = [
        ("M2", run.extended(options(Variant::Model2, false), two_before, false)?),
        ("M1_zero", run.extended(options(Variant::Model1, false), |_| 0.0, false)?),
        ("M1_skip", run.extended(options(Variant::Model1, false), two_before, true)?),
        ("M2_mixvar", run.extended(options(Variant::Model2, true), two_before, false)?),
        ("EKF_hold", run.kalman(|k| Some(run.shown(k, two_before)), Some(&expected.get("EKF_hold")?))?),
        ("EKF_zero", run.kalman(|k| Some(if run.came[k] { run.z[k] } else { 0.0 }), Some(&expected.get("EKF_zero")?))?),
        ("EKF_skip", run.kalman(|k| run.came[k].then_some(run.z[k]), None)?),
    ];
    let mut out = Vec::new();
    for (name, ours) in runs {
        out.extend(compare_steps(name, &Tolerance::of(root, name)?, &expected.get(name)?, &ours)?);
    }
    Ok(out)
}

/// `ct`: the coordinated turn, its Jacobian and the inverse of that.
pub(super) fn turn(root: &Json<'_>) -> Result<Vec<Quantity>, BuildError> {
    let tolerance = Tolerance::of(root, "")?;
    let mut compared = ["f", "Phi", "Phi_inv"].map(|key| tolerance.compare(key.to_owned()));
    for case in root.get("cases")?.list()? {
        let x = case.get("x")?.numbers()?;
        if x.len() != 5 {
            return Err(case.fail(format!("has an x of {} entries, expected 5", x.len())));
        }
        let motion = CoordinatedTurn::new([0.0; 2], 0.0).map_err(|e| case.fail(e.to_string()))?;
        let leap = motion.leap(&Vector::from_fn(|i, _| x[i]), case.get("T")?.number()?);
        let inverse = Lu::new(leap.f).map(|lu| lu.solve(Matrix::<5, 5>::identity()));
        let inverse = inverse.map(|m| block(&m, 5, 5)).unwrap_or_default();
        let ours = [leap.next.as_slice().to_vec(), block(&leap.f, 5, 5), inverse];
        for ((compared, key), ours) in compared.iter_mut().zip(["f", "Phi", "Phi_inv"]).zip(ours) {
            compared.add(&ours, &flat(&case.get(key)?)?);
        }
    }
    Ok(compared.into_iter().map(Comparison::done).collect())
}
