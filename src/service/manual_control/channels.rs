//! The channels of radio control: RC_CHANNELS_OVERRIDE, RADIO_RC_CHANNELS and RC_CHANNELS (J-4, J-12).

use crate::dialect::{RadioRcChannels, RcChannels, RcChannelsOverride};
use crate::frame::Frame;
use crate::message::Message;
use crate::time::Instant;
use crate::types::{CHANNELS, RcOverride};

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

/// What a message says about a channel.
pub(super) enum Given {
    /// A pulse (µs).
    Pulse(u16),
    /// The channel is no longer overridden.
    Released,
    /// Nothing: it stays as it is.
    Nothing,
    /// A value out of range, which is ignored.
    Invalid,
}

/// The number of channels in RC_CHANNELS_OVERRIDE, and of those in its original form.
pub(super) const OVERRIDES: u8 = 18;
const FIRST_OVERRIDES: u8 = 8;
/// The value of RC_CHANNELS_OVERRIDE that releases a channel.
const RELEASE: u16 = u16::MAX - 1;

/// Where the extensions begin in the payloads: the channels of RADIO_RC_CHANNELS, and those after channel 8 in
/// RC_CHANNELS_OVERRIDE.
const RADIO_AT: u8 = 9;
const OVERRIDES_AT: u8 = 18;
const _: () = assert!(RadioRcChannels::BASE_LEN == 9 && RcChannelsOverride::BASE_LEN == 18, "the offsets above");

/// Returns a number of a payload, as far as the sender did not cut it off (S-6). A loop over bytes takes less flash than decoding
/// all channels by name.
fn number(frame: &Frame<'_>, at: u8) -> u16 {
    u16::from_le_bytes([frame.byte(at), frame.byte(at.saturating_add(1))])
}

/// Returns what RC_CHANNELS_OVERRIDE says about a channel (J-4). `index` is 0 for channel 1.
pub(super) fn of_override(frame: &Frame<'_>, index: u8) -> Given {
    let later = index.checked_sub(FIRST_OVERRIDES);
    let at = later.map_or(index.wrapping_mul(2), |later| later.wrapping_mul(2).saturating_add(OVERRIDES_AT));
    match number(frame, at) {
        u16::MAX => Given::Nothing,
        // In the later channels a 0 means that the field was cut off.
        0 if later.is_some() => Given::Nothing,
        // The later channels' value for "release" works for all: no pulse is 65 ms long.
        0 | RELEASE => Given::Released,
        raw => Given::Pulse(raw),
    }
}

/// Returns what RADIO_RC_CHANNELS says about a channel (J-12): ±4096 is 860 to 2140 µs, as ArduPilot takes it. `index` is 0 for
/// channel 1.
pub(super) fn of_radio(frame: &Frame<'_>, index: u8) -> Given {
    let value = i32::from(number(frame, index.wrapping_mul(2).saturating_add(RADIO_AT)).cast_signed());
    let pulse = u16::try_from((value.wrapping_mul(5) / 32).wrapping_add(1_500));
    match pulse {
        Ok(pulse) if (-4_096..=4_096).contains(&value) => Given::Pulse(pulse),
        _ => Given::Invalid,
    }
}
