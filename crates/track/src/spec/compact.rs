//! Estimators in a compact form, `fms:window=15,lag=5`: the same keys and checks as `[estimator]`.

use super::value::{Node, Table};
use super::{Align, EmvfVariant, EstimatorSpec, FosbNoise, Span, Spec, estimator, link};
use crate::error::BuildError;
use std::path::Path;

/// The estimators of a list like `ekf,fms:window=15,lag=5,rts`: what follows a comma and has a `=` before any `:` is one more option of the
/// estimator before.
pub fn split_estimators(list: &str) -> Vec<String> {
    let mut out: Vec<String> = Vec::new();
    for part in list.split(',').map(str::trim) {
        let is_option = part.find('=').is_some_and(|at| !part[..at].contains(':'));
        match out.last_mut().filter(|_| is_option) {
            Some(last) => {
                last.push(if last.contains(':') { ',' } else { ':' });
                last.push_str(part);
            }
            None => out.push(part.to_owned()),
        }
    }
    out
}

impl Spec {
    /// This spec with the estimator that `text` names. Options that it leaves out are those of the spec's own estimator if that is of the
    /// same kind. `given` says in messages where `text` comes from.
    ///
    /// # Errors
    /// [`BuildError`] with the key, as for `[estimator]`: an unknown name or key, a bad value, an estimator that does not suit model, sensors
    /// or link.
    pub fn with_estimator(&self, text: &str, given: &str) -> Result<Spec, BuildError> {
        let place = format!("{given} {text}");
        let file = Path::new(&place);
        let parsed = self.parse_estimator(text, file).map_err(|mut e| {
            e.place.line = None;
            e
        })?;
        Ok(Spec { estimator: parsed, ..self.clone() })
    }

    fn parse_estimator(&self, text: &str, file: &Path) -> Result<EstimatorSpec, BuildError> {
        let (kind, options) = text.split_once(':').map_or((text, None), |(kind, options)| (kind, Some(options)));
        if options.is_none() && kind.trim() == self.estimator.name() {
            // Some have options that no compact form holds.
            return Ok(self.estimator);
        }
        let fail = |key: &str, what: String| BuildError::new(file, None, Some(&format!("estimator.{key}")), what);
        let mut entries = vec![("kind", kind.trim())];
        for option in options.into_iter().flat_map(|o| o.split(',')) {
            let Some((key, value)) = option.split_once('=').map(|(k, v)| (k.trim(), v.trim())) else {
                return Err(BuildError::new(file, None, None, format!("has {option:?}, expected `key=value`")));
            };
            if entries.iter().any(|(k, _)| *k == key) {
                let what =
                    if key == "kind" { "stands before the colon, expected other keys" } else { "is given twice" };
                return Err(fail(key, what.to_owned()));
            }
            entries.push((key, value));
        }
        let own = self.estimator.options();
        if self.estimator.name() == kind.trim() {
            // A span in seconds takes the place of one in instants.
            let stem = |key: &str| key.strip_suffix("_s").unwrap_or(key).to_owned();
            let given: Vec<String> = entries.iter().map(|(key, _)| stem(key)).collect();
            entries
                .extend(own.iter().filter(|(key, _)| !given.contains(&stem(key))).map(|(key, v)| (*key, v.as_str())));
        }
        let node = Node::of_words("estimator", &entries);
        let field = node.field(file, "");
        let root: Table<'_> = field.table("a table")?;
        let table = root.require("estimator", "a table")?.table("a table")?;
        let parsed = estimator::estimator(&table, &self.model, &self.sensors)?;
        link::suits(&root, &self.link, &parsed, &self.model)?;
        Ok(parsed)
    }
}

