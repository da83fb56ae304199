//! Commands that measure, check and compare.

pub mod bench;
pub mod compare;
pub mod experiment;
pub mod surrogate;
pub mod synth;
pub mod verify;

use console::Term;

use crate::cli::output;
use mhsplat::lab::report::Report;
use mhsplat::lab::text::text;

/// Columns that a line of a terminal has at least; a narrower one wraps it.
const NARROW: u16 = 40;

/// Form of a report on stdout.
#[derive(clap::Args)]
pub struct Form {
    /// Print the whole report as Markdown on a terminal, too; elsewhere it is printed so.
    #[arg(long, conflicts_with = "json")]
    markdown: bool,
}

impl Form {
    /// Prints a report.
    pub fn print(&self, report: &Report) {
        let terminal = Term::stdout();
        match terminal.is_term() && !self.markdown {
            true => {
                let width = terminal.size().1.max(NARROW);
                output::line(text(report, usize::from(width)).trim_end());
            }
            false => output::line(&report.to_markdown()),
        }
    }
}
