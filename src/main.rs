//! mhsplat.
fn main() {}
