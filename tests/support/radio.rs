//! Receivers for radio control in MAVLink mode: what ExpressLRS and mLRS send by their UART, millisecond by millisecond.
//!
//! Rates, addresses, packing and flow control follow the firmware of ExpressLRS (`SerialMavlink.cpp`) and of mLRS
//! (`mavlink_interface_rx.h`), both of August 2026. Neither sends a HEARTBEAT of its own.

use mavstack::dialect::{RadioRcChannels, RadioRcChannelsFlags, RadioStatus, RcChannelsOverride};
use mavstack::frame::{MAX_FRAME_LEN, Version, encode};
use mavstack::{Address, Message};

/// The addresses of ExpressLRS, and of mLRS for its RC_CHANNELS_OVERRIDE; and of mLRS for everything else.
pub const ELRS: Address = Address::new(255, 68);
pub const MLRS: Address = Address::new(51, 68);

/// The sender of one UART. Frames of one address share a sequence number.
#[derive(Debug, Default)]
struct Sender {
    seqs: [u8; 2],
}

impl Sender {
    fn put<M: Message>(&mut self, bytes: &mut Vec<u8>, from: Address, message: &M) {
        let seq = &mut self.seqs[usize::from(from == MLRS)];
        let mut frame = [0; MAX_FRAME_LEN];
        let len = encode(message, Version::V2, from, *seq, &mut frame).expect("every message fits");
        *seq = seq.wrapping_add(1);
        bytes.extend(&frame[..len]);
    }
}

/// Sixteen channels; the first is `pulse` (µs), the others are centred. Channels 17 and 18 are not given.
fn channels(target_system: u8, pulse: u16) -> RcChannelsOverride {
    let center = 1_500;
    RcChannelsOverride {
        target_system,
        target_component: 0,
        chan1_raw: pulse,
        chan2_raw: center,
        chan3_raw: center,
        chan4_raw: center,
        chan5_raw: center,
        chan6_raw: center,
        chan7_raw: center,
        chan8_raw: center,
        chan9_raw: center,
        chan10_raw: center,
        chan11_raw: center,
        chan12_raw: center,
        chan13_raw: center,
        chan14_raw: center,
        chan15_raw: center,
        chan16_raw: center,
        ..RcChannelsOverride::default()
    }
}

/// ExpressLRS in MAVLink mode.
///
/// Every second packet of the air link is telemetry. A received packet becomes RC_CHANNELS_OVERRIDE, at most one every 10 ms.
/// RADIO_STATUS is sent every 11 ms, with or without a transmitter. Its `txbuf` is the free part of a buffer of 1,024 bytes, which
/// the telemetry empties.
#[derive(Debug)]
pub struct ExpressLrs {
    /// Packets per second.
    pub rate: u64,
    /// Bytes of telemetry in a packet: 5, or 10 in the "Full" modes.
    pub telemetry: u32,
    /// Whether the transmitter is received.
    pub is_connected: bool,
    /// The first channel (µs).
    pub pulse: u16,
    /// Bytes from the vehicle that wait for the air link.
    pub waiting: u32,
    /// Bytes from the vehicle for which there was no room.
    pub overflow: u32,
    next_channels: u64,
    next_status: u64,
    is_fresh: bool,
    sender: Sender,
}

impl ExpressLrs {
    const BUFFER: u32 = 1_024;

    /// A connected receiver with 250 packets a second.
    pub fn new() -> Self {
        Self {
            rate: 250,
            telemetry: 5,
            is_connected: true,
            pulse: 1_500,
            waiting: 0,
            overflow: 0,
            next_channels: 0,
            next_status: 0,
            is_fresh: false,
            sender: Sender::default(),
        }
    }

    /// Reads `len` bytes of the vehicle.
    pub fn read(&mut self, len: usize) {
        // Without a transmitter they are dropped on purpose.
        if self.is_connected {
            let len = u32::try_from(len).unwrap();
            let room = Self::BUFFER - self.waiting;
            self.overflow += len.saturating_sub(room);
            self.waiting += len.min(room);
        }
    }

