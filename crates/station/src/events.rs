//! Events: received in order and without a gap, as [`Follow`] requests what is missing.
//!
//! QGroundControl and MAVSDK receive them by libevents (`protocol/receive.h`): the next event is requested by REQUEST_EVENT as soon as a
//! later one, or CURRENT_EVENT_SEQUENCE, shows that it is missing, and every 100 ms until it comes. Later events are dropped
//! meanwhile, and requested one by one. MAVProxy and pymavlink request nothing: they take what comes.

use crate::{Client, Dialogue, Failure, Io, Received};
use mavstack::dialect::{CurrentEventSequence, Event, MavEventCurrentSequenceFlags, RequestEvent, ResponseEventError};
use mavstack::{Duration, Instant};

/// After which time a missing event is requested again.
const AGAIN: Duration = Duration::from_millis(100);
/// A time since boot that is so much earlier than the last one is of another boot (ms).
const REBOOT: u32 = 10_000;

/// When a [`Follow`] ends.
#[derive(Clone, Copy, Debug)]
enum End {
    Never,
    After(Duration),
    Events(usize, Duration),
}

/// Receives events. Ends with them.
///
/// It never ends by default: it runs beside other dialogues, see [`alongside`](crate::GroundStation::alongside).
///
/// ```
/// use mavstack::Duration;
/// use mavstack_station::events::Follow;
/// let armed = Follow::new().until(1, Duration::from_secs(3));
/// # let _ = armed;
/// ```
#[derive(Debug)]
pub struct Follow {
    end: End,
    begin: Option<Instant>,
    events: Vec<Event>,
    lost: u32,
    /// The number of the last event received.
    latest: Option<u16>,
    /// The number in the last CURRENT_EVENT_SEQUENCE.
    current: Option<u16>,
    /// When the next event is requested again.
    due: Option<Instant>,
    /// The time of the last event (ms since boot).
    time: u32,
    requests: u32,
}

impl Default for Follow {
    fn default() -> Self {
        Self::new()
    }
}

impl Follow {
    /// Receives events without an end.
    pub fn new() -> Self {
        Self {
            end: End::Never,
            begin: None,
            events: Vec::new(),
            lost: 0,
            latest: None,
            current: None,
            due: None,
            time: 0,
            requests: 0,
        }
    }

    /// Ends after this time.
    #[must_use]
    pub fn for_time(mut self, time: Duration) -> Self {
        self.end = End::After(time);
        self
    }

    /// Ends when `count` events were received; fails if that takes longer than `limit`.
    #[must_use]
    pub fn until(mut self, count: usize, limit: Duration) -> Self {
        self.end = End::Events(count, limit);
        self
    }

    /// Returns the events received so far, in order.
    pub fn events(&self) -> &[Event] {
        &self.events
    }

    /// Returns the number of events that the vehicle did not have any more, or that a client without requests has missed.
    pub fn lost(&self) -> u32 {
        self.lost
    }

    /// Returns the number of REQUEST_EVENT sent.
    pub fn requests(&self) -> u32 {
        self.requests
    }

    fn request_next(&mut self, io: &mut Io<'_>) {
        let Some(latest) = self.latest.filter(|_| requests(io.client())) else { return };
        let (target, sequence) = (io.target(), latest.wrapping_add(1));
        io.send(&RequestEvent {
            first_sequence: sequence,
            last_sequence: sequence,
            target_system: target.system.wire(),
            target_component: target.component.wire(),
        });
        self.requests += 1;
        self.due = Some(io.now() + AGAIN);
    }

    fn take_event(&mut self, io: &mut Io<'_>, event: &Event) {
        if event.event_time_boot_ms.saturating_add(REBOOT) < self.time {
            (self.latest, self.current) = (None, None);
        }
        let latest = *self.latest.get_or_insert(event.sequence.wrapping_sub(1));
        let ahead = event.sequence.wrapping_sub(latest.wrapping_add(1));
        if ahead >= 0x8000 {
            return;
        }
        if ahead > 0 {
            if requests(io.client()) {
                return self.request_next(io);
            }
            self.lost += u32::from(ahead);
        }
        (self.latest, self.time, self.due) = (Some(event.sequence), event.event_time_boot_ms, None);
        if self.current.is_some_and(|current| is_newer(current, event.sequence)) {
            self.request_next(io);
        }
        if io.is_for_us(event.destination_system, event.destination_component) {
            self.events.push(*event);
        }
    }

    fn take_current(&mut self, io: &mut Io<'_>, message: &CurrentEventSequence) {
        if message.flags.contains(MavEventCurrentSequenceFlags::RESET) {
            self.latest = None;
        }
        let latest = *self.latest.get_or_insert(message.sequence);
        self.current = Some(message.sequence);
        if is_newer(message.sequence, latest) {
            self.request_next(io);
        }
    }

    fn take_error(&mut self, io: &mut Io<'_>, error: &ResponseEventError) {
        let Some(latest) = self.latest else { return };
        if error.sequence != latest.wrapping_add(1) || !io.is_for_us(error.target_system, error.target_component) {
            return;
        }
        let before_oldest = error.sequence_oldest_available.wrapping_sub(1);
        self.lost += u32::from(before_oldest.wrapping_sub(latest));
        self.latest = Some(before_oldest);
        self.request_next(io);
    }
}

fn requests(client: Client) -> bool {
    matches!(client, Client::QGroundControl | Client::Mavsdk)
}

/// Whether a number comes after `other`. Numbers wrap.
fn is_newer(number: u16, other: u16) -> bool {
    (1..0x8000).contains(&number.wrapping_sub(other))
}

impl Dialogue for Follow {
    type Output = Vec<Event>;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Vec<Event>, Failure>> {
        let begin = *self.begin.get_or_insert(io.now());
        if self.due.is_some_and(|due| io.now() >= due) {
            self.request_next(io);
        }
        match self.end {
            End::Events(count, _) if self.events.len() >= count => {}
            End::Events(count, limit) if io.now() - begin >= limit => {
                return Some(Err(Failure::timeout(format!("event {} of {count}", self.events.len() + 1), 1)));
            }
            End::After(time) if io.now() - begin >= time => {}
            _ => return None,
        }
        Some(Ok(std::mem::take(&mut self.events)))
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        if frame.source() != io.target() {
            return;
        }
        if let Some(event) = frame.decode() {
            self.take_event(io, &event);
        } else if let Some(message) = frame.decode() {
            self.take_current(io, &message);
        } else if let Some(error) = frame.decode() {
            self.take_error(io, &error);
        }
    }
}
