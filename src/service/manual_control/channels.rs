//! The channels of radio control: RC_CHANNELS_OVERRIDE, RADIO_RC_CHANNELS and RC_CHANNELS (J-4, J-12).

use crate::dialect::{RcChannels, RcChannelsOverride};
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

/// Returns the pulse (µs) of a channel in RADIO_RC_CHANNELS: ±4096 is 860 to 2140, as ArduPilot takes it. `None` out of this
/// range.
pub(super) fn pulse(value: i16) -> Option<u16> {
    let value = Some(i32::from(value)).filter(|value| (-4_096..=4_096).contains(value))?;
    u16::try_from((value.wrapping_mul(5) / 32).wrapping_add(1_500)).ok()
}

/// Returns the channels of an RC_CHANNELS_OVERRIDE, channel 1 first.
pub(super) const fn raw_channels(message: &RcChannelsOverride) -> [u16; 18] {
    [
        message.chan1_raw,
        message.chan2_raw,
        message.chan3_raw,
        message.chan4_raw,
        message.chan5_raw,
        message.chan6_raw,
        message.chan7_raw,
        message.chan8_raw,
        message.chan9_raw,
        message.chan10_raw,
        message.chan11_raw,
        message.chan12_raw,
        message.chan13_raw,
        message.chan14_raw,
        message.chan15_raw,
        message.chan16_raw,
        message.chan17_raw,
        message.chan18_raw,
    ]
}
