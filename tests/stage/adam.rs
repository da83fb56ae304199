//! Tests: adam.
