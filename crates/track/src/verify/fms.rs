//! Vectors of `fms-golden-1`: finite-memory estimates, gains and covariances, and the Kalman family on the same data.

use super::json::Json;
use super::kf::filter_quantities;
use super::run::{LinearRun, packet, unpacked};
use super::{Comparison, Quantity, Scale};
use crate::dims::with_size;
use crate::error::BuildError;
use crate::heap::Heap;
use crate::mat::Mat;
use crate::model::{LinearModel, Motion, Sensing};
use crate::packet::Content;
use crate::spec::{Align, EstimatorSpec, LinearSpec, LinearStep, MAX_MEASUREMENT, MAX_STATE, Prior, Span};
use crate::tracker::Step;
use crate::trackers::LaggedMode;
use fixtrail_core::estimators::diffuse::Joint;
use fixtrail_core::estimators::fms::varying::Varying;
use fixtrail_core::{Row, Transition, Vector};

/// The file says: 1e-9·max(1, |b|) for estimates, 1e-10 of the largest entry for covariances.
const ESTIMATE: f64 = 1e-9;
const COVARIANCE: f64 = 1e-10;

struct Vectors {
    n: usize,
    window: usize,
    lag: usize,
    run: LinearRun,
}

/// Compares everything that the file expects.
pub(super) fn quantities(root: &Json<'_>) -> Result<Vec<Quantity>, BuildError> {
    let v = read(root)?;
    let expected = root.get("expected")?;
    let mut out = estimates(&v, &expected.get("estimates")?)?;
    out.extend(with_size!(v.n, N => windows::<N>(&v, &expected)?, Vec::new()));
    if let Some(kf) = root.optional("kf") {
        out.extend(kalman(&v, &kf)?);
    }
    Ok(out)
}

fn read(root: &Json<'_>) -> Result<Vectors, BuildError> {
    let count = |key: &str| root.get(key)?.count();
    let (n, q, window, lag, len) = (count("n")?, count("q")?, count("M")?, count("d")?, count("N")?);
    if !(1..=MAX_STATE).contains(&n) || !(1..=MAX_MEASUREMENT).contains(&q) {
        return Err(
            root.fail(format!("has n = {n}, q = {q}, expected n up to {MAX_STATE} and q up to {MAX_MEASUREMENT}"))
        );
    }
    if window == 0 || lag > window {
        return Err(root.fail(format!("has M = {window}, d = {lag}, expected 1 ≤ M and d ≤ M")));
    }
    let steps: Vec<LinearStep> = match root.optional("steps") {
        Some(steps) => steps.list()?.iter().map(|s| step(s, n, q)).collect::<Result<_, _>>()?,
        None => vec![step(root, n, q)?],
    };
    let base = steps.first().cloned().ok_or_else(|| root.fail("has no steps"))?;
    let sequence = if steps.len() > 1 { steps } else { Vec::new() };
    let inputs = root.get("inputs")?.list()?;
    let measurements = root.get("measurements")?.list()?;
    if inputs.len() != len || measurements.len() != len {
        let (u, z) = (inputs.len(), measurements.len());
        return Err(root.fail(format!("has {z} measurements and {u} inputs, expected N = {len} of each")));
    }
    let mut packets = Vec::with_capacity(len);
    for (k, (z, u)) in measurements.iter().zip(&inputs).enumerate() {
        let (z, u) = (z.holed(q)?, u.numbers()?);
        if z.len() != q || u.len() != base.b.cols {
            return Err(root.fail(format!("has a row {k} with {} components and {} inputs", z.len(), u.len())));
        }
        packets.push(packet(k, z, u));
    }
    let run = LinearRun { spec: LinearSpec { base, sequence, prior: None }, packets };
    Ok(Vectors { n, window, lag, run })
}

/// Which of a window's data is 1 while all others are 0.
#[derive(Clone, Copy)]
struct Unit {
    k: usize,
    component: usize,
    input: bool,
}

/// Estimates of a window from its end and its data.
type Windowed<'a, const N: usize> = &'a dyn Fn(usize, Option<Unit>) -> Result<Joint<N>, BuildError>;

