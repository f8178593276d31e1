//! Uploads.

use super::items::{to_float_message, to_message};
use super::{Timing, ack_of, is_ardupilot, is_ours, refused, send_ack, target};
use crate::failure::plan_name;
use crate::{Client, Dialogue, Due, Failure, Io, Received, Retry};
use mavstack::dialect::{MavMissionResult, MissionCount, MissionItemInt, MissionRequest, MissionRequestInt};
use mavstack::{Item, PlanType};
use std::collections::BTreeSet;

/// MAVSDK fails a transfer in which one item is asked for more often.
const MAVSDK_RETRIES: u32 = 5;

/// Uploads a plan.
///
/// Ends with the id that the vehicle gave the plan (`opaque_id`); 0 if it has none.
#[derive(Clone, Debug)]
pub struct Upload {
    plan: PlanType,
    items: Vec<Item>,
    phase: Phase,
    /// The timer of the phase.
    retry: Option<Retry>,
    /// The items that were sent at least once.
    sent: BTreeSet<u16>,
    /// What MAVSDK counts: see [`MAVSDK_RETRIES`].
    retries: u32,
    /// The item that MAVSDK expects to be asked for, or one before.
    next: u16,
    end: Option<Result<u32, Failure>>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// MISSION_COUNT was not answered.
    Count,
    /// The vehicle asks for items.
    Items,
    /// MAVProxy has sent the last item, and waits for the end.
    Sent,
}

/// The two forms of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Form {
    Float,
    Int,
}

/// A request for an item.
struct Request {
    form: Form,
    seq: u16,
}

impl Upload {
    /// Creates the dialogue.
    pub fn new(plan: PlanType, items: &[Item]) -> Self {
        Self {
            plan,
            items: items.to_vec(),
            phase: Phase::Count,
            retry: None,
            sent: BTreeSet::new(),
            retries: 0,
            next: 0,
            end: None,
        }
    }

    fn count(&self) -> u16 {
        u16::try_from(self.items.len()).unwrap_or(u16::MAX)
    }

    fn send_count(&mut self, io: &mut Io<'_>) {
        let (target_system, target_component) = target(io);
        let mission_type = self.plan.mission_type();
        self.retries += 1;
        io.send(&MissionCount { count: self.count(), target_system, target_component, mission_type, opaque_id: 0 });
    }

    /// Returns the item to send.
    fn message(&self, io: &Io<'_>, seq: u16) -> Option<MissionItemInt> {
        self.items.get(usize::from(seq)).map(|item| to_message(item, seq, self.plan, target(io)))
    }

    fn send_item(&mut self, io: &mut Io<'_>, request: &Request) {
        let Some(message) = self.message(io, request.seq) else { return };
        match request.form {
            Form::Float if io.client() == Client::Pymavlink => io.send(&to_float_message(&message)),
            _ => io.send(&message),
        }
        self.sent.insert(request.seq);
        self.phase = Phase::Items;
        if io.client() == Client::MavProxy && request.seq + 1 == self.count() {
            self.phase = Phase::Sent;
        }
        // The next request or the end is awaited from now on.
        let Timing { wait, .. } = Timing::of(io.client());
        if let Some(retry) = &mut self.retry {
            match io.client() {
                Client::Mavsdk => retry.extend(io.now(), wait),
                _ => retry.finish(io.now(), wait),
            }
        }
    }

    fn request_of(&self, io: &Io<'_>, frame: &Received) -> Option<Request> {
        let (form, seq, mission_type, is_for_us) = if let Some(message) = frame.decode::<MissionRequestInt>() {
            let is_for_us = io.is_for_us(message.target_system, message.target_component);
            (Form::Int, message.seq, message.mission_type, is_for_us)
        } else {
            let message = frame.decode::<MissionRequest>()?;
            let is_for_us = io.is_for_us(message.target_system, message.target_component);
            (Form::Float, message.seq, message.mission_type, is_for_us)
        };
        // MAVSDK does not look at the plan type.
        let is_plan = mission_type == self.plan.mission_type() || io.client() == Client::Mavsdk;
        (is_plan && is_ours(io, frame, is_for_us)).then_some(Request { form, seq })
    }

