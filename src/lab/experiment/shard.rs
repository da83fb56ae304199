//! [`Shard`]: the part of an experiment that one of several jobs trains.

use std::str::FromStr;

/// One of so many parts, which have no run in common and all of them together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    /// Place of the part, from 0.
    place: usize,
    /// Number of parts.
    of: usize,
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || "I/N expected, the part I from 1 to N of N, as 2/8".to_owned();
        let (part, of) = text.split_once('/').ok_or_else(wrong)?;
        let number = |text: &str| text.parse::<usize>().map_err(|_| wrong());
        let (part, of) = (number(part)?, number(of)?);
        match (1..=of).contains(&part) {
            true => Ok(Self {
                place: part - 1,
                of,
            }),
            false => Err(wrong()),
        }
    }
}

impl Shard {
    /// Every so many of the runs, in their blocks; every so many blocks if the runs of one are to stay `together`.
    pub(super) fn take<T>(self, blocks: Vec<Vec<T>>, together: bool) -> Vec<Vec<T>> {
        let mut runs = 0;
        let mut kept = Vec::new();
        for (place, mut block) in blocks.into_iter().enumerate() {
            block.retain(|_| {
                runs += 1;
                let at = if together { place } else { runs - 1 };
                at % self.of == self.place
            });
            if !block.is_empty() {
                kept.push(block);
            }
        }
        kept
    }
}

#[cfg(test)]
mod tests {
    use super::Shard;

    #[test]
    fn parts_are_disjoint_and_complete() {
        let blocks: Vec<Vec<usize>> = (0..7).map(|b| (3 * b..3 * b + 3).collect()).collect();
        for together in [false, true] {
            for of in 1..30 {
                let part = |i| format!("{i}/{of}").parse::<Shard>().unwrap();
                let parts: Vec<_> = (1..=of)
                    .map(|i| part(i).take(blocks.clone(), together).concat())
                    .collect();
                let mut all = parts.concat();
                all.sort_unstable();
                assert_eq!(all, blocks.concat(), "{of}");
                let whole = |p: &Vec<usize>| p.chunks(3).all(|c| c.len() == 3 && c[0] % 3 == 0);
                assert!(!together || parts.iter().all(whole), "{parts:?}");
                let sizes = parts.iter().map(Vec::len);
                let step = if together { 3 } else { 1 };
                let spread = sizes.clone().max().unwrap() - sizes.min().unwrap();
                assert!(spread <= step, "{parts:?}");
            }
        }
    }

    #[test]
    fn what_is_no_part_is_refused() {
        for wrong in [
            "0/3", "4/3", "x", "", "/", "1", "1/0", "-1/3", "1/3/3", "1.5/3", "a/b",
        ] {
            let said = wrong.parse::<Shard>().unwrap_err();
            assert!(said.contains("I/N"), "{wrong}: {said}");
        }
    }
}
