//! Tests: gradient.
