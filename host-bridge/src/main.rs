//! Command line of the bridge.
fn main() {}
