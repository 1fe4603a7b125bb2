//! The Kalman family's vectors: filter, prediction, innovations, fixed-lag and fixed-interval smoother.

use super::json::Json;
use super::run::{LinearRun, packet, unpacked};
use super::{Comparison, Quantity, Scale};
use crate::dims::with_size;
use crate::error::BuildError;
use crate::mat::Mat;
use crate::model::{LinearModel, Motion, Sensing};
use crate::packet::Content;
use crate::spec::{EstimatorSpec, LinearSpec, LinearStep, Prior, Span};
use crate::tracker::Step;
use crate::trackers::LaggedMode;
use crate::trail::Trail;
use fixtrail_core::estimators::kalman::{self, Innovation, Robust};
use fixtrail_core::{Belief, Row, Vector};

/// One step of the filter as the core takes it.
struct Filtered {
    prior: (Vec<f64>, Vec<f64>),
    /// Innovation and its variance, of scalar measurements.
    innovation: Option<(f64, f64)>,
    log_likelihood: f64,
}

/// Runs the filter of the core over a run with a prior; one more prediction at the end.
fn filtered(run: &LinearRun) -> Result<Vec<Filtered>, BuildError> {
    with_size!(run.spec.base.a.rows, N => filtered_sized::<N>(run), Ok(Vec::new()))
}

fn filtered_sized<const N: usize>(run: &LinearRun) -> Result<Vec<Filtered>, BuildError> {
    let fail = |what: String| BuildError::new("vectors", None, Some("kf"), what);
    let steps = if run.spec.sequence.is_empty() { std::slice::from_ref(&run.spec.base) } else { &run.spec.sequence };
    let model = LinearModel::<N>::new(steps);
    let prior = run.spec.prior.as_ref().ok_or_else(|| fail("lacks a prior".to_owned()))?;
    let mut belief = Belief { mean: Vector::from_fn(|i, _| prior.mean[i]), cov: crate::model::square::<N>(&prior.cov) };
    let slices = |b: &Belief<N>| (b.mean.as_slice().to_vec(), b.cov.as_slice().to_vec());
    let mut out = Vec::with_capacity(run.packets.len() + 1);
    for (k, packet) in run.packets.iter().enumerate() {
        let packets = std::slice::from_ref(packet);
        let mut rows: Vec<Row<N>> = Vec::new();
        model.rows(&Step::new(k as u64, Some(packet.t_s), packets), &belief.mean, &mut rows);
        let innovation = match rows.as_slice() {
            [row] => Some((row.residual, row.h.dot(&(belief.cov * row.h)) + row.var)),
            _ => None,
        };
        let mut log_likelihood = 0.0;
        let noted = |i: Innovation| log_likelihood += i.log_density();
        let (posterior, _) =
            kalman::update_noting(&belief, &rows, Robust::None, noted).map_err(|e| fail(e.to_string()))?;
        // Whitened scalar rows have unit variance: the file's innovation is in the measurement's own unit.
        let innovation = innovation.map(|(e, s)| {
            let var = steps[k.min(steps.len() - 1)].r.at(0, 0);
            (e * var.sqrt(), s * var)
        });
        out.push(Filtered { prior: slices(&belief), innovation, log_likelihood });
        let Content::Linear { u, .. } = &packet.content else { continue };
        let leap = model.leap(k as u64, 0.0, &model.drive(k as u64, u), &posterior.mean);
        belief = kalman::predict(&posterior, &leap);
    }
    out.push(Filtered { prior: slices(&belief), innovation: None, log_likelihood: 0.0 });
    Ok(out)
}

/// `xhat_pred`, `P_pred`, `xhat_filt`, `P_filt`: predictions by the core, filtered values through the pipeline.
pub(super) fn filter_quantities(
    run: &LinearRun,
    kf: &Json<'_>,
    (estimate, covariance): (f64, f64),
) -> Result<Vec<Quantity>, BuildError> {
    let steps = filtered(run)?;
    let trail = run.track(EstimatorSpec::Kalman, LaggedMode::Own)?;
    let mut out = Vec::new();
    let columns: [(&str, Scale, f64); 4] = [
        ("xhat_pred", Scale::Entry, estimate),
        ("P_pred", Scale::Array, covariance),
        ("xhat_filt", Scale::Entry, estimate),
        ("P_filt", Scale::Array, covariance),
    ];
    for (key, scale, tolerance) in columns {
        let mut compared = Comparison::new(&format!("kf.{key}"), scale, tolerance);
        for (i, at) in kf.get(key)?.list()?.iter().enumerate() {
            let theirs = if key.starts_with('P') { at.matrix()?.data } else { at.numbers()? };
            let ours = match key {
                "xhat_pred" => steps.get(i).map(|s| s.prior.0.clone()),
                "P_pred" => steps.get(i).map(|s| s.prior.1.clone()),
                "xhat_filt" if i < trail.len() => trail.mean(i).map(<[f64]>::to_vec),
                _ if i < trail.len() => unpacked(&trail, i),
                _ => None,
            };
            compared.add_optional(ours.as_deref(), Some(&theirs));
        }
        out.push(compared.done());
    }
    Ok(out)
}

