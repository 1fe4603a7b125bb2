//! The message-passing filter's vectors: runs, its literal start, steady states and the moments of errors.

use super::json::Json;
use super::kf::{tolerance, two_state_noise};
use super::{Comparison, Quantity, Scale};
use crate::error::BuildError;
use fixtrail_core::estimators::alpha_beta::{Design, Steady, Truth};
use fixtrail_core::estimators::fosb::{Fosb, Gauss, LiteralStart, Noise, Step};

fn noise(model: &Json<'_>) -> Result<Noise<f64>, BuildError> {
    match model.get("type")?.text()? {
        "speed_noise" => Ok(Noise::Speed { q11: model.get("Q11")?.number()?, q33: model.get("Q33")?.number()? }),
        "accel_noise" => Ok(Noise::Acceleration { q: model.get("q")?.number()? }),
        other => Err(model.fail(format!("has type `{other}`, expected `speed_noise` or `accel_noise`"))),
    }
}

fn gauss(at: &Json<'_>) -> Result<Gauss<f64>, BuildError> {
    Ok(Gauss { mean: at.get("mean")?.number()?, var: at.get("var")?.number()? })
}

fn refused(at: &Json<'_>, e: fixtrail_core::StepError) -> BuildError {
    at.fail(format!("cannot be filtered: {e}"))
}

fn compared(name: String, rel: f64, ours: &[f64], theirs: &Json<'_>) -> Result<Quantity, BuildError> {
    let mut comparison = Comparison::new(&name, Scale::Array, rel);
    comparison.add(ours, &theirs.numbers()?);
    Ok(comparison.done())
}

fn each<T>(of: &[T], take: impl Fn(&T) -> f64) -> Vec<f64> {
    of.iter().map(take).collect()
}

/// `fosb`: one filter per axis; entry 0 is the start, whose measurement is already in it.
pub(super) fn runs(root: &Json<'_>) -> Result<Vec<Quantity>, BuildError> {
    let rel = tolerance(root)?;
    let inputs = root.get("inputs")?;
    let dt = inputs.get("dt")?.numbers()?;
    let column = |key: &str| inputs.get(key)?.list();
    let (models, zs, rs, inits) = (column("model")?, column("z")?, column("R")?, column("init")?);
    let mut out = Vec::new();
    for (axis, want) in root.get("expected")?.list()?.iter().enumerate() {
        let missing = || inputs.fail(format!("lacks axis {axis}"));
        let noise = noise(models.get(axis).ok_or_else(missing)?)?;
        let z = zs.get(axis).ok_or_else(missing)?;
        let (values, vars) = (z.numbers()?, rs.get(axis).ok_or_else(missing)?.numbers()?);
        let init = inits.get(axis).ok_or_else(missing)?;
        if values.len() != dt.len() + 1 || vars.len() != values.len() {
            let what = format!("has {} measurements and {} intervals on axis {axis}", values.len(), dt.len());
            return Err(inputs.fail(what));
        }
        let number = |key: &str| init.get(key)?.number();
        let location = Gauss { mean: number("x")?, var: number("var_x")? };
        let speed = Gauss { mean: number("s")?, var: number("var_s")? };
        let mut filter = Fosb::start(location, speed);
        let (mut places, mut speeds) = (vec![location], vec![speed]);
        let mut steps = Vec::with_capacity(dt.len());
        for (k, dt) in dt.iter().enumerate() {
            let measured = Gauss { mean: values[k + 1], var: vars[k + 1] };
            let step = filter.step(*dt, &noise, measured).map_err(|e| refused(z, e))?;
            places.push(step.location);
            speeds.push(step.speed);
            steps.push(step);
        }
        let refined: Vec<Gauss<f64>> = steps.iter().filter_map(|s| s.refined).collect();
        let predicted: Vec<Gauss<f64>> = steps.iter().map(|s| s.predicted).collect();
        let columns = [
            ("x", "var_x", &places),
            ("s_forward", "var_s_forward", &speeds),
            ("s_refined", "var_s_refined", &refined),
            ("x_pred", "var_x_pred", &predicted),
        ];
        for (mean, var, ours) in columns {
            out.push(compared(format!("{mean}[{axis}]"), rel, &each(ours, |g| g.mean), &want.get(mean)?)?);
            out.push(compared(format!("{var}[{axis}]"), rel, &each(ours, |g| g.var), &want.get(var)?)?);
        }
        if let Some(messages) = want.optional("messages") {
            out.extend(passed_on(&messages, axis, rel, &steps)?);
        }
    }
    Ok(out)
}

