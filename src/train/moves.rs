//! A density step on rows that ranks share: all of them decide alike, each edits its own rows, and rows that lie elsewhere in the new order
//! go to their new ranks.

use crate::base::error::{Error, Result};
use crate::base::hash::Fnv;
use crate::density::Outcome;
use crate::device::{Array, Device, Program};
use crate::pipeline::buffers::Shard;
use crate::pipeline::share::Share;
use crate::pipeline::stage::morton::{Order, kept};
use crate::ranks::Part;
use crate::scene::{Edit, Plane};
use crate::train::decision::words_of;
use crate::train::gaussians::{Carried, GaussianState};

/// Rank of a row, and its number there.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Place {
    rank: usize,
    row: usize,
}

/// Places of all rows, and the number of rows at each rank, those without a place included.
#[derive(Debug)]
struct Places {
    of: Vec<Place>,
    counts: Vec<usize>,
}

/// Rows of one rank on their way to a new order.
#[derive(Debug, PartialEq)]
struct Moves {
    /// Its rows that go to each rank.
    sent: Vec<Vec<u32>>,
    /// Number of rows that come from each rank.
    received: Vec<usize>,
    /// Its rows in the new order; those received stand behind its own, one rank's after the other's.
    order: Vec<u32>,
}

fn wrong(what: impl Into<String>) -> Error {
    Error::numerics("density control", what.into())
}

impl Places {
    /// Rows of ranks that have so many each, one after the other.
    fn new(counts: Vec<usize>) -> Self {
        let each = counts.iter().enumerate();
        let of = each.flat_map(|(rank, n)| (0..*n).map(move |row| Place { rank, row }));
        Self {
            of: of.collect(),
            counts,
        }
    }

    /// Follows edits that leave `rows` rows, each made by the rank of its source; returns those of one rank, by its own rows.
    fn edit(&mut self, edits: &[Edit], rows: usize, rank: usize) -> Result<Vec<Edit>> {
        let mut own = Vec::new();
        let before = self.of.len();
        let none = Place {
            rank: usize::MAX,
            row: 0,
        };
        self.of.resize(rows, none);
        for edit in edits {
            let source = self.of[..before].get(edit.src as usize).copied();
            let (Some(source), Some(place)) = (source, self.of.get_mut(edit.dst as usize)) else {
                return Err(wrong("an edit of a row that does not exist"));
            };
            if place.rank != source.rank {
                let count = &mut self.counts[source.rank];
                *place = Place {
                    rank: source.rank,
                    row: *count,
                };
                *count += 1;
            }
            if source.rank == rank {
                own.push(Edit {
                    src: source.row as u32,
                    dst: place.row as u32,
                    ..*edit
                });
            }
        }
        match self.of.iter().any(|place| place.rank == usize::MAX) {
            true => Err(wrong("a new row that no edit writes")),
            false => Ok(own),
        }
    }

    /// A plane of all rows, from the `plane`-th of each rank's.
    fn plane(&self, of_ranks: &[Vec<u32>], plane: usize) -> Result<Vec<f32>> {
        let value = |place: &Place| {
            let at = plane * self.counts[place.rank] + place.row;
            let bits = of_ranks[place.rank].get(at).copied();
            bits.map(f32::from_bits)
                .ok_or_else(|| wrong("a rank that has told too few positions"))
        };
        self.of.iter().map(value).collect()
    }

    /// Ways of the rows of one rank to an order of which each rank takes the part from its number in `division` on.
    fn moves(&self, order: &[u32], division: &[usize], rank: usize) -> Moves {
        let ranks = self.counts.len();
        let mut moves = Moves {
            sent: vec![Vec::new(); ranks],
            received: vec![0; ranks],
            order: Vec::new(),
        };
        let place = |row: &u32| self.of[*row as usize];
        let own = &order[division[rank]..division[rank + 1]];
        for from in own.iter().map(place).filter(|from| from.rank != rank) {
            moves.received[from.rank] += 1;
        }
        let mut next = vec![self.counts[rank]; ranks];
        for from in 1..ranks {
            next[from] = next[from - 1] + moves.received[from - 1];
        }
        moves.order.extend(own.iter().map(|row| {
            let from = place(row);
            if from.rank == rank {
                return from.row as u32;
            }
            next[from.rank] += 1;
            next[from.rank] as u32 - 1
        }));
        for (to, bounds) in division
            .windows(2)
            .enumerate()
            .filter(|(to, _)| *to != rank)
        {
            let rows = order[bounds[0]..bounds[1]].iter().map(place);
            let own = rows.filter(|from| from.rank == rank);
            moves.sent[to].extend(own.map(|from| from.row as u32));
        }
        moves
    }
}

