//! `fixtrail tune` from end to end.

mod common;

use common::{Folder, walk_folder_with_truth};

/// The walk with its truth.
fn with_truth() -> Folder {
    walk_folder_with_truth(115)
}

#[test]
fn tuned_specs_track_and_say_where_their_numbers_come_from() {
    let folder = with_truth();
    let json = folder
        .run(&["tune", "-c", "spec.toml", "m.csv", "--truth", "truth.csv", "-o", "tuned.toml", "--json"])
        .good()
        .json();
    assert_eq!(json["with_truth"], true);
    assert!(json["after"]["score"].as_f64() >= json["before"]["score"].as_f64(), "{json}");
    let text = folder.text("tuned.toml");
    assert!(text.starts_with("# Tuned on m.csv, with truth ("), "{text}");
    assert!(text.contains("# half loses ") && text.contains("residuals at known positions"), "{text}");
    let tracked = |spec: &str| {
        let json =
            folder.run(&["track", "-c", spec, "m.csv", "--truth", "truth.csv", "-o", "t.csv", "--json"]).good().json();
        json["truth"]["overall"]["rmse_m"].as_f64().expect("a number")
    };
    // Scored where it was tuned: it must at least not be worse.
    assert!(tracked("tuned.toml") <= 1.02 * tracked("spec.toml"));
    // Bytes do not depend on the threads.
    folder
        .run(&["tune", "-c", "spec.toml", "m.csv", "--truth", "truth.csv", "-o", "again.toml", "--threads", "1"])
        .good();
    assert_eq!(folder.text("again.toml"), text);
}

#[test]
fn widths_that_rest_on_few_errors_are_said_to() {
    let folder = with_truth();
    // The truth of someone who measures half a metre off, to one side and then to the other.
    let truth = folder.text("truth.csv");
    let displaced = |line: &str| {
        let mut cells = line.split(',').map(str::to_owned).collect::<Vec<_>>();
        let (t, x): (f64, f64) = (cells[0].parse().ok()?, cells[2].parse().ok()?);
        cells[2] = (x + 0.5 * (0.3 * t).sin()).to_string();
        Some(cells.join(","))
    };
    let lines: Vec<String> = truth.lines().map(|line| displaced(line).unwrap_or_else(|| line.to_owned())).collect();
    folder.write("off.csv", lines.join("\n"));
    let tuned = |truth: &str| {
        let arguments =
            ["tune", "-c", "spec.toml", "m.csv", "--truth", truth, "-o", "tuned.toml", "--keep-structure", "--json"];
        let said = folder.run(&arguments).good();
        let independent = said.json()["widths"]["independent_errors"].as_f64().expect("a number");
        (independent, said.err.contains("independent errors: elsewhere the 95 % ellipse may hold far less"))
    };
    let (few, many) = (tuned("off.csv"), tuned("truth.csv"));
    assert!(few.0 < 10.0 && few.1, "{few:?}");
    assert!(many.0 > 10.0 && !many.1, "{many:?}");
}

#[test]
fn without_truth_or_spec_the_next_measurements_decide() {
    let folder = with_truth();
    let said = folder.run(&["tune", "m.csv", "-o", "tuned.toml", "--first", "0.5", "--keep-structure"]).good();
    assert!(said.err.contains("no spec given") && said.err.contains("tuned in "), "{}", said.err);
    let text = folder.text("tuned.toml");
    assert!(text.starts_with("# Tuned on m.csv, the first 0.500 of each, without truth ("), "{text}");
    folder.run(&["track", "-c", "tuned.toml", "m.csv", "-o", "t.csv"]).good();
}

const LINEAR: &str =
    "[model]\nkind = \"linear\"\nA = [[1.0]]\nC = [[1.0]]\nQ = [[0.1]]\nR = [[1.0]]\nx0 = [0.0]\nP0 = [[1.0]]\n";

