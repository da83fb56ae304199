//! `mhsplat verify`.
use super::{Common, Outcome};
use mhsplat::error::Result;
/// Arguments.
#[derive(clap::Args)]
pub struct VerifyArgs {}
/// Checks.
pub fn run(_: &VerifyArgs, _: &Common) -> Result<Outcome> {
    Ok(Outcome::Done)
}