pub(super) fn tolerance(root: &Json<'_>) -> Result<f64, BuildError> {
    root.get("suggested_tolerance")?.get("rel")?.number()
}

/// Covariance of (position, speed) over an interval.
pub(super) fn two_state_noise(model: &Json<'_>, dt_s: f64) -> Result<[f64; 3], BuildError> {
    match model.get("type")?.text()? {
        "speed_noise" => Ok([model.get("Q11")?.number()?, 0.0, model.get("Q33")?.number()?]),
        "accel_noise" => {
            let q = model.get("q")?.number()?;
            let dt2 = dt_s * dt_s;
            Ok([dt2 * dt2 * q / 4.0, dt2 * dt_s * q / 2.0, dt2 * q])
        }
        other => Err(model.fail(format!("has type `{other}`, expected `speed_noise` or `accel_noise`"))),
    }
}

/// `kf2_rts_lag1`: one two-state filter per axis. Entry 0 is the start, whose measurement is already in it.
pub(super) fn two_state(root: &Json<'_>) -> Result<Vec<Quantity>, BuildError> {
    let rel = tolerance(root)?;
    let inputs = root.get("inputs")?;
    let dt = inputs.get("dt")?.numbers()?;
    let column = |key: &str| inputs.get(key)?.list();
    let (models, zs, rs, inits) = (column("model")?, column("z")?, column("R")?, column("init")?);
    let expected = root.get("expected")?.list()?;
    let mut out = Vec::new();
    for (axis, want) in expected.iter().enumerate() {
        let missing = || inputs.fail(format!("lacks axis {axis}"));
        let model = models.get(axis).ok_or_else(missing)?;
        let z = zs.get(axis).ok_or_else(missing)?.numbers()?;
        let r = rs.get(axis).ok_or_else(missing)?.numbers()?;
        let init = inits.get(axis).ok_or_else(missing)?;
        if z.len() != dt.len() + 1 || r.len() != z.len() {
            return Err(inputs.fail(format!("has {} measurements and {} intervals on axis {axis}", z.len(), dt.len())));
        }
        let mut steps = Vec::with_capacity(z.len());
        for (k, r) in r.iter().enumerate() {
            let dt_s = dt.get(k).copied().unwrap_or(0.0);
            let [q11, q13, q33] = two_state_noise(model, dt_s)?;
            steps.push(LinearStep {
                a: mat(2, 2, &[1.0, dt_s, 0.0, 1.0]),
                b: mat(2, 0, &[]),
                g: Mat::identity(2),
                c: mat(1, 2, &[1.0, 0.0]),
                q: mat(2, 2, &[q11, q13, q13, q33]),
                r: mat(1, 1, &[*r]),
            });
        }
        let number = |key: &str| init.get(key)?.number();
        let prior = Prior {
            mean: vec![number("x")?, number("s")?],
            cov: mat(2, 2, &[number("var_x")?, 0.0, 0.0, number("var_s")?]),
            second_moment: None,
        };
        let packets = z.iter().enumerate().map(|(k, z)| packet(k, vec![(k > 0).then_some(*z)], Vec::new())).collect();
        let run =
            LinearRun { spec: LinearSpec { base: steps[0].clone(), sequence: steps, prior: Some(prior) }, packets };
        out.extend(two_state_axis(&run, want, axis, rel)?);
    }
    Ok(out)
}