impl Places {
    /// Has each rank take its part of the rows in an order.
    fn arrange(
        &self,
        share: &Share<f32>,
        (device, gaussians, stage): (&Device, &mut GaussianState, &Program),
        (order, division): (&[u32], &[usize]),
        carried: Carried,
    ) -> Result<()> {
        if division.last() != Some(&order.len()) {
            return Err(wrong("a division of another number of rows"));
        }
        let rank = share.rank();
        let moves = self.moves(order, division, rank);
        let sent = moves.sent.concat();
        let words = gaussians.pick_words(device, stage, &sent, carried)?;
        let got = share.trade(Part::Rows, by_rank(&words, &moves.sent))?;
        let mut first = self.counts[rank];
        gaussians.grow(device, first + moves.received.iter().sum::<usize>())?;
        for (message, rows) in got.iter().zip(&moves.received) {
            gaussians.write_words(first..first + rows, message, carried)?;
            first += rows;
        }
        let sorted = match moves.order.is_empty() {
            // A kernel takes no empty array.
            true => vec![0],
            false => moves.order,
        };
        let sorted = Array::from_slice(device, "row order", &sorted)?;
        let [start, end] = [division[rank], division[rank + 1]];
        gaussians.reorder(device, stage, (&sorted, end - start), carried)?;
        gaussians.shrink_far(device)?;
        gaussians.scene.shard = Some(Shard {
            first: start,
            all: order.len(),
        });
        Ok(())
    }
}

/// Numbers of rows of all ranks, once it is sure that they have decided alike.
fn agree(share: &Share<f32>, outcome: &Outcome, own: usize) -> Result<Vec<usize>> {
    let mut sum = Fnv::default();
    for word in words_of(outcome) {
        sum.word(word.into());
    }
    let told = vec![own as u32, sum.0 as u32, (sum.0 >> 32) as u32];
    let got = share.tell_all(Part::Evidence, told.clone())?;
    if let Some(rank) = got.iter().position(|other| other[1..] != told[1..]) {
        return Err(wrong(format!(
            "rank {rank} has decided a density step otherwise than rank {}: take devices of one kind with one driver, and go on from the last checkpoint",
            share.rank()
        )));
    }
    Ok(got.iter().map(|told| told[0] as usize).collect())
}

/// Applies an outcome that all ranks have decided on, and has each take its part of the rows in an order: that from its number in
/// `division` on. Returns the order. `stage` is a build of `kernels/edit.cl`.
///
/// # Errors
/// Ranks that have decided differently, another rank's failure, no room, or the driver's.
pub(super) fn apply(
    share: &Share<f32>,
    (device, gaussians, stage): (&Device, &mut GaussianState, &Program),
    outcome: &Outcome,
    (order, division): (Order, &[usize]),
) -> Result<Vec<u32>> {
    let rank = share.rank();
    let mut places = Places::new(agree(share, outcome, gaussians.scene.count)?);
    let edits = places.edit(&outcome.edits, outcome.rows, rank)?;
    let own = places.counts[rank];
    gaussians.edit(device, stage, &edits, own, outcome.logit_limit)?;

    let mut told = Vec::new();
    for axis in 0..3 {
        let at = (Plane::POSITION + axis) * gaussians.scene.stride;
        gaussians.scene.params.append_words(at, own, &mut told)?;
    }
    let got = share.tell_all(Part::Evidence, told)?;
    let [x, y, z] = [0, 1, 2].map(|axis| places.plane(&got, axis));
    let order = kept([&x?, &y?, &z?], &outcome.removed, order);

    let carried = Carried::Optimized;
    places.arrange(
        share,
        (device, gaussians, stage),
        (&order, division),
        carried,
    )?;
    Ok(order)
}

