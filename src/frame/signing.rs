//! Signatures of frames: signing and verifying.
//!
//! Implements the signature of <https://mavlink.io/en/guide/message_signing.html>, rules G-1 to G-3 and G-7, and SEC-7.
//! [`Signing`](crate::signing::Signing) decides whether a signed frame is a replay, and whether unsigned frames are
//! accepted.
//!
//! SHA-256 is from the crate `sha2`. Its compact implementation has a third of the size and is somewhat slower. Only
//! the firmware can select it: add `--cfg sha2_backend_soft="compact"` to the `rustflags` in its `.cargo/config.toml`.

use core::hint::black_box;
use core::ops::Range;

use sha2::{Digest, Sha256};
use zeroize::Zeroize;

use super::{EncodeError, Frame, Header, INCOMPAT_SIGNED, SIGNATURE_LEN, Version, wrap};
use crate::message::{Address, Message};

/// How many bytes of the hash are sent.
const TAG_LEN: usize = 6;

/// The largest timestamp: 48 bits in units of 10 µs, which last until 2104 (G-3).
pub(crate) const MAX_TIMESTAMP: u64 = (1 << 48) - 1;

/// A secret key, shared by all components that sign for each other.
///
/// The bytes cannot be read back, and `Debug` does not show them. They are overwritten when the key is replaced or
/// dropped; copies that the compiler made of them on the stack are not.
#[derive(Clone)]
pub struct SigningKey(Wiped<[u8; Self::LEN]>);

impl SigningKey {
    /// Length of a key in bytes.
    pub const LEN: usize = 32;

    /// Returns the key with these bytes. Many ground stations compute them as the SHA-256 of a passphrase.
    pub const fn new(bytes: [u8; Self::LEN]) -> Self {
        Self(Wiped(bytes))
    }

    /// Compares two keys in constant time.
    pub(crate) fn is_same(&self, other: &Self) -> bool {
        is_same(&self.0.0, &other.0.0)
    }

    /// Returns the key's bytes. For storage only.
    #[cfg(feature = "storage")]
    pub(crate) const fn bytes(&self) -> &[u8; Self::LEN] {
        &self.0.0
    }

    /// Returns the signature of `bytes`: the frame, link id and timestamp (G-2).
    fn tag(&self, bytes: &[u8]) -> [u8; TAG_LEN] {
        let mut hash = Sha256::new();
        hash.update(self.0.0);
        hash.update(bytes);
        // Resetting the state also removes the key from it.
        let mut digest = [0; Self::LEN];
        hash.finalize_into_reset((&mut digest).into());
        let [a, b, c, d, e, f, ..] = digest;
        [a, b, c, d, e, f]
    }

    /// Returns whether a whole signed frame has a valid signature. The time does not depend on the result (G-7).
    pub(crate) fn has_signed(&self, raw: &[u8]) -> bool {
        raw.split_last_chunk().is_some_and(|(signed, tag)| is_same(&self.tag(signed), tag))
    }

    /// Appends the signature to a frame whose flags announce it, and returns where it ends; `None` when there is no
    /// room.
    pub(crate) fn sign(&self, out: &mut [u8], frame: Range<usize>, link_id: u8, timestamp: u64) -> Option<usize> {
        let [t0, t1, t2, t3, t4, t5, ..] = timestamp.to_le_bytes();
        let stamp = [link_id, t0, t1, t2, t3, t4, t5];
        *out.get_mut(frame.end..)?.first_chunk_mut()? = stamp;
        let at = frame.end.checked_add(stamp.len())?;
        let tag = self.tag(out.get(frame.start..at)?);
        *out.get_mut(at..)?.first_chunk_mut()? = tag;
        frame.end.checked_add(SIGNATURE_LEN)
    }
}

/// Returns the cost of signing or verifying a frame of `len` bytes (SEC-2): 150 units for each hashed block. On a
/// microcontroller a block takes four times as long; but at that cost two frames would spend the budget of a poll.
pub(crate) fn signature_cost(len: usize) -> u32 {
    const BLOCK: u32 = 150;
    // The key, and at least 9 bytes of padding.
    let hashed = len.saturating_add(const { SigningKey::LEN + 9 - TAG_LEN });
    u32::try_from(hashed.div_ceil(64)).unwrap_or(u32::MAX).saturating_mul(BLOCK)
}

/// Returns the cost of the signature of a frame that is sent, 0 without one. Forwarded frames cost the same as our own, though they
/// were signed elsewhere.
pub(crate) fn cost_of_sending(frame: &[u8]) -> u32 {
    let is_signed = Header::parse(frame).is_some_and(|header| header.is_signed());
    if is_signed { signature_cost(frame.len()) } else { 0 }
}

