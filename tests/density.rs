//! Tests: density.
