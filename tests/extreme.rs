//! Tests: extreme.
