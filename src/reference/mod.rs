//! The stages in plain f64 Rust.
