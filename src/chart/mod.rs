//! Charts and the text on pages.

pub mod axis;
pub mod svg;
pub mod text;
