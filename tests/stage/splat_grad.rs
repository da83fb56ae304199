//! Tests: splat_grad.