impl EstimatorSpec {
    /// Keys and values of `[estimator]` besides `kind`, those that are not the defaults.
    fn options(&self) -> Vec<(&'static str, String)> {
        let span = |[instants, seconds]: [&'static str; 2], span: Span| match span {
            Span::Instants(n) => (instants, n.to_string()),
            Span::Seconds(s) => (seconds, s.to_string()),
        };
        let (window_keys, lag_keys) = (["window", "window_s"], ["lag", "lag_s"]);
        match *self {
            EstimatorSpec::FixedLagKalman { lag } => vec![span(lag_keys, lag)],
            EstimatorSpec::Ufir { window } => vec![span(window_keys, window)],
            EstimatorSpec::Fms { window, lag, align } => {
                let mut out = vec![span(window_keys, window)];
                if lag != Span::Instants(0) {
                    out.push(span(lag_keys, lag));
                }
                if align == Align::Predicted {
                    out.push(("align", "predicted".to_owned()));
                }
                out
            }
            EstimatorSpec::Lmvf { square_root: true } => vec![("square_root", "true".to_owned())],
            EstimatorSpec::Emvf { variant, range_mixture } => {
                let variant = match variant {
                    EmvfVariant::Model2 => None,
                    EmvfVariant::Model1Zero => Some("model1-zero"),
                    EmvfVariant::Model1Skip => Some("model1-skip"),
                };
                let mut out: Vec<_> = variant.into_iter().map(|v| ("variant", v.to_owned())).collect();
                out.extend(range_mixture.then(|| ("range_mixture", "true".to_owned())));
                out
            }
            EstimatorSpec::Fosb { noise, speed_sd } => {
                let mut out = match noise {
                    FosbNoise::Model => Vec::new(),
                    FosbNoise::Speed { q11, q33 } => vec![("q11", q11.to_string()), ("q33", q33.to_string())],
                    FosbNoise::Acceleration { q } => vec![("q", q.to_string())],
                };
                out.extend(speed_sd.map(|sd| ("speed_sd", sd.to_string())));
                out
            }
            EstimatorSpec::AlphaBeta { gains, interval_s } => {
                let mut out: Vec<_> = gains
                    .into_iter()
                    .flat_map(|[alpha, beta]| [("alpha", alpha.to_string()), ("beta", beta.to_string())])
                    .collect();
                out.extend(interval_s.map(|s| ("interval_s", s.to_string())));
                out
            }
            _ => Vec::new(),
        }
    }

    /// The compact form, which [`Spec::with_estimator`] reads: `fms:window=15,lag=5`.
    pub fn compact(&self) -> String {
        let options: Vec<String> = self.options().into_iter().map(|(key, value)| format!("{key}={value}")).collect();
        if options.is_empty() { self.name().to_owned() } else { format!("{}:{}", self.name(), options.join(",")) }
    }

