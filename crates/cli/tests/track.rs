//! `fixtrail track` from end to end.

mod common;

use common::{Folder, SPEC, walk, walk_folder, walk_folder_with_truth};
use parquet::file::reader::{FileReader, SerializedFileReader};
use std::fs::File;

#[test]
fn every_output_format_holds_the_same_rows() {
    let folder = walk_folder();
    for name in ["t.csv", "t.ndjson", "t.parquet"] {
        folder.run(&["track", "-c", "spec.toml", "m.csv", "-o", name, "--covariance"]).good();
    }
    let csv = folder.text("t.csv");
    let mut lines = csv.lines();
    let header: Vec<&str> = lines.next().expect("a header").split(',').collect();
    assert_eq!(header[..6], ["target", "t", "x", "y", "vx", "vy"]);
    assert!(header.contains(&"p_1_1") || header.iter().any(|h| h.starts_with("p_")), "{header:?}");
    // 120 instants of two tags, none of which lost all four ranges.
    let rows: Vec<Vec<&str>> = lines.map(|l| l.split(',').collect()).collect();
    assert_eq!(rows.len(), 240);
    let x = header.iter().position(|h| *h == "x").expect("x");
    let ndjson = folder.text("t.ndjson");
    for (row, line) in rows.iter().zip(ndjson.lines()) {
        let object: serde_json::Value = serde_json::from_str(line).expect("JSON");
        assert_eq!(object["target"], row[0]);
        // Numbers read back to the same bits from both.
        assert_eq!(object["x"].as_f64(), row[x].parse().ok(), "{line}");
    }
    let parquet = SerializedFileReader::new(File::open(folder.path("t.parquet")).expect("a file")).expect("Parquet");
    assert_eq!(parquet.metadata().file_metadata().num_rows(), 240);
    assert_eq!(parquet.metadata().file_metadata().schema_descr().num_columns(), header.len());
}

#[test]
fn trail_of_the_walk_is_where_the_walk_was() {
    let folder = walk_folder_with_truth(100);
    let arguments = ["track", "-c", "spec.toml", "m.csv", "-o", "t.csv", "--truth", "truth.csv", "--report", "r.html"];
    let ran = folder.run(&arguments).good();
    assert!(ran.out.contains("RMSE") && ran.out.contains("T2") && ran.out.contains("all"), "{ran:?}");
    assert!(folder.text("r.html").starts_with("<!DOCTYPE html>"));
    let json = folder.run(&[&arguments[..], &["--json"]].concat()).good().json();
    // Ranges err by 0.05/√2 m, four of them a fifth of a second apart: a position errs by no more than one range does, twice over.
    let rmse = json["truth"]["overall"]["rmse_m"].as_f64().expect("an error");
    assert!(rmse < 0.07, "{rmse}");
    assert_eq!(
        json["fixes"]["updated"].as_u64().expect("a count") + json["fixes"]["unobservable"].as_u64().expect("a count"),
        240
    );
}

#[test]
fn order_of_rows_form_of_table_and_number_of_threads_leave_the_bytes_as_they_are() {
    let folder = walk_folder();
    let (table, _) = walk();
    folder.run(&["track", "-c", "spec.toml", "m.csv", "-o", "t.csv", "--threads", "1"]).good();
    let expected = folder.read("t.csv");

    folder.run(&["track", "-c", "spec.toml", "m.csv", "-o", "two.csv", "--threads", "2"]).good();
    assert_eq!(folder.read("two.csv"), expected);

    let mut lines: Vec<&str> = table.lines().collect();
    lines[1..].reverse();
    // Turned round, with the line ends of another system, a mark at the front, none at the end, and a row twice.
    let odd = format!("\u{feff}{}\r\n{}", lines.join("\r\n"), lines[5]);
    folder.write("odd.csv", odd);
    let ran = folder.run(&["track", "-c", "spec.toml", "odd.csv", "-o", "odd_t.csv"]).good();
    assert!(ran.err.contains("1 duplicate dropped"), "{ran:?}");
    assert_eq!(folder.read("odd_t.csv"), expected);

    let objects: String = table
        .lines()
        .skip(1)
        .map(|l| {
            let c: Vec<&str> = l.split(',').collect();
            format!(
                "{{\"t\":{},\"target\":\"{}\",\"kind\":\"range\",\"anchor\":\"{}\",\"value\":{}}}\n",
                c[0], c[1], c[3], c[4]
            )
        })
        .collect();
    let arguments = ["track", "-c", "spec.toml", "-", "--anchors", "anchors.csv", "--format", "ndjson", "-o", "-"];
    let ran = folder.run_with(&arguments, objects.as_bytes()).good();
    assert_eq!(ran.out.as_bytes(), expected);
}

