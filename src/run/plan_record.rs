//! [`PlanRecord`]: the plan as `run.json`, the report and the terminal show it.

use serde::{Deserialize, Serialize};

use crate::train::Plan;

/// A part of the work with the reason why it is kept or left out.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Item {
    /// Name of the part.
    pub what: String,
    /// Reason.
    pub why: String,
}

/// A plan in words.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct PlanRecord {
    /// Parts that are computed.
    pub kept: Vec<Item>,
    /// Parts that are not, and cost nothing.
    pub left_out: Vec<Item>,
}

impl PlanRecord {
    /// The words for a plan.
    #[must_use]
    pub fn of(plan: &Plan) -> Self {
        let mut record = Self::default();
        for part in plan.parts() {
            let list = match part.kept {
                true => &mut record.kept,
                false => &mut record.left_out,
            };
            list.push(Item {
                what: part.name.to_owned(),
                why: part.why.clone(),
            });
        }
        record
    }

    /// One line on everything that is new since an earlier record; `None` if nothing is.
    #[must_use]
    pub fn since(&self, earlier: &Self) -> Option<String> {
        let new = |items: &[Item], old: &[Item]| -> Vec<String> {
            let fresh = items.iter().filter(|i| !old.contains(i));
            fresh.map(|i| format!("{}: {}", i.what, i.why)).collect()
        };
        let kept = new(&self.kept, &earlier.kept);
        let out = new(&self.left_out, &earlier.left_out);
        let line = |label: &str, items: &[String]| {
            let some = !items.is_empty();
            some.then(|| format!("{label}: {}", items.join("; ")))
        };
        let lines = [line("kept", &kept), line("left out", &out)];
        let lines = lines.into_iter().flatten().collect::<Vec<_>>();
        (!lines.is_empty()).then(|| format!("found in training: {}", lines.join("; ")))
    }

    /// One line for the terminal.
    #[must_use]
    pub fn summary(&self) -> String {
        let kept: Vec<&str> = self.kept.iter().map(|i| i.what.as_str()).collect();
        let out = self.left_out.iter();
        let out: Vec<String> = out
            .map(|i| format!("{}, because {}", i.what, i.why))
            .collect();
        if out.is_empty() {
            format!("plan: {}", kept.join(", "))
        } else {
            format!("plan: {}; left out: {}", kept.join(", "), out.join("; "))
        }
    }
}
