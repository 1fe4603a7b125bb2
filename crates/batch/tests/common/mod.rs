//! What the tests of tables share.
#![allow(dead_code)]

use fixtrail_batch::{Input, ReadOptions, Table, read_table};
use fixtrail_track::error::BuildError;
use std::path::PathBuf;
use tempfile::TempDir;

pub const ANCHORS: &str = "anchor,x,y,z\nA0,0,0,2\nA1,10,0,2\nA2,0,10,2.5\n";

/// A folder with files in it.
pub struct Folder(TempDir);

impl Folder {
    pub fn new(files: &[(&str, &[u8])]) -> Folder {
        let folder = Folder(TempDir::new().unwrap());
        for (name, bytes) in files {
            std::fs::write(folder.path(name), bytes).unwrap();
        }
        folder
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn names(&self) -> Vec<String> {
        let mut names: Vec<String> =
            std::fs::read_dir(self.0.path()).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }
}

/// Reads `bytes` as a file called `name` beside the usual anchors.
pub fn read(name: &str, bytes: &[u8], options: &ReadOptions) -> Result<Table, BuildError> {
    let folder = Folder::new(&[(name, bytes), ("anchors.csv", ANCHORS.as_bytes())]);
    read_table(&Input::File(folder.path(name)), None, options, &mut |_, _| {})
}

/// Reads a CSV table that must be good.
pub fn csv(text: &str) -> Table {
    read("m.csv", text.as_bytes(), &ReadOptions::default()).unwrap()
}

/// The table without what legitimately depends on the order of rows.
pub fn without_lines(mut table: Table) -> Table {
    for packet in table.targets.iter_mut().flat_map(|t| &mut t.packets) {
        packet.line = 0;
    }
    table.counts.out_of_order = 0;
    table
}