#[test]
fn standard_output_holds_the_trail_alone() {
    let folder = walk_folder();
    folder.write("truth.csv", "t,target,x,y\n5,T1,3.2,4.8\n");
    let ran = folder.run(&["track", "-c", "spec.toml", "m.csv", "-o", "-", "--truth", "truth.csv", "--json"]).good();
    assert!(ran.out.starts_with("target,t,x,y,") && ran.out.lines().count() == 241, "{ran:?}");
    let json = &ran.err[ran.err.find("\n{").expect("an object on standard error")..];
    let json: serde_json::Value = serde_json::from_str(json).expect("JSON");
    assert_eq!(json["truth"]["overall"]["instants"], 1);
}

#[test]
fn rows_by_time_hold_what_rows_by_target_hold() {
    let folder = walk_folder();
    folder.run(&["track", "-c", "spec.toml", "m.csv", "-o", "a.csv"]).good();
    folder.run(&["track", "-c", "spec.toml", "m.csv", "-o", "b.csv", "--order", "time"]).good();
    let (a, b) = (folder.text("a.csv"), folder.text("b.csv"));
    let targets: Vec<&str> = b.lines().skip(1).take(4).map(|l| &l[..2]).collect();
    assert_eq!(targets, ["T1", "T2", "T1", "T2"]);
    let sorted = |text: &str| {
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        lines.sort();
        lines
    };
    assert_eq!(sorted(&a), sorted(&b));
}

#[test]
fn large_table_that_is_kept_in_memory_is_said_to_be() {
    let folder = walk_folder();
    // A header that the reader refuses at once, and a hole.
    folder.write("large.csv", "x,y\n");
    let file = File::options().write(true).open(folder.path("large.csv")).expect("a file");
    file.set_len(300_000_000).expect("room for a hole");
    let arguments = ["track", "-c", "spec.toml", "large.csv", "-o", "t.csv"];
    let bounded = folder.run(&arguments);
    assert!(!bounded.err.contains("memory"), "{bounded:?}");
    let kept = folder.run(&[&arguments[..], &["--order", "time", "--report", "r.html"]].concat());
    assert!(
        kept.err.contains(
            "0.3 GB are kept in memory, where a table of text takes about twenty times that, for `--report` and `--order time`"
        ),
        "{kept:?}"
    );
}

#[test]
fn lagged_columns_come_from_estimators_that_smooth_only() {
    let folder = walk_folder();
    let refused = folder.run(&["track", "-c", "spec.toml", "m.csv", "-o", "t.csv", "--lagged", "both"]);
    assert_eq!(refused.code, Some(2));
    assert!(refused.err.contains("`estimator.kind` is \"ekf\""), "{refused:?}");
    folder.write("lag.toml", SPEC.replace("\"ekf\"", "\"fixed-lag-kalman\"\nlag = 3"));
    folder.run(&["track", "-c", "lag.toml", "m.csv", "-o", "both.csv", "--lagged", "both"]).good();
    assert!(folder.text("both.csv").lines().next().expect("a header").contains("x_lag"));
    // Without it the smoother's rows stand at the time they describe: one per instant.
    folder.run(&["track", "-c", "lag.toml", "m.csv", "-o", "own.csv"]).good();
    assert_eq!(folder.text("own.csv").lines().count(), 241);
}

#[test]
fn bad_rows_are_skipped_and_counted_where_asked() {
    let folder = walk_folder();
    let broken = format!("{}1.0,T1,range,A0,lots\n", folder.text("m.csv"));
    folder.write("broken.csv", broken);
    assert_eq!(folder.run(&["track", "-c", "spec.toml", "broken.csv", "-o", "t.csv"]).code, Some(2));
    let ran = folder.run(&["track", "-c", "spec.toml", "broken.csv", "-o", "t.csv", "--skip-bad-rows"]).good();
    assert!(ran.err.contains("skipped 1 bad row") && ran.err.contains("lots"), "{ran:?}");
    folder.run(&["track", "-c", "spec.toml", "m.csv", "-o", "whole.csv"]).good();
    assert_eq!(folder.read("t.csv"), folder.read("whole.csv"));
}

