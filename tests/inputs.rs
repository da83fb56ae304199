//! Tests: photos and datasets in other forms than folders of small 8-bit files.

pub mod archive;
mod png;

pub use archive::small_archive;
