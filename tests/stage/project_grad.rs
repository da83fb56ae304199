//! Tests: project_grad.
