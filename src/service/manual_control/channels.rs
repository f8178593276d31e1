//! The channels of radio control: RC_CHANNELS_OVERRIDE, RADIO_RC_CHANNELS and RC_CHANNELS (J-4, J-12).

use crate::dialect::{RadioRcChannels, RcChannels, RcChannelsOverride};
use crate::frame::Frame;
use crate::message::Message;
use crate::time::Instant;
use crate::types::{CHANNELS, RcOverride};
use core::num::Saturating;

impl RcOverride {
    /// Returns the pulse of channel `number`, 1 to 32, in µs. Any number from 1 to 65533 is possible; a sane sender
    /// uses 1000 to 2000, and RADIO_RC_CHANNELS 860 to 2140. `None` if the channel is not given: the value of another
    /// receiver applies. Channels 19 to 32 exist in RADIO_RC_CHANNELS only.
    pub fn channel(&self, number: u8) -> Option<u16> {
        let index = usize::from(number).checked_sub(1)?;
        self.channels.get(index).copied().filter(|&raw| raw != 0)
    }

    /// Returns RC_CHANNELS as the vehicle uses them: each channel's override, or else the receiver's value in
    /// `received` (µs; empty for a vehicle without a receiver). The signal strength is unknown.
    ///
    /// ```
    /// use mavstack::Instant;
    /// use mavstack::manual_control::RcOverride;
    ///
    /// let nothing = RcOverride::default();
    /// let message = nothing.to_message(Instant::from_millis(7), &[1500, 1100]);
    /// assert_eq!((message.time_boot_ms, message.chancount), (7, 2));
    /// assert_eq!((message.chan1_raw, message.chan2_raw, message.chan3_raw), (1500, 1100, u16::MAX));
    /// ```
    pub fn to_message(&self, now: Instant, received: &[u16]) -> RcChannels {
        let mut channels = [u16::MAX; 18];
        let mut chancount = 0;
        for ((number, channel), index) in (1..=u8::MAX).zip(&mut channels).zip(0..CHANNELS) {
            let Some(raw) = self.channel(number).or_else(|| received.get(index).copied()) else { continue };
            *channel = raw;
            chancount = number;
        }
        let [c1, c2, c3, c4, c5, c6, c7, c8, c9, c10, c11, c12, c13, c14, c15, c16, c17, c18] = channels;
        RcChannels {
            time_boot_ms: now.time_boot_ms(),
            chan1_raw: c1,
            chan2_raw: c2,
            chan3_raw: c3,
            chan4_raw: c4,
            chan5_raw: c5,
            chan6_raw: c6,
            chan7_raw: c7,
            chan8_raw: c8,
            chan9_raw: c9,
            chan10_raw: c10,
            chan11_raw: c11,
            chan12_raw: c12,
            chan13_raw: c13,
            chan14_raw: c14,
            chan15_raw: c15,
            chan16_raw: c16,
            chan17_raw: c17,
            chan18_raw: c18,
            chancount,
            rssi: u8::MAX,
        }
    }
}

/// The value of a channel in a message.
pub(super) enum ChannelValue {
    /// A pulse (µs).
    Pulse(u16),
    /// The channel is no longer overridden.
    Released,
    /// The channel stays as it is.
    NotGiven,
    /// A value out of range, which is ignored.
    Invalid,
}

/// The number of channels in RC_CHANNELS_OVERRIDE, and of those in its original form.
pub(super) const OVERRIDES: u8 = 18;
const FIRST_OVERRIDES: u8 = 8;
/// The value of RC_CHANNELS_OVERRIDE that releases a channel.
const RELEASE: u16 = u16::MAX - 1;

/// Where channel 1 is in the payload of RADIO_RC_CHANNELS; and where it would be in RC_CHANNELS_OVERRIDE if the target
/// did not separate channels 8 and 9.
const RADIO_AT: u8 = 9;
const LATER_OVERRIDES_AT: u8 = 2;
const _: () = assert!(
    RadioRcChannels::BASE_LEN == 9 && RcChannelsOverride::BASE_LEN == 18,
    "the offsets above: extensions follow the other fields"
);

/// Returns a channel's number in a payload, as far as the sender did not cut it off (S-6). A loop over bytes takes less
/// flash than decoding all channels by name. `first_at` is where channel 1 is, and `index` is 0 for it.
fn number(frame: &Frame<'_>, first_at: u8, index: u8) -> u16 {
    let at = Saturating(first_at) + Saturating(index) * Saturating(2);
    u16::from_le_bytes([frame.byte(at.0), frame.byte((at + Saturating(1)).0)])
}

/// Returns the value of a channel in RC_CHANNELS_OVERRIDE (J-4). `index` is 0 for channel 1.
pub(super) fn of_override(frame: &Frame<'_>, index: u8) -> ChannelValue {
    let is_later = index >= FIRST_OVERRIDES;
    match number(frame, if is_later { LATER_OVERRIDES_AT } else { 0 }, index) {
        u16::MAX => ChannelValue::NotGiven,
        // In the later channels a 0 means that the field was cut off.
        0 if is_later => ChannelValue::NotGiven,
        // The later channels' value for "release" works for all: no pulse is 65 ms long.
        0 | RELEASE => ChannelValue::Released,
        pulse => ChannelValue::Pulse(pulse),
    }
}

/// Returns the value of a channel in RADIO_RC_CHANNELS (J-12): ±4096 is 860 to 2140 µs, as ArduPilot takes it. `index`
/// is 0 for channel 1.
pub(super) fn of_radio(frame: &Frame<'_>, index: u8) -> ChannelValue {
    let value = Saturating(i32::from(number(frame, RADIO_AT, index).cast_signed()));
    let pulse = Saturating((value * Saturating(5)).0 / 32) + Saturating(1_500);
    match u16::try_from(pulse.0) {
        Ok(pulse) if (-4_096..=4_096).contains(&value.0) => ChannelValue::Pulse(pulse),
        _ => ChannelValue::Invalid,
    }
}
