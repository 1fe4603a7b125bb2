//! Decimal numbers as sensors write them: few digits, no exponent.

/// Powers of ten that an f64 holds exactly.
const TENS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20,
    1e21, 1e22,
];

/// Whole numbers up to here are exact in an f64.
const EXACT: u64 = 1 << 53;

/// The number that `text` is, white space around it aside, if its digits make a whole number below 2^53 and it has no exponent; `None` says
/// that it needs a closer look.
///
/// Both the digits and the power of ten are exact then, so the quotient, rounded once, is the f64 nearest to the text
/// (Clinger 1990, the fast path).
pub(super) fn decimal(text: &[u8]) -> Option<f64> {
    let text = text.trim_ascii();
    let (value, length) = leading(text)?;
    (length == text.len()).then_some(value)
}

/// The number at the beginning of `text` and its length, under the same conditions.
#[inline]
pub(crate) fn leading(text: &[u8]) -> Option<(f64, usize)> {
    let negative = text.first() == Some(&b'-');
    let start = usize::from(negative);
    if let Some((value, length)) = text.get(start..).and_then(short) {
        return Some((if negative { -value } else { value }, start + length));
    }
    let (mut whole, mut at) = (0_u64, start);
    let mut digits = |from: usize| {
        let mut at = from;
        while let Some(digit) = text.get(at).map(|byte| byte.wrapping_sub(b'0')).filter(|digit| *digit < 10) {
            whole = whole.wrapping_mul(10).wrapping_add(u64::from(digit));
            at += 1;
        }
        at
    };
    at = digits(at);
    let (mut places, mut has_point) = (0, 0);
    if text.get(at) == Some(&b'.') {
        has_point = 1;
        let end = digits(at + 1);
        places = end - at - 1;
        at = end;
    }
    let count = at - start - has_point;
    // 19 digits cannot overflow.
    if count == 0 || count > 19 || whole > EXACT {
        return None;
    }
    let value = whole as f64 / TENS[places];
    Some((if negative { -value } else { value }, at))
}

/// The number at the beginning of `text` and its length, if it has at most 7 digits before and after its point and 18 bytes follow: digits are
/// taken eight at a time.
#[inline]
fn short(text: &[u8]) -> Option<(f64, usize)> {
    let (whole, count) = digits(text)?;
    if count == 0 {
        return None;
    }
    if text[count] != b'.' {
        return Some((whole as i64 as f64, count));
    }
    let (part, places) = digits(&text[count + 1..])?;
    Some(((whole * WHOLE_TENS[places] + part) as i64 as f64 / TENS[places], count + 1 + places))
}

/// Powers of ten as whole numbers.
const WHOLE_TENS: [u64; 8] = [1, 10, 100, 1_000, 10_000, 100_000, 1_000_000, 10_000_000];

/// The whole number of the digits at the beginning of `text`, and how many there are; `None` for more than 7, and at the end of a text.
#[inline]
fn digits(text: &[u8]) -> Option<(u64, usize)> {
    let eight = u64::from_le_bytes(*text.first_chunk::<8>()?);
    // A digit becomes its value, anything else a byte of 10 or more; then its top bit tells.
    let values = eight ^ 0x3030_3030_3030_3030;
    let others = (values.wrapping_add(0x7676_7676_7676_7676) | values) & 0x8080_8080_8080_8080;
    let count = (others.trailing_zeros() / 8) as usize;
    if count > 7 {
        return None;
    }
    if count == 0 {
        return Some((0, 0));
    }
    // As the last of eight digits, with zeros before them: pairs, then fours, then all.
    let padded = values << (64 - 8 * count);
    let pairs = (padded.wrapping_mul(2561) >> 8) & 0x00FF_00FF_00FF_00FF;
    let fours = (pairs.wrapping_mul(6_553_601) >> 16) & 0x0000_FFFF_0000_FFFF;
    Some((fours.wrapping_mul(42_949_672_960_001) >> 32, count))
}

#[cfg(test)]
mod tests {
    use super::{decimal, leading};

    #[test]
    fn what_is_read_is_what_the_standard_library_reads() {
        let mut state = 1_u64;
        let mut random = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            state >> 33
        };
        let mut read = 0;
        for _ in 0..200_000 {
            let (digits, point) = (random() % 19 + 1, random() % 20);
            let sign = if random() % 2 == 0 { "-" } else { "" };
            let mut text: String = (0..digits).map(|_| char::from(b'0' + (random() % 10) as u8)).collect();
            if point <= digits {
                text.insert(point as usize, '.');
            }
            let text = format!("{sign}{text}");
            if let Some(x) = decimal(text.as_bytes()) {
                read += 1;
                assert_eq!(x.to_bits(), text.parse::<f64>().unwrap().to_bits(), "{text}");
            }
        }
        assert!(read > 100_000);
    }

    #[test]
    fn short_numbers_within_a_line_are_what_the_standard_library_reads() {
        let mut state = 2_u64;
        let mut random = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            state >> 33
        };
        for _ in 0..200_000 {
            let mut digits =
                |count: u64| (0..count).map(|_| char::from(b'0' + (random() % 10) as u8)).collect::<String>();
            let (whole, part) = (digits(9), digits(9));
            let (n, m, form) = (random() as usize % 8 + 1, random() as usize % 8, random() % 4);
            let sign = if form % 2 == 0 { "-" } else { "" };
            let text = if form < 2 {
                format!("{sign}{}.{}", &whole[..n], &part[..m])
            } else {
                format!("{sign}{}", &whole[..n])
            };
            // A second point ends a number that has one.
            let end =
                [",", "\n", "e5", "x", ":", "/", "-1", "\u{e9}", "."][random() as usize % if form < 2 { 9 } else { 8 }];
            let line = format!("{text}{end}{part}{part}");
            let (value, length) = leading(line.as_bytes()).unwrap();
            assert_eq!((value.to_bits(), length), (text.parse::<f64>().unwrap().to_bits(), text.len()), "{line}");
        }
    }

    #[test]
    fn what_needs_a_closer_look_is_left() {
        for text in [
            "",
            " ",
            "-",
            ".",
            "-.",
            "1e3",
            "nan",
            "inf",
            "+1",
            "1.2.3",
            "0x1",
            "1_0",
            "12345678901234567890",
            "--1",
            "1 2",
            "9007199254740993",
        ] {
            assert_eq!(decimal(text.as_bytes()), None, "{text}");
        }
        assert_eq!(decimal(b" 1.5 "), Some(1.5));
        assert_eq!(decimal(b"1."), Some(1.0));
        assert_eq!(decimal(b".5"), Some(0.5));
    }
}
