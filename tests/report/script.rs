//! The page's script in headless Chromium, where there is one.

use std::path::Path;

use super::samples::*;
use crate::viewer::browser::{browser, open};
use mhsplat::run::write_report;

/// Uses charts and pictures as a reader does, and writes into the page's title what it finds.
const USE: &str = r#"<script>
const said = [], figure = document.querySelector('svg[data-axes]').closest('figure');
const charts = [...document.querySelectorAll('svg[data-axes]')], svg = charts[0], value = () => figure.querySelector('b').textContent;
svg.setPointerCapture = () => {};
const box = svg.getBoundingClientRect();
const send = (type, share, more) => svg.dispatchEvent(new PointerEvent(type,
  {clientX: box.left + share * box.width, clientY: box.top + 0.5 * box.height, bubbles: true, pointerType: 'mouse', ...more}));
const ticks = () => [...svg.querySelectorAll('text')].filter(t => t.style.display !== 'none').length;
const first = value();
send('pointermove', 0.14, {buttons: 0});
said.push(value() !== first, charts.filter(c => c.querySelector('.cursor line')).length > 1);
send('pointerleave', 0.14, {});
said.push(value() === first);
send('pointerdown', 0.5, {button: 2, buttons: 2});
send('pointermove', 0.7, {buttons: 0});
said.push(svg.querySelector('.select').getAttribute('width') === '0');
const before = svg.querySelector('polyline').getAttribute('points');
send('pointerdown', 0.4, {button: 0, buttons: 1});
send('pointermove', 0.8, {buttons: 1});
send('pointerup', 0.8, {button: 0, buttons: 0});
said.push(svg.querySelector('polyline').getAttribute('points') !== before, ticks() > 4);
for (let k = 0; k < 12; k++) {
  send('pointerdown', 0.45, {button: 0, buttons: 1});
  send('pointermove', 0.5, {buttons: 1});
  send('pointerup', 0.5, {button: 0, buttons: 0});
}
said.push(ticks() < 40);
send('dblclick', 0.5, {});
said.push(svg.querySelector('polyline').getAttribute('points') === before);
document.querySelector('.view img[alt="error"]').click();
const dialog = document.querySelector('dialog');
said.push(dialog.open, dialog.classList.contains('wrong'));
const name = () => dialog.querySelector('p').textContent, shown = name();
dialog.dispatchEvent(new KeyboardEvent('keydown', {key: 'ArrowRight', bubbles: true}));
said.push(name() !== shown, dialog.querySelectorAll('img').length === 3);
dialog.querySelector('button:last-child').click();
said.push(!dialog.open);
document.title = 'said ' + said.map(Number).join('');
</script>"#;

/// Findings of [`USE`] in a report after a change of its text.
fn used(browser: &Path, change: impl FnOnce(String) -> String) -> String {
    let dir = tempfile::tempdir().unwrap();
    let (rows, density) = (rows(), density());
    let views = [view("a.jpg", 0.0), view("b.jpg", 1.0)];
    write_report(dir.path(), &record(), &rows, &density, &views, &[]).unwrap();
    let file = dir.path().join("report.html");
    let page = std::fs::read_to_string(&file).unwrap();
    // The page's own policy lets no other script run.
    let (before, policy) = page.split_once("<meta http-equiv").unwrap();
    let (_, after) = policy.split_once("/>").unwrap();
    let page = [before, after]
        .concat()
        .replace("</body>", &[USE, "</body>"].concat());
    std::fs::write(&file, change(page)).unwrap();
    let text = open(browser, dir.path(), "report.html", "", &["--dump-dom"]);
    let (_, title) = text.split_once("<title>").unwrap();
    title.split_once("</title>").unwrap().0.to_owned()
}

#[test]
fn the_browser_shows_values_zooms_and_enlarges() {
    let Some(browser) = browser() else {
        return;
    };
    assert_eq!(used(&browser, |page| page), "said 1111111111111");
    // Faults that must be noticed.
    for (right, wrong) in [
        ("range[1] - range[0] > 1e-6", "range[1] - range[0] > 1e9"),
        ("open(now + 1)", "open(now)"),
        ("zoom(this, null)", "zoom(this, [0, 1])"),
        ("point(this, null)", "point(this, 1)"),
    ] {
        let broken = |page: String| {
            assert!(page.contains(right), "{right}");
            page.replace(right, wrong)
        };
        let found = used(&browser, broken);
        assert_ne!(found, "said 1111111111111", "{right}");
    }
}
