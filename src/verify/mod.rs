//! Every stage on a device against the f64 reference: error and time.

pub mod chain;
