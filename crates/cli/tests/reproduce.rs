//! `fixtrail reproduce`: rows, JSON, page, and what it refuses.

mod common;

use common::Folder;

#[test]
fn rows_fit_a_hundred_columns_and_say_what_came_of_each_number() {
    let ran = Folder::new().run(&["reproduce", "fms", "--runs", "2"]).good();
    assert!(ran.out.lines().all(|l| l.chars().count() <= 100), "{}", ran.out);
    assert!(ran.out.starts_with("P. S. Kim, Finite Memory Structure"), "{}", ran.out);
    let row = ran.out.lines().find(|l| l.contains(" 0.0477 ")).expect("a row of Table 2");
    assert!(row.contains("0.27") && row.contains("0.04"), "{row}");
    assert!(ran.err.is_empty(), "no progress without a terminal: {}", ran.err);
}

#[test]
fn json_has_every_entry_and_the_same_bytes_on_any_number_of_threads() {
    let folder = Folder::new();
    let with = |threads: &str| {
        let arguments =
            ["reproduce", "fms", "--runs", "3", "--seed", "9", "--threads", threads, "--json", "--report", "r.html"];
        let ran = folder.run(&arguments).good();
        (ran, folder.text("r.html"))
    };
    let ((one, page), (two, page_of_two)) = (with("1"), with("2"));
    assert_eq!((&one.out, page), (&two.out, page_of_two));
    let json = one.json();
    assert_eq!(json["seed"], 9);
    let entries = json["papers"][0]["entries"].as_array().expect("entries");
    let of = |what: &str| entries.iter().find(|e| e["what"] == what).expect("an entry");
    let smoother = of("position error, FMS smoother, ramp, m");
    assert_eq!(smoother["printed"], 0.006);
    assert_eq!(smoother["verdict"], "reproduced under a reading");
    for number in
        [&smoother["ours"]["mean"], &smoother["ours"]["se"], &smoother["reading"]["mean"], &smoother["bound"]["value"]]
    {
        assert!(number.as_f64().is_some_and(|v| v > 0.0), "{smoother}");
    }
    assert!(entries.iter().all(|e| e["verdict"].is_string() && e["where"].is_string()));
}

#[test]
fn page_has_every_figure_and_loads_nothing() {
    let folder = Folder::new();
    let ran = folder.run(&["reproduce", "fms", "--runs", "2", "--report", "r.html"]).good();
    assert!(ran.err.contains("r.html: the report"), "{}", ran.err);
    let page = folder.text("r.html");
    for figure in [
        "Figure 1, first plot",
        "Figure 2, second plot",
        "Figure 3, third plot",
        "Figure 4, first plot, another reading",
    ] {
        assert!(page.contains(&format!("<h3>{figure}</h3>")), "{figure}");
    }
    assert_eq!(page.matches("<svg viewBox").count(), 16);
    assert!(page.contains("<code>fixtrail reproduce fms --runs 2 --seed 1</code>"));
    assert!(!page.contains("http://") && !page.contains("https://"));
}

#[test]
fn what_cannot_be_done_is_refused_before_the_run_with_one_sentence() {
    let folder = Folder::new();
    let started = std::time::Instant::now();
    let ran = folder.run(&["reproduce", "all", "--report", "nowhere/r.html"]);
    assert_eq!(ran.code, Some(2), "{ran:?}");
    assert!(ran.err.contains("nowhere/r.html: cannot be written: the folder `nowhere` does not exist"), "{}", ran.err);
    assert_eq!(ran.err.lines().count(), 1, "{}", ran.err);
    assert!(started.elapsed().as_secs() < 5);

    let unknown = folder.run(&["reproduce", "kalman60"]);
    assert_eq!(unknown.code, Some(2), "{unknown:?}");
    assert!(unknown.err.contains("kalman60") && unknown.err.contains("fosb"), "{}", unknown.err);
    assert_eq!(folder.run(&["reproduce", "fms", "--runs", "1"]).code, Some(2));
    assert_eq!(folder.run(&["reproduce"]).code, Some(2));
    assert!(folder.names().is_empty());
}