#[test]
fn a_link_without_time_stamps_learns_its_arrival_rate() {
    let folder = Folder::new();
    // Of ten values after the first, the fourth and the eighth are shown again.
    folder.write("z.csv", "k,z1\n0,0\n1,1\n2,2\n3,3\n4,3\n5,5\n6,4\n7,3\n8,3\n9,2\n10,1\n");
    let held = format!("{LINEAR}[link]\nstamped = false\nhold = \"last-received\"\n[estimator]\nkind = \"lmmse\"\n");
    folder.write("held.toml", &held);
    let run = folder.run(&["tune", "-c", "held.toml", "z.csv", "-o", "tuned.toml", "--json"]).good();
    assert!(run.err.contains("arrival rate 0.750 ± 0.12"), "{}", run.err);
    let json = run.json();
    // Beta(1 + 8, 1 + 2): mean 9/12, variance (9/12)(3/12)/13, on a grid of hundredths.
    let number = |key: &str| json["arrival"][key].as_f64().expect("a number");
    assert!((number("rate") - 0.75).abs() < 1e-3 && (number("standard_error") - 0.1201).abs() < 1e-3, "{json}");
    assert_eq!(number("values"), 10.0);
    let text = folder.text("tuned.toml");
    assert!(text.contains("arrival = 0.75  # ±0.12, of 10 values shown, by those that repeat"), "{text}");
    folder.run(&["track", "-c", "tuned.toml", "z.csv", "-o", "t.csv"]).good();
    // A rate that the table says is not learnt.
    folder.write("column.toml", held.replace("hold =", "arrival = { column = \"p\" }\nhold ="));
    folder.write("p.csv", "k,z1,p\n0,0,1\n1,1,1\n2,2,0.5\n");
    let run = folder.run(&["tune", "-c", "column.toml", "p.csv", "-o", "x.toml"]);
    assert!(run.code == Some(2) && run.err.contains("no arrival rate to learn"), "{}", run.err);
}

#[test]
fn what_cannot_be_tuned_is_one_sentence() {
    let folder = with_truth();
    folder
        .write("empty.csv", "t,target,anchor,value\n")
        .write("linear.toml", "[model]\nkind = \"linear\"\nA = [[1.0]]\nC = [[1.0]]\nQ = [[1.0]]\nR = [[1.0]]\n");
    folder.write("z.csv", "k,z1\n0,1\n1,2\n2,1\n");
    for (arguments, says) in [
        (
            &["tune", "m.csv", "m.csv", "m.csv", "--truth", "truth.csv", "--truth", "truth.csv", "-o", "x.toml"][..],
            "2 times for 3 inputs",
        ),
        (&["tune", "-c", "spec.toml", "m.csv", "-o", "spec.toml"], "spec.toml"),
        (&["tune", "-", "-o", "x.toml"], "standard input"),
        (&["tune", "-c", "spec.toml", "empty.csv", "-o", "x.toml"], "no rows"),
        (&["tune", "-c", "linear.toml", "z.csv", "-o", "x.toml"], "no number to tune"),
        (&["tune", "-c", "linear.toml", "z.csv", "--truth", "truth.csv", "-o", "x.toml"], "a model with positions"),
        (&["tune", "m.csv", "--first", "0", "-o", "x.toml"], "0.01 to 1"),
        (&["tune", "m.csv", "-o", "nowhere/x.toml"], "nowhere"),
        (&["tune", "missing.csv", "-o", "x.toml"], "missing.csv"),
        (&["tune", "-c", "spec.toml", "m.csv", "--truth", "missing.csv", "-o", "x.toml"], "missing.csv"),
    ] {
        let run = folder.run(arguments);
        assert_eq!(run.code, Some(2), "{arguments:?}: {}", run.err);
        assert!(run.err.contains(says), "{arguments:?}: {}", run.err);
        assert!(!folder.path("x.toml").exists(), "{arguments:?}");
    }
}