/// Compares in constant time: it does not depend on where the bytes differ (G-7).
fn is_same<const N: usize>(ours: &[u8; N], theirs: &[u8; N]) -> bool {
    black_box(ours.iter().zip(theirs).fold(0, |sum, (a, b)| sum | (a ^ b))) == 0
}

/// A value that is overwritten when it is dropped: replaced, removed, or dropped with its owner (SEC-15).
/// `zeroize::Zeroizing` does the same, but cannot be constructed in a `const fn`.
#[derive(Clone)]
struct Wiped<T: Zeroize>(T);

impl<T: Zeroize> Drop for Wiped<T> {
    fn drop(&mut self) {
        self.0.zeroize();
    }
}

impl core::fmt::Debug for SigningKey {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("SigningKey")
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for SigningKey {
    fn format(&self, f: defmt::Formatter<'_>) {
        defmt::write!(f, "SigningKey");
    }
}

impl Frame<'_> {
    /// Returns whether the frame has a signature made with `key`. Replays are not detected: it may be a duplicate of an
    /// old frame.
    pub fn is_signed_with(&self, key: &SigningKey) -> bool {
        self.header.is_signed() && key.has_signed(self.raw)
    }
}

/// Writes `message` as one signed MAVLink 2 frame to the front of `out` and returns the frame's length in bytes.
///
/// `out` must hold 13 bytes more than for [`encode`](crate::frame::encode). `link_id` is the sender's own id of the link.
/// `timestamp` is in units of 10 µs since 2015-01-01 00:00 UTC. It must be greater than in every other frame that the
/// sender has signed for this link (G-4, G-5). Only its low 48 bits are sent.
///
/// # Errors
///
/// [`EncodeError::BufferTooSmall`]; `out` may then be partly overwritten.
///
/// ```
/// use mavstack::frame::encode_signed;
/// use mavstack::signing::SigningKey;
/// use mavstack::{Address, dialect::Heartbeat};
/// let key = SigningKey::new([7; 32]);
/// let mut frame = [0; 48];
/// let heartbeat = Heartbeat { mavlink_version: 3, ..Default::default() };
/// let len = encode_signed(&heartbeat, Address::new(1, 1), 0, &key, 0, 33_000_000_000_000, &mut frame)?;
/// assert_eq!(len, 34);
/// # Ok::<(), mavstack::frame::EncodeError>(())
/// ```
pub fn encode_signed<M: Message>(
    message: &M,
    source: Address,
    seq: u8,
    key: &SigningKey,
    link_id: u8,
    timestamp: u64,
    out: &mut [u8],
) -> Result<usize, EncodeError> {
    let payload_at = Version::V2.header_len();
    let payload = out.get_mut(payload_at..).ok_or(EncodeError::BufferTooSmall)?;
    message.encode(payload).ok_or(EncodeError::BufferTooSmall)?;
    let frame = wrap(const { &M::INFO }, Version::V2, INCOMPAT_SIGNED, source, seq, out, payload_at)?;
    key.sign(out, frame, link_id, timestamp).ok_or(EncodeError::BufferTooSmall)
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::cell::Cell;

    /// Counts how often the value is overwritten.
    #[derive(Clone)]
    struct Spy<'a>(&'a Cell<u32>);

    impl Zeroize for Spy<'_> {
        fn zeroize(&mut self) {
            self.0.set(self.0.get() + 1);
        }
    }

    /// SEC-15: a value that is dropped or replaced is overwritten, and so is each clone. Safe code cannot read the
    /// bytes of a dropped key. So the test shows that a key has drop glue, and relies on the tests of `zeroize` for the
    /// rest.
    #[test]
    fn a_dropped_key_is_overwritten() {
        const { assert!(core::mem::needs_drop::<SigningKey>() && core::mem::needs_drop::<Option<SigningKey>>()) };
        let wiped = Cell::new(0);
        let mut key = Some(Wiped(Spy(&wiped)));
        drop(key.clone());
        assert_eq!(wiped.get(), 1);
        key.replace(Wiped(Spy(&wiped)));
        assert_eq!(wiped.get(), 2);
        key = None;
        assert_eq!((wiped.get(), key.is_none()), (3, true));
    }

    /// G-7: every bit is compared.
    #[test]
    fn all_bits_of_a_signature_are_compared() {
        let tag = [1, 2, 3, 4, 5, 6];
        assert!(is_same(&tag, &tag));
        for bit in 0..48 {
            let mut other = tag;
            other[bit / 8] ^= 1 << (bit % 8);
            assert!(!is_same(&tag, &other), "bit {bit}");
        }
        // Differences do not cancel out.
        assert!(!is_same(&[1, 1], &[2, 2]));
    }
}
