//! Charts and the text on pages.

pub mod bars;
pub mod loglog;
pub mod svg;
pub mod text;
pub mod ticks;
