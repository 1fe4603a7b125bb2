//! Writes pages with invented trails, to look at: `cargo run -p fixtrail-report --example pages -- FOLDER`.

use fixtrail_report::{Page, Series, render};
use fixtrail_sim::metrics::{Kind, Score, kinematic, score};
use fixtrail_sim::scenario::demo;
use fixtrail_track::anchors::Anchors;
use fixtrail_track::layout::Layout;
use fixtrail_track::packet::{Content, Packet};
use fixtrail_track::target::{TargetPackets, TargetTrail};
use fixtrail_track::truth::TargetTruth;
use std::path::Path;

#[path = "../tests/synthetic/mod.rs"]
mod synthetic;
use synthetic::{Errs, linear_trail, long_walk, trail};

fn scored(trails: &[TargetTrail], layout: &Layout, truth: &[TargetTruth], kind: Kind) -> Result<Score, String> {
    score(trails, layout, &kinematic(layout, &[]), truth, kind)
}

/// The demo's walk with three invented estimators.
fn walk() -> Result<String, String> {
    let run = demo(1);
    let layout = Layout::kinematic(2, 2, &[]);
    let make =
        |sd_m, claim, growth, seed| [trail(&run.truth[0], &run.packets[0], 2, Errs { sd_m, claim, growth }, seed)];
    let trails = [make(0.14, 1.0, 0.6, 1), make(0.08, 1.0, 0.2, 2), make(0.2, 0.55, 0.7, 3)];
    let kinds = [Kind::Filter, Kind::Smoother, Kind::Filter];
    let scores: Result<Vec<_>, _> =
        trails.iter().zip(kinds).map(|(t, kind)| scored(t, &layout, &run.truth, kind)).collect();
    let scores = scores?;
    let names = ["ekf", "rts", "fms (window 15)"];
    let series: Vec<_> =
        (0..3).map(|i| Series { name: names[i], trails: &trails[i], score: Some(&scores[i]) }).collect();
    Ok(render(&Page {
        title: "A walk through a lossy network",
        subtitle: "Six anchors, ranges at 5 Hz with 0.15 m noise, a quarter of the reports lost in bursts",
        notes: &[format!(
            "The network lost {:.0} % of the reports, at most {} in a row ({:.1} s).",
            100.0 * run.loss_rate,
            run.longest_burst,
            0.2 * run.longest_burst as f64
        )],
        layout: &layout,
        series: &series,
        truth: &run.truth,
        anchors: &run.anchors,
        theory: None,
        packets: &run.packets,
    }))
}

/// Twenty-four targets with measured positions, one estimator.
fn fleet(points: usize) -> Result<String, String> {
    let layout = Layout::kinematic(2, 2, &[]);
    let truth: Vec<_> = (0..24).map(|i| long_walk(&format!("forklift {i}"), points, i)).collect();
    let packets: Vec<_> = truth
        .iter()
        .enumerate()
        .map(|(i, t)| TargetPackets {
            target: t.target.clone(),
            packets: t
                .points
                .iter()
                .enumerate()
                .filter(|(k, _)| k % (5 + i) != 0)
                .map(|(k, p)| {
                    Packet::new(
                        p.t_s,
                        Content::Position([
                            p.position_m[0].map(|x| x + 3.0 * ((k * 7919) % 13) as f64 / 13.0 - 1.5),
                            p.position_m[1],
                            None,
                        ]),
                        k as u64 + 1,
                    )
                })
                .collect(),
        })
        .collect();
    let trails: Vec<_> = truth
        .iter()
        .zip(&packets)
        .enumerate()
        .map(|(i, (t, p))| {
            let p = TargetPackets { target: None, packets: p.packets.iter().take(600).cloned().collect() };
            trail(t, &p, 1, Errs { sd_m: 0.3 + 0.05 * i as f64, claim: 1.0, growth: 0.0 }, i as u64)
        })
        .collect();
    let score = scored(&trails, &layout, &truth, Kind::Filter)?;
    Ok(render(&Page {
        title: "Fleet",
        subtitle: "24 targets, measured positions",
        notes: &[],
        layout: &layout,
        series: &[Series { name: "kalman", trails: &trails, score: Some(&score) }],
        truth: &truth,
        anchors: &Anchors::default(),
        theory: None,
        packets: &packets,
    }))
}

/// A linear run without truth.
fn linear() -> String {
    let trails = [linear_trail(400)];
    render(&Page {
        title: "run.csv",
        subtitle: "linear model with two states, fms (window 15, lag 5)",
        notes: &[],
        layout: &Layout::linear(2),
        series: &[Series { name: "fms", trails: &trails, score: None }],
        truth: &[],
        anchors: &Anchors::default(),
        theory: None,
        packets: &[],
    })
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = std::env::args().nth(1).ok_or("expected a folder to write to")?;
    for (name, text) in [("walk", walk()?), ("fleet", fleet(600)?), ("linear", linear())] {
        std::fs::write(Path::new(&folder).join(format!("{name}.html")), text)?;
    }
    Ok(())
}
