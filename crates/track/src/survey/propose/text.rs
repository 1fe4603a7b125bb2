//! Numbers and names as TOML has them.

use core::fmt::Write as _;

/// Two significant digits, as TOML reads a float.
pub(super) fn rounded(value: f64) -> String {
    let text = format!("{value:.1e}");
    let short = text.parse::<f64>().unwrap_or(value);
    let plain = format!("{short:?}");
    if plain.len() <= 12 { plain } else { text }
}

/// Centimetres, as TOML reads a float.
pub(super) fn tidy(value: f64) -> String {
    format!("{:?}", (100.0 * value).round() / 100.0)
}

/// Text that stays on its line of comment.
pub(super) fn comment(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}

/// A TOML key: bare where it may be.
pub(super) fn key(name: &str) -> String {
    let bare = !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-');
    if bare { name.to_owned() } else { quoted(name) }
}

/// A basic TOML string.
pub(super) fn quoted(text: &str) -> String {
    let mut out = String::from("\"");
    for c in text.chars() {
        match c {
            '"' | '\\' => out.extend(['\\', c]),
            c if c.is_control() => {
                let _ = write!(out, "\\u{:04X}", c as u32);
            }
            c => out.push(c),
        }
    }
    out + "\""
}
