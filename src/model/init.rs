//! The first Gaussians.