#[test]
fn anchors_are_found_beside_the_input_or_where_the_spec_says() {
    let folder = Folder::new();
    let (table, anchors) = walk();
    std::fs::create_dir(folder.path("site")).expect("a folder");
    folder.write("m.csv", table).write("site/radios.csv", anchors);
    folder.write("site/spec.toml", format!("anchors = \"radios.csv\"\n{SPEC}"));
    folder.run(&["track", "-c", "site/spec.toml", "m.csv", "-o", "t.csv"]).good();
    folder.write("spec.toml", SPEC);
    folder.run(&["track", "-c", "spec.toml", "m.csv", "-o", "u.csv", "--anchors", "site/radios.csv"]).good();
    assert_eq!(folder.read("t.csv"), folder.read("u.csv"));
    let ran = folder.run(&["track", "-c", "spec.toml", "m.csv", "-o", "v.csv"]);
    assert_eq!(ran.code, Some(2), "{ran:?}");
}

#[test]
fn reader_who_has_seen_enough_is_no_failure() {
    use std::io::Read;
    use std::process::{Command, Stdio};
    let folder = walk_folder();
    // More rows than a pipe holds.
    let rows: String = (0..20_000).map(|i| format!("{},{},0\n", 0.1 * f64::from(i), f64::from(i % 7))).collect();
    folder.write("long.csv", format!("t,x,y\n{rows}"));
    let mut child = Command::new(env!("CARGO_BIN_EXE_fixtrail"))
        .args(["track", "long.csv", "-o", "-"])
        .current_dir(folder.path(""))
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the binary starts");
    let mut some = [0; 100];
    child.stdout.take().expect("a pipe").read_exact(&mut some).expect("some rows");
    let output = child.wait_with_output().expect("the binary ends");
    let err = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{err}");
    assert!(!err.contains("error") && !err.contains("panicked"), "{err}");
}

/// The walk with its rows in the order in which they came when each took up to `most_s`, and the numbers of the rows that are over
/// `late_s` late by then.
fn delayed(most_s: f64, late_s: f64) -> (String, Vec<usize>) {
    let (table, _) = walk();
    let mut lines = table.lines();
    let header = lines.next().expect("a header");
    let cell = |line: &str, i: usize| line.split(',').nth(i).expect("a cell").to_owned();
    let t = |line: &str| -> f64 { cell(line, 0).parse().expect("a time") };
    // A pattern with no mean and no period of the walk's stands for chance.
    let mut rows: Vec<(f64, &str)> =
        lines.enumerate().map(|(i, line)| (t(line) + most_s * (1.7 * i as f64).sin().abs(), line)).collect();
    rows.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut newest = std::collections::HashMap::new();
    let mut late = Vec::new();
    for (i, (_, line)) in rows.iter().enumerate() {
        let newest = newest.entry(cell(line, 1)).or_insert(f64::NEG_INFINITY);
        if *newest - t(line) > late_s + 1e-6 {
            late.push(i + 2);
        }
        *newest = newest.max(t(line));
    }
    let text: String = rows.iter().map(|(_, line)| format!("{line}\n")).collect();
    (format!("{header}\n{text}"), late)
}

#[test]
fn rows_at_most_late_s_late_give_the_bytes_of_rows_in_order() {
    let folder = walk_folder();
    folder.write("late.toml", format!("{SPEC}[link]\nlate_s = 1.0\n"));
    let (table, late) = delayed(1.0, 1.0);
    assert!(late.is_empty());
    folder.write("late.csv", &table);
    folder.run(&["track", "-c", "spec.toml", "m.csv", "-o", "a.csv", "--covariance"]).good();
    let ran = folder.run(&["track", "-c", "late.toml", "late.csv", "-o", "b.csv", "--covariance", "--json"]).good();
    assert_eq!(folder.read("a.csv"), folder.read("b.csv"));
    assert!(!ran.err.contains("link:"), "{ran:?}");
    let json = ran.json();
    assert_eq!((&json["link"]["too_late"], &json["link"]["late_s"]), (&0.into(), &1.0.into()));
    assert!(json["out_of_order"].as_u64().expect("a count") > 100, "{json}");
}

