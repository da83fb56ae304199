//! The last part of the page: the command, the device and every option.

use super::html::{escape, grouped, span};
use super::record::{RECORD_FILE, RunRecord};
use crate::config::{Background, Init, TrainConfig};
use serde_json::Value;
use std::fmt::Write;
use std::path::Path;

/// Command, dataset, device and configuration.
pub(super) fn section(out: &mut String, record: &RunRecord, run_dir: &Path) {
    let _ = write!(
        out,
        "<h2>How to repeat it</h2><pre>{}</pre>\n<h2>Dataset, device and cost</h2><table>",
        escape(&command(record, run_dir))
    );
    let (dataset, device) = (&record.dataset, &record.device);
    let memory = match record.peak_rss_bytes {
        0 => "not measured".to_owned(),
        bytes => format!("{:.0} MiB", bytes as f64 / (1024.0 * 1024.0)),
    };
    let density = &record.density;
    let facts = [
        ("dataset", dataset.path.clone()),
        ("layout", dataset.layout.clone()),
        ("device", device.name.clone()),
        ("vendor", device.vendor.clone()),
        ("platform", device.platform.clone()),
        ("driver", device.driver.clone()),
        ("version", format!("{} ({})", record.version, record.commit)),
        ("whole run", span(record.wall_seconds)),
        ("peak memory", memory),
        (
            "births",
            format!(
                "{} of {} proposed",
                grouped(density.accepted),
                grouped(density.proposed)
            ),
        ),
        (
            "relocated, removed",
            format!(
                "{}, {}",
                grouped(density.relocated),
                grouped(density.pruned)
            ),
        ),
    ];
    for (name, value) in facts {
        let _ = write!(out, "<tr><th>{name}</th><td>{}</td></tr>", escape(&value));
    }
    out.push_str("</table>\n<h2>Options</h2><p class=note>Bold where not the default.</p><table>");
    let defaults = flatten(&TrainConfig::default());
    for (name, value) in flatten(&record.config) {
        let default = defaults.iter().any(|d| d.0 == name && d.1 == value);
        let class = if default { "dim" } else { "set" };
        let (name, value) = (escape(&name), escape(&value));
        let _ = write!(
            out,
            "<tr class={class}><th>{name}</th><td>{value}</td></tr>"
        );
    }
    out.push_str("</table>\n");
}

/// Every option with its dotted name, in the order of the configuration file.
fn flatten(config: &TrainConfig) -> Vec<(String, String)> {
    // By way of text, which spells an f32 as it was typed (0.2), where serde_json's own values widen it.
    let value = serde_json::to_string(config)
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
/// where an option has no flag.
fn command(record: &RunRecord, run_dir: &Path) -> String {
    let (c, d) = (&record.config, TrainConfig::default());
    let mut line = format!("mhsplat train {}", quoted(&record.dataset.path));
    let mut flag = |set: bool, name: &str, value: String| {
        if set {
            let _ = write!(line, " --{name} {}", quoted(&value));
        }
    };
    let flagless = c.loss != d.loss || c.optimizer != d.optimizer || c.mh != d.mh;
    flag(
        flagless,
        "config",
        run_dir.join(RECORD_FILE).display().to_string(),
    );
    flag(c.sampler != d.sampler, "sampler", plain(&c.sampler));
    flag(
        c.iterations != d.iterations,
        "iterations",
        c.iterations.to_string(),
    );
    if let Some(seconds) = c.time_budget {
        flag(true, "time-budget", format!("{seconds}s"));
    }
    flag(c.max_size != d.max_size, "max-size", c.max_size.to_string());
    if let Some(most) = c.max_gaussians {
        flag(true, "max-gaussians", most.to_string());
    }
    flag(
        c.sh_degree != d.sh_degree,
        "sh-degree",
        c.sh_degree.to_string(),
    );
    flag(c.seed != d.seed, "seed", c.seed.to_string());
    flag(
        c.eval_every != d.eval_every,
        "eval-every",
        c.eval_every.to_string(),
    );
    flag(
        c.test_every != d.test_every,
        "test-every",
        c.test_every.to_string(),
    );
    flag(
        c.export_every != d.export_every,
        "export-every",
        c.export_every.to_string(),
    );
    let every = c.checkpoint_every;
    flag(
        every != d.checkpoint_every,
        "checkpoint-every",
        every.to_string(),
    );
    let init = match &c.init {
        Init::File(path) => path.display().to_string(),
        other => plain(other),
    };
    flag(c.init != d.init, "init", init);
    let background = match c.background {
        Background::Color([r, g, b]) => format!("{r},{g},{b}"),
        other => plain(&other),
    };
    flag(c.background != d.background, "background", background);
    flag(
        !record.device.name.is_empty(),
        "device",
        record.device.name.clone(),
    );
    line
}

/// The name of a unit variant, as typed.
fn plain(value: &impl serde::Serialize) -> String {
    match serde_json::to_value(value) {
        Ok(Value::String(text)) => text,
        Ok(other) => other.to_string(),
        Err(_) => String::new(),
    }
}

/// `text` as one word of a POSIX shell.
fn quoted(text: &str) -> String {
    let safe = |c: char| c.is_ascii_alphanumeric() || "-_./,:=+@%".contains(c);
    if !text.is_empty() && text.chars().all(safe) {
        return text.to_owned();
    }
    format!("'{}'", text.replace('\'', r"'\''"))
}