/// Has ranks that have `counts` rows each, one rank's after the other's, take their parts of some of them, with everything that belongs
/// to these; see [`apply`].
///
/// # Errors
/// Another rank's failure, no room, or the driver's.
pub(super) fn keep(
    share: &Share<f32>,
    on: (&Device, &mut GaussianState, &Program),
    counts: Vec<usize>,
    kept: (&[u32], &[usize]),
) -> Result<()> {
    Places::new(counts).arrange(share, on, kept, Carried::All)
}

/// Messages for the ranks from planes of rows for all of them, one rank's after the other's.
fn by_rank(words: &[u32], rows: &[Vec<u32>]) -> Vec<Vec<u32>> {
    let all: usize = rows.iter().map(Vec::len).sum();
    let mut messages = vec![Vec::new(); rows.len()];
    for plane in words.chunks_exact(all.max(1)) {
        let mut rest = plane;
        for (message, rows) in messages.iter_mut().zip(rows) {
            let (part, others) = rest.split_at(rows.len());
            message.extend_from_slice(part);
            rest = others;
        }
    }
    messages
}

#[cfg(test)]
mod tests {
    use super::{Places, by_rank};
    use crate::scene::Edit;

    fn edit([src, dst]: [u32; 2]) -> Edit {
        Edit {
            src,
            dst,
            ..Edit::default()
        }
    }

    /// Rows that are told apart by their values go where the same edits and the same order have them at one rank.
    #[test]
    fn rows_come_to_the_places_that_one_rank_gives_them() {
        let counts = vec![3, 0, 4];
        let (ranks, all) = (counts.len(), 7);
        // A row in place, one that another rank writes anew, two births.
        let edits = [[1, 1], [4, 0], [6, 7], [2, 8]].map(edit);
        let mut alone: Vec<u32> = (0..all).collect();
        alone.extend([6, 2]);
        alone[0] = 4;
        let order = [8, 0, 3, 7, 6, 1, 5];
        let want: Vec<u32> = order.iter().map(|row| alone[*row as usize]).collect();
        let division = [0, 4, 6, 7];
        let mut held: Vec<Vec<u32>> = vec![vec![0, 1, 2], vec![], vec![3, 4, 5, 6]];
        let mut all_moves = Vec::new();
        for (rank, rows) in held.iter_mut().enumerate() {
            let mut places = Places::new(counts.clone());
            for own in places.edit(&edits, 9, rank).unwrap() {
                let value = rows[own.src as usize];
                rows.resize(rows.len().max(own.dst as usize + 1), 0);
                rows[own.dst as usize] = value;
            }
            assert_eq!(rows.len(), places.counts[rank]);
            all_moves.push(places.moves(&order, &division, rank));
        }
        let mut got = Vec::new();
        for (rank, moves) in all_moves.iter().enumerate() {
            let mut rows = held[rank].clone();
            for from in 0..ranks {
                let sent = &all_moves[from].sent[rank];
                assert_eq!(sent.len(), moves.received[from], "{from} to {rank}");
                rows.extend(sent.iter().map(|row| held[from][*row as usize]));
            }
            assert_eq!(moves.order.len(), division[rank + 1] - division[rank]);
            got.extend(moves.order.iter().map(|row| rows[*row as usize]));
        }
        assert_eq!(got, want);
    }

    #[test]
    fn edits_that_do_not_fit_are_refused() {
        let edited = |edits: &[[u32; 2]], rows| {
            let edits: Vec<Edit> = edits.iter().copied().map(edit).collect();
            Places::new(vec![2, 2]).edit(&edits, rows, 0)
        };
        assert_eq!(edited(&[[0, 4]], 5).unwrap(), [edit([0, 2])]);
        assert!(
            edited(&[[4, 0]], 5).is_err(),
            "a source that is not there yet"
        );
        assert!(edited(&[[0, 5]], 5).is_err(), "beyond the rows");
        assert!(edited(&[], 5).is_err(), "a row that nobody writes");
    }

    #[test]
    fn planes_are_cut_by_ranks() {
        let rows = [vec![0, 1], vec![], vec![2]];
        let planes = vec![10, 11, 12, 20, 21, 22];
        assert_eq!(
            by_rank(&planes, &rows),
            [vec![10, 11, 20, 21], vec![], vec![12, 22]]
        );
        assert_eq!(by_rank(&[], &[vec![], vec![]]), [vec![], Vec::<u32>::new()]);
    }
}
