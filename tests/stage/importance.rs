//! Tests: importance.
