//! The committed conformance vectors, each at its file's own tolerance.

use fixtrail_track::verify::verify;
use std::path::PathBuf;

fn vectors(folder: &str, prefix: &str) -> Vec<PathBuf> {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../golden").join(folder);
    let mut files: Vec<PathBuf> = std::fs::read_dir(&root)
        .unwrap_or_else(|e| panic!("{}: {e}", root.display()))
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(prefix)))
        .collect();
    files.sort();
    files
}

fn assert_passes(files: &[PathBuf], at_least: usize) {
    assert!(files.len() >= at_least, "found {} files", files.len());
    for file in files {
        let verdict = verify(&std::fs::read_to_string(file).unwrap(), file).unwrap();
        for q in &verdict.quantities {
            assert!(
                q.passed(),
                "{}: {} deviates by {:e}, allowed {:e}, {} numbers compared",
                verdict.file,
                q.name,
                q.worst,
                q.tolerance,
                q.compared
            );
        }
        assert!(verdict.passed(), "{}: nothing compared", verdict.file);
    }
}

#[test]
fn finite_memory_vectors_pass() {
    assert_passes(&vectors("fms", ""), 5);
}

#[test]
fn kalman_family_vectors_pass() {
    assert_passes(&vectors("fosb", "kf"), 12);
}

#[test]
fn message_passing_vectors_pass() {
    assert_passes(&vectors("fosb", "fosb"), 13);
    assert_passes(&vectors("fosb", "st"), 2);
}

#[test]
fn a_wrong_number_in_message_passing_vectors_is_found() {
    for (name, after, from, to, quantity) in [
        ("fosb_messages_accel", "expected", "-7.54843529519816", "-7.54843529529816", "x[0]"),
        ("fosb_messages_accel", "var_s_refined", "1.0795741098863707", "1.0795741099863707", "var_s_refined[0]"),
        ("fosb_messages_accel", "step8_G_tilde", "9.588234704399998", "9.588234704499998", "messages.step8_G_tilde[0]"),
        ("fosb_literal", "expected", "22.77707912", "22.77708912", "step4_x_pred_1"),
        ("fosb_literal", "expected", "1.4287544282670264", "1.4287545282670264", "var_s_refined"),
        ("steady_state", "expected", "0.3009928845522819", "0.3009928846522819", "fosb.alpha"),
        ("steady_state", "\"kf\"", "1.27128403618525", "1.27128403718525", "kf.P12"),
        ("statistics", "expected", "2.15564790676874", "2.15564791676874", "kf.mse_x"),
        ("statistics", "expected", "1.9663691946072133", "1.9663692046072133", "fosb.q60_2d"),
    ] {
        let file = &vectors("fosb", name)[0];
        let verdict = verify(&altered(file, after, from, to), file).unwrap();
        let failed: Vec<&str> = verdict.quantities.iter().filter(|q| !q.passed()).map(|q| q.name.as_str()).collect();
        assert_eq!(failed, [quantity], "{name}: {from} as {to}");
    }
}

#[test]
fn position_vectors_pass() {
    for kind in ["lateration", "tdoa", "rss_ml", "rss_to_range"] {
        assert_passes(&vectors("fosb", kind), 1);
    }
}

#[test]
fn scheduler_vectors_pass() {
    assert_passes(&vectors("mvf", "idgss"), 2);
}

#[test]
fn a_wrong_number_in_scheduler_vectors_is_found() {
    for (file, after, from, to, quantity) in [
        ("idgss_ekf", "\"k\":11,", "\"coast\"", "\"fallback\"", "decisions"),
        ("idgss_ekf", "\"k\":5,", "\"handoff\":false", "\"handoff\":true", "decisions"),
        ("idgss_ekf", "\"k\":2,", "0.3798979986607661", "0.37989899", "candidates"),
        ("idgss_ekf", "\"k\":2,", "0.24356960723968002", "0.2435699", "candidates"),
        ("idgss_ekf", "\"n_steps\"", "20", "19", "totals"),
        ("idgss_emvf", "\"total_energy_mJ\"", "9.045854753730561", "9.0458748", "totals"),
        ("idgss_emvf", "\"k\":1,", "0.13943683636056897", "0.139438", "candidates"),
    ] {
        let files = vectors("mvf", file);
        let text = altered(&files[0], after, from, to);
        let verdict = verify(&text, &files[0]).unwrap();
        let wrong: Vec<&str> = verdict.quantities.iter().filter(|q| !q.passed()).map(|q| q.name.as_str()).collect();
        assert_eq!(wrong, [quantity], "{file} after {after}");
    }
}

