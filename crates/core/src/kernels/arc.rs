//! What turning by an angle needs: sine, cosine, the chord and their derivatives.

use super::Real;

/// Sine and cosine of θ, and how far a target that turns by θ comes along its first direction and aside.
#[derive(Clone, Copy, Debug)]
pub struct Arc<T> {
    /// sin θ
    pub sin: T,
    /// cos θ
    pub cos: T,
    /// s = sin θ/θ
    pub along: T,
    /// c = (1 − cos θ)/θ
    pub aside: T,
    /// ds/dθ
    pub along_slope: T,
    /// dc/dθ
    pub aside_slope: T,
}

/// Below this angle the closed forms cancel; the series does not.
const SERIES_BELOW: f64 = 1.0;

/// With θ² < 1 the first terms left out are below 2/20! = 8e-19.
const TERMS: usize = 9;

/// Coefficients in powers of θ² of `(1 − s)/θ²` and of `c/θ`: `(−1)^k/(2k + 3)!` and `(−1)^k/(2k + 2)!`.
const SERIES: [[f64; TERMS]; 2] = {
    let mut series = [[0.0; TERMS]; 2];
    let (mut sign, mut factorial, mut k) = (1.0, 2.0, 0); // (2k + 2)!
    while k < TERMS {
        let even = (2 * k + 2) as f64;
        series[1][k] = sign / factorial;
        series[0][k] = sign / (factorial * (even + 1.0));
        factorial *= (even + 1.0) * (even + 2.0);
        sign = -sign;
        k += 1;
    }
    series
};

impl<T: Real> Arc<T> {
    /// Returns them for an angle, radians, of any size; each to 6e-16 of itself, or of a tenth where it is less; the slopes from 1 rad on to 2e-15.
    #[inline(always)]
    pub fn of(theta: T) -> Self {
        if theta.within(SERIES_BELOW) { Self::small(theta) } else { Self::each(theta) }
    }

    /// By series: of the quotients what differs from 1 and ½, so that nothing cancels.
    #[inline(always)]
    fn small(theta: T) -> Self {
        let square = theta * theta;
        let [short, c] = [sum(&SERIES[0], square), sum(&SERIES[1], square)];
        let one = theta.constant(1.0);
        let along = one - square * short;
        Arc {
            sin: theta * along,
            cos: one - square * c,
            along,
            aside: theta * c,
            // (cos θ − s)/θ and (sin θ − c)/θ
            along_slope: theta * (short - c),
            aside_slope: along - c,
        }
    }

    /// One angle after the other, for at least one is large.
    #[inline(never)]
    fn each(theta: T) -> Self {
        Arc {
            sin: theta.each(|theta| any(theta).sin),
            cos: theta.each(|theta| any(theta).cos),
            along: theta.each(|theta| any(theta).along),
            aside: theta.each(|theta| any(theta).aside),
            along_slope: theta.each(|theta| any(theta).along_slope),
            aside_slope: theta.each(|theta| any(theta).aside_slope),
        }
    }
}

/// A polynomial, in pairs so that one does not wait for the other.
#[inline(always)]
fn sum<T: Real>(t: &[f64; TERMS], x: T) -> T {
    // Written out: what is not inlined, as a closure over an array may be, loses the vector instructions that the caller was compiled for.
    let (square, [t0, t1, t2, t3, t4, t5, t6, t7, t8]) = (x * x, *t);
    let fourth = square * square;
    let low = (x.constant(t0) + x.constant(t1) * x) + (x.constant(t2) + x.constant(t3) * x) * square;
    let high = (x.constant(t4) + x.constant(t5) * x) + (x.constant(t6) + x.constant(t7) * x) * square;
    low + (high + x.constant(t8) * fourth) * fourth
}

/// Of one angle; small ones as among others.
fn any(theta: f64) -> Arc<f64> {
    if theta.within(SERIES_BELOW) {
        return Arc::small(theta);
    }
    let (sin, cos) = libm::sincos(theta);
    let half = libm::sin(theta / 2.0);
    let (along, aside) = (sin / theta, 2.0 * half * half / theta);
    Arc { sin, cos, along, aside, along_slope: (cos - along) / theta, aside_slope: (sin - aside) / theta }
}