/// The messages that the gain form passes on, by the numbers of the paper's steps; step 9 is the measurement, step 10 is inside step 11.
fn passed_on(messages: &Json<'_>, axis: usize, rel: f64, steps: &[Step<f64>]) -> Result<Vec<Quantity>, BuildError> {
    type Message = fn(&Step<f64>) -> Option<Gauss<f64>>;
    let kinds: [(&str, Message); 5] = [
        ("step8_G_tilde", |s| Some(s.predicted)),
        ("step11_F_hat", |s| s.refined),
        ("step5_F_tilde", |s| Some(s.speed)),
        ("step6_F_hat_g", |s| Some(s.speed)),
        ("step7_G_hat", |s| Some(s.location)),
    ];
    let theirs = messages.list()?;
    kinds
        .into_iter()
        .map(|(name, ours)| {
            let mut compared = Comparison::new(&format!("messages.{name}[{axis}]"), Scale::Array, rel);
            compared.mismatched |= theirs.len() != steps.len();
            for (step, message) in steps.iter().zip(&theirs) {
                let (ours, theirs) = (ours(step).map(|g| [g.mean, g.var]), gauss(&message.get(name)?)?);
                compared.add_optional(ours.as_ref().map(|o| &o[..]), Some(&[theirs.mean, theirs.var]));
            }
            Ok(compared.done())
        })
        .collect()
}

/// `fosb_literal_init`: steps 1 to 4 with two messages of the speed.
pub(super) fn literal(root: &Json<'_>) -> Result<Vec<Quantity>, BuildError> {
    let rel = tolerance(root)?;
    let inputs = root.get("inputs")?;
    let (dt, r, z) = (inputs.get("dt")?.numbers()?, inputs.get("R")?.numbers()?, inputs.get("z")?.numbers()?);
    if dt.is_empty() || z.len() != dt.len() + 1 || r.len() != z.len() {
        return Err(inputs.fail(format!("has {} measurements and {} intervals", z.len(), dt.len())));
    }
    let noise = noise(&inputs.get("model")?)?;
    let start = LiteralStart {
        location: gauss(&inputs.get("G_hat_0")?)?,
        forward: gauss(&inputs.get("F_hat_g_0")?)?,
        refined: gauss(&inputs.get("F_hat_0")?)?,
    };
    let measured = |k: usize| Gauss { mean: z[k], var: r[k] };
    let (mut filter, first) =
        Fosb::start_literal(&start, dt[0], &noise, measured(1)).map_err(|e| refused(&inputs, e))?;
    let mut steps = vec![first];
    for k in 1..dt.len() {
        steps.push(filter.step(dt[k], &noise, measured(k + 1)).map_err(|e| refused(&inputs, e))?);
    }
    let want = root.get("expected")?;
    let ahead = gauss(&want.get("step4_x_pred_1")?)?;
    let mut step_4 = Comparison::new("step4_x_pred_1", Scale::Array, rel);
    step_4.add(&[first.predicted.mean, first.predicted.var], &[ahead.mean, ahead.var]);
    let refined: Vec<Gauss<f64>> = steps.iter().filter_map(|s| s.refined).collect();
    let columns = [
        ("x", each(&steps, |s| s.location.mean)),
        ("var_x", each(&steps, |s| s.location.var)),
        ("s_forward", each(&steps, |s| s.speed.mean)),
        ("var_s_forward", each(&steps, |s| s.speed.var)),
        ("s_refined", each(&refined, |g| g.mean)),
        ("var_s_refined", each(&refined, |g| g.var)),
    ];
    let mut out = vec![step_4.done()];
    for (key, ours) in columns {
        out.push(compared(key.to_owned(), rel, &ours, &want.get(key)?)?);
    }
    Ok(out)
}

/// The design of a case, and the steady states of FOSB and of the Kalman filter.
fn steady(inputs: &Json<'_>) -> Result<[Steady; 2], BuildError> {
    let (r, dt) = (inputs.get("R")?.number()?, inputs.get("dt")?.number()?);
    let [q11, q13, q33] = two_state_noise(&inputs.get("model")?, dt)?;
    let design = Design { r, dt, q11, q13, q33 };
    match (design.fosb(), design.kalman()) {
        (Some(fosb), Some(kalman)) => Ok([fosb, kalman]),
        _ => Err(inputs.fail("is no design: variances are not positive")),
    }
}