    fn answer(&mut self, io: &mut Io<'_>, request: &Request) {
        match io.client() {
            Client::Mavsdk => self.answer_as_mavsdk(io, request),
            Client::MavProxy if self.phase == Phase::Sent => {}
            Client::QGroundControl if request.seq >= self.count() => {
                let what = format!("the vehicle asked for item {} of {}", request.seq, self.count());
                self.end = Some(Err(Failure::Protocol(what)));
            }
            _ => self.send_item(io, request),
        }
    }

    fn answer_as_mavsdk(&mut self, io: &mut Io<'_>, request: &Request) {
        if request.form == Form::Float && !is_ardupilot(io) {
            send_ack(io, self.plan, MavMissionResult::UNSUPPORTED);
            if let Some(retry) = &mut self.retry {
                retry.extend(io.now(), Timing::of(Client::Mavsdk).wait);
            }
            return;
        }
        self.phase = Phase::Items;
        if request.seq > self.next {
            return;
        }
        if request.seq == self.next {
            self.retries = 0;
        } else if self.retries >= MAVSDK_RETRIES {
            self.end = Some(Err(self.timeout()));
            return;
        }
        self.next = (request.seq + 1).min(self.count());
        self.retries += 1;
        self.send_item(io, request);
    }

    fn take_ack(&mut self, io: &Io<'_>, result: MavMissionResult, id: u32) {
        let is_whole = match io.client() {
            Client::Mavsdk => self.next == self.count(),
            _ => self.sent.len() == usize::from(self.count()),
        };
        self.end = Some(match result {
            MavMissionResult::ACCEPTED if is_whole => Ok(id),
            // QGroundControl and MAVSDK take that for an error.
            MavMissionResult::ACCEPTED => {
                Err(Failure::Protocol("the vehicle accepted the plan before it asked for all items".into()))
            }
            result => Err(refused(self.plan, self.sent.last().copied(), result)),
        });
    }

    fn timeout(&self) -> Failure {
        let name = plan_name(self.plan);
        let request = match (self.phase, self.sent.last()) {
            (Phase::Count, _) | (_, None) => format!("MISSION_COUNT of the {name}"),
            (_, Some(seq)) if seq + 1 < self.count() => format!("item {seq} of the {name}"),
            _ => format!("the last item of the {name}"),
        };
        Failure::timeout(request, self.retry.map_or(1, |retry| retry.tries()))
    }

    /// Handles a timeout of the items.
    fn item_timeout(&mut self, io: &Io<'_>) -> Option<Failure> {
        // MAVSDK only counts.
        if io.client() == Client::Mavsdk && self.retries < MAVSDK_RETRIES {
            self.retries += 1;
            self.retry.as_mut()?.extend(io.now(), Timing::of(Client::Mavsdk).wait);
            return None;
        }
        // QGroundControl sends MISSION_COUNT again only as long as no item was asked for.
        Some(self.timeout())
    }

    /// Returns why the client does not even begin.
    fn refuses(&self, client: Client) -> Option<Failure> {
        let is_empty = self.items.is_empty() && client == Client::Mavsdk;
        is_empty.then(|| Failure::Protocol("MAVSDK uploads no empty plan: clear it instead".into()))
    }
}

impl Dialogue for Upload {
    type Output = u32;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<u32, Failure>> {
        if let Some(failure) = self.refuses(io.client()) {
            return Some(Err(failure));
        }
        if let Some(end) = self.end.take() {
            return Some(end);
        }
        let timing = Timing::of(io.client());
        let retry = self.retry.get_or_insert(Retry::new(timing.wait, timing.tries));
        match (self.phase, io.now()) {
            (Phase::Count, now) => match retry.due(now) {
                Due::Wait => None,
                Due::Send => {
                    self.send_count(io);
                    None
                }
                Due::GiveUp => Some(Err(self.timeout())),
            },
            (_, now) if retry.is_waiting(now) => None,
            _ => self.item_timeout(io).map(Err),
        }
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        if self.retry.is_none() || self.end.is_some() {
            return;
        }
        if let Some(request) = self.request_of(io, frame) {
            self.answer(io, &request);
        } else if let Some(ack) = ack_of(io, frame, self.plan) {
            self.take_ack(io, ack.r#type, ack.opaque_id);
        }
    }
}
