//! The position front end's vectors: lateration, time differences, likelihood of signal strengths, distances from them.

use super::json::Json;
use super::{Comparison, Quantity, Scale};
use crate::error::BuildError;
use fixtrail_core::Vector;
use fixtrail_core::position::Point;
use fixtrail_core::position::lateration::{self, Linear, Range, Rank};
use fixtrail_core::position::rss::to_range;
use fixtrail_core::position::rss_ml::{self, Strength, Strengths};
use fixtrail_core::position::tdoa::{self, Difference, Differences};
use fixtrail_core::sensors::PathLoss;

/// Sums of squares below this are what rounding leaves of residuals: they are compared on this scale.
const LEAST_CHI2: f64 = 1e-6;

/// Quantities by name, deviations relative to the largest element of each array.
struct Compared {
    tolerance: f64,
    quantities: Vec<Comparison>,
}

impl Compared {
    fn new(root: &Json<'_>) -> Result<Self, BuildError> {
        Ok(Self { tolerance: root.get("suggested_tolerance")?.get("rel")?.number()?, quantities: Vec::new() })
    }

    fn named(&mut self, name: &str) -> &mut Comparison {
        let at = self.quantities.iter().position(|q| q.name == name).unwrap_or_else(|| {
            self.quantities.push(Comparison::new(name, Scale::Entry, self.tolerance));
            self.quantities.len() - 1
        });
        &mut self.quantities[at]
    }

    /// One array; `least` is the smallest scale.
    fn add(&mut self, name: &str, ours: &[f64], theirs: &[f64], least: f64) {
        let largest = theirs.iter().fold(least, |m, v| m.max(v.abs()));
        let scale = if largest > 0.0 { largest } else { 1.0 };
        // Entries are at most 1 then: each deviation counts as it is.
        let scaled = |values: &[f64]| values.iter().map(|v| v / scale).collect::<Vec<_>>();
        self.named(name).add(&scaled(ours), &scaled(theirs));
    }

    /// A text or a count, which is equal or not.
    fn equal(&mut self, name: &str, equal: bool) {
        self.named(name).add(&[f64::from(u8::from(equal))], &[1.0]);
    }

    /// A minimum with its covariance; `null` where there is none.
    fn point<const N: usize>(
        &mut self,
        name: &str,
        ours: Option<Point<N>>,
        theirs: Option<&Json<'_>>,
    ) -> Result<(), BuildError> {
        let Some(theirs) = theirs else {
            self.equal(&format!("{name}.none"), ours.is_none());
            return Ok(());
        };
        let p = vector::<N>(&theirs.get("p")?)?;
        let cov = theirs.get("cov")?.shaped(N, N)?;
        let chi2 = theirs.get("chi2")?.number()?;
        let Some(ours) = ours else {
            self.equal(&format!("{name}.p"), false);
            return Ok(());
        };
        self.add(&format!("{name}.p"), ours.belief.mean.as_slice(), p.as_slice(), 0.0);
        // Symmetric: column-major and row-major storage are the same matrix.
        self.add(&format!("{name}.cov"), ours.belief.cov.as_slice(), &cov.data, 0.0);
        self.add(&format!("{name}.chi2"), &[ours.chi2], &[chi2], LEAST_CHI2);
        Ok(())
    }

    fn done(self) -> Vec<Quantity> {
        self.quantities.into_iter().map(Comparison::done).collect()
    }
}

fn vector<const N: usize>(at: &Json<'_>) -> Result<Vector<N>, BuildError> {
    let values = at.numbers()?;
    if values.len() != N {
        return Err(at.fail(format!("has {} entries, expected {N}", values.len())));
    }
    Ok(Vector::from_fn(|i, _| values[i]))
}

/// A positive finite number.
fn positive(at: &Json<'_>) -> Result<f64, BuildError> {
    let value = at.number()?;
    if value > 0.0 { Ok(value) } else { Err(at.fail(format!("is {value}, expected a positive number"))) }
}

/// `len` numbers, each read by `number`.
fn listed<'a>(
    at: &Json<'a>,
    len: usize,
    number: impl Fn(&Json<'a>) -> Result<f64, BuildError>,
) -> Result<Vec<f64>, BuildError> {
    let values: Vec<f64> = at.list()?.iter().map(number).collect::<Result<_, _>>()?;
    if values.len() == len { Ok(values) } else { Err(at.fail(format!("has {} entries, expected {len}", values.len()))) }
}

