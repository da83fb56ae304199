//! The last part of the page: the command, the device and every option.

use std::fmt::Write;
use std::path::Path;

use serde_json::Value;

use crate::chart::text::{escape, grouped, span};
use crate::config::{Sampler, TrainConfig};
use crate::run::record::{RECORD_FILE, RunRecord};

/// Command, dataset, device and configuration.
pub(super) fn section(out: &mut String, record: &RunRecord, run_dir: &Path) {
    let _ = write!(
        out,
        "<h2>How to repeat it</h2><pre>{}</pre>\n<h2>Dataset, device and cost</h2>",
        escape(&command(record, run_dir))
    );
    let (dataset, device) = (&record.dataset, &record.device);
    let cores = device.cores.zip(device.compute_units);
    let cores = cores.map_or_else(String::new, |(n, all)| format!("{n} of {all}"));
    let ranks = device.ranks.map_or_else(String::new, |n| n.to_string());
    let facts = [
        ("dataset", &*dataset.path),
        ("layout", &dataset.layout),
        ("device", &device.name),
        ("vendor", &device.vendor),
        ("platform", &device.platform),
        ("driver", &device.driver),
        ("compute units", &cores),
        ("ranks, the first of which this is", &ranks),
        (
            "version",
            &format!("{} ({})", record.version, record.commit),
        ),
        ("whole run", &span(record.wall_seconds)),
        ("density control", &density_control(record)),
    ];
    // Records of earlier versions do not have all of them.
    let known = facts.into_iter().filter(|(_, value)| !value.is_empty());
    table(out, known);
    let all = flatten(&record.config);
    let set = changed(&record.config);
    out.push_str("\n<h2>Options that differ from the defaults</h2>");
    if set.is_empty() {
        out.push_str("<p class=note>None.</p>");
    } else {
        table(out, set.iter().map(|(name, value)| (&**name, &**value)));
    }
    let _ = write!(out, "<details><summary>All {} options</summary>", all.len());
    table(out, all.iter().map(|(name, value)| (&**name, &**value)));
    out.push_str("</details>\n");
}

/// Writes a table of names and values.
pub(super) fn table<'a>(out: &mut String, rows: impl IntoIterator<Item = (&'a str, &'a str)>) {
    out.push_str("<table>");
    for (name, value) in rows {
        let (name, value) = (escape(name), escape(value));
        let _ = write!(out, "<tr><th>{name}</th><td>{value}</td></tr>");
    }
    out.push_str("</table>");
}

/// Sums of density control over the run, in the sampler's terms.
fn density_control(record: &RunRecord) -> String {
    let d = &record.density;
    let [born, proposed] = [d.accepted, d.proposed].map(grouped);
    let [relocated, removed] = [d.relocated, d.pruned].map(grouped);
    let [cloned, split] = [d.cloned, d.split].map(grouped);
    match record.config.sampler {
        Sampler::Mh => format!(
            "{born} of {proposed} proposed births, {removed} removed, {relocated} relocated"
        ),
        Sampler::Mcmc => format!("{born} born, {relocated} relocated"),
        Sampler::Adc => format!(
            "{cloned} cloned, {split} split, {removed} removed, {} opacity resets",
            grouped(d.opacity_resets)
        ),
        Sampler::None => "none: a fixed set".to_owned(),
    }
}

/// Options whose values are not the defaults.
fn changed(config: &TrainConfig) -> Vec<(String, String)> {
    let defaults = flatten(&TrainConfig::default());
    let mut options = flatten(config);
    options.retain(|option| !defaults.contains(option));
    options
}

/// Every option with its dotted name, sorted by name; not the lengths that a time budget decided.
pub(crate) fn flatten(config: &TrainConfig) -> Vec<(String, String)> {
    let mut config = config.clone();
    if config.has_budget() {
        config.lengths.clear();
    }
    // By way of text, which spells an f32 as it was typed (0.2); serde_json's own values widen it.
    let value = serde_json::to_string(&config)
        .and_then(|text| serde_json::from_str::<Value>(&text))
        .unwrap_or_default();
    let mut out = Vec::new();
    walk(&mut out, "", &value);
    out
}

fn walk(out: &mut Vec<(String, String)>, name: &str, value: &Value) {
    match value {
        Value::Object(fields) => {
            for (key, value) in fields {
                let dot = if name.is_empty() { "" } else { "." };
                walk(out, &format!("{name}{dot}{key}"), value);
            }
        }
        Value::String(text) => out.push((name.to_owned(), text.clone())),
        Value::Null => out.push((name.to_owned(), "none".to_owned())),
        other => out.push((name.to_owned(), other.to_string().replace(',', ", "))),
    }
}

/// The command line that repeats the run: options that differ from the defaults, and the record itself as configuration
/// where one of a table does, which have no flags.
fn command(record: &RunRecord, run_dir: &Path) -> String {
    let mut line = format!("mhsplat train {}", quoted(&record.dataset.path));
    let (tables, flags): (Vec<_>, Vec<_>) = changed(&record.config)
        .into_iter()
        .partition(|(name, _)| name.contains('.'));
    let repeats = !record.config.lengths.is_empty();
    if repeats || !tables.is_empty() {
        let config = run_dir.join(RECORD_FILE).display().to_string();
        let _ = write!(line, " --config {}", quoted(&config));
    }
    for (name, value) in flags {
        // Typed, they would win over the lengths that the record repeats.
        if repeats && ["iterations", "time-budget", "budget-cpu", "lengths"].contains(&&*name) {
            continue;
        }
        let _ = match value.as_str() {
            "true" => write!(line, " --{name}"),
            _ => write!(line, " --{name} {}", quoted(&value)),
        };
    }
    if !record.device.name.is_empty() {
        let _ = write!(line, " --device {}", quoted(&record.device.name));
    }
    line
}

/// `text` as one word of a POSIX shell.
fn quoted(text: &str) -> String {
    let safe = |c: char| c.is_ascii_alphanumeric() || "-_./,:=+@%".contains(c);
    if !text.is_empty() && text.chars().all(safe) {
        return text.to_owned();
    }
    format!("'{}'", text.replace('\'', r"'\''"))
}
