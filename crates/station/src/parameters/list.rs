//! The whole list of parameters.

use super::{Parameter, is_from_target, parameter_of};
use crate::{Client, Dialogue, Due, Failure, Io, Received, Retry};
use mavstack::dialect::{ParamRequestList, ParamRequestRead, ParamValue};
use mavstack::message::Text;
use mavstack::{Duration, Instant};
use std::collections::{BTreeMap, BTreeSet};

/// How long without a new value a client that never gives up is waited for.
const NO_PROGRESS: Duration = Duration::from_secs(60);

/// Downloads all parameters, and asks for those that were lost, as the client does.
///
/// MAVSDK and MAVProxy never give up once they have a value: the dialogue ends after 60 s without a new one.
#[derive(Clone, Debug, Default)]
pub struct List {
    values: BTreeMap<u16, Parameter>,
    count: Option<u16>,
    /// The requests of the list.
    request: Option<Retry>,
    gaps: Gaps,
}

/// The requests of lost values.
#[derive(Clone, Debug, Default)]
struct Gaps {
    /// The indices that were asked for and not answered.
    asked: BTreeSet<u16>,
    /// How often each index was asked for.
    tries: BTreeMap<u16, u32>,
    /// The last index of the batch: MAVSDK asks for the next batch when it comes.
    last_asked: Option<u16>,
    /// When the silence is long enough to ask.
    due: Instant,
    /// When a new value was received.
    progress: Instant,
    has_begun: bool,
}

/// How a client asks for gaps.
struct Style {
    /// Silence until the first request.
    first: Duration,
    /// Silence until the next request.
    next: Duration,
    /// The number of requests in a batch.
    batch: usize,
    /// How often each index is asked for.
    tries: u32,
}

impl Style {
    fn of(client: Client) -> Self {
        let (first, next, batch, tries) = match client {
            // Its batch is one more than the 10 that it means.
            Client::QGroundControl => (3_000, 3_000, 11, 5),
            Client::Mavsdk => (2_000, 500, 10, u32::MAX),
            Client::MavProxy => (1_000, 1_000, 10, u32::MAX),
            // As DroneKit: `mavutil` leaves it to the script.
            Client::Pymavlink => (200, 5_000, 51, u32::MAX),
        };
        Self { first: Duration::from_millis(first), next: Duration::from_millis(next), batch, tries }
    }
}

impl List {
    /// Creates the dialogue.
    pub fn new() -> Self {
        Self::default()
    }

    fn timer(client: Client) -> Retry {
        match client {
            Client::QGroundControl => Retry::new(Duration::from_secs(5), 5),
            Client::Mavsdk => Retry::new(Duration::from_secs(2), 6),
            // It asks for ever.
            Client::MavProxy => Retry::new(Duration::from_secs(2), 15),
            Client::Pymavlink => Retry::new(client.patience(), 1),
        }
    }

    fn request(io: &mut Io<'_>) {
        let target = io.target();
        // QGroundControl asks all components.
        let target_component = if io.client() == Client::QGroundControl { 0 } else { target.component.wire() };
        io.send(&ParamRequestList { target_system: target.system.wire(), target_component });
    }

    /// Returns the indices that are missing.
    fn missing(&self) -> impl Iterator<Item = u16> {
        (0..self.count.unwrap_or(0)).filter(|index| !self.values.contains_key(index))
    }

    fn is_complete(&self) -> bool {
        self.count.is_some() && self.missing().next().is_none()
    }

    /// Asks for the next missing values, up to a full batch. Returns false if one of them was asked for too often.
    fn ask(&mut self, io: &mut Io<'_>, style: &Style) -> bool {
        let missing: Vec<u16> = self.missing().filter(|index| !self.gaps.asked.contains(index)).collect();
        let room = style.batch.saturating_sub(self.gaps.asked.len());
        for index in missing.into_iter().take(room) {
            let tries = self.gaps.tries.entry(index).or_default();
            *tries += 1;
            if *tries > style.tries {
                return false;
            }
            self.gaps.asked.insert(index);
            self.gaps.last_asked = Some(index);
            request_by_index(io, index);
        }
        true
    }

    fn give_up(&self) -> Failure {
        let missing: Vec<String> = self.missing().take(10).map(|index| index.to_string()).collect();
        let request = format!("the request of the parameters with the indices {}", missing.join(", "));
        Failure::timeout(request, self.gaps.tries.values().copied().max().unwrap_or(0))
    }
}

/// Sends a PARAM_REQUEST_READ by index.
fn request_by_index(io: &mut Io<'_>, index: u16) {
    let target = io.target();
    // DroneKit addresses all components.
    let is_broadcast = io.client() == Client::Pymavlink;
    let (target_system, target_component) =
        if is_broadcast { (0, 0) } else { (target.system.wire(), target.component.wire()) };
    let param_index = i16::try_from(index).unwrap_or(i16::MAX);
    io.send(&ParamRequestRead { param_index, target_system, target_component, param_id: Text::EMPTY });
}

impl Dialogue for List {
    type Output = Vec<Parameter>;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Vec<Parameter>, Failure>> {
        if self.is_complete() {
            return Some(Ok(std::mem::take(&mut self.values).into_values().collect()));
        }
        let style = Style::of(io.client());
        if self.count.is_none() {
            let retry = self.request.get_or_insert_with(|| Self::timer(io.client()));
            return match retry.due(io.now()) {
                Due::Wait => None,
                Due::Send => {
                    Self::request(io);
                    None
                }
                Due::GiveUp => Some(Err(Failure::timeout("PARAM_REQUEST_LIST", retry.tries()))),
            };
        }
        if io.now() - self.gaps.progress >= NO_PROGRESS {
            return Some(Err(self.give_up()));
        }
        if io.now() >= self.gaps.due {
            self.gaps.has_begun = true;
            self.gaps.due = io.now() + style.next;
            self.gaps.asked.clear();
            if !self.ask(io, &style) {
                return Some(Err(self.give_up()));
            }
        }
        None
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        let Some(message) = frame.decode::<ParamValue>().filter(|_| is_from_target(io, frame)) else { return };
        // A value that the vehicle sends by itself has no index, and PX4 sends a hash.
        if message.param_index == u16::MAX || message.param_index >= message.param_count {
            return;
        }
        self.count = Some(message.param_count);
        let style = Style::of(io.client());
        if self.values.insert(message.param_index, parameter_of(io, &message)).is_none() {
            self.gaps.progress = io.now();
        }
        self.gaps.due = io.now() + if self.gaps.has_begun { style.next } else { style.first };
        let was_asked = self.gaps.asked.remove(&message.param_index);
        let asks_more = self.gaps.has_begun
            && match io.client() {
                Client::QGroundControl => was_asked,
                Client::Mavsdk => self.gaps.last_asked == Some(message.param_index),
                Client::MavProxy => was_asked && self.gaps.asked.is_empty(),
                Client::Pymavlink => false,
            };
        if asks_more {
            if io.client() == Client::Mavsdk {
                self.gaps.asked.clear();
            }
            // A failure shows at the next timeout.
            self.ask(io, &style);
        }
    }
}
