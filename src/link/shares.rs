//! What each kind of traffic had of a busy link, so that none starves another.

use core::num::Saturating;

/// The length of the longest frame (bytes): streams that are so far behind are sent first.
const LONG_FRAME: u16 = 280;

/// A kind of traffic, as the link's rate is shared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Traffic {
    /// What the vehicle sends by its schedule while the link is idle.
    Stream,
    /// Frames of other systems, which are sent while the link is idle too.
    Forwarded,
    /// Lists, plans, files and logs, which have shares of their own.
    Transfer,
    /// Signs of life, answers and news.
    Answer,
}

/// Balances in bytes. Initially all zero bits.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shares {
    /// How far streams and forwarded frames are behind the rest: at most two long frames.
    behind: Saturating<u16>,
    /// How far forwarded frames are behind streams: at most a long frame, either way.
    forwarded: Saturating<i16>,
}

impl Shares {
    /// Nobody is behind.
    pub(crate) const NEW: Self = Self { behind: Saturating(0), forwarded: Saturating(0) };

    /// Records a sent frame. Streams and forwarded frames together get half of the link, and three elevenths (27 %) beside a
    /// transfer, which then keeps more than the 70 % that a list and a file have together. Forwarded frames get half of that.
    pub(crate) fn note(&mut self, traffic: Traffic, len: usize) {
        let len = u16::try_from(len).unwrap_or(LONG_FRAME).min(LONG_FRAME);
        let signed = Saturating(len.cast_signed());
        match traffic {
            Traffic::Stream => self.forwarded += signed,
            Traffic::Forwarded => self.forwarded -= signed,
            Traffic::Transfer => self.behind += len.wrapping_mul(3) >> 3,
            Traffic::Answer => self.behind += len,
        }
        if matches!(traffic, Traffic::Stream | Traffic::Forwarded) {
            self.behind -= len;
        }
        let most = LONG_FRAME.cast_signed();
        self.forwarded = Saturating(self.forwarded.0.clamp(-most, most));
        self.behind = Saturating(self.behind.0.min(LONG_FRAME.wrapping_mul(2)));
    }

    /// Whether streams and forwarded frames are sent before answers.
    pub(crate) const fn streams_first(&self) -> bool {
        self.behind.0 >= LONG_FRAME
    }

    /// Whether forwarded frames are sent before streams.
    pub(crate) const fn forwarded_first(&self) -> bool {
        self.forwarded.0 > 0
    }
}
