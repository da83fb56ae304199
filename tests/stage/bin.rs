//! Tests: bin.
