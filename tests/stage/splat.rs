//! Tests: splat.
