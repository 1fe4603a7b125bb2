//! From tracks in rows to instants in rows and back: a square of as many steps as a register has tracks at a time.

use crate::wide::{DEEP, MOST, MOST_LANES, Wide};
use pulp::{Simd, bytemuck};

/// Hands measurements of `Q` numbers to `step`, an instant of all tracks at a time, and writes the `N` numbers that it returns.
///
/// `z` and `out` are those of as many tracks as fill the registers, `steps` of each, one track after the other.
#[inline(always)]
pub fn tiles<S: Simd, const Q: usize, const N: usize>(
    simd: S,
    z: &[f64],
    steps: usize,
    out: &mut [f64],
    mut step: impl FnMut(usize, [Wide<S>; Q]) -> [Wide<S>; N],
) {
    let lanes = S::F64_LANES;
    let blank = Wide::splat(simd, 0.0);
    // Registers of a tile: first those of a step, then those of the next.
    let mut measured = [[[simd.splat_f64s(0.0); Q]; MOST_LANES]; DEEP];
    let mut means = [[[simd.splat_f64s(0.0); N]; MOST_LANES]; DEEP];
    let whole = steps / lanes * lanes;
    for k in (0..whole).step_by(lanes) {
        for (deep, measured) in measured.iter_mut().enumerate() {
            for (i, square) in measured.as_flattened_mut()[..Q * lanes].chunks_exact_mut(lanes).enumerate() {
                for (lane, register) in square.iter_mut().enumerate() {
                    let at = ((deep * lanes + lane) * steps + k) * Q + i * lanes;
                    *register = S::as_simd_f64s(&z[at..at + lanes]).0[0];
                }
                turn(simd, square);
            }
        }
        for i in 0..lanes {
            let mut now = [blank; Q];
            for (c, now) in now.iter_mut().enumerate() {
                let mut registers = [measured[0][i][c]; DEEP];
                for (register, measured) in registers.iter_mut().zip(&measured) {
                    *register = measured[i][c];
                }
                *now = Wide::of(simd, registers);
            }
            for (c, mean) in step(k + i, now).iter().enumerate() {
                for (means, register) in means.iter_mut().zip(mean.registers()) {
                    means[i][c] = register;
                }
            }
        }
        for (deep, means) in means.iter_mut().enumerate() {
            for (i, square) in means.as_flattened_mut()[..N * lanes].chunks_exact_mut(lanes).enumerate() {
                turn(simd, square);
                for (lane, register) in square.iter().enumerate() {
                    let at = ((deep * lanes + lane) * steps + k) * N + i * lanes;
                    S::as_mut_simd_f64s(&mut out[at..at + lanes]).0[0] = *register;
                }
            }
        }
    }
    let mut row = [0.0; MOST];
    for k in whole..steps {
        let mut now = [blank; Q];
        for (c, now) in now.iter_mut().enumerate() {
            for (track, value) in row.iter_mut().enumerate().take(Wide::<S>::TRACKS) {
                *value = z[(track * steps + k) * Q + c];
            }
            *now = Wide::load(simd, &row);
        }
        for (c, mean) in step(k, now).iter().enumerate() {
            mean.store(&mut row);
            for (track, value) in row.iter().enumerate().take(Wide::<S>::TRACKS) {
                out[(track * steps + k) * N + c] = *value;
            }
        }
    }
}

/// Turns a square of registers: what was the number `j` of register `i` is the number `i` of register `j`.
#[inline(always)]
fn turn<S: Simd>(simd: S, square: &mut [S::f64s]) {
    if let [a, b, c, d] = square {
        // Of four registers this is the whole turn; of other squares the order within is not told.
        [*a, *b, *c, *d] = simd.deinterleave_shfl_f64s([*a, *b, *c, *d]);
        return;
    }
    let lanes = square.len();
    let numbers: &mut [f64] = bytemuck::cast_slice_mut(square);
    for i in 0..lanes {
        for j in 0..i {
            numbers.swap(i * lanes + j, j * lanes + i);
        }
    }
}
