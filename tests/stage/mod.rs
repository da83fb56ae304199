//! Tests: stage/mod.
