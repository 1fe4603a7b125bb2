//! Table 4 of \[FOSB12\], whose values are not in the text: operations per step, counted on the equations themselves.
//!
//! Numbers are replaced by what is known of them. As in the paper, a multiplication by 0 or 1, a division by 1 and an addition of 0 do not
//! count; that covariances of different axes are 0 is not used.

use crate::papers::{Entry, Measured};
use std::cell::Cell;
use std::ops::{Add, Div, Mul, Sub};

/// What is known of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Known {
    Zero,
    One,
    Nothing,
}
use Known::{Nothing, One, Zero};

/// Multiplications, additions and subtractions, divisions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Operations {
    /// Multiplications.
    pub mul: u32,
    /// Additions and subtractions.
    pub add: u32,
    /// Divisions.
    pub div: u32,
}

thread_local! {
    static COUNT: Cell<Operations> = const { Cell::new(Operations { mul: 0, add: 0, div: 0 }) };
}

fn note(change: impl Fn(&mut Operations)) -> Known {
    COUNT.with(|c| {
        let mut operations = c.get();
        change(&mut operations);
        c.set(operations);
    });
    Nothing
}

impl Mul for Known {
    type Output = Known;
    fn mul(self, other: Known) -> Known {
        match (self, other) {
            (Zero, _) | (_, Zero) => Zero,
            (One, x) | (x, One) => x,
            _ => note(|o| o.mul += 1),
        }
    }
}

impl Add for Known {
    type Output = Known;
    fn add(self, other: Known) -> Known {
        match (self, other) {
            (Zero, x) | (x, Zero) => x,
            _ => note(|o| o.add += 1),
        }
    }
}

impl Sub for Known {
    type Output = Known;
    fn sub(self, other: Known) -> Known {
        match other {
            Zero => self,
            _ => note(|o| o.add += 1),
        }
    }
}

impl Div for Known {
    type Output = Known;
    fn div(self, other: Known) -> Known {
        match other {
            One => self,
            _ => note(|o| o.div += 1),
        }
    }
}

/// Which noise drives the motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Driven {
    /// (13): Q is diagonal.
    Speed,
    /// (15).
    Acceleration,
}

fn counted(step: impl Fn()) -> Operations {
    COUNT.set(Operations::default());
    step();
    COUNT.get()
}

type Square<const R: usize, const C: usize> = [[Known; C]; R];

fn product<const R: usize, const K: usize, const C: usize>(a: &Square<R, K>, b: &Square<K, C>) -> Square<R, C> {
    std::array::from_fn(|i| std::array::from_fn(|j| (1..K).fold(a[i][0] * b[0][j], |sum, k| sum + a[i][k] * b[k][j])))
}

fn transposed<const R: usize, const C: usize>(a: &Square<R, C>) -> Square<C, R> {
    std::array::from_fn(|i| std::array::from_fn(|j| a[j][i]))
}

fn each<const R: usize, const C: usize>(
    a: &Square<R, C>,
    b: &Square<R, C>,
    f: fn(Known, Known) -> Known,
) -> Square<R, C> {
    std::array::from_fn(|i| std::array::from_fn(|j| f(a[i][j], b[i][j])))
}

/// A step of (41), (43)–(45) in matrices, one axis or two: `N` = 2 `M` states, locations first.
fn matrices<const N: usize, const M: usize>(driven: Driven, eliminate: bool) -> Operations {
    let known = |k: Known| if eliminate { k } else { Nothing };
    let f: Square<N, N> = std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            known(if i == j {
                One
            } else if j == i + M {
                Nothing
            } else {
                Zero
            })
        })
    });
    let h: Square<M, N> = std::array::from_fn(|i| std::array::from_fn(|j| known(if i == j { One } else { Zero })));
    let one: Square<N, N> = std::array::from_fn(|i| std::array::from_fn(|j| known(if i == j { One } else { Zero })));
    let r: Square<M, M> = std::array::from_fn(|i| std::array::from_fn(|j| known(if i == j { Nothing } else { Zero })));
    let axis = |i: usize, j: usize| i % M == j % M;
    let p: Square<N, N> = [[Nothing; N]; N];
    let q: Square<N, N> = std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            known(if i == j || driven == Driven::Acceleration && axis(i, j) { Nothing } else { Zero })
        })
    });
    let (x, z) = ([[Nothing]; N], [[Nothing]; M]);
    counted(|| {
        let x = product(&f, &x);
        let p = each(&product(&product(&f, &p), &transposed(&f)), &q, Add::add);
        let s = each(&product(&product(&h, &p), &transposed(&h)), &r, Add::add);
        let gain = product(&product(&p, &transposed(&h)), &inverse(&s));
        let nu = each(&z, &product(&h, &x), Sub::sub);
        each(&x, &product(&gain, &nu), Add::add);
        product(&each(&one, &product(&gain, &h), Sub::sub), &p);
    })
}

/// The inverse of a matrix of one or two rows.
fn inverse<const M: usize>(s: &Square<M, M>) -> Square<M, M> {
    if M == 1 {
        return [[One / s[0][0]; M]; M];
    }
    let inverse = One / (s[0][0] * s[1][1] - s[0][1] * s[1][0]);
    let adjugate = [[s[1][1], s[0][1]], [s[1][0], s[0][0]]];
    std::array::from_fn(|i| std::array::from_fn(|j| adjugate[i][j] * inverse))
}

