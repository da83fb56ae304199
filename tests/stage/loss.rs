//! Tests: loss.
