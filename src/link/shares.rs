//! What each kind of traffic had of a busy link, so that none starves another.
//!
//! Streams and forwarded frames have at least half, by bytes. What requests on other links have caused has a tenth: its turns are
//! marked, and a marked turn waits until nine times as much of the rest was sent, or until the link is idle. Waiting loses nothing:
//! states are merged where they are kept.

use core::num::Saturating;

/// The length of the longest frame (bytes): streams that are so far behind are sent first.
const LONG_FRAME: u16 = 280;

/// The most that forwarded frames make up (bytes): where they have been none, they do not come in a burst.
const MOST_BEHIND: i16 = 120;

/// Nine of ten parts are for the rest.
const REST: u16 = 9;

/// The most frames that a link's own peers have to their credit.
const MOST_OWED: u8 = 8;

/// A kind of traffic, as the link's rate is shared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Traffic {
    /// What the vehicle sends by its schedule while the link is idle.
    Stream,
    /// Frames of other systems, before a stream.
    ForwardedFirst,
    /// Frames of other systems while no stream waits.
    Forwarded,
    /// Plans, which precede streams (D-4).
    Plan,
    /// Lists, files and logs, which have shares of their own.
    Transfer,
    /// Signs of life, answers and news.
    Answer,
}

impl Traffic {
    /// Whether it is of streams or forwarded frames.
    pub(crate) const fn is_stream(self) -> bool {
        matches!(self, Self::Stream | Self::ForwardedFirst | Self::Forwarded)
    }
}

/// Balances in bytes. Initially all zero bits.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shares {
    /// How far streams and forwarded frames are behind the rest: at most two long frames.
    behind: Saturating<u16>,
    /// How far forwarded frames are behind streams: at most three short frames; or before them, at most a long one.
    forwarded: Saturating<i16>,
    /// How much of the rest must be sent before a marked turn has its next frame.
    debt: Saturating<u16>,
    /// Frames of marked turns that do not wait, because the link's own peers have made as many requests: at most eight.
    owed: Saturating<u8>,
    /// Shared turns, as `Turn` packs them, that are marked: what is pending there may be due to a request on another link.
    caused: u32,
    /// The marked turns that have sent a frame since each of them has: they come after the others, so that a flood in one turn does
    /// not take the whole tenth.
    served: u32,
    /// Shared turns that requests on this link have given something to send since the last poll.
    pub(crate) asked: u32,
}

impl Shares {
    /// Nobody is behind.
    pub(crate) const NEW: Self = Self {
        behind: Saturating(0),
        forwarded: Saturating(0),
        debt: Saturating(0),
        owed: Saturating(0),
        caused: 0,
        served: 0,
        asked: 0,
    };

    /// Nothing waits, so nobody is behind.
    pub(crate) const fn reset(&mut self) {
        *self = Self { asked: self.asked, ..Self::NEW };
    }

    /// Records a sent frame. Streams and forwarded frames together get half of the link. Beside a plan that fills it they get a
    /// ninth, so that they never fall silent; beside other transfers three elevenths (27 %), so that a list and a file keep the 70 %
    /// that they have together. Forwarded frames get half of that.
    pub(crate) fn note(&mut self, traffic: Traffic, len: usize) {
        let len = u16::try_from(len).unwrap_or(LONG_FRAME).min(LONG_FRAME);
        let signed = Saturating(len.cast_signed());
        match traffic {
            Traffic::Stream => self.forwarded += signed,
            Traffic::ForwardedFirst => self.forwarded -= signed,
            // No stream waits, so none is owed anything.
            Traffic::Forwarded => {}
            Traffic::Plan => self.behind += len >> 3,
            Traffic::Transfer => self.behind += len.wrapping_mul(3) >> 3,
            Traffic::Answer => self.behind += len,
        }
        if traffic.is_stream() {
            self.behind -= len;
        }
        let ahead = LONG_FRAME.cast_signed().wrapping_neg();
        self.forwarded = Saturating(self.forwarded.0.clamp(ahead, MOST_BEHIND));
        self.behind = Saturating(self.behind.0.min(LONG_FRAME.wrapping_mul(2)));
    }

    /// Records that a request on this link has given these shared turns something to send, on any link.
    pub(crate) fn ask(&mut self, turns: u32) {
        if turns != 0 {
            self.asked |= turns;
            self.owed = Saturating(self.owed.0.saturating_add(1).min(MOST_OWED));
        }
    }

    /// Marks shared turns: a request on another link has given them something to send.
    pub(crate) const fn mark(&mut self, turns: u32) {
        self.caused |= turns;
    }

    /// Records that shared turns have nothing to send.
    pub(crate) const fn unmark(&mut self, turns: u32) {
        self.caused &= !turns;
        self.serve(0);
    }

    /// Records that a marked turn has sent. After the last of them, all begin again.
    const fn serve(&mut self, turn: u32) {
        self.served = (self.served | turn) & self.caused;
        if self.served == self.caused {
            self.served = 0;
        }
    }

    /// Charges a sent frame to the tenth if its turn is marked, or else to the rest.
    pub(crate) fn charge(&mut self, turn: u32, len: usize) {
        let len = u16::try_from(len).unwrap_or(LONG_FRAME).min(LONG_FRAME);
        if self.caused & turn == 0 {
            self.debt -= len;
            return;
        }
        if self.owed.0 > 0 {
            self.owed -= 1;
        } else if self.debt.0 == 0 {
            self.debt = Saturating(len.wrapping_mul(REST));
        }
        self.serve(turn);
    }

    /// Returns the shared turns that are sent only while the link is idle.
    pub(crate) const fn deferred(&self) -> u32 {
        if self.debt.0 == 0 || self.owed.0 > 0 { self.served } else { self.caused }
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