/// A step of the Kalman filter of one axis, its covariance as three numbers.
fn kalman(driven: Driven) -> Operations {
    let [d, r, q11, q33, x, s, p11, p12, p22, z] = [Nothing; 10];
    let q13 = if driven == Driven::Acceleration { Nothing } else { Zero };
    counted(|| {
        let x = x + d * s;
        let across = p12 + d * p22;
        let p11 = p11 + d * (p12 + across) + q11;
        let (across, p22) = (across + q13, p22 + q33);
        let i = One / (p11 + r);
        let (kx, ks, nu) = (p11 * i, across * i, z - x);
        let _ = (x + kx * nu, s + ks * nu, r * kx, r * ks, p22 - ks * across);
    })
}

/// Steps 5–11 as printed, D² kept.
fn fosb_literal() -> Operations {
    let [d, d2, r, q11, q33, x, s, vx, vs, z] = [Nothing; 10];
    counted(|| {
        let (xp, vp) = (x + d * s, vx + d2 * vs + q11);
        let (mb, vb) = ((z - x) / d, (r + vx + q11) / d2);
        let sum = vb + vs;
        let _ = ((s * vb + mb * vs) / sum, vb * vs / sum + q33);
        let sum = r + vp;
        let _ = ((r * xp + z * vp) / sum, r * vp / sum);
    })
}

/// The same in gain form.
fn fosb_gain() -> Operations {
    let [d, r, q11, q33, x, s, vx, vs, z] = [Nothing; 9];
    counted(|| {
        let t = d * vs;
        let p = vx + q11 + d * t;
        let i = One / (p + r);
        let (kx, ks, xt) = (p * i, t * i, x + d * s);
        let nu = z - xt;
        let _ = (xt + kx * nu, s + ks * nu, r * kx, vs - ks * t + q33);
    })
}

/// A filter of fixed gains α and β/D.
fn alpha_beta() -> Operations {
    let [d, alpha, beta, x, s, z] = [Nothing; 6];
    counted(|| {
        let xt = x + d * s;
        let nu = z - xt;
        let _ = (xt + alpha * nu, s + beta * nu);
    })
}

impl Operations {
    fn total(self) -> f64 {
        f64::from(self.mul + self.add + self.div)
    }

    fn text(self) -> String {
        format!("{} multiplications, {} additions, {} divisions", self.mul, self.add, self.div)
    }
}

/// The entries of Table 4 and of what is said of it.
pub fn entries() -> Vec<Entry> {
    let speed = Driven::Speed;
    let (coupled, literal, gain, one) = (matrices::<4, 2>(speed, true), fosb_literal(), fosb_gain(), kalman(speed));
    let rows = [
        ("Kalman filter, two axes, nothing left out", matrices::<4, 2>(speed, false)),
        ("Kalman filter, two axes, noise on the speed", coupled),
        ("Kalman filter, two axes, noise on the acceleration", matrices::<4, 2>(Driven::Acceleration, true)),
        ("Kalman filter, one axis, in matrices", matrices::<2, 1>(speed, true)),
        ("Kalman filter, one axis, covariance as three numbers", one),
        ("FOSB, one axis, steps 5–11 as printed", literal),
        ("FOSB, one axis, in gain form", gain),
        ("fixed gains (α-β filter), one axis", alpha_beta()),
    ];
    let mut out: Vec<Entry> = rows
        .into_iter()
        .map(|(what, operations)| {
            Entry::ours("Table 4", &format!("{what}: operations a step"), Measured::exact(operations.total()))
                .because(operations.text())
        })
        .collect();
    out.push(
        Entry::claim(
            "section 3.3",
            "FOSB dramatically reduces the load of the scheme without decoupling",
            2.0 * literal.total() * 2.0 < coupled.total(),
            "operations for two axes, as a part of those of the coupled filter: most of it comes from decoupling, which leaves the Kalman \
             filter exact"
                .to_owned(),
        )
        .literally(Measured::exact(2.0 * literal.total() / coupled.total())),
    );
    out.push(
        Entry::claim(
            "section 1",
            "its load is lower than that of the Kalman filter",
            literal.total() < one.total(),
            "operations as a part of those of the Kalman filter of one axis; most of its divisions can be saved"
                .to_owned(),
        )
        .literally(Measured::exact(literal.total() / one.total()))
        .holds_read_as(
            "written in gain form",
            Measured::exact(gain.total() / one.total()),
            gain.total() < one.total(),
        ),
    );
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn operations(mul: u32, add: u32, div: u32) -> Operations {
        Operations { mul, add, div }
    }

    #[test]
    fn operations_are_those_counted_by_hand() {
        assert_eq!(matrices::<4, 2>(Driven::Speed, false), operations(358, 293, 1));
        assert_eq!(matrices::<2, 1>(Driven::Speed, true), operations(13, 15, 1));
        assert_eq!(matrices::<2, 1>(Driven::Acceleration, true), operations(13, 17, 1));
        assert_eq!(kalman(Driven::Speed), operations(10, 11, 1));
        assert_eq!(kalman(Driven::Acceleration), operations(10, 12, 1));
        assert_eq!(fosb_literal(), operations(8, 11, 6));
        assert_eq!(fosb_gain(), operations(9, 9, 1));
        assert_eq!(alpha_beta(), operations(3, 4, 0));
    }

    #[test]
    fn structure_leaves_a_quarter_of_the_coupled_filter() {
        let coupled = matrices::<4, 2>(Driven::Speed, true);
        assert_eq!(coupled, operations(80, 75, 1));
        assert_eq!(matrices::<4, 2>(Driven::Acceleration, true), operations(80, 79, 1));
    }
}
