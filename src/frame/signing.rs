//! Signatures: made and compared.
//!
//! Implements the signature of <https://mavlink.io/en/guide/message_signing.html>, rules G-1 to G-3 and G-7. Whether a signed
//! frame is also fresh, and what becomes of the others, [`Signing`](crate::Signing) decides.
//!
//! SHA-256 is `sha2`'s. Its compact form is a third of the size and somewhat slower; a firmware chooses it, a library cannot:
//! `--cfg sha2_backend_soft="compact"` in the `rustflags` of its `.cargo/config.toml`.

use core::hint::black_box;
use core::ops::Range;

use sha2::{Digest, Sha256};
use zeroize::Zeroize;

use super::{Address, EncodeError, Frame, INCOMPAT_SIGNED, SIGNATURE_LEN, Version, wrap};
use crate::message::Message;

/// Bytes of the hash that are sent.
const TAG_LEN: usize = 6;

/// The largest timestamp: 48 bits of 10 µs, which end in 2104 (G-3).
pub(crate) const MAX_TIMESTAMP: u64 = (1 << 48) - 1;

/// A secret key, shared by all who sign for each other.
///
/// It is never shown: its `Debug` says nothing, and nothing gives it back. Its bytes are overwritten when it is replaced or
/// dropped; copies that the compiler made of them on the stack are not.
#[derive(Clone)]
pub struct SigningKey(Wiped<[u8; Self::LEN]>);

impl SigningKey {
    /// How long a key is (bytes).
    pub const LEN: usize = 32;

    /// The key of these bytes. Many ground stations make them of a passphrase, by SHA-256.
    pub const fn new(bytes: [u8; Self::LEN]) -> Self {
        Self(Wiped(bytes))
    }

    /// Compares two keys in constant time.
    pub(crate) fn is_same(&self, other: &Self) -> bool {
        is_same(&self.0.0, &other.0.0)
    }

    /// For storage only.
    #[cfg(feature = "storage")]
    pub(crate) const fn bytes(&self) -> &[u8; Self::LEN] {
        &self.0.0
    }

    /// The signature of everything before it (G-2).
    fn tag(&self, bytes: &[u8]) -> [u8; TAG_LEN] {
        let mut hash = Sha256::new();
        hash.update(self.0.0);
        hash.update(bytes);
        // In place, which also leaves nothing of the key in the state.
        let mut digest = [0; Self::LEN];
        hash.finalize_into_reset((&mut digest).into());
        let [a, b, c, d, e, f, ..] = digest;
        [a, b, c, d, e, f]
    }

    /// Whether a whole signed frame bears the signature that it has to. Takes as long for a wrong one as for a right one (G-7).
    pub(crate) fn has_signed(&self, raw: &[u8]) -> bool {
        raw.split_last_chunk().is_some_and(|(signed, tag)| is_same(&self.tag(signed), tag))
    }

    /// Writes the signature behind a frame whose flag says that it has one, and returns where it ends; `None` when there is
    /// no room for it.
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

/// What a signature of a frame of `len` bytes counts as work, made or compared (SEC-2): 150 units for each block that is hashed.
/// On a microcontroller a block takes four times as long; but at its full price two frames would be a poll's work.
pub(crate) fn signature_cost(len: usize) -> u32 {
    const BLOCK: u32 = 150;
    // Key, and at least 9 bytes of padding.
    let hashed = len.saturating_add(const { SigningKey::LEN + 9 - TAG_LEN });
    u32::try_from(hashed.div_ceil(64)).unwrap_or(u32::MAX).saturating_mul(BLOCK)
}

/// Whether the bytes are the same, found out in the same time wherever they differ (G-7).
fn is_same<const N: usize>(ours: &[u8; N], theirs: &[u8; N]) -> bool {
    black_box(ours.iter().zip(theirs).fold(0, |sum, (a, b)| sum | (a ^ b))) == 0
}

/// Overwritten when it is dropped, whatever becomes of it: replaced, taken away, or forgotten with the memory that it is in
/// (SEC-15). `zeroize::Zeroizing` is the same, but cannot be made in a constant.
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
    /// Whether the frame bears a signature made with `key`. That says who made it, not when: it may be a copy of an old one.
    pub fn is_signed_with(&self, key: &SigningKey) -> bool {
        self.header.is_signed() && key.has_signed(self.raw)
    }
}

/// Writes `message` as one signed MAVLink 2 frame to the front of `out` and returns the frame's length in bytes; as
/// [`encode`](crate::encode) otherwise. `out` must hold 13 bytes more.
///
/// `link_id` is the sender's own number of the line, `timestamp` counts 10 µs since 2015-01-01 00:00 UTC and must be greater
/// than that of every other frame that the sender has signed for that line (G-4, G-5); only its low 48 bits are sent.
///
/// # Errors
///
/// [`EncodeError`]; `out` is then in an unknown state.
///
/// ```
/// use mavstack::{Address, SigningKey, dialect::Heartbeat, encode_signed};
/// let key = SigningKey::new([7; 32]);
/// let mut frame = [0; 48];
/// let heartbeat = Heartbeat { mavlink_version: 3, ..Default::default() };
/// let len = encode_signed(&heartbeat, Address::new(1, 1), 0, &key, 0, 33_000_000_000_000, &mut frame)?;
/// assert_eq!(len, 34);
/// # Ok::<(), mavstack::EncodeError>(())
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

    /// Counts how often it is overwritten.
    #[derive(Clone)]
    struct Spy<'a>(&'a Cell<u32>);

    impl Zeroize for Spy<'_> {
        fn zeroize(&mut self) {
            self.0.set(self.0.get() + 1);
        }
    }

    /// SEC-15: what is dropped or replaced is overwritten, and so is each copy. Without unsafe code nobody can look at the bytes
    /// of a key that is gone: that a key is wrapped so is seen by its being dropped at all, and `zeroize` is tested by its makers.
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

    /// G-7: each byte counts, the first as the last.
    #[test]
    fn signatures_are_compared_whole() {
        let tag = [1, 2, 3, 4, 5, 6];
        assert!(is_same(&tag, &tag));
        for bit in 0..48 {
            let mut other = tag;
            other[bit / 8] ^= 1 << (bit % 8);
            assert!(!is_same(&tag, &other), "bit {bit}");
        }
        // Differences do not cancel each other out.
        assert!(!is_same(&[1, 1], &[2, 2]));
    }
}
