//! `mhsplat verify`.
use mhsplat::error::Result;
use super::{Common, Outcome};
/// Arguments.
#[derive(clap::Args)]
pub struct VerifyArgs {}
/// Checks.
pub fn run(_: &VerifyArgs, _: &Common) -> Result<Outcome> { Ok(Outcome::Done) }
