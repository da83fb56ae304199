//! One file per stage, and the cases they share.

mod adam;
mod bin;
mod edit;
mod importance;
mod loss;
mod metrics;
mod project;
mod project_grad;
mod scan;
mod sort;
mod splat;
mod splat_grad;