fn step(at: &Json<'_>, n: usize, q: usize) -> Result<LinearStep, BuildError> {
    let g = match at.optional("G") {
        Some(g) => g.matrix()?,
        None => Mat::identity(n),
    };
    if g.rows != n {
        return Err(at.fail(format!("has a G of {} rows, expected n = {n}", g.rows)));
    }
    let b = match at.optional("B") {
        Some(b) => b.matrix()?,
        None => Mat { rows: n, cols: 0, data: Vec::new() },
    };
    if b.rows != n {
        return Err(at.fail(format!("has a B of {} rows, expected n = {n}", b.rows)));
    }
    Ok(LinearStep {
        a: at.get("A")?.shaped(n, n)?,
        c: at.get("C")?.shaped(q, n)?,
        q: at.get("Q")?.shaped(g.cols, g.cols)?,
        r: at.get("R")?.shaped(q, q)?,
        b,
        g,
    })
}

/// Estimates and statuses of every window, through the whole pipeline.
fn estimates(v: &Vectors, expected: &Json<'_>) -> Result<Vec<Quantity>, BuildError> {
    let estimator =
        EstimatorSpec::Fms { window: Span::Instants(v.window), lag: Span::Instants(v.lag), align: Align::Predicted };
    let trail = v.run.track(estimator, LaggedMode::Both)?;
    let mut filter = Comparison::new("xhat_filter", Scale::Entry, ESTIMATE);
    let mut smoother = Comparison::new("xhat_smoother", Scale::Entry, ESTIMATE);
    let mut status = Comparison::new("status", Scale::Entry, 0.0);
    let index = expected.get("i")?.list()?;
    let column = |key: &str| expected.get(key)?.list();
    let (filters, smoothers, statuses) = (column("xhat_filter")?, column("xhat_smoother")?, column("status")?);
    for (row, i) in index.iter().enumerate() {
        let i = i.count()?;
        let missing = || expected.fail(format!("lacks row {row}"));
        let state = statuses.get(row).ok_or_else(missing)?.text()?;
        if i >= trail.len() {
            return Err(expected.fail(format!("expects time {i}, the run ends at {}", trail.len() - 1)));
        }
        if state == "borderline" {
            continue;
        }
        let read = |list: &[Json<'_>]| -> Result<Option<Vec<f64>>, BuildError> {
            let at = list.get(row).ok_or_else(missing)?;
            if at.value.is_null() { Ok(None) } else { at.numbers().map(Some) }
        };
        filter.add_optional(trail.mean(i), read(&filters)?.as_deref());
        smoother.add_optional(trail.lagged(i).map(|l| l.0), read(&smoothers)?.as_deref());
        let observed = |yes: bool| if yes { 1.0 } else { 0.0 };
        status.add(&[observed(trail.mean(i).is_some())], &[observed(state != "unobservable")]);
    }
    Ok(vec![filter.done(), smoother.done(), status.done()])
}