    /// Whether the estimator's own rows are smoothed, with data later than the instant they describe; `fms` with a lag is asked for it.
    pub fn is_smoother(&self) -> bool {
        matches!(self, EstimatorSpec::Rts | EstimatorSpec::FixedLagKalman { .. })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spec::parse;

    const LINEAR: &str = "[model]\nkind = \"linear\"\nA = [[1.0]]\nC = [[1.0]]\nQ = [[1.0]]\nR = [[1.0]]\n";
    const RANGES: &str =
        "[model]\nkind = \"constant-velocity\"\naxes = 2\nnoise = 1.0\n[sensor]\nkind = \"range\"\nsd = 0.1\n";

    fn spec(text: &str) -> Spec {
        parse(text, Path::new("spec.toml"), &mut |_| Err(std::io::ErrorKind::NotFound.into())).unwrap()
    }

    #[test]
    fn lists_split_into_estimators_with_their_options() {
        let split = split_estimators("ekf, fms:window=15,lag=5,rts,ufir:window_s=2.5");
        assert_eq!(split, ["ekf", "fms:window=15,lag=5", "rts", "ufir:window_s=2.5"]);
        assert_eq!(split_estimators("ekf,,rts"), ["ekf", "", "rts"]);
        // A slip of the hand that means the same.
        assert_eq!(split_estimators("fms,window=15,lag=5"), ["fms:window=15,lag=5"]);
    }

    #[test]
    fn options_left_out_come_from_the_spec_of_the_same_kind() {
        let own = spec(&format!("{LINEAR}[estimator]\nkind = \"fms\"\nwindow = 15\nlag = 5\nalign = \"predicted\"\n"));
        for (text, expected) in [
            ("fms", "fms:window=15,lag=5,align=predicted"),
            ("fms:lag=2", "fms:window=15,lag=2,align=predicted"),
            ("fms:window_s=9.5,lag_s=0.5", "fms:window_s=9.5,lag_s=0.5,align=predicted"),
            ("fms:window=3,lag=0,align=filtered", "fms:window=3"),
            ("ufir:window=8", "ufir:window=8"),
            ("fixed-lag-kalman:lag=5", "fixed-lag-kalman:lag=5"),
            ("kalman", "kalman"),
        ] {
            let made = own.with_estimator(text, "--estimators").unwrap();
            assert_eq!(made.estimator.compact(), expected);
            assert_eq!(made.with_estimator(expected, "--estimators").unwrap(), made);
        }
    }

    #[test]
    fn filters_of_two_states_have_a_compact_form() {
        let own = spec(&RANGES.replace("range", "position"));
        for text in [
            "fosb",
            "fosb:q=0.16,speed_sd=2",
            "fosb:q11=0.16,q33=0.25",
            "alpha-beta",
            "alpha-beta:alpha=0.5,beta=0.1,interval_s=0.5",
        ] {
            let made = own.with_estimator(text, "--estimators").unwrap();
            assert_eq!(made.estimator.compact(), text);
            assert_eq!(made.with_estimator(text, "--estimators").unwrap(), made);
            // What is left out comes from the spec.
            assert_eq!(made.with_estimator(made.estimator.name(), "--estimators").unwrap(), made);
        }
    }

    #[test]
    fn modes_of_motion_come_from_the_spec_or_are_the_defaults() {
        let mode = |noise: f64| format!("[[estimator.mode]]\nnoise = {noise:?}\nmean_s = 3.0\n");
        let own = spec(&format!("{RANGES}[estimator]\nkind = \"imm\"\n{}{}", mode(0.1), mode(5.0)));
        assert_eq!(own.with_estimator("imm", "--estimators").unwrap(), own);
        let other = spec(RANGES).with_estimator("imm", "--estimators").unwrap();
        assert_eq!(other.estimator.compact(), "imm");
        assert_ne!(other.estimator, own.estimator);
    }

    #[test]
    fn bad_estimators_are_refused_by_their_key() {
        for (base, text, message) in [
            (LINEAR, "kalmann", "--estimators kalmann: `estimator.kind`: is \"kalmann\", expected one of "),
            (LINEAR, "fms", "--estimators fms: `estimator.window`: is missing, expected a number of instants"),
            (LINEAR, "fms:window=0", "`estimator.window`: is 0, expected a whole number from 1 to"),
            (LINEAR, "fms:window=x", "`estimator.window`: is \"x\", expected a whole number"),
            (LINEAR, "fms:windw=9", "fms:windw=9: `estimator.windw`: is not a key of the estimator `fms`"),
            (LINEAR, "fms:window=9,window=8", "`estimator.window`: is given twice"),
            (LINEAR, "fms:window", "has \"window\", expected `key=value`"),
            (LINEAR, "kalman:kind=ekf", "`estimator.kind`: stands before the colon"),
            (LINEAR, "gpb1", "`estimator.kind`: is \"gpb1\", which is for receivers that do not know"),
            (RANGES, "kalman", "`estimator.kind`: is \"kalman\", which is for linear models and sensors, but"),
        ] {
            let error = spec(base).with_estimator(text, "--estimators").unwrap_err().to_string();
            assert!(error.contains(message), "{text}: {error}");
        }
    }
}
