//! A pilot's receiver for radio control: whether it hears its transmitter, and since when (J-10 to J-12).

use crate::dialect::{RadioRcChannels, RadioRcChannelsFlags, RcChannelsOverride};
use crate::frame::Frame;
use crate::message::{Address, Message};
use crate::time::{Duration, Instant};
use crate::types::{LinkId, Peer};

/// A receiver that comes back takes over after it has sent for this long (J-11).
const TAKEOVER: Duration = Duration::from_millis(500);

/// A RADIO_RC_CHANNELS, without its channels.
#[derive(Clone, Copy)]
pub(super) struct RadioHeader {
    flags: RadioRcChannelsFlags,
    pub(super) count: u8,
}

impl RadioHeader {
    pub(super) fn of(frame: &Frame<'_>) -> Option<Self> {
        frame.decode::<RadioRcChannels>().map(|RadioRcChannels { flags, count, .. }| Self { flags, count })
    }
}

/// A receiver for radio control.
#[derive(Clone, Copy, Debug)]
pub(super) struct Receiver {
    /// Its address is 0/0 in a vacant entry.
    pub(super) peer: Peer,
    /// Since when it has sent without a gap, and when its last frame was received that shows that the transmitter is
    /// alive.
    since: Instant,
    heard: Instant,
    /// Until when its RC_CHANNELS_OVERRIDEs are ignored, because it sends RADIO_RC_CHANNELS (J-12).
    radio_until: Instant,
}

impl Receiver {
    /// All zero bits.
    pub(super) const VACANT: Self = Self {
        peer: Peer { address: Address::new(0, 0), link: LinkId(0) },
        since: Instant::ZERO,
        heard: Instant::ZERO,
        radio_until: Instant::ZERO,
    };

    /// Handles a frame of this receiver, and returns its meaning.
    pub(super) fn on_frame(
        &mut self,
        now: Instant,
        timeout: Duration,
        id: u32,
        radio: Option<RadioHeader>,
    ) -> ReceiverFrame {
        if let Some(RadioHeader { flags, .. }) = radio {
            self.radio_until = now + timeout;
            if flags.contains(RadioRcChannelsFlags::FAILSAFE) {
                // The next input is the first after a gap.
                self.since = now;
                self.heard = Instant::ZERO;
                return ReceiverFrame::Failsafe;
            }
            if flags.contains(RadioRcChannelsFlags::OUTDATED) {
                return ReceiverFrame::Outdated;
            }
        } else if id == RcChannelsOverride::ID && now < self.radio_until {
            return ReceiverFrame::Redundant;
        }
        if now - self.heard >= timeout.min(TAKEOVER) {
            self.since = now;
        }
        self.heard = now;
        ReceiverFrame::Input
    }

    /// Forgets when it has sent: the clock was set back.
    pub(super) const fn forget(&mut self) {
        *self = Self { peer: self.peer, ..Self::VACANT };
    }

    /// Whether it has sent for long enough to take over.
    pub(super) fn has_returned(&self, now: Instant) -> bool {
        now - self.since >= TAKEOVER
    }
}

/// The meaning of a receiver's frame.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum ReceiverFrame {
    /// Input from its transmitter.
    Input,
    /// RC_CHANNELS_OVERRIDE besides RADIO_RC_CHANNELS.
    Redundant,
    /// Earlier input, which it sends again because it received nothing new.
    Outdated,
    /// It has lost its transmitter.
    Failsafe,
}
