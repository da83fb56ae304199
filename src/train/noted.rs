//! Findings of a density step about each Gaussian, for somebody who looks on.

use crate::density::Outcome;

/// Findings of the last density step, by the rows that it left.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Noted {
    /// Rows of the births, rising.
    pub births: Vec<u32>,
    /// Importance I of each row \[N\], births having that of their source or pixel; empty if the strategy has none.
    pub importance: Vec<f64>,
}

impl Noted {
    /// The findings of a step on `before` Gaussians once it has been applied: rows from `before` on are new, and `order` has the rows that
    /// stay, in their new order; `None` if all stay where they are.
    #[must_use]
    pub fn new(outcome: &Outcome, before: usize, order: Option<&[u32]>) -> Self {
        let new = before as u32..outcome.rows as u32;
        let Some(order) = order else {
            return Self {
                births: new.collect(),
                importance: outcome.importance.clone(),
            };
        };
        let places = (0u32..).zip(order);
        let born = places.filter(|(_, row)| new.contains(row));
        let of = |row: &u32| outcome.importance.get(*row as usize).copied();
        Self {
            births: born.map(|(place, _)| place).collect(),
            importance: order.iter().filter_map(of).collect(),
        }
    }
}
