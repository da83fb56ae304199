//! Sets `MHSPLAT_COMMIT`, the source revision that a run records, and nothing else: the variable's own value where it is set, else
//! that of the package (`cargo install`), else that of the Git checkout; elsewhere there is none.
#![allow(clippy::print_stdout)]

use std::path::Path;
use std::process::Command;

fn main() {
    println!("cargo:rerun-if-env-changed=MHSPLAT_COMMIT");
    if std::env::var_os("MHSPLAT_COMMIT").is_some() {
        return;
    }
    if let Some(commit) = of_package().or_else(of_checkout) {
        println!("cargo:rustc-env=MHSPLAT_COMMIT={commit}");
    }
}

/// The revision that `cargo package` wrote down.
fn of_package() -> Option<String> {
    let info = std::fs::read_to_string(".cargo_vcs_info.json").ok()?;
    let after = info.split("\"sha1\"").nth(1)?;
    Some(after.split('"').nth(1)?.chars().take(7).collect())
}

/// The revision of the repository whose root this is.
fn of_checkout() -> Option<String> {
    let moves = Path::new(".git")
        .exists()
        .then(|| git(&["--git-path", "logs/HEAD"]))??;
    if Path::new(&moves).exists() {
        println!("cargo:rerun-if-changed={moves}");
    }
    git(&["--short", "HEAD"])
}

fn git(what: &[&str]) -> Option<String> {
    let output = Command::new("git")
        .arg("rev-parse")
        .args(what)
        .output()
        .ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| text.trim().to_owned())
}
