//! Relocation of dead Gaussians.
