//! From values to places on the page, and the round numbers beside an axis.

/// Maps values onto an interval of the drawing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// Smallest value.
    pub low: f64,
    /// Largest value.
    pub high: f64,
    /// Where `low` stands.
    pub from: f64,
    /// Where `high` stands.
    pub to: f64,
    /// Whether equal distances are equal ratios.
    pub log: bool,
}

impl Scale {
    /// A linear scale; an empty or unusable interval of values is widened.
    pub fn linear([low, high]: [f64; 2], [from, to]: [f64; 2]) -> Scale {
        let (low, high) = if low.is_finite() && high.is_finite() { (low, high) } else { (0.0, 1.0) };
        let pad = if high > low { 0.0 } else { 0.5 * low.abs().max(1.0) };
        Scale { low: low - pad, high: high + pad, from, to, log: false }
    }

    /// A logarithmic scale of positive values.
    pub fn log([low, high]: [f64; 2], [from, to]: [f64; 2]) -> Scale {
        Scale { low, high, from, to, log: true }
    }

    /// Where `value` stands.
    pub fn at(&self, value: f64) -> f64 {
        let f = |v: f64| if self.log { v.max(f64::MIN_POSITIVE).log10() } else { v };
        self.from + (f(value) - f(self.low)) / (f(self.high) - f(self.low)) * (self.to - self.from)
    }

    /// Round values inside the scale, about `wanted` of them, with their labels.
    pub fn ticks(&self, wanted: usize) -> Vec<(f64, String)> {
        if self.log { self.log_ticks() } else { self.linear_ticks(wanted) }
    }

    fn linear_ticks(&self, wanted: usize) -> Vec<(f64, String)> {
        let step = round_step((self.high - self.low) / wanted.max(1) as f64);
        let decimals = (-step.log10().floor()).max(0.0) as usize;
        // Ends that are round up to rounding belong to the axis.
        let first = (self.low / step - 1e-9).ceil() as i64;
        let last = (self.high / step + 1e-9).floor() as i64;
        (first..=last)
            .map(|i| {
                let v = i as f64 * step;
                (v, if v.abs() >= 1e7 || decimals > 6 { format!("{v:.3e}") } else { format!("{v:.decimals$}") })
            })
            .collect()
    }

    fn log_ticks(&self) -> Vec<(f64, String)> {
        let (first, last) = (self.low.log10().floor() as i32, self.high.log10().ceil() as i32);
        let parts: &[f64] = if last - first <= 3 { &[1.0, 2.0, 5.0] } else { &[1.0] };
        (first..=last)
            .flat_map(|e| parts.iter().map(move |m| m * 10f64.powi(e)))
            .filter(|v| *v >= self.low * (1.0 - 1e-9) && *v <= self.high * (1.0 + 1e-9))
            .map(|v| {
                let decimals = (-v.log10().floor()).max(0.0) as usize;
                (v, if (1e-4..1e6).contains(&v) { format!("{v:.decimals$}") } else { format!("{v:.0e}") })
            })
            .collect()
    }
}

/// The one of 1, 2, 5 × a power of ten that is near `step`.
fn round_step(step: f64) -> f64 {
    let power = 10f64.powf(step.log10().floor());
    let ratio = step / power;
    power
        * if ratio <= 1.5 {
            1.0
        } else if ratio <= 3.5 {
            2.0
        } else if ratio <= 7.5 {
            5.0
        } else {
            10.0
        }
}

/// The horizontal axis of everything over time: seconds, minutes or hours from the first instant, or the index of a linear run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeAxis {
    origin: f64,
    unit: f64,
    /// What stands below the axis.
    pub title: &'static str,
    /// Short unit, as in a caption.
    pub unit_name: &'static str,
    /// Length in units.
    pub length: f64,
}

impl TimeAxis {
    /// The axis of instants from `first` to `last`, in seconds.
    pub fn seconds(first: f64, last: f64) -> TimeAxis {
        let span = last - first;
        let (unit, title, unit_name) = if span <= 900.0 {
            (1.0, "time from the first instant [s]", "s")
        } else if span <= 4.0 * 3600.0 {
            (60.0, "time from the first instant [min]", "min")
        } else {
            (3600.0, "time from the first instant [h]", "h")
        };
        TimeAxis { origin: first, unit, title, unit_name, length: span / unit }
    }

    /// The axis of time indices from 0 to `last`.
    pub fn index(last: u64) -> TimeAxis {
        TimeAxis { origin: 0.0, unit: 1.0, title: "time index k", unit_name: "steps", length: last as f64 }
    }

    /// An instant in units of the axis.
    pub fn of(&self, t: f64) -> f64 {
        (t - self.origin) / self.unit
    }

    /// The scale onto `px`.
    pub fn scale(&self, px: [f64; 2]) -> Scale {
        Scale::linear([0.0, self.length.max(f64::MIN_POSITIVE)], px)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(s: Scale) -> Vec<String> {
        s.ticks(5).into_iter().map(|(_, l)| l).collect()
    }

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(labels(Scale::linear([0.0, 120.0], [0.0, 1.0])), ["0", "20", "40", "60", "80", "100", "120"]);
        assert_eq!(
            labels(Scale::linear([0.0, 0.3], [0.0, 1.0])),
            ["0.00", "0.05", "0.10", "0.15", "0.20", "0.25", "0.30"]
        );
        assert_eq!(
            labels(Scale::linear([-0.02, 0.05], [0.0, 1.0])),
            ["-0.02", "-0.01", "0.00", "0.01", "0.02", "0.03", "0.04", "0.05"]
        );
        assert_eq!(labels(Scale::log([0.05, 3.0], [0.0, 1.0])), ["0.05", "0.1", "0.2", "0.5", "1", "2"]);
    }

    #[test]
    fn scale_of_a_single_value_is_widened() {
        let s = Scale::linear([3.0, 3.0], [0.0, 100.0]);
        assert_eq!(s.at(3.0), 50.0);
        assert!(Scale::linear([f64::INFINITY, f64::NEG_INFINITY], [0.0, 1.0]).at(0.5).is_finite());
    }

    #[test]
    fn time_axis_chooses_a_readable_unit() {
        let axis = TimeAxis::seconds(1.7e9, 1.7e9 + 7200.0);
        assert_eq!((axis.unit_name, axis.of(1.7e9 + 3600.0), axis.length), ("min", 60.0, 120.0));
    }
}
