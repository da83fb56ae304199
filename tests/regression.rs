//! Tests: regression.
