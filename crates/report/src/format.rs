//! Numbers and names as readers see them.

/// A number with about three significant digits.
pub fn number(v: f64) -> String {
    let size = v.abs();
    if size == 0.0 {
        "0".to_owned()
    } else if !(0.001..1e6).contains(&size) {
        format!("{v:.2e}")
    } else if size >= 100.0 {
        format!("{v:.0}")
    } else if size >= 10.0 {
        format!("{v:.1}")
    } else if size >= 0.995 {
        format!("{v:.2}")
    } else {
        format!("{v:.3}")
    }
}

/// A count with thin spaces between groups of three digits.
pub fn count(n: usize) -> String {
    let digits = n.to_string();
    let mut out = String::new();
    for (i, c) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push('\u{2009}');
        }
        out.push(c);
    }
    out
}

/// A fraction in per cent.
pub fn percent(fraction: f64) -> String {
    let p = 100.0 * fraction;
    if p > 99.0 && p < 100.0 || p > 0.0 && p < 1.0 { format!("{p:.1} %") } else { format!("{p:.0} %") }
}

/// The name of a target.
pub fn target(id: Option<&str>) -> &str {
    id.unwrap_or("the target")
}

/// At most `max` characters of `s`, with an ellipsis where it was cut.
pub fn shortened(s: &str, max: usize) -> String {
    if s.chars().count() <= max { s.to_owned() } else { s.chars().take(max - 1).chain(['…']).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_three_digits_and_counts_are_grouped() {
        assert_eq!(
            [0.0, 0.12345, 1.2345, 0.997, 12.345, 1234.5].map(number),
            ["0", "0.123", "1.23", "1.00", "12.3", "1234"]
        );
        assert_eq!(number(1.5e-5), "1.50e-5");
        assert_eq!([7, 1234, 1234567].map(count), ["7", "1\u{2009}234", "1\u{2009}234\u{2009}567"]);
        assert_eq!([0.0, 0.314, 0.9951, 1.0].map(percent), ["0 %", "31 %", "99.5 %", "100 %"]);
        assert_eq!((shortened("anchor", 6), shortened("anchors", 6)), ("anchor".to_owned(), "ancho…".to_owned()));
    }
}
