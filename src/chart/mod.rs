//! Charts and the text on pages.

pub mod axis;
mod labels;
pub mod svg;
pub mod text;
