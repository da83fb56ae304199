//! Metropolis–Hastings density control.
