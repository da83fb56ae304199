//! Numbers, durations and text as pages and charts show them.

use std::path::{Component, Path};

/// `text` with the special characters of HTML text and quoted attributes replaced.
#[must_use]
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            // Other control characters are not allowed in HTML, whichever way they are spelt.
            c if c.is_control() && c != '\n' && c != '\t' => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

/// A relative path as the target of a link: slashes, and every byte that an address may not have as it is as `%XX`.
#[must_use]
pub fn href(path: &Path) -> String {
    let plain = |b: u8| b.is_ascii_alphanumeric() || b"-._~".contains(&b);
    let part = |part: Component<'_>| -> String {
        let bytes = part.as_os_str().to_string_lossy().into_owned().into_bytes();
        let spelt = bytes.into_iter().map(|b| match plain(b) {
            true => char::from(b).to_string(),
            false => format!("%{b:02X}"),
        });
        spelt.collect()
    };
    let parts: Vec<String> = path.components().map(part).collect();
    parts.join("/")
}

/// `value` in groups of three digits, set apart by narrow no-break spaces.
#[must_use]
pub fn grouped(value: u64) -> String {
    let digits = value.to_string();
    let mut out = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            out.push('\u{202f}');
        }
        out.push(digit);
    }
    out
}

/// Seconds as `12.3 s`, `4 min 05 s` or `1 h 07 min`; a dash if they are not finite or negative.
#[must_use]
pub fn span(seconds: f64) -> String {
    if !(seconds.is_finite() && seconds >= 0.0) {
        return "–".to_owned();
    }
    // Judged as it will be shown, so that 119.96 is not "120.0 s" and 7199.7 not "120 min 00 s".
    let whole = seconds.round() as u64;
    match whole {
        0..=9 => format!("{seconds:.2} s"),
        10..=119 => format!("{seconds:.1} s"),
        120..=7199 => format!("{} min {:02} s", whole / 60, whole % 60),
        _ => format!("{} h {:02} min", whole / 3600, whole % 3600 / 60),
    }
}

/// An estimated time, to two digits or so: 40 s, 14 min, 1 h 50 min.
#[must_use]
pub fn about(seconds: f64) -> String {
    if !(seconds.is_finite() && seconds >= 0.0) {
        return "–".to_owned();
    }
    let to = |step: f64| ((seconds / step).round() * step) as u64;
    match seconds {
        s if s < 19.5 => format!("{} s", to(1.0)),
        s if s < 87.5 => format!("{} s", to(5.0)),
        s if s < 570.0 && !to(30.0).is_multiple_of(60) => format!("{}.5 min", to(30.0) / 60),
        s if s < 3570.0 => format!("{} min", to(60.0) / 60),
        _ => {
            let minutes = to(300.0) / 60;
            format!("{} h {:02} min", minutes / 60, minutes % 60)
        }
    }
}

/// A number with `decimals` places, a dash if it is not finite.
#[must_use]
pub fn fixed(value: f64, decimals: usize) -> String {
    if value.is_finite() {
        format!("{value:.decimals$}").replace('-', "−")
    } else {
        "–".to_owned()
    }
}
