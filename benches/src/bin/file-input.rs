//! Writes measurement tables for the comparison of file runs: `t,target,x` of many targets on one axis.
//!
//! `file-input DIR --targets N --steps N` writes `by-target.csv`, `by-time.csv`, `by-target.ndjson` and the spec `spec.toml`; equal numbers give equal
//! bytes.

use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

const SPEC: &str = "\
[model]
kind = \"constant-velocity\"
axes = 1
noise = 0.1
x0 = [0.0, 0.0]
P0 = [[100.0, 0.0], [0.0, 4.0]]

[estimator]
kind = \"kalman\"

[[sensor]]
kind = \"position\"
sd = 0.3
";

/// Positions of one target, a tenth of a second apart, in millimetres.
fn track(target: u64, steps: usize) -> Vec<i64> {
    let mut rng = Pcg64::new(u128::from(target), 1);
    let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
    let (mut x, mut v) = (0.0, normal());
    (0..steps)
        .map(|_| {
            x += 0.1 * v;
            v += 0.1 * normal();
            ((x + 0.3 * normal()) * 1000.0).round() as i64
        })
        .collect()
}

/// A number of thousandths.
struct Milli(i64);

impl std::fmt::Display for Milli {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let sign = if self.0 < 0 { "-" } else { "" };
        let (whole, rest) = (self.0.unsigned_abs() / 1000, self.0.unsigned_abs() % 1000);
        write!(f, "{sign}{whole}.{rest:03}")
    }
}

fn write(path: &Path, header: &str, rows: impl Iterator<Item = String>) -> io::Result<()> {
    let mut out = BufWriter::with_capacity(1 << 20, File::create(path)?);
    out.write_all(header.as_bytes())?;
    for row in rows {
        out.write_all(row.as_bytes())?;
    }
    out.flush()
}

fn main() -> io::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let (mut folder, mut targets, mut steps) = (None, 31_250_usize, 800_usize);
    while let Some(argument) = arguments.next() {
        let mut number = || arguments.next().and_then(|text| text.parse().ok());
        match argument.as_str() {
            "--targets" => targets = number().ok_or_else(|| io::Error::other("--targets expects a number"))?,
            "--steps" => steps = number().ok_or_else(|| io::Error::other("--steps expects a number"))?,
            _ => folder = Some(PathBuf::from(argument)),
        }
    }
    let folder = folder.ok_or_else(|| io::Error::other("expected a folder: file-input DIR --targets N --steps N"))?;
    let tracks: Vec<Vec<i64>> = (0..targets as u64).map(|target| track(target, steps)).collect();
    let at = |target: usize, step: usize| (Milli(100 * step as i64), target, Milli(tracks[target][step]));
    let by_target = || (0..targets).flat_map(|target| (0..steps).map(move |step| (target, step)));
    let by_time = (0..steps).flat_map(|step| (0..targets).map(move |target| (target, step)));
    let csv = |(target, step)| {
        let (t, target, x) = at(target, step);
        format!("{t},{target},{x}\n")
    };
    let object = |(target, step)| {
        let (t, target, x) = at(target, step);
        format!("{{\"t\":{t},\"target\":{target},\"x\":{x}}}\n")
    };
    std::fs::write(folder.join("spec.toml"), SPEC)?;
    write(&folder.join("by-target.csv"), "t,target,x\n", by_target().map(csv))?;
    write(&folder.join("by-time.csv"), "t,target,x\n", by_time.map(csv))?;
    write(&folder.join("by-target.ndjson"), "", by_target().map(object))
}
