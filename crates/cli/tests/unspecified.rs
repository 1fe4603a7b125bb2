//! `fixtrail track` without a spec, kind by kind, and heights alone.

mod common;

use common::{Folder, Ran};

/// SplitMix64: seeded, so that the bounds below hold for ever once they hold.
struct Chance(u64);

impl Chance {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

const ANCHORS: [(&str, [f64; 3]); 6] = [
    ("A0", [0.0, 0.0, 0.0]),
    ("A1", [12.0, 0.0, 0.0]),
    ("A2", [12.0, 10.0, 0.0]),
    ("A3", [0.0, 10.0, 0.0]),
    ("A4", [6.0, 0.5, 0.0]),
    ("A5", [6.0, 9.5, 0.0]),
];

/// A walk of two minutes on an ellipse among six anchors, twice a second; `rows` makes the rows of one instant from its distances.
fn walk(mut rows: impl FnMut(f64, &[f64]) -> String) -> Folder {
    let (mut table, mut truth) = (String::from("t,kind,anchor,anchor2,value\n"), String::from("t,x,y\n"));
    for i in 0..240 {
        let t = 0.5 * f64::from(i);
        let (x, y) = (6.0 + 3.5 * (0.1 * t).cos(), 5.0 + 3.0 * (0.1 * t).sin());
        let distances = ANCHORS.map(|(_, a)| (x - a[0]).hypot(y - a[1]));
        table += &rows(t, &distances);
        truth += &format!("{t},{x},{y}\n");
    }
    let anchors: String = ANCHORS.iter().map(|(name, [x, y, z])| format!("{name},{x},{y},{z}\n")).collect();
    let folder = Folder::new();
    folder.write("m.csv", table).write("truth.csv", truth).write("anchors.csv", format!("anchor,x,y,z\n{anchors}"));
    folder
}

fn track(folder: &Folder) -> (Ran, f64) {
    let ran = folder.run(&["track", "m.csv", "-o", "t.csv", "--truth", "truth.csv", "--json"]).good();
    let json = ran.json();
    let rmse = json["truth"]["overall"]["rmse_m"].as_f64().expect("an error");
    assert!(json["truth"]["overall"]["missing"].as_u64().expect("a count") < 12, "{json}");
    (ran, rmse)
}

#[test]
fn strengths_without_a_spec_are_tracked_by_a_law_of_their_own() {
    let mut chance = Chance(1);
    let folder = walk(|t, distances| {
        let law = |d: f64| -45.0 - 25.0 * d.log10();
        let rows = distances.iter().zip(ANCHORS);
        rows.map(|(d, (name, _))| format!("{t},rssi,{name},,{}\n", law(*d) + 4.0 * chance.normal())).collect()
    });
    let (ran, rmse) = track(&folder);
    // Who always says "the middle" errs by √((3.5² + 3²)/2) = 3.3 m.
    assert!(rmse < 1.7, "{rmse}");
    assert!(ran.err.contains("sensor `rssi`") && ran.err.contains("`fixtrail tune` would gain"), "{ran:?}");
}

#[test]
fn time_differences_without_a_spec_are_tracked_through_gross_errors() {
    let mut chance = Chance(2);
    let folder = walk(|t, distances| {
        let times: Vec<f64> = distances.iter().map(|d| d + 0.1 * chance.normal()).collect();
        let wrong = chance.uniform() < 0.05;
        (1..6)
            .map(|j| {
                let gross = if wrong && j == 3 { 7.0 } else { 0.0 };
                format!("{t},tdoa,A{j},A0,{}\n", times[j] - times[0] + gross)
            })
            .collect()
    });
    let (ran, rmse) = track(&folder);
    // Five differences place a moment to about their own 0.14 m; a filter does no worse.
    assert!(rmse < 0.2, "{rmse}");
    assert!(ran.err.contains("sensor `tdoa`") && ran.err.contains("redescending"), "{ran:?}");
}

#[test]
fn ranges_too_long_without_a_spec_lose_their_common_bias_and_strengths_beside_them_are_counted() {
    let mut chance = Chance(3);
    let folder = walk(|t, distances| {
        let rows = distances.iter().zip(ANCHORS);
        rows.map(|(d, (name, _))| {
            let late = if chance.uniform() < 0.05 { 4.0 } else { 0.0 };
            format!("{t},range,{name},,{}\n{t},rssi,{name},,-60\n", d + 1.5 + late + 0.2 * chance.normal())
        })
        .collect()
    });
    let (ran, rmse) = track(&folder);
    assert!(rmse < 0.25, "{rmse}");
    let spec = ran.json()["proposed_spec"].as_str().expect("a spec").to_owned();
    assert!(spec.contains("bias = { A0 = 1.") && spec.contains("huber"), "{spec}");
    assert_eq!(ran.json()["unused_kinds"], serde_json::json!({ "rssi": 1440 }));
    assert!(ran.err.contains("no sensor for the 1440 rows of kind `rssi`"), "{ran:?}");
}

const ALTIMETER: &str = "\
[model]
kind = \"constant-velocity\"
axes = 3
noise = 0.1

[[sensor]]
kind = \"range\"
sd = 0.1

[[sensor]]
kind = \"position\"
sd = 0.3
";

#[test]
fn a_height_alone_settles_what_ranges_to_a_plane_leave_open() {
    let mut chance = Chance(4);
    let mut table = String::from("t,kind,anchor,value,x,y,z\n");
    for i in 0..120 {
        let t = 0.5 * f64::from(i);
        let at = [6.0 + 0.02 * t, 5.0, 3.0 + 0.03 * t];
        for (name, a) in &ANCHORS[..4] {
            let d = (0..3).map(|j| (at[j] - a[j]).powi(2)).sum::<f64>().sqrt();
            table += &format!("{t},range,{name},{},,,\n", d + 0.1 * chance.normal());
        }
        table += &format!("{t},position,,,,,{}\n", at[2] + 0.3 * chance.normal());
    }
    let anchors: String = ANCHORS.iter().map(|(name, [x, y, z])| format!("{name},{x},{y},{z}\n")).collect();
    let folder = Folder::new();
    folder.write("m.csv", table).write("anchors.csv", format!("anchor,x,y,z\n{anchors}")).write("spec.toml", ALTIMETER);
    folder.run(&["track", "-c", "spec.toml", "m.csv", "-o", "t.csv"]).good();
    let trail = folder.text("t.csv");
    let header: Vec<&str> = trail.lines().next().expect("a header").split(',').collect();
    let z = header.iter().position(|h| *h == "z").expect("z");
    let last: Vec<&str> = trail.lines().last().expect("a row").split(',').collect();
    // 3 + 0.03 · 59.5; ranges alone would leave the sign open.
    assert!((last[z].parse::<f64>().expect("a height") - 4.785).abs() < 0.3, "{last:?}");
    // The first rows do not come before the data say something.
    assert!(trail.lines().nth(20).expect("a row").contains("updated"));
    // Heights alone are no positions.
    folder.write("h.csv", "t,kind,x,y,z\n0,position,,,1\n1,position,,,2\n2,position,,,2\n");
    let ran = folder.run(&["track", "h.csv", "-o", "h_trail.csv"]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains("heights alone"), "{ran:?}");
}

const COUNTRY: &str = "\
[model]
kind = \"constant-velocity\"
axes = 2
noise = 30.0

[[sensor]]
kind = \"tdoa\"
sd = 50.0
height_m = 9000.0
robust = \"redescending\"

[estimator]
kind = \"ekf\"
";

#[test]
fn time_differences_over_a_country_start_where_they_meet() {
    // Five receivers about the target and a cluster far away, which pulls the centre of all anchors to where no message was heard.
    let mut anchors = String::from("anchor,x,y,z\n");
    let near = [[10e3, -11e3], [-67e3, -47e3], [220e3, 100e3], [16e3, 128e3], [-62e3, 443e3]];
    let far = (0..5).map(|i| [-1400e3 + 30e3 * f64::from(i), -700e3 - 20e3 * f64::from(i)]);
    for (i, [x, y]) in near.into_iter().chain(far).enumerate() {
        anchors += &format!("R{i},{x},{y},0\n");
    }
    let mut chance = Chance(5);
    let (mut table, mut truth) = (String::from("t,target,kind,anchor,anchor2,value\n"), String::from("t,target,x,y\n"));
    for tag in 0..20 {
        let start = [150e3 * chance.uniform(), 200e3 * chance.uniform()];
        let speed = [150.0 * chance.normal(), 150.0 * chance.normal()];
        for i in 0..8 {
            let t = 45.0 * f64::from(i);
            let at = [start[0] + speed[0] * t, start[1] + speed[1] * t];
            let heard: Vec<f64> = near
                .iter()
                .map(|a| {
                    ((at[0] - a[0]).powi(2) + (at[1] - a[1]).powi(2) + 9e3_f64.powi(2)).sqrt() + 35.0 * chance.normal()
                })
                .collect();
            for j in 1..5 {
                table += &format!("{t},P{tag},tdoa,R{j},R0,{}\n", heard[j] - heard[0]);
            }
            truth += &format!("{t},P{tag},{},{}\n", at[0], at[1]);
        }
    }
    let folder = Folder::new();
    folder.write("m.csv", table).write("truth.csv", truth).write("anchors.csv", anchors).write("spec.toml", COUNTRY);
    let ran =
        folder.run(&["track", "-c", "spec.toml", "m.csv", "-o", "t.csv", "--truth", "truth.csv", "--json"]).good();
    let overall = &ran.json()["truth"]["overall"];
    // The first instant of each target has half the measurements that a robust start waits for; a start may take one more.
    assert!(overall["missing"].as_u64().expect("a count") <= 30, "{overall}");
    assert!(overall["p50_m"].as_f64().expect("an error") < 100.0, "{overall}");
    assert!(overall["max_m"].as_f64().expect("an error") < 3000.0, "{overall}");
}

/// The folder of the recordings, which are not part of the repository.
fn recordings() -> Option<std::path::PathBuf> {
    let beside = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let folder = std::env::var_os("FIXTRAIL_DATA").map_or(beside, Into::into);
    if folder.is_dir() {
        return Some(folder);
    }
    println!("not tested: no recordings in {}", folder.display());
    None
}

#[test]
fn recordings_without_a_spec_end_in_sensible_trails() {
    let Some(data) = recordings() else { return };
    // RMSE in metres: half as much again as measured when this was written.
    let bounds = [
        ("uwb_labyrinth/rec1", 0.25),
        ("uwb_hanyang_outdoor/nlos_B4", 0.6),
        ("wifi_rtt_walk/canteen_1_u1", 0.9),
        ("wifi_rtt_walk/conference_1_u1", 3.7),
        ("ble_rssi_tetam/zigzagging_with_rotation", 3.0),
        ("ble_rssi_flat/calib3", 3.7),
        ("gnss_comma2k19/ublox", 2.2),
    ];
    let folder = Folder::new();
    for (recording, bound) in bounds {
        let file = |name: &str| data.join(recording).join(name).to_string_lossy().into_owned();
        let (table, truth) = (file("measurements.csv"), file("truth.csv"));
        let ran = folder.run(&["track", &table, "-o", "t.csv", "--truth", &truth, "--json"]).good();
        let rmse = ran.json()["truth"]["overall"]["rmse_m"].as_f64().expect("an error");
        assert!(rmse < bound, "{recording}: {rmse}");
    }
}

#[test]
fn aircraft_with_their_heights_are_within_75_metres() {
    let Some(data) = recordings() else { return };
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let spec = root.join("examples/tdoa_locards_aircraft.toml").to_string_lossy().into_owned();
    let folder = Folder::new();
    for set in ["set_1", "set_2"] {
        let file = |name: &str| data.join("tdoa_locards_aircraft").join(set).join(name).to_string_lossy().into_owned();
        let (table, anchors) = (file("measurements.csv"), file("anchors.csv"));
        let common = ["-c", &spec, "--anchors", &anchors];
        // Heights over a flat Earth, a rough trail, and the heights over a round Earth there.
        let join = |rough: Option<std::path::PathBuf>, to: &str| {
            let mut join = std::process::Command::new(root.join("scripts/altimeter"));
            let joined = join.args([&table, &file("altitude.csv")]).args(rough).output().expect("Python");
            assert!(joined.status.success(), "{joined:?}");
            folder.write(to, joined.stdout);
        };
        join(None, "flat.csv");
        folder.run(&[&["track"], &common[..], &["flat.csv", "-o", "rough.csv"]].concat()).good();
        join(Some(folder.path("rough.csv")), "with_heights.csv");
        let truth = file("truth.csv");
        let last = ["with_heights.csv", "-o", "t.csv", "--truth", &truth, "--json"];
        let ran = folder.run(&[&["track"], &common[..], &last].concat()).good();
        let overall = &ran.json()["truth"]["overall"];
        assert!(overall["p50_m"].as_f64().expect("an error") <= 75.0, "{set}: {overall}");
        // A wrong solution is hundreds of kilometres off.
        assert!(overall["max_m"].as_f64().expect("an error") < 20e3, "{set}: {overall}");
        assert!(overall["instants"].as_u64() > Some(200), "{set}: {overall}");
    }
}