/// Gains of the first window and joint covariances, from the window itself.
fn windows<const N: usize>(v: &Vectors, expected: &Json<'_>) -> Result<Vec<Quantity>, BuildError> {
    let mut out = Vec::new();
    let first = expected.get("first_window")?;
    let end = first.get("i")?.count()?;
    if end < v.window || end > v.run.packets.len() {
        return Err(first.fail(format!("ends at {end}, expected between M and N")));
    }
    let joint = |i: usize, data: Option<Unit>| window_joint::<N>(v, i, data);
    out.push(gain("first_window.Kz", &first.get("Kz")?.matrix()?, v, end, false, &joint)?);
    let ku = first.get("Ku")?.matrix()?;
    if ku.cols > 0 {
        out.push(gain("first_window.Ku", &ku, v, end, true, &joint)?);
    }
    if let Some(h) = expected.optional("paper_H") {
        out.extend(paper_gain(&h, v, end, &joint)?);
    }
    let mut cov = Comparison::new("first_window.cov", Scale::Array, COVARIANCE);
    cov.add_optional(joint_covariance(&joint(end, None)?).as_deref(), Some(&first.get("cov")?.matrix()?.data));
    out.push(cov.done());
    if let Some(list) = expected.optional("cov_per_i") {
        let index = expected.get("estimates")?.get("i")?.list()?;
        let statuses = expected.get("estimates")?.get("status")?.list()?;
        let mut all = Comparison::new("cov_per_i", Scale::Entry, COVARIANCE);
        for ((at, i), status) in list.list()?.iter().zip(&index).zip(&statuses) {
            if status.text()? == "borderline" {
                continue;
            }
            let ours = joint_covariance(&joint(i.count()?, None)?);
            let theirs = if at.value.is_null() { None } else { Some(at.matrix()?.data) };
            // Relative to the largest entry of each matrix.
            let scale = theirs.as_ref().map_or(1.0, |m| m.iter().fold(f64::MIN_POSITIVE, |s, x| s.max(x.abs())));
            let scaled = |m: Option<Vec<f64>>| m.map(|m| m.iter().map(|x| x / scale).collect::<Vec<f64>>());
            all.add_optional(scaled(ours).as_deref(), scaled(theirs).as_deref());
        }
        out.push(all.done());
    }
    Ok(out)
}

/// The paper's H of eq. (14), `[[K_f, 0], [K_s, −I]]`: its left columns are our gain, its right block is fixed by eq. (11).
fn paper_gain<const N: usize>(
    h: &Json<'_>,
    v: &Vectors,
    end: usize,
    joint: Windowed<'_, N>,
) -> Result<[Quantity; 2], BuildError> {
    let h = h.matrix()?;
    let columns = h.cols.saturating_sub(N);
    let block = |from: usize, to: usize| Mat {
        rows: h.rows,
        cols: to - from,
        data: (0..h.rows).flat_map(|i| (from..to).map(move |j| (i, j))).map(|(i, j)| h.at(i, j)).collect(),
    };
    let mut fixed = Comparison::new("paper_H, right block", Scale::Entry, ESTIMATE);
    let ours: Vec<f64> = (0..2 * N * N).map(|e| if e / N == e % N + N { -1.0 } else { 0.0 }).collect();
    fixed.add(&ours, &block(columns, h.cols).data);
    Ok([gain("paper_H, left columns", &block(0, columns), v, end, false, joint)?, fixed.done()])
}

/// A gain matrix, column by column: the estimate of unit data less the estimate of no data.
fn gain<const N: usize>(
    name: &str,
    expected: &Mat,
    v: &Vectors,
    end: usize,
    inputs: bool,
    joint: Windowed<'_, N>,
) -> Result<Quantity, BuildError> {
    let mut out = Comparison::new(name, Scale::Entry, ESTIMATE);
    let mut columns = Vec::new();
    for k in end - v.window..end {
        let Content::Linear { z, u } = &v.run.packets[k].content else { continue };
        let entries = if inputs { u.len() } else { z.len() };
        columns.extend((0..entries).filter(|c| inputs || z[*c].is_some()).map(|c| (k, c)));
    }
    if expected.rows != 2 * N || expected.cols != columns.len() {
        out.mismatched = true;
    }
    for (j, (k, c)) in columns.iter().enumerate().take(expected.cols) {
        let unit = joint(end, Some(Unit { k: *k, component: *c, input: inputs }))?;
        let ours: Option<Vec<f64>> =
            unit.filter.zip(unit.lagged).map(|(f, l)| f.mean.iter().chain(l.mean.iter()).copied().collect());
        let theirs: Vec<f64> = (0..expected.rows).map(|i| expected.at(i, j)).collect();
        out.add_optional(ours.as_deref(), Some(&theirs));
    }
    Ok(out.done())
}