    /// Returns what it writes at this time (ms).
    pub fn write(&mut self, millis: u64) -> Vec<u8> {
        let mut bytes = Vec::new();
        let packet = |millis: u64| millis * self.rate / 1_000;
        if self.is_connected && packet(millis) != packet(millis.saturating_sub(1)) {
            // Alternately sticks and telemetry.
            if packet(millis).is_multiple_of(2) {
                self.is_fresh = true;
            } else {
                self.waiting = self.waiting.saturating_sub(self.telemetry);
            }
        }
        if self.is_fresh && millis >= self.next_channels {
            (self.is_fresh, self.next_channels) = (false, millis + 10);
            self.sender.put(&mut bytes, ELRS, &channels(1, self.pulse));
        }
        if millis >= self.next_status {
            self.next_status = millis + 11;
            let txbuf = u8::try_from((Self::BUFFER - self.waiting) * 100 / Self::BUFFER).unwrap();
            let status = RadioStatus { rssi: 255, remrssi: 200, txbuf, noise: 9, ..RadioStatus::default() };
            self.sender.put(&mut bytes, ELRS, &status);
        }
        bytes
    }
}

/// What mLRS sends for the sticks: its setting "Rx Snd RcChannel".
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MlrsChannels {
    /// "rc override".
    Override,
    /// "rc channels".
    Radio,
}

/// mLRS. It addresses its messages to all, unless the autopilot is ArduPilot.
///
/// Channels are sent once a frame of the air link. A frame that was not received is sent again: RADIO_RC_CHANNELS says so. After
/// 1,250 ms without any, the receiver is disconnected. Then it sends nothing, or its failsafe values.
#[derive(Debug)]
pub struct Mlrs {
    pub channels: MlrsChannels,
    /// The period of the air link (ms): 9, 20, 32 or 53.
    pub period: u64,
    /// Whether the transmitter is received.
    pub is_connected: bool,
    /// Whether "Rx FailSafe Mode" is "low thr" instead of "no sig".
    pub has_failsafe_values: bool,
    /// The first channel (µs).
    pub pulse: u16,
    next: u64,
    next_status: u64,
    heard: u64,
    updated: u64,
    sender: Sender,
}

impl Mlrs {
    pub const TIMEOUT_MS: u64 = 1_250;

    /// A connected receiver at 50 Hz.
    pub fn new(channels: MlrsChannels) -> Self {
        Self {
            channels,
            period: 20,
            is_connected: true,
            has_failsafe_values: false,
            pulse: 1_500,
            next: 0,
            next_status: 1_000,
            heard: 0,
            updated: 0,
            sender: Sender::default(),
        }
    }

    /// The address from which it sends the sticks.
    pub fn address(&self) -> Address {
        if self.channels == MlrsChannels::Radio { MLRS } else { ELRS }
    }

    /// Returns what it writes at this time (ms).
    pub fn write(&mut self, millis: u64) -> Vec<u8> {
        let mut bytes = Vec::new();
        if self.is_connected {
            self.heard = millis;
        }
        let is_lost = millis - self.heard > Self::TIMEOUT_MS;
        if millis >= self.next {
            self.next = millis + self.period;
            if !is_lost || self.has_failsafe_values {
                self.put_channels(&mut bytes, millis, is_lost);
            }
        }
        if millis >= self.next_status {
            self.next_status = millis + 1_000;
            let status = RadioStatus { rssi: 90, remrssi: 90, txbuf: 50, ..RadioStatus::default() };
            self.sender.put(&mut bytes, MLRS, &status);
        }
        bytes
    }

    fn put_channels(&mut self, bytes: &mut Vec<u8>, millis: u64, is_lost: bool) {
        if self.channels == MlrsChannels::Override {
            return self.sender.put(bytes, ELRS, &channels(0, self.pulse));
        }
        let mut flags = RadioRcChannelsFlags::EMPTY;
        if self.is_connected {
            self.updated = millis;
        } else {
            flags |= RadioRcChannelsFlags::OUTDATED;
        }
        if is_lost {
            flags |= RadioRcChannelsFlags::FAILSAFE;
        }
        let mut channels = [0; 32];
        channels[0] = i16::try_from((i32::from(self.pulse) - 1_500) * 32 / 5).unwrap();
        let time_last_update_ms = u32::try_from(self.updated).unwrap();
        let message =
            RadioRcChannels { time_last_update_ms, flags, target_system: 0, target_component: 0, count: 16, channels };
        self.sender.put(bytes, MLRS, &message);
    }
}
