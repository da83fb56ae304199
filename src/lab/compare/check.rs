//! Refusal of runs that are not comparable.

use crate::base::error::{Error, Result};
use crate::lab::compare::load::Loaded;
use crate::lab::table::folder_name;
use crate::train::schedule::Schedule;

/// Name of the flag that lets incomparable runs pass.
pub const ALLOW: &str = "--allow-different";

/// Names of the held-out views of the last evaluation.
fn held_out(run: &Loaded) -> Option<Vec<&str>> {
    let scores = run.record.final_scores.as_ref()?;
    Some(scores.per_view.iter().map(|v| v.view.as_str()).collect())
}

/// The reason why two runs are not comparable; `None` if they are.
fn difference(a: &Loaded, b: &Loaded) -> Option<String> {
    let (x, y) = (&a.record.dataset, &b.record.dataset);
    if (x.width, x.height) != (y.width, y.height) {
        let [from, to] = [x, y].map(|d| format!("{} × {}", d.width, d.height));
        return Some(format!("another resolution, {to} instead of {from} pixels"));
    }
    if (x.train_views, x.test_views) != (y.train_views, y.test_views) {
        let [from, to] = [x, y].map(|d| format!("{} + {}", d.train_views, d.test_views));
        return Some(format!(
            "another split, {to} instead of {from} training and held-out views"
        ));
    }
    if let (Some(p), Some(q)) = (held_out(a), held_out(b))
        && p != q
    {
        return Some("other held-out views".into());
    }
    match (&x.fingerprint, &y.fingerprint) {
        (Some(p), Some(q)) if p == q => None,
        (Some(_), Some(_)) => Some(format!(
            "another dataset, {} instead of {}: views, cameras, lenses, sizes or masks differ, or one run is of an earlier version",
            y.path, x.path
        )),
        // Records of earlier versions have no fingerprint. Folders move, their names rarely change.
        _ if x.layout == y.layout && folder_name(&x.path) == folder_name(&y.path) => None,
        _ => Some(format!("another dataset, {} instead of {}", y.path, x.path)),
    }
}

/// A caveat of two runs that are comparable.
fn remark(a: &Loaded, b: &Loaded) -> Option<String> {
    let (x, y) = (&a.record, &b.record);
    let [p, q] = [x, y].map(|r| Schedule::new(&r.config).fixed_background());
    if p != q {
        return Some(
            "scored over another background, which counts where photos are transparent".into(),
        );
    }
    let [p, q] = [x, y].map(|r| folder_name(&r.dataset.path));
    let other = x.dataset.fingerprint.is_some() && p != q;
    other.then(|| {
        format!("its dataset is named {q} instead of {p}, with the same views and cameras")
    })
}

/// Refuses runs of another dataset, resolution, split or other held-out views than the first one's, or warns of them if
/// `allow` is set.
///
/// # Errors
/// The first such run.
pub fn check(runs: &[Loaded], allow: bool, warnings: &mut Vec<String>) -> Result<()> {
    let Some((first, others)) = runs.split_first() else {
        return Ok(());
    };
    for run in others {
        let path = &run.source.path;
        let against = first.source.path.display();
        if let Some(what) = difference(first, run) {
            if !allow {
                return Err(Error::input(
                    path,
                    format!("{what} (of {against}): not comparable"),
                    format!("leave it out, or give {ALLOW}"),
                ));
            }
            warnings.push(format!(
                "not comparable: {} has {what} (of {against})",
                path.display()
            ));
        } else if let Some(what) = remark(first, run) {
            warnings.push(format!("{}: {what} (of {against})", path.display()));
        }
    }
    Ok(())
}