#[test]
fn rows_beyond_late_s_are_counted_and_leave_the_bytes_of_the_table_without_them() {
    let folder = walk_folder();
    folder.write("late.toml", format!("{SPEC}[link]\nlate_s = 0.5\n"));
    let (table, late) = delayed(1.0, 0.5);
    let without: String =
        (1..).zip(table.lines()).filter(|(i, _)| !late.contains(i)).map(|(_, l)| format!("{l}\n")).collect();
    folder.write("late.csv", &table).write("without.csv", without);
    folder.run(&["track", "-c", "spec.toml", "without.csv", "-o", "a.csv"]).good();
    let ran = folder.run(&["track", "-c", "late.toml", "late.csv", "-o", "b.csv", "--json"]).good();
    assert_eq!(folder.read("a.csv"), folder.read("b.csv"));
    let said = format!("link: {} rows not used, over 0.5 s late (the first is row {})", late.len(), late[0]);
    assert!(late.len() > 20 && ran.err.contains(&said), "{said}\n{ran:?}");
    let link = &ran.json()["link"];
    assert_eq!((&link["too_late"], &link["first_too_late_row"]), (&late.len().into(), &late[0].into()));
    // A column with the time of reception goes before the order of the rows.
    let mut lines = table.lines();
    let received: String = lines.by_ref().skip(1).enumerate().map(|(i, l)| format!("{l},{}\n", 100 + i)).collect();
    let mut sorted: Vec<&str> = received.lines().collect();
    sorted.sort_unstable();
    folder.write("received.csv", format!("t,target,kind,anchor,value,received\n{}\n", sorted.join("\n")));
    folder.run(&["track", "-c", "late.toml", "received.csv", "-o", "c.csv"]).good();
    assert_eq!(folder.read("a.csv"), folder.read("c.csv"));
}

const HELD: &str = "\
[model]
kind = \"linear\"
A = [[1.0, 1.0], [0.0, 1.0]]
C = [[1.0, 0.0]]
Q = [[0.1, 0.0], [0.0, 0.1]]
R = [[1.0]]
x0 = [0.0, 0.0]
P0 = [[1.0, 0.0], [0.0, 1.0]]

[estimator]
kind = \"lmmse\"

[link]
stamped = false
hold = \"last-received\"
duplicates = \"detect\"
";

#[test]
fn what_a_link_without_time_stamps_found_is_reported() {
    let folder = Folder::new();
    folder.write("spec.toml", HELD);
    let values = |y: &[f64]| -> String { y.iter().enumerate().map(|(k, y)| format!("{k},{y}\n")).collect() };
    folder.write("m.csv", format!("k,z1\n{}", values(&[0.1, 1.2, 1.2, 1.2, 4.1, 5.3, 5.3, 7.2])));
    let ran = folder.run(&["track", "-c", "spec.toml", "m.csv", "-o", "t.csv", "--json"]).good();
    // Three of seven are lost, under a uniform prior: 5 of 9.
    let said = "link: 3 repeated values counted as lost, arrival rate estimated as 0.556";
    assert!(ran.err.contains(said) && !ran.err.contains("0.556 ("), "{ran:?}");
    let link = &ran.json()["link"];
    assert_eq!((&link["repeats"], &link["stale"]), (&3.into(), &0.into()));
    let arrival = link["arrival"].as_f64().expect("a rate");
    assert!((arrival - 5.0 / 9.0).abs() < 1e-3, "{link}");
    // Two targets, one of which loses nothing; sequence numbers this time.
    let numbered =
        "target,k,z1,seq\nA,0,0.1,9\nA,1,1.2,10\nA,2,1.2,10\nA,3,3.3,12\nB,0,0.2,0\nB,1,1.1,1\nB,2,2.5,2\nB,3,3.4,3\n";
    folder.write("n.csv", numbered);
    let ran = folder.run(&["track", "-c", "spec.toml", "n.csv", "-o", "t.csv", "--json"]).good();
    assert!(ran.err.contains("link: 1 old value by sequence number counted as lost"), "{ran:?}");
    assert!(ran.err.contains("arrival rate estimated as 0.700 (0.600 to 0.800)"), "{ran:?}");
    assert_eq!((&ran.json()["link"]["arrival_min"], &ran.json()["link"]["arrival_max"]), (&0.6.into(), &0.8.into()));
}

#[test]
fn time_of_reception_stands_for_a_time_that_the_link_does_not_carry() {
    let folder = Folder::new();
    let spec = "[model]\nkind = \"constant-velocity\"\nnoise = 0.5\nx0 = [1, 2, 0, 0]\nP0 = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]\n\
        [[sensor]]\nkind = \"position\"\nsd = 0.1\n[estimator]\nkind = \"gpb1\"\n[link]\nstamped = false\narrival = 0.9\n";
    folder.write("spec.toml", spec);
    let rows: String =
        (0..20).map(|k| format!("{},{},{}\n", 0.5 * f64::from(k), 1.0 + 0.1 * f64::from(k), 2.0)).collect();
    folder.write("received.csv", format!("received,x,y\n{rows}")).write("t.csv", format!("t,x,y\n{rows}"));
    folder.run(&["track", "-c", "spec.toml", "received.csv", "-o", "a.csv"]).good();
    folder.run(&["track", "-c", "spec.toml", "t.csv", "-o", "b.csv"]).good();
    assert_eq!(folder.read("a.csv"), folder.read("b.csv"));
    assert_eq!(folder.text("a.csv").lines().count(), 21);
}
