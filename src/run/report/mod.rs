//! The report page of a run.

pub mod gallery;
pub mod page;
pub(crate) mod panels;
pub(crate) mod settings;
