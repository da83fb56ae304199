//! Tests: learning.
