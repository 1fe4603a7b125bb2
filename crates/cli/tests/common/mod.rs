//! What the tests of the binary share: a folder of their own, and the binary run in it.

#![allow(dead_code)] // Every test binary uses a part of it.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

/// A folder that is removed at the end of a test.
pub struct Folder(tempfile::TempDir);

impl Folder {
    pub fn new() -> Folder {
        Folder(tempfile::tempdir().expect("a temporary folder"))
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn write(&self, name: &str, content: impl AsRef<[u8]>) -> &Folder {
        fs::write(self.path(name), content).expect("a file in a temporary folder");
        self
    }

    pub fn read(&self, name: &str) -> Vec<u8> {
        fs::read(self.path(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
    }

    pub fn text(&self, name: &str) -> String {
        String::from_utf8(self.read(name)).expect("UTF-8")
    }

    /// Names of everything in the folder, sorted.
    pub fn names(&self) -> Vec<String> {
        names(self.0.path())
    }

    /// Runs the binary in the folder.
    pub fn run(&self, arguments: &[&str]) -> Ran {
        self.run_with(arguments, b"")
    }

    /// Runs the binary in the folder with `input` on standard input.
    pub fn run_with(&self, arguments: &[&str], input: &[u8]) -> Ran {
        let mut child = Command::new(env!("CARGO_BIN_EXE_fixtrail"))
            .args(arguments)
            .current_dir(self.0.path())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the binary starts");
        // A command that does not read its input closes the pipe; that is its right.
        let _ = child.stdin.take().expect("a pipe").write_all(input);
        Ran::from(child.wait_with_output().expect("the binary ends"))
    }
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(folder)
        .expect("a folder")
        .map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

/// What a run left.
#[derive(Debug)]
pub struct Ran {
    pub code: Option<i32>,
    pub out: String,
    pub err: String,
}

impl From<Output> for Ran {
    fn from(output: Output) -> Ran {
        Ran {
            code: output.status.code(),
            out: String::from_utf8_lossy(&output.stdout).into_owned(),
            err: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }
}

impl Ran {
    /// The run, if it went well.
    #[track_caller]
    pub fn good(self) -> Ran {
        assert_eq!(self.code, Some(0), "{self:?}");
        self
    }

    /// Standard output as JSON.
    #[track_caller]
    pub fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.out).unwrap_or_else(|e| panic!("{e}: {self:?}"))
    }
}

/// A walk of two tags among four anchors at 5 Hz, a few rows lost: a table and its anchors.
pub fn walk() -> (String, String) {
    let anchors = [("A0", 0.0, 0.0), ("A1", 8.0, 0.0), ("A2", 8.0, 6.0), ("A3", 0.0, 6.0)];
    let mut table = String::from("t,target,kind,anchor,value\n");
    for i in 0..120 {
        let t = 0.2 * f64::from(i);
        for (tag, phase) in [("T1", 0.0), ("T2", 1.5)] {
            let (x, y) = (4.0 + 2.0 * (0.4 * t + phase).cos(), 3.0 + 2.0 * (0.4 * t + phase).sin());
            for (j, (anchor, ax, ay)) in anchors.iter().enumerate() {
                // A pattern with no mean and no period of the walk's stands for noise.
                let noise = 0.05 * (f64::from(i) * 1.7 + j as f64 * 2.9 + phase).sin();
                let range = f64::hypot(x - ax, y - ay) + noise;
                if (i + j as i32) % 11 != 3 {
                    table += &format!("{t},{tag},range,{anchor},{range}\n");
                }
            }
        }
    }
    let anchors: String = anchors.iter().map(|(name, x, y)| format!("{name},{x},{y},0\n")).collect();
    (table, format!("anchor,x,y,z\n{anchors}"))
}

pub const SPEC: &str = "\
[model]
kind = \"constant-velocity\"
axes = 2
noise = 0.5

[[sensor]]
kind = \"range\"
sd = 0.1

[estimator]
kind = \"ekf\"
";

/// A folder with the walk: `m.csv`, `anchors.csv`, `spec.toml`.
pub fn walk_folder() -> Folder {
    let folder = Folder::new();
    let (table, anchors) = walk();
    folder.write("m.csv", table).write("anchors.csv", anchors).write("spec.toml", SPEC);
    folder
}

/// The folder with the walk and its `truth.csv`, at the instants from 10 to `end`.
pub fn walk_folder_with_truth(end: i32) -> Folder {
    let folder = walk_folder();
    let truth: String = (10..end)
        .flat_map(|i| [("T1", 0.0), ("T2", 1.5)].map(|(tag, phase)| (0.2 * f64::from(i), tag, phase)))
        .map(|(t, tag, phase)| {
            let angle: f64 = 0.4 * t + phase;
            format!("{t},{tag},{},{}\n", 4.0 + 2.0 * angle.cos(), 3.0 + 2.0 * angle.sin())
        })
        .collect();
    folder.write("truth.csv", format!("t,target,x,y\n{truth}"));
    folder
}
