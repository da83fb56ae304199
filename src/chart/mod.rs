//! Charts and the text on pages.

pub mod axis;
pub mod bars;
pub mod loglog;
mod plot;
pub mod svg;
pub mod text;
