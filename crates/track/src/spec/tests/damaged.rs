//! Specs that were damaged on the way: an answer or an error, never a panic.

use super::parse_with;

const SPECS: [&str; 3] = [
    "version = 1\nanchors = \"a.csv\"\n[model]\nkind = \"constant-velocity\"\naxes = 2\nnoise = [0.5, 1e-3]\nx0 = [0, 0, 0, 0]\n\
     P0 = [[1, 0, 0, 0], [0, 1, 0.5, 0], [0, 0.5, 1, 0], [0, 0, 0, 1]]\n[[sensor]]\nkind = \"range\"\nsd = 0.15\n\
     bias = { A3 = 0.18 }\nheight_m = 1.0\nrobust = \"gate\"\ngate = 9.0\n[[sensor]]\nkind = \"position\"\nsd = 1\n\
     [estimator]\nkind = \"fms\"\nwindow_s = 3.0\nlag_s = 1\n[link]\nlate_s = 5.0\n[columns]\nt = \"zeit\"\n",
    "[model]\nkind = \"linear\"\nA = [[1.0, 2.0], [0.0, 1.0]]\nB = [[1], [2]]\nG = [[1], [0]]\nC = [[1.0, 0.0]]\nQ = [[0.1]]\n\
     R = [[0.25]]\nx0 = [0, 0]\nP0 = [[1, 0], [0, 1]]\nsequence = \"steps.ndjson\"\n\
     [estimator]\nkind = \"fms\"\nwindow = 15\nlag = 5\nalign = \"predicted\"\n",
    "[model]\nkind = \"coordinated-turn\"\nnoise = 1\nturn_noise = 0.1\n[sensor]\nkind = \"position\"\nsd = 1\n",
];

const STEPS: &[u8] = b"{\"A\": [[1, 2], [0, 1]], \"R\": [[0.5]]}\n{\"Q\": [[0.2]]}\n{}\n";

/// Numerical Recipes' 64-bit linear congruential generator: the same damage in every run.
struct Chance(u64);

impl Chance {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) % n as u64) as usize
    }

    /// `bytes` cut short, or with up to four of them changed, dropped or doubled.
    fn damage(&mut self, bytes: &[u8]) -> Vec<u8> {
        const LIKELY: &[u8] = b"[]{}=\",.-+0123456789eExinfa_ \n\r\0#";
        let mut bytes = bytes.to_vec();
        if self.below(4) == 0 {
            bytes.truncate(self.below(bytes.len()));
            return bytes;
        }
        for _ in 0..=self.below(4) {
            let i = self.below(bytes.len());
            match self.below(4) {
                0 => bytes[i] ^= 1 << self.below(8),
                1 => bytes[i] = LIKELY[self.below(LIKELY.len())],
                2 => drop(bytes.remove(i)),
                _ => bytes.insert(i, bytes[i]),
            }
        }
        bytes
    }
}

#[test]
fn damaged_specs_and_steps_never_panic() {
    let mut chance = Chance(2);
    let (mut good, mut bad) = (0, 0);
    for round in 0..6000 {
        let spec = SPECS[round % SPECS.len()];
        let text = chance.damage(spec.as_bytes());
        // Text that is no longer UTF-8 never reaches the parser.
        let results = [parse_with(&String::from_utf8_lossy(&text), STEPS), parse_with(spec, &chance.damage(STEPS))];
        for result in results {
            match result {
                Ok(_) => good += 1,
                Err(error) => {
                    bad += 1;
                    let message = error.to_string();
                    assert!(!message.contains('\n') && !message.ends_with('.'), "{message:?}");
                }
            }
        }
    }
    // Most damage hurts and some does not: both ways were taken many times.
    assert!(good > 500 && bad > 500, "{good} good, {bad} bad");
}

#[test]
fn undamaged_specs_are_good() {
    for spec in SPECS {
        parse_with(spec, STEPS).unwrap();
    }
}

#[test]
fn deep_nesting_is_an_error() {
    let deep = format!("x = {}", "[".repeat(100_000));
    assert!(parse_with(&deep, b"").is_err());
    let steps = format!("{{\"A\": {}", "[".repeat(100_000));
    assert!(parse_with(SPECS[1], steps.as_bytes()).is_err());
}
