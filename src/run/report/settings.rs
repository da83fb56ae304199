//! The last part of the page: the command, the device and every option.

use std::fmt::Write;
use std::path::Path;

use serde_json::Value;

use crate::chart::text::{escape, grouped, span};
use crate::config::{Background, Init, Sampler, TrainConfig};
use crate::run::record::{RECORD_FILE, RunRecord};

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
        ("density control", density_control(record)),
    ];
    for (name, value) in facts {
        let _ = write!(out, "<tr><th>{name}</th><td>{}</td></tr>", escape(&value));
    }
    out.push_str("</table>\n");
    options(out, &record.config);
}

/// Sums of density control over the run, in the sampler's terms.
fn density_control(record: &RunRecord) -> String {
    let d = &record.density;
    let [born, proposed] = [d.accepted, d.proposed].map(grouped);
    let [relocated, removed] = [d.relocated, d.pruned].map(grouped);
    let [cloned, split] = [d.cloned, d.split].map(grouped);
    match record.config.sampler {
        Sampler::Mh => format!("{born} of {proposed} proposed births, {relocated} relocated"),
        Sampler::Mcmc => format!("{born} born, {relocated} relocated"),
        Sampler::Adc => format!(
            "{cloned} cloned, {split} split, {removed} removed, {} opacity resets",
            grouped(d.opacity_resets)
        ),
        Sampler::None => "none: a fixed set".to_owned(),
    }
}

/// The options that were set, and the list of all.
fn options(out: &mut String, config: &TrainConfig) {
    let table = |out: &mut String, options: &[(String, String)]| {
        out.push_str("<table>");
        for (name, value) in options {
            let (name, value) = (escape(name), escape(value));
            let _ = write!(out, "<tr><th>{name}</th><td>{value}</td></tr>");
        }
        out.push_str("</table>");
    };
    let (all, defaults) = (flatten(config), flatten(&TrainConfig::default()));
    let set: Vec<_> = all
        .iter()
        .filter(|o| !defaults.contains(o))
        .cloned()
        .collect();
    out.push_str("<h2>Options that differ from the defaults</h2>");
    if set.is_empty() {
        out.push_str("<p class=note>None.</p>");
    } else {
        table(out, &set);
    }
    let _ = write!(out, "<details><summary>All {} options</summary>", all.len());
    table(out, &all);
    out.push_str("</details>\n");
}

/// Every option with its dotted name, sorted by name.
pub(crate) fn flatten(config: &TrainConfig) -> Vec<(String, String)> {
    // By way of text, which spells an f32 as it was typed (0.2); serde_json's own values widen it.
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
    let mut flag = |name: &str, value: String| {
        let _ = write!(line, " --{name} {}", quoted(&value));
    };
    let samplers = c.mh == d.mh && c.mcmc == d.mcmc && c.adc == d.adc;
    if !samplers || c.loss != d.loss || c.optimizer != d.optimizer || c.work != d.work {
        flag("config", run_dir.join(RECORD_FILE).display().to_string());
    }
    if c.anti_aliasing != d.anti_aliasing {
        flag("anti-aliasing", plain(&c.anti_aliasing));
    }
    if c.exposure != d.exposure {
        flag("exposure", plain(&c.exposure));
    }
    if c.sampler != d.sampler {
        flag("sampler", plain(&c.sampler));
    }
    for ((name, value), (_, default)) in numbers(c).into_iter().zip(numbers(&d)) {
        if value != default {
            flag(name, value.to_string());
        }
    }
    if let Some(seconds) = c.time_budget {
        flag("time-budget", format!("{seconds}s"));
    }
    if let Some(bytes) = c.image_budget {
        flag("image-budget", bytes.to_string());
    }
    if let Some(most) = c.max_gaussians {
        flag("max-gaussians", most.to_string());
    }
    match &c.init {
        init if *init == d.init => {}
        Init::File(path) => flag("init", path.display().to_string()),
        init => flag("init", plain(init)),
    }
    match c.background {
        background if background == d.background => {}
        Background::Color([r, g, b]) => flag("background", format!("{r},{g},{b}")),
        background => flag("background", plain(&background)),
    }
    if c.alpha_is_mask {
        line.push_str(" --alpha-is-mask");
    }
    let mut flag = |name: &str, value: String| {
        let _ = write!(line, " --{name} {}", quoted(&value));
    };
    if !record.device.name.is_empty() {
        flag("device", record.device.name.clone());
    }
    line
}

/// The flags that take a whole number.
fn numbers(config: &TrainConfig) -> [(&'static str, u64); 9] {
    [
        ("iterations", config.iterations.into()),
        ("max-size", config.max_size.into()),
        ("sh-degree", config.sh_degree.into()),
        ("seed", config.seed),
        // None is the default, which is never printed.
        ("eval-every", config.eval_every.map_or(u64::MAX, u64::from)),
        ("patience", config.patience.map_or(u64::MAX, u64::from)),
        ("test-every", config.test_every.into()),
        ("export-every", config.export_every.into()),
        ("checkpoint-every", config.checkpoint_every.into()),
    ]
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