/// Anchors of `inputs`, in space.
fn anchors<const N: usize>(inputs: &Json<'_>) -> Result<Vec<[f64; 3]>, BuildError> {
    let place = |at: &Json<'_>| {
        let p = vector::<N>(at)?;
        Ok(std::array::from_fn(|i| if i < N { p[i] } else { 0.0 }))
    };
    inputs.get("anchors")?.list()?.iter().map(place).collect()
}

/// Runs every case at its `inputs.dim`.
fn cases(
    root: &Json<'_>,
    plane: fn(&mut Compared, &Json<'_>) -> Result<(), BuildError>,
    space: fn(&mut Compared, &Json<'_>) -> Result<(), BuildError>,
) -> Result<Vec<Quantity>, BuildError> {
    let mut compared = Compared::new(root)?;
    for case in root.get("cases")?.list()? {
        let dim = case.get("inputs")?.get("dim")?;
        match dim.count()? {
            2 => plane(&mut compared, &case)?,
            3 => space(&mut compared, &case)?,
            other => return Err(dim.fail(format!("is {other}, expected 2 or 3"))),
        }
    }
    Ok(compared.done())
}

/// `lateration`: status, linear stage and Gauss–Newton from each of its positions.
pub(super) fn laterations(root: &Json<'_>) -> Result<Vec<Quantity>, BuildError> {
    cases(root, lateration::<2>, lateration::<3>)
}

fn lateration<const N: usize>(compared: &mut Compared, case: &Json<'_>) -> Result<(), BuildError> {
    let (inputs, expected) = (case.get("inputs")?, case.get("expected")?);
    let anchors = anchors::<N>(&inputs)?;
    let range_m = listed(&inputs.get("ranges")?, anchors.len(), |at| at.number())?;
    let var_m2 = listed(&inputs.get("range_var")?, anchors.len(), positive)?;
    let range = |i: usize| Range { anchor_m: anchors[i], range_m: range_m[i], var_m2: var_m2[i] };
    let ranges: Vec<Range> = (0..anchors.len()).map(range).collect();
    let relative = inputs.optional("rank_rtol").map_or(Ok(Rank::EXACT.relative), |at| positive(&at))?;
    let (status, mut ours) = match lateration::linear::<N>(&ranges, None, Rank { relative, offset_m: 0.0 }) {
        Linear::Unique(p) => ("unique", vec![p]),
        Linear::Mirror(pair) => ("mirror", pair.to_vec()),
        Linear::NoIntersection { foot, .. } => ("nointersection", vec![foot; 2]),
        Linear::NotDetermined => ("under", Vec::new()),
    };
    compared.equal("status", expected.get("status")?.text()? == status);
    let theirs = expected.get("linear")?.list()?.iter().map(vector::<N>).collect::<Result<Vec<_>, _>>()?;
    // A mirrored pair is a set.
    let apart = |ours: &[Vector<N>]| ours.iter().zip(&theirs).map(|(a, b)| (a - b).norm()).sum::<f64>();
    let turned: Vec<Vector<N>> = ours.iter().rev().copied().collect();
    if apart(&turned) < apart(&ours) {
        ours = turned;
    }
    compared.equal("linear.count", ours.len() == theirs.len());
    for (a, b) in ours.iter().zip(&theirs) {
        compared.add("linear", a.as_slice(), b.as_slice(), 0.0);
    }
    let points = expected.get("gauss_newton")?.list()?;
    compared.equal("gauss_newton.count", points.len() == ours.len());
    for (start, theirs) in ours.iter().zip(&points) {
        let found = lateration::gauss_newton(&ranges, None, start);
        compared.point("gauss_newton", found, Some(theirs).filter(|p| !p.value.is_null()))?;
    }
    Ok(())
}

/// `tdoa`: linear start, and Gauss–Newton from the start given.
pub(super) fn time_differences(root: &Json<'_>) -> Result<Vec<Quantity>, BuildError> {
    cases(root, time_difference::<2>, time_difference::<3>)
}

fn time_difference<const N: usize>(compared: &mut Compared, case: &Json<'_>) -> Result<(), BuildError> {
    let (inputs, expected) = (case.get("inputs")?, case.get("expected")?);
    let anchors = anchors::<N>(&inputs)?;
    let (Some(reference_m), differences) = (anchors.first(), anchors.len().saturating_sub(1)) else {
        return Err(inputs.get("anchors")?.fail("has no anchor"));
    };
    let difference_m = listed(&inputs.get("tdoa_range_diff")?, differences, |at| at.number())?;
    let var_m2 = listed(&inputs.get("toa_var")?, anchors.len(), positive)?;
    let difference =
        |i: usize| Difference { anchor_m: anchors[i + 1], difference_m: difference_m[i], var_m2: var_m2[i + 1] };
    let list: Vec<Difference> = (0..differences).map(difference).collect();
    let data =
        Differences { reference_m: *reference_m, reference_var_m2: var_m2[0], differences: &list, height_m: None };
    let ours = match tdoa::linear::<N>(&data) {
        tdoa::Linear::Unique { position_m, reference_range_m } => {
            let mut all = position_m.as_slice().to_vec();
            all.push(reference_range_m);
            Some(all)
        }
        tdoa::Linear::Roots(_) | tdoa::Linear::NotDetermined => None,
    };
    match (ours, expected.optional("linear_p_r0")) {
        (Some(ours), Some(theirs)) => compared.add("linear_p_r0", &ours, &theirs.numbers()?, 0.0),
        (ours, theirs) => compared.equal("linear_p_r0", ours.is_none() && theirs.is_none()),
    }
    let start = vector::<N>(&inputs.get("start")?)?;
    compared.point("gauss_newton", tdoa::gauss_newton(&data, &start), expected.optional("gauss_newton").as_ref())
}

/// The path loss of `inputs`, and what its strength at `d0` is less than that at one metre.
fn law(inputs: &Json<'_>) -> Result<(PathLoss, f64), BuildError> {
    let exponent = positive(&inputs.get("n")?)?;
    let drop_db = 10.0 * exponent * positive(&inputs.get("d0")?)?.log10();
    Ok((PathLoss { exponent, at_1m_dbm: inputs.get("p0_dbm")?.number()? + drop_db }, drop_db))
}

/// `rss_ml`: the likelihood's maximum with the strength at `d0` known and unknown.
pub(super) fn likelihoods(root: &Json<'_>) -> Result<Vec<Quantity>, BuildError> {
    cases(root, likelihood::<2, 3>, likelihood::<3, 4>)
}

fn likelihood<const N: usize, const M: usize>(compared: &mut Compared, case: &Json<'_>) -> Result<(), BuildError> {
    let (inputs, expected) = (case.get("inputs")?, case.get("expected")?);
    let anchors = anchors::<N>(&inputs)?;
    let rss_dbm = listed(&inputs.get("rss_dbm")?, anchors.len(), |at| at.number())?;
    let strength = |(a, rss): (&[f64; 3], &f64)| Strength { anchor_m: *a, rss_dbm: *rss };
    let strengths: Vec<Strength> = anchors.iter().zip(&rss_dbm).map(strength).collect();
    let (law, drop_db) = law(&inputs)?;
    let data = Strengths { law, sd_db: positive(&inputs.get("sigma_db")?)?, strengths: &strengths, height_m: None };
    let start = vector::<N>(&inputs.get("start")?)?;
    let known = rss_ml::gauss_newton(&data, N, &start);
    compared.point("known_p0", known, expected.optional("known_p0").as_ref())?;
    // The search for the level starts where the position is best for the level stated.
    let from = known.map_or(start, |p| p.belief.mean);
    let start = Vector::<M>::from_fn(|i, _| if i < N { from[i] } else { law.at_1m_dbm });
    let unknown = rss_ml::gauss_newton(&data, N, &start).map(|mut point| {
        point.belief.mean[N] -= drop_db;
        point
    });
    compared.point("unknown_p0", unknown, expected.optional("unknown_p0").as_ref())
}

/// `rss_to_range`: the distances that a strength stands for.
pub(super) fn distances(root: &Json<'_>) -> Result<Vec<Quantity>, BuildError> {
    let mut compared = Compared::new(root)?;
    for case in root.get("cases")?.list()? {
        let (inputs, expected) = (case.get("inputs")?, case.get("expected")?);
        let (law, _) = law(&inputs)?;
        let range = to_range(law, inputs.get("rss_dbm")?.number()?, inputs.get("sigma_db")?.number()?);
        let ours = [
            ("range_median", range.median_m),
            ("kappa", range.kappa),
            ("range_mean_unbiased", range.unbiased_m),
            ("var_mean_unbiased", range.var_m2),
            ("mean_bias_factor_of_median", range.median_bias()),
        ];
        for (name, ours) in ours {
            compared.add(name, &[ours], &[expected.get(name)?.number()?], 0.0);
        }
    }
    Ok(compared.done())
}