/// Quantities gathered over the cases of a file, each entry by itself relative to its own size.
struct Gathered {
    rel: f64,
    found: Vec<Comparison>,
}

impl Gathered {
    fn add(&mut self, name: &str, ours: Option<f64>, theirs: &Json<'_>) -> Result<(), BuildError> {
        let i = self.found.iter().position(|c| c.name == name).unwrap_or_else(|| {
            self.found.push(Comparison::new(name, Scale::Mixed { floor: 0.0 }, self.rel));
            self.found.len() - 1
        });
        self.found[i].add_optional(ours.as_ref().map(std::slice::from_ref), Some(&[theirs.number()?]));
        Ok(())
    }

    fn done(self) -> Vec<Quantity> {
        self.found.into_iter().map(Comparison::done).collect()
    }
}

/// `steady_state`: gains and covariances that the recursions settle at.
pub(super) fn steady_states(root: &Json<'_>) -> Result<Vec<Quantity>, BuildError> {
    let mut out = Gathered { rel: tolerance(root)?, found: Vec::new() };
    for case in root.get("cases")?.list()? {
        let [fosb, kalman] = steady(&case.get("inputs")?)?;
        let expected = case.get("expected")?;
        let want = expected.get("fosb")?;
        let ours = [
            ("alpha", fosb.alpha),
            ("beta", fosb.beta),
            ("var_x", fosb.cov[(0, 0)]),
            ("var_s_forward", fosb.cov[(1, 1)]),
            ("S", fosb.innovation_var),
        ];
        for (key, value) in ours {
            out.add(&format!("fosb.{key}"), Some(value), &want.get(key)?)?;
        }
        let want = expected.get("kf")?;
        let ours = [
            ("alpha", kalman.alpha),
            ("beta", kalman.beta),
            ("P11", kalman.cov[(0, 0)]),
            ("P12", kalman.cov[(0, 1)]),
            ("P22", kalman.cov[(1, 1)]),
            ("S", kalman.innovation_var),
        ];
        for (key, value) in ours {
            out.add(&format!("kf.{key}"), Some(value), &want.get(key)?)?;
        }
    }
    Ok(out.done())
}

/// `statistics`: moments of the errors, quantiles of their size in the plane, and what the filters report. The paper's own numbers and the
/// operation counts of the file are not ours to compute.
pub(super) fn statistics(root: &Json<'_>) -> Result<Vec<Quantity>, BuildError> {
    let mut out = Gathered { rel: tolerance(root)?, found: Vec::new() };
    for case in root.get("cases")?.list()? {
        let inputs = case.get("inputs")?;
        let truth = inputs.get("truth")?;
        let truth = match truth.text()? {
            "matched" => Truth::Matched,
            "const_speed" => Truth::ConstantSpeed,
            other => return Err(truth.fail(format!("is `{other}`, expected `matched` or `const_speed`"))),
        };
        let filters = steady(&inputs)?;
        let expected = case.get("expected")?;
        let mut sizes = [None; 2];
        for ((name, filter), size) in ["fosb", "kf"].into_iter().zip(filters).zip(&mut sizes) {
            let want = expected.get(name)?;
            let moments = filter.moments(truth);
            *size = moments.map(|m| m.mse_x);
            let ours = [
                ("mse_x", moments.map(|m| m.mse_x)),
                ("mse_s", moments.map(|m| m.mse_s)),
                ("cov_xs", moments.map(|m| m.cov_xs)),
                ("q90_2d", moments.map(|m| m.distance_quantile(0.9))),
                ("q60_2d", moments.map(|m| m.distance_quantile(0.6))),
                ("reported_var_x", Some(filter.cov[(0, 0)])),
            ];
            for (key, value) in ours {
                out.add(&format!("{name}.{key}"), value, &want.get(key)?)?;
            }
            if let Some(theirs) = want.optional("reported_var_s") {
                out.add(&format!("{name}.reported_var_s"), Some(filter.cov[(1, 1)]), &theirs)?;
            }
        }
        let ratio = match sizes {
            [Some(fosb), Some(kalman)] => Some((fosb / kalman).sqrt()),
            _ => None,
        };
        out.add("rms_ratio_x_fosb_over_kf", ratio, &expected.get("rms_ratio_x_fosb_over_kf")?)?;
    }
    Ok(out.done())
}
