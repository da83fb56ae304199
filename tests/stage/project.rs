//! Tests: project.