/// The estimate at `end` from its window. With `unit`, all data are 0 but one.
fn window_joint<const N: usize>(v: &Vectors, end: usize, unit: Option<Unit>) -> Result<Joint<N>, BuildError> {
    let steps =
        if v.run.spec.sequence.is_empty() { std::slice::from_ref(&v.run.spec.base) } else { &v.run.spec.sequence };
    let model = LinearModel::<N>::new(steps);
    let fail = |e: fixtrail_core::StepError| BuildError::new("vectors", None, None, e.to_string());
    let mut window: Varying<N, Heap> =
        Varying::new(v.window).ok_or_else(|| BuildError::new("vectors", None, Some("M"), "is too long"))?;
    let zero = Vector::zeros();
    let mut leap = Transition { next: zero, f: nalgebra::one(), q: nalgebra::zero() };
    for k in end.saturating_sub(v.window)..end {
        let mut packet = v.run.packets[k].clone();
        if let (Content::Linear { z, u }, Some(one)) = (&mut packet.content, unit) {
            for (i, value) in z.iter_mut().enumerate() {
                *value = value.map(|_| if !one.input && one.k == k && one.component == i { 1.0 } else { 0.0 });
            }
            for (i, value) in u.iter_mut().enumerate() {
                *value = if one.input && one.k == k && one.component == i { 1.0 } else { 0.0 };
            }
        }
        let packets = [packet];
        let step = Step::new(k as u64, Some(k as f64), &packets);
        let mut rows: Vec<Row<N>> = Vec::new();
        model.rows(&step, &zero, &mut rows);
        window.push(&leap, &mut rows).map_err(fail)?;
        let Content::Linear { u, .. } = &packets[0].content else { continue };
        leap = model.leap(k as u64, 0.0, &model.drive(k as u64, u), &zero);
    }
    Ok(window.predicted(v.lag, &leap))
}

/// Row-major joint covariance of (newest, lagged).
fn joint_covariance<const N: usize>(joint: &Joint<N>) -> Option<Vec<f64>> {
    let (filter, lagged) = (joint.filter?, joint.lagged?);
    let mut out = Vec::with_capacity(4 * N * N);
    for i in 0..2 * N {
        for j in 0..2 * N {
            out.push(match (i < N, j < N) {
                (true, true) => filter.cov[(i, j)],
                (true, false) => joint.cross[(i, j - N)],
                (false, true) => joint.cross[(j, i - N)],
                (false, false) => lagged.cov[(i - N, j - N)],
            });
        }
    }
    Some(out)
}

/// The Kalman filter and fixed-lag smoother on the same data.
fn kalman(v: &Vectors, kf: &Json<'_>) -> Result<Vec<Quantity>, BuildError> {
    let prior = Prior { mean: kf.get("x0")?.numbers()?, cov: kf.get("P0")?.shaped(v.n, v.n)?, second_moment: None };
    if prior.mean.len() != v.n {
        return Err(kf.fail(format!("has an x0 of {} entries, expected n = {}", prior.mean.len(), v.n)));
    }
    let mut run = v.run.clone();
    run.spec.prior = Some(prior);
    let mut out = filter_quantities(&run, kf, (ESTIMATE, COVARIANCE))?;
    if v.lag >= 1 {
        // xhat_fixedlag[i] is x̂_{i−d} given z_0 … z_{i−1}: the row of time i − d at lag d − 1.
        let trail = run.track(EstimatorSpec::FixedLagKalman { lag: Span::Instants(v.lag - 1) }, LaggedMode::Own)?;
        let mut x = Comparison::new("kf.xhat_fixedlag", Scale::Entry, ESTIMATE);
        let mut p = Comparison::new("kf.P_fixedlag", Scale::Array, COVARIANCE);
        let (means, covs) = (kf.get("xhat_fixedlag")?.list()?, kf.get("P_fixedlag")?.list()?);
        for (i, (mean, cov)) in means.iter().zip(&covs).enumerate() {
            if mean.value.is_null() {
                continue;
            }
            let row = i.checked_sub(v.lag).filter(|r| *r < trail.len());
            let row = row.ok_or_else(|| mean.fail("has no row in the run"))?;
            x.add_optional(trail.mean(row), Some(&mean.numbers()?));
            p.add_optional(unpacked(&trail, row).as_deref(), Some(&cov.matrix()?.data));
        }
        out.extend([x.done(), p.done()]);
    }
    Ok(out)
}
