//! Seeded mutations of files.

use mhsplat::base::rng::Philox;

/// Numbers that counts, offsets and sizes get wrong.
const NUMBERS: [u64; 10] = [
    0,
    1,
    0x7f,
    0xff,
    0xffff,
    0x7fff_ffff,
    0xffff_ffff,
    1 << 40,
    i64::MAX as u64,
    u64::MAX,
];
/// Words that parsers of text get wrong.
const WORDS: [&str; 14] = [
    "nan",
    "-inf",
    "1e999",
    "-1",
    "0",
    "99999999999999999999",
    "1e-999",
    "\"",
    "{",
    "[",
    "\n",
    "\0",
    "../../x",
    "é",
];

/// Draws from a counter.
pub struct Dice {
    seed: u64,
    at: u64,
}

impl Dice {
    pub fn new(seed: u64) -> Self {
        Self { seed, at: 0 }
    }

    /// Below `n`; 0 for no n.
    pub fn below(&mut self, n: usize) -> usize {
        self.at += 1;
        let u = Philox::uniform(self.seed, 77, self.at)[0];
        ((u * n as f64) as usize).min(n.saturating_sub(1))
    }
}

/// One to four mutations of one of the seeds.
pub fn mutated(seeds: &[Vec<u8>], dice: &mut Dice) -> Vec<u8> {
    let mut bytes = seeds[dice.below(seeds.len())].clone();
    for _ in 0..=dice.below(4) {
        once(&mut bytes, seeds, dice);
    }
    bytes
}

fn once(bytes: &mut Vec<u8>, seeds: &[Vec<u8>], dice: &mut Dice) {
    let n = bytes.len();
    // Half of them near the start, where counts and headers are.
    let reach = if dice.below(2) == 0 { n.min(256) } else { n };
    let at = dice.below(reach.max(1)).min(n);
    match dice.below(9) {
        0 if n > 0 => bytes[at.min(n - 1)] ^= 1 << dice.below(8),
        1 if n > 0 => bytes[at.min(n - 1)] = dice.below(256) as u8,
        2 => bytes.truncate(at),
        3 => {
            let end = (at + 1 + dice.below(64)).min(n);
            bytes.drain(at..end);
        }
        4 => {
            let end = (at + 1 + dice.below(64)).min(n);
            let part = bytes[at..end].to_vec();
            bytes.splice(at..at, part);
        }
        5 => {
            let value = NUMBERS[dice.below(NUMBERS.len())].to_le_bytes();
            let width = [1, 2, 4, 8][dice.below(4)];
            let end = (at + width).min(n);
            bytes.splice(at..end, value[..width].iter().copied());
        }
        6 => {
            let word = WORDS[dice.below(WORDS.len())];
            bytes.splice(at..at, word.bytes());
        }
        7 => {
            // A number in a text becomes another word.
            let digit = bytes[at..].iter().position(u8::is_ascii_digit);
            if let Some(first) = digit.map(|d| at + d) {
                let digits = bytes[first..].iter().take_while(|b| b.is_ascii_digit());
                let end = first + digits.count();
                let word = WORDS[dice.below(WORDS.len())];
                bytes.splice(first..end, word.bytes());
            }
        }
        _ => {
            let other = &seeds[dice.below(seeds.len())];
            let from = dice.below(other.len().max(1)).min(other.len());
            bytes.truncate(at);
            bytes.extend_from_slice(&other[from..]);
        }
    }
}
