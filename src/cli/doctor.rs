//! `mhsplat doctor`.

use crate::cli::common::{Common, Outcome};
use crate::cli::output;
use mhsplat::base::error::{Error, Result};
use mhsplat::lab::doctor::{Findings, examine};

/// Tells what there is of OpenCL, and what to do.
///
/// # Errors
/// No device that can be used.
pub fn run(common: &Common) -> Result<Outcome> {
    let found = examine();
    match common.json {
        true => output::json(&found)?,
        false => lines(&found)
            .iter()
            .for_each(|line| output::line(&printable(line))),
    }
    match found.usable() {
        true => Ok(Outcome::Done),
        false => Err(Error::device(
            "OpenCL",
            "no usable device",
            "see what to do above",
        )),
    }
}

fn verdict(failure: Option<&String>) -> String {
    failure.map_or_else(|| "ok".to_owned(), |why| format!("NO: {why}"))
}

/// A line without what a terminal would act on: names of files, libraries and devices are others' text. JSON has escapes for it.
fn printable(line: &str) -> String {
    line.replace(char::is_control, " ")
}

/// The findings in words.
fn lines(f: &Findings) -> Vec<String> {
    let mut lines = Vec::new();
    let all = |paths: &[std::path::PathBuf]| -> String {
        let paths: Vec<String> = paths.iter().map(|p| p.display().to_string()).collect();
        paths.join(", ")
    };
    lines.push(format!("loader: {}", all(&f.loader)));
    lines.push(format!("drivers named in: {}", all(&f.vendors)));
    for d in &f.drivers {
        let verdict = verdict(d.failure.as_ref());
        lines.push(format!("  {} ({}): {verdict}", d.library, d.named_by));
    }
    lines.push("devices:".into());
    for d in &f.devices {
        let i = &d.info;
        lines.push(format!(
            "  {} {} [{:?}, {}, {} MiB, buffers to {} MiB, {} KiB local, work-groups to {}]: {}",
            i.index,
            i.name,
            i.kind,
            i.units(),
            i.global_memory >> 20,
            i.max_alloc >> 20,
            i.local_memory >> 10,
            i.max_work_group,
            verdict(d.failure.as_ref()),
        ));
    }
    lines.extend(f.no_devices.iter().map(|why| format!("  none: {why}")));
    if !f.nodes.is_empty() {
        lines.push("device files:".into());
    }
    for n in &f.nodes {
        let group = n.group.as_deref().unwrap_or("?");
        let verdict = verdict(n.failure.as_ref());
        lines.push(format!("  {} (group {group}): {verdict}", n.path.display()));
    }
    lines.push("limits:".into());
    let limits = f.limits.iter();
    lines.extend(limits.map(|l| format!("  {}: {}", l.name, l.value)));
    lines.push(match f.advice.is_empty() {
        true => "nothing is wrong; `mhsplat verify` checks what a device computes".into(),
        false => "to do:".into(),
    });
    lines.extend(f.advice.iter().map(|what| format!("  {what}")));
    lines
}
