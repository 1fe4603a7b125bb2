//! Counts of sizes, for quantiles of more values than are worth keeping.

use std::collections::BTreeMap;

/// Cells in a factor of two. A quantile is known to half a cell, 0.034 %.
const CELLS: f64 = 1024.0;

/// Values that are not negative, counted in cells of equal ratio. What it holds does not depend on the order in which values came.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Histogram {
    cells: BTreeMap<i32, u64>,
    count: u64,
}

impl Histogram {
    /// Counts a value.
    pub fn add(&mut self, value: f64) {
        // 0 and what is smaller than any number that means something share the lowest cell, what is not finite the highest.
        let cell = if value.is_finite() { (value.log2() * CELLS).floor() as i32 } else { i32::MAX };
        *self.cells.entry(cell).or_insert(0) += 1;
        self.count += 1;
    }

    /// How many values it has counted.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// The values below which each of the shares `p`, ascending, of the values lies; empty without values.
    pub fn quantiles(&self, p: &[f64]) -> Vec<f64> {
        let Some(last) = self.count.checked_sub(1) else { return Vec::new() };
        let (mut before, mut cells) = (0, self.cells.iter());
        let mut cell = cells.next();
        p.iter()
            .map(|p| {
                // Of n values in order the p-th stands at p·(n − 1).
                let place = p.clamp(0.0, 1.0) * last as f64;
                while let Some((_, n)) = cell.filter(|(_, n)| (before + **n) as f64 <= place) {
                    before += n;
                    cell = cells.next();
                }
                match cell {
                    None | Some((&i32::MAX, _)) => f64::INFINITY,
                    Some((&i32::MIN, _)) => 0.0,
                    Some((cell, n)) => {
                        let within = (place - before as f64 + 0.5) / *n as f64;
                        ((f64::from(*cell) + within.min(1.0)) / CELLS).exp2()
                    }
                }
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_agree_with_those_of_the_sorted_values_to_a_cell() {
        let mut values: Vec<f64> = (1..=5000).map(|i| (6.0 * (f64::from(i) * 0.618_033_988_7).fract()).exp()).collect();
        let mut histogram = Histogram::default();
        values.iter().for_each(|v| histogram.add(*v));
        values.sort_by(f64::total_cmp);
        let p = [0.0, 0.05, 0.5, 0.6, 0.9, 0.95, 1.0];
        for (p, got) in p.iter().zip(histogram.quantiles(&p)) {
            let wanted = values[(p * 4999.0).round() as usize];
            // Neighbours are 0.12 % apart, at most twice that; a cell is 0.07 %.
            assert!((got / wanted - 1.0).abs() < 3e-3, "{p}: {got} {wanted}");
        }
    }

    #[test]
    fn order_does_not_matter_and_edges_have_their_cells() {
        let values = [0.0, 3.0, f64::INFINITY, 1e-300, 3.0, f64::NAN];
        let of = |values: &mut dyn Iterator<Item = &f64>| {
            let mut histogram = Histogram::default();
            values.for_each(|v| histogram.add(*v));
            histogram
        };
        assert_eq!(of(&mut values.iter()), of(&mut values.iter().rev()));
        let q = of(&mut values.iter()).quantiles(&[0.0, 0.5, 1.0]);
        assert!(q[0] == 0.0 && (q[1] / 3.0 - 1.0).abs() < 1e-3 && q[2] == f64::INFINITY, "{q:?}");
        assert!(Histogram::default().quantiles(&[0.5]).is_empty());
    }
}
