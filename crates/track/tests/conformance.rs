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
fn vectors_of_an_unknown_kind_are_refused_by_name() {
    for file in vectors("fosb", "lateration") {
        let error = verify(&std::fs::read_to_string(&file).unwrap(), &file).unwrap_err().to_string();
        assert!(error.contains("is not understood"), "{error}");
    }
}
