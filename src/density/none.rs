//! A fixed set of Gaussians.

/// Density control that never changes the set.
#[derive(Debug, Clone, Copy, Default)]
pub struct Fixed;
