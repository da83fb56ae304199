//! The report page of a run.

pub(crate) mod advice;
pub mod gallery;
pub(crate) mod map;
pub mod page;
pub(crate) mod panels;
pub(crate) mod settings;
pub(crate) mod training;