fn two_state_axis(run: &LinearRun, want: &Json<'_>, axis: usize, rel: f64) -> Result<Vec<Quantity>, BuildError> {
    let len = run.packets.len();
    let steps = filtered(run)?;
    let mut out = Vec::new();
    let mut compare = |name: String, ours: Vec<f64>, theirs: &[f64]| {
        let mut c = Comparison::new(&name, Scale::Array, rel);
        c.add(&ours, theirs);
        out.push(c.done());
    };
    let predicted: Vec<(&[f64], &[f64])> =
        steps[1..len].iter().map(|s| (s.prior.0.as_slice(), s.prior.1.as_slice())).collect();
    let rows = |trail: &Trail, count: usize| -> Option<Vec<(Vec<f64>, Vec<f64>)>> {
        (0..count).map(|i| Some((trail.mean(i)?.to_vec(), unpacked(trail, i)?))).collect()
    };
    let kalman = run.track(EstimatorSpec::Kalman, LaggedMode::Own)?;
    let lag1 = run.track(EstimatorSpec::FixedLagKalman { lag: Span::Instants(1) }, LaggedMode::Own)?;
    let rts = run.track(EstimatorSpec::Rts, LaggedMode::Own)?;
    let groups = [
        ("filter", rows(&kalman, len)),
        ("predicted", Some(predicted.iter().map(|(m, p)| (m.to_vec(), p.to_vec())).collect())),
        ("lag1_smoother", rows(&lag1, len - 1)),
        ("rts_smoother", rows(&rts, len)),
    ];
    for (group, ours) in groups {
        let at = want.get(group)?;
        let ours = ours.ok_or_else(|| at.fail("has no estimate in this run"))?;
        for (key, mean, entry) in
            [("x", true, 0), ("s", true, 1), ("P11", false, 0), ("P12", false, 1), ("P22", false, 3)]
        {
            let values = ours.iter().map(|(m, p)| if mean { m[entry] } else { p[entry] }).collect();
            compare(format!("{group}.{key}[{axis}]"), values, &at.get(key)?.numbers()?);
        }
    }
    let innovations: Vec<(f64, f64)> = steps[1..len].iter().filter_map(|s| s.innovation).collect();
    let list = |f: fn(&(f64, f64)) -> f64| innovations.iter().map(f).collect::<Vec<f64>>();
    compare(format!("innovation[{axis}]"), list(|i| i.0), &want.get("innovation")?.numbers()?);
    compare(format!("innovation_var[{axis}]"), list(|i| i.1), &want.get("innovation_var")?.numbers()?);
    if let Some(at) = want.optional("log_likelihood") {
        // The library whitens: the density of z is that of z/√r over √r.
        let whitening: f64 = run.spec.sequence[1..].iter().map(|s| 0.5 * s.r.at(0, 0).ln()).sum();
        let total: f64 = steps[1..len].iter().map(|s| s.log_likelihood).sum::<f64>() - whitening;
        compare(format!("log_likelihood[{axis}]"), vec![total], &[at.number()?]);
    }
    Ok(out)
}

/// `kf4`: two axes with correlated measurement noise. Entry 0 is the start.
pub(super) fn four_state(root: &Json<'_>) -> Result<Vec<Quantity>, BuildError> {
    let rel = tolerance(root)?;
    let inputs = root.get("inputs")?;
    let dt = inputs.get("dt")?.numbers()?;
    let model = inputs.get("model")?;
    let z = inputs.get("z")?.list()?;
    let r = inputs.get("R")?.list()?;
    if z.len() != dt.len() + 1 || r.len() != z.len() {
        return Err(inputs.fail(format!("has {} measurements and {} intervals", z.len(), dt.len())));
    }
    let mut steps = Vec::with_capacity(z.len());
    for (k, r) in r.iter().enumerate() {
        let dt_s = dt.get(k).copied().unwrap_or(0.0);
        let [q11, q13, q33] = two_state_noise(&model, dt_s)?;
        let two = |i: usize, j: usize, a: f64| if i % 2 == j % 2 { a } else { 0.0 };
        let block = |top: f64, cross: f64, bottom: f64, lower: f64| -> Vec<f64> {
            (0..16)
                .map(|e| {
                    let (i, j) = (e / 4, e % 4);
                    two(
                        i,
                        j,
                        match (i < 2, j < 2) {
                            (true, true) => top,
                            (true, false) => cross,
                            (false, true) => lower,
                            (false, false) => bottom,
                        },
                    )
                })
                .collect()
        };
        steps.push(LinearStep {
            a: Mat { rows: 4, cols: 4, data: block(1.0, dt_s, 1.0, 0.0) },
            b: mat(4, 0, &[]),
            g: Mat::identity(4),
            c: mat(2, 4, &[1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0]),
            q: Mat { rows: 4, cols: 4, data: block(q11, q13, q33, q13) },
            r: r.shaped(2, 2)?,
        });
    }
    let init = inputs.get("init")?;
    let prior = Prior { mean: init.get("m")?.numbers()?, cov: init.get("P")?.shaped(4, 4)?, second_moment: None };
    if prior.mean.len() != 4 {
        return Err(init.fail(format!("has a mean of {} entries, expected 4", prior.mean.len())));
    }
    let mut packets = Vec::with_capacity(z.len());
    for (k, z) in z.iter().enumerate() {
        let z = z.numbers()?;
        packets.push(packet(k, z.into_iter().map(|z| (k > 0).then_some(z)).collect(), Vec::new()));
    }
    let run = LinearRun { spec: LinearSpec { base: steps[0].clone(), sequence: steps, prior: Some(prior) }, packets };
    let trail = run.track(EstimatorSpec::Kalman, LaggedMode::Own)?;
    let expected = root.get("expected")?;
    let mut m = Comparison::new("m", Scale::Array, rel);
    let mut p = Comparison::new("P", Scale::Array, rel);
    for (k, (mean, cov)) in expected.get("m")?.list()?.iter().zip(&expected.get("P")?.list()?).enumerate() {
        if k >= trail.len() {
            return Err(mean.fail("has no row in the run"));
        }
        m.add_optional(trail.mean(k), Some(&mean.numbers()?));
        p.add_optional(unpacked(&trail, k).as_deref(), Some(&cov.matrix()?.data));
    }
    Ok(vec![m.done(), p.done()])
}

fn mat(rows: usize, cols: usize, data: &[f64]) -> Mat {
    Mat { rows, cols, data: data.to_vec() }
}
