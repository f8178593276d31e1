//! A keyed hash of 64 bits: HalfSipHash-1-3, which needs operations of 32 bits only
//! (<https://github.com/veorq/SipHash>, <https://doi.org/10.1007/978-3-642-34931-7_28>).
//!
//! Its key is not known to the peers, so they cannot make two frames with the same hash.

/// A hash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Hash(u32, u32);

impl Hash {
    pub(super) const ZERO: Self = Self(0, 0);
}

/// A key.
#[derive(Clone, Copy, Debug)]
pub(super) struct Key(u32, u32);

impl Key {
    /// The key before the first [`renewed`](Self::renewed): all zero bits.
    pub(super) const ZERO: Self = Self(0, 0);

    /// Returns another key, made from this one, from a secret and from the time of an arrival in µs. It is as hard to
    /// guess as all of them together.
    pub(super) fn renewed(self, secret: u64, arrival: u64) -> Self {
        let [low, high] = halves(secret);
        let Hash(low, high) = Self(self.0 ^ low, self.1 ^ high).hash(&arrival.to_le_bytes());
        Self(low, high)
    }

    /// Returns the hash of these bytes.
    pub(super) fn hash(self, bytes: &[u8]) -> Hash {
        self.hash_in_rounds::<1, 3>(bytes)
    }

    /// Returns the hash by `EACH` rounds for each word and `LAST` rounds at the end.
    fn hash_in_rounds<const EACH: usize, const LAST: usize>(self, bytes: &[u8]) -> Hash {
        let Self(k0, k1) = self;
        let mut state = State(k0, k1 ^ 0xEE, 0x6C79_6765 ^ k0, 0x7465_6462 ^ k1);
        let (words, rest) = bytes.as_chunks();
        for word in words {
            state.take::<EACH>(u32::from_le_bytes(*word));
        }
        // The last word has the bytes that are left, and the low byte of the length.
        let [length, ..] = bytes.len().to_le_bytes();
        let mut last = [0, 0, 0, length];
        for (to, from) in last.iter_mut().zip(rest) {
            *to = *from;
        }
        state.take::<EACH>(u32::from_le_bytes(last));
        state.2 ^= 0xEE;
        let low = state.finish::<LAST>();
        state.1 ^= 0xDD;
        Hash(low, state.finish::<LAST>())
    }
}

/// The low and the high 32 bits.
fn halves(value: u64) -> [u32; 2] {
    let [a, b, c, d, e, f, g, h] = value.to_le_bytes();
    [u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes([e, f, g, h])]
}

/// The state of a hash in progress.
struct State(u32, u32, u32, u32);

impl State {
    fn take<const ROUNDS: usize>(&mut self, word: u32) {
        self.3 ^= word;
        self.rounds::<ROUNDS>();
        self.0 ^= word;
    }

    fn finish<const ROUNDS: usize>(&mut self) -> u32 {
        self.rounds::<ROUNDS>();
        self.1 ^ self.3
    }

    fn rounds<const ROUNDS: usize>(&mut self) {
        let Self(v0, v1, v2, v3) = self;
        for _ in 0..ROUNDS {
            *v0 = v0.wrapping_add(*v1);
            *v1 = v1.rotate_left(5) ^ *v0;
            *v0 = v0.rotate_left(16);
            *v2 = v2.wrapping_add(*v3);
            *v3 = v3.rotate_left(8) ^ *v2;
            *v0 = v0.wrapping_add(*v3);
            *v3 = v3.rotate_left(7) ^ *v0;
            *v2 = v2.wrapping_add(*v1);
            *v1 = v1.rotate_left(13) ^ *v2;
            *v2 = v2.rotate_left(16);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The authors' vectors for 2 and 4 rounds, with the key 00 01 … 07 and the bytes 00 01 … of each length.
    #[test]
    fn hashes_are_those_of_the_authors() {
        let key = Key(0x0302_0100, 0x0706_0504);
        let bytes: [u8; 4] = core::array::from_fn(|index| index as u8);
        let expected: [[u8; 8]; 2] =
            [[0x21, 0x8D, 0x1F, 0x59, 0xB9, 0xB8, 0x3C, 0xC8], [0xBE, 0x55, 0x24, 0x12, 0xF8, 0x38, 0x73, 0x15]];
        for (len, expected) in expected.iter().enumerate() {
            let Hash(low, high) = key.hash_in_rounds::<2, 4>(&bytes[..len]);
            assert_eq!([low.to_le_bytes(), high.to_le_bytes()].concat(), expected, "{len} bytes");
        }
    }

    /// every byte counts, and so do the length and the key.
    #[test]
    fn all_bytes_and_the_key_count() {
        let key = Key::ZERO.renewed(1, 2);
        let frame = [0xFD, 3, 0, 0, 7, 255, 190, 1, 2, 3, 4, 5, 6, 7, 8];
        for index in 0..frame.len() {
            let mut other = frame;
            other[index] ^= 0x10;
            assert_ne!(key.hash(&frame), key.hash(&other), "byte {index}");
        }
        assert_ne!(key.hash(&frame), key.hash(&frame[..14]));
        assert_ne!(key.hash(&[0; 8]), key.hash(&[0; 9]));
        for other in [Key::ZERO, Key::ZERO.renewed(1, 3), Key::ZERO.renewed(2, 2), key.renewed(1, 2)] {
            assert_ne!(key.hash(&frame), other.hash(&frame));
        }
    }
}
