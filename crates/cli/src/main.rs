//! The `fixtrail` binary.
fn main() {}
