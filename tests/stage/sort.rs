//! Tests: sort.
