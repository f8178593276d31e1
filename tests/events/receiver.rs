//! A receiver of events that follows the rules of libevents' one (`libs/cpp/protocol/receive.h`), which QGroundControl and MAVSDK
//! use: it takes events in order, requests the next one as soon as it notices that one is missing, and again after 100 ms.

use crate::support::*;
use mavstack::dialect::{CurrentEventSequence, Event, MavEventCurrentSequenceFlags, RequestEvent, ResponseEventError};
use mavstack::{Address, Instant};

/// How long it waits for a requested event.
const TIMEOUT: mavstack::Duration = millis(100);

#[derive(Debug)]
pub struct Receiver {
    address: Address,
    /// The last event in order.
    latest: Option<u16>,
    /// The last CURRENT_EVENT_SEQUENCE.
    current: Option<u16>,
    last_ms: u32,
    timer: Option<Instant>,
    /// The number of received frames that it has looked at.
    seen: usize,
    /// The events, in order.
    pub events: Vec<Event>,
    /// The number of events that it knows to be lost.
    pub lost: u32,
    /// The number of its requests.
    pub requests: usize,
}

/// Whether `sequence` is newer than `than`.
fn is_newer(sequence: u16, than: u16) -> bool {
    (1..=u16::MAX / 2).contains(&sequence.wrapping_sub(than))
}

impl Receiver {
    pub const fn new(address: Address) -> Self {
        Self {
            address,
            latest: None,
            current: None,
            last_ms: 0,
            timer: None,
            seen: 0,
            events: Vec::new(),
            lost: 0,
            requests: 0,
        }
    }

    /// The ground station has forgotten what it has received.
    pub fn forgot(&mut self) {
        self.seen = 0;
    }

    /// Handles what has been received since the last call.
    pub fn poll(&mut self, now: Instant, gcs: &mut Gcs) {
        let fresh: Vec<_> = gcs.received.iter().skip(self.seen).cloned().collect();
        for frame in fresh {
            if let Some(event) = frame.decode() {
                self.on_event(now, gcs, &event);
            } else if let Some(current) = frame.decode() {
                self.on_current(now, gcs, &current);
            } else if let Some(error) = frame.decode() {
                self.on_error(now, gcs, &error);
            }
        }
        self.seen = gcs.received.len();
        if self.timer.is_some_and(|timer| timer <= now) {
            self.request(now, gcs);
        }
    }

    fn on_event(&mut self, now: Instant, gcs: &mut Gcs, event: &Event) {
        if event.event_time_boot_ms.saturating_add(10_000) < self.last_ms {
            (self.latest, self.current) = (None, None);
        }
        let latest = *self.latest.get_or_insert(event.sequence.wrapping_sub(1));
        if event.sequence != latest.wrapping_add(1) {
            if is_newer(event.sequence, latest) {
                self.request(now, gcs);
            }
            return;
        }
        (self.latest, self.last_ms, self.timer) = (Some(event.sequence), event.event_time_boot_ms, None);
        self.events.push(*event);
        if self.current.is_some_and(|current| is_newer(current, event.sequence)) {
            self.request(now, gcs);
        }
    }

    fn on_current(&mut self, now: Instant, gcs: &mut Gcs, current: &CurrentEventSequence) {
        if current.flags.contains(MavEventCurrentSequenceFlags::RESET) {
            self.latest = None;
        }
        let latest = *self.latest.get_or_insert(current.sequence);
        if is_newer(current.sequence, latest) {
            self.request(now, gcs);
        }
        self.current = Some(current.sequence);
    }

    fn on_error(&mut self, now: Instant, gcs: &mut Gcs, error: &ResponseEventError) {
        let to = Address::new(error.target_system, error.target_component);
        let next = self.latest.map(|latest| latest.wrapping_add(1));
        if to != self.address || next != Some(error.sequence) {
            return;
        }
        self.lost += u32::from(error.sequence_oldest_available.wrapping_sub(error.sequence));
        self.latest = Some(error.sequence_oldest_available.wrapping_sub(1));
        self.request(now, gcs);
    }

    /// Requests the next event.
    fn request(&mut self, now: Instant, gcs: &mut Gcs) {
        let next = self.latest.map_or(1, |latest| latest.wrapping_add(1));
        let (target_system, target_component) = (VEHICLE.system.wire(), VEHICLE.component.wire());
        let request = RequestEvent { first_sequence: next, last_sequence: next, target_system, target_component };
        gcs.send_from(self.address, &request);
        self.requests += 1;
        self.timer = Some(now + TIMEOUT);
    }
}