/// The text of a file with the first `from` after `after` replaced.
fn altered(file: &std::path::Path, after: &str, from: &str, to: &str) -> String {
    let text = std::fs::read_to_string(file).unwrap();
    let at = text.find(after).unwrap_or_else(|| panic!("{after}"));
    format!("{}{}", &text[..at], text[at..].replacen(from, to, 1))
}

#[test]
fn a_wrong_number_in_position_vectors_is_found() {
    for (kind, after, from, to, quantity) in [
        ("lateration", "\"box2\"", "1.983415506455496", "1.98341560645", "linear"),
        ("lateration", "\"box2\"", "7.258691390296573", "7.25869149029", "gauss_newton.p"),
        ("lateration", "\"box2\"", "0.059876439569595145", "0.05987644156", "gauss_newton.cov"),
        ("lateration", "\"box2\"", "0.6006857223672697", "0.6006857423", "gauss_newton.chi2"),
        ("lateration", "\"box2\"", "\"unique\"", "\"mirror\"", "status"),
        (
            "lateration",
            "\"two2_gap\"",
            "null",
            "{\"p\": [1, 2], \"cov\": [[1, 0], [0, 1]], \"chi2\": 0}",
            "gauss_newton.p",
        ),
        ("tdoa", "linear_p_r0", "1.7486882625708653", "1.7486885625", "linear_p_r0"),
        ("tdoa", "gauss_newton", "0.5113500197565922", "0.5113500297", "gauss_newton.chi2"),
        ("rss_ml", "known_p0", "16.834207474303906", "16.83420774", "known_p0.p"),
        ("rss_ml", "unknown_p0", "1.1030152116224519", "1.1030152316", "unknown_p0.cov"),
        ("rss_to_range", "expected", "77.50702750761309", "77.5070275078", "var_mean_unbiased"),
    ] {
        let file = &vectors("fosb", kind)[0];
        let verdict = verify(&altered(file, after, from, to), file).unwrap();
        let failed: Vec<&str> = verdict.quantities.iter().filter(|q| !q.passed()).map(|q| q.name.as_str()).collect();
        assert_eq!(failed, [quantity], "{kind}: {from} as {to}");
    }
}

#[test]
fn position_vectors_that_lack_something_say_what() {
    for (kind, after, from, to, says) in [
        ("lateration", "cases", "\"dim\": 2", "\"dim\": 4", ["cases[0].inputs.dim", "expected 2 or 3"]),
        ("lateration", "range_var", "0.134,", "", ["cases[0].inputs.range_var", "3 entries, expected 4"]),
        ("lateration", "range_var", "0.134", "-0.134", ["cases[0].inputs.range_var[0]", "positive"]),
        ("tdoa", "cases", "tdoa_range_diff", "differences", ["cases[0].inputs", "lacks `tdoa_range_diff`"]),
        ("rss_ml", "cases", "\"n\": 2.89", "\"n\": null", ["cases[0].inputs", "lacks `n`"]),
        ("rss_to_range", "cases", "\"kappa\"", "\"k\"", ["cases[0].expected", "lacks `kappa`"]),
    ] {
        let file = &vectors("fosb", kind)[0];
        let error = verify(&altered(file, after, from, to), file).unwrap_err().to_string();
        assert!(says.iter().all(|part| error.contains(part)), "{kind}: {error}");
    }
}

#[test]
fn vectors_of_an_unknown_kind_are_refused_by_name() {
    let file = &vectors("fosb", "steady_state")[0];
    let error = verify(&altered(file, "kind", "steady_state", "op_counts"), file).unwrap_err().to_string();
    assert!(error.contains("kind `op_counts`") && error.contains("is not understood"), "{error}");
}
