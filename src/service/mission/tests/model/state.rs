//! A state of the model: the engine, the client, the frames in transit, and the faults that may still occur.

use super::*;
use core::fmt::{self, Debug, Write};
use core::num::Wrapping;
use std::collections::BTreeSet;
use std::hash::DefaultHasher;
use std::string::String;

/// The content of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Msg {
    /// MISSION_COUNT.
    Count(u16),
    /// MISSION_ITEM_INT of the upload of this task.
    Item { op: usize, seq: u16 },
    /// MISSION_CLEAR_ALL.
    Clear,
    /// MISSION_ACK that refuses a MISSION_REQUEST.
    Nack,
    /// MISSION_REQUEST_INT.
    Request(u16),
    /// MISSION_REQUEST.
    OldRequest,
    /// MISSION_ACK.
    Ack(u8),
}

impl Msg {
    pub(super) fn is_to_vehicle(self) -> bool {
        matches!(self, Msg::Count(_) | Msg::Item { .. } | Msg::Clear | Msg::Nack)
    }
}

/// A frame in transit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct InTransit {
    pub(super) msg: Msg,
    pub(super) sent: Instant,
    /// `None` for frames of the vehicle, whose numbers do not matter.
    pub(super) number: Option<FrameNumber>,
    /// Others may overtake it.
    pub(super) is_delayed: bool,
}

/// A state of the model.
#[derive(Clone)]
pub(super) struct State {
    pub(super) bench: Bench,
    pub(super) client: Client,
    /// The frames in transit, in the order of sending.
    pub(super) in_transit: Vec<InTransit>,
    /// The sequence number of the client's last frame.
    pub(super) number: u8,
    /// Whether the client numbers its frames.
    pub(super) is_counting: bool,
    /// Number of faults that may still occur.
    pub(super) faults: u8,
    /// The content of storage, if it is attached.
    pub(super) stored: Vec<Item>,
    /// The hash that identifies this state.
    pub(super) key: u64,
}

impl State {
    pub(super) fn now(&self) -> Instant {
        self.bench.now
    }

    pub(super) fn live(&self) -> &[Item] {
        self.bench.live(PlanType::Mission).0
    }

    /// When the engine's next timer is due. MISSION_CURRENT is not part of the model.
    pub(super) fn engine_due(&self) -> Option<Instant> {
        let missions = &self.bench.missions;
        let transfer = match &missions.transfer {
            Transfer::Idle => None,
            Transfer::Upload(_) => Some(missions.upload_deadline()),
            Transfer::Commit(_) => Some(missions.commit_deadline()),
        };
        let second_answer = missions.second_answer.as_ref().map(|second| second.at);
        transfer.into_iter().chain(second_answer).min()
    }

    /// Whether the engine is idle.
    pub(super) fn is_idle(&self) -> bool {
        let missions = &self.bench.missions;
        matches!(missions.transfer, Transfer::Idle) && missions.second_answer.is_none()
    }

    pub(super) fn send(&mut self, msg: Msg) {
        let sent = self.now();
        self.number = self.number.wrapping_add(u8::from(self.is_counting && msg.is_to_vehicle()));
        let number = msg.is_to_vehicle().then_some(FrameNumber { link: A.link, seq: Wrapping(self.number) });
        self.in_transit.push(InTransit { msg, sent, number, is_delayed: false });
    }

    pub(super) fn remove(&mut self, frame: InTransit) {
        let at = self.in_transit.iter().position(|other| *other == frame).expect("it is in transit");
        self.in_transit.remove(at);
    }

    /// Advances the time. Frames that are delayed for too long are lost.
    pub(super) fn wait_until(&mut self, at: Instant) {
        self.bench.now = at.max(self.bench.now);
        self.in_transit.retain(|frame| at - frame.sent <= LIFETIME);
    }

    /// Delivers a frame.
    pub(super) fn deliver(&mut self, InTransit { msg, number, .. }: InTransit, op: Option<Op>) {
        self.bench.number = number.map_or(0, |number| number.seq.0);
        match msg {
            Msg::Count(len) => self.bench.send(A, &count(MISSION, len.into())),
            Msg::Item { op, seq } => self.bench.send(A, &int(MISSION, seq.into(), &item(tag(op), seq))),
            Msg::Clear => self.bench.send(A, &clear(MISSION)),
            Msg::Nack => self.bench.send(A, &ack(MISSION, UNSUPPORTED)),
            Msg::OldRequest => {
                if matches!(self.client.phase, Phase::Uploading { .. }) {
                    self.send(Msg::Nack);
                }
            }
            Msg::Request(seq) => {
                let reply = op.and_then(|op| self.client.on_request(self.now(), seq, op));
                reply.into_iter().for_each(|msg| self.send(msg));
            }
            Msg::Ack(result) => {
                let result = MavMissionResult(result);
                let now = self.now();
                op.into_iter().for_each(|op| self.client.on_ack(now, result, op));
            }
        }
        self.after();
    }

    /// Sends the pending messages of the engine.
    pub(super) fn after(&mut self) {
        self.bench.vehicle.changes.clear();
        self.bench.vehicle.asked.clear();
        for (_, _, out) in self.bench.drain() {
            self.send(match out {
                Out::Ask(seq) => Msg::Request(seq),
                Out::AskLegacy(_) => Msg::OldRequest,
                Out::Ack(result, _) => Msg::Ack(result.0),
                other => panic!("{other:?}"),
            });
        }
    }

    /// Hashes everything that the future depends on: times relative to now, and the order of sequence numbers. Not included are
    /// counters, texts, downloads, MISSION_CURRENT, and the ids of plans, which follow from their items.
    pub(super) fn rehash(&mut self) {
        let Missions { transfer, schedule, finished, second_answer, .. } = &self.bench.missions;
        let mut text = std::format!("{transfer:?}{schedule:?}{finished:?}{second_answer:?}{:?}", self.bench.replies);
        let mut frames = self.in_transit.clone();
        frames.sort_by_key(|frame| {
            frame.is_delayed.then_some((frame.sent, frame.msg, frame.number.map(|number| number.seq)))
        });
        let mut memory = self.bench.memory.clone();
        let staged = names(memory.view().staged_items());
        let plans = (names(self.live()), names(&self.stored), staged);
        // The order of the numbers does not show which of them belong to the upload's COUNTs.
        let is_own = |frame: &InTransit| {
            let Transfer::Upload(upload) = &self.bench.missions.transfer else { return false };
            frame.number.is_some_and(|number| upload.counts.contains(number.seq))
        };
        let own: Vec<bool> = frames.iter().map(is_own).collect();
        write!(text, "{:?}{frames:?}{own:?}{plans:?}{}", self.client, self.faults).expect("a String takes everything");
        let mut hasher = DefaultHasher::new();
        ranked(&relative(&text, self.now()), self.number).hash(&mut hasher);
        self.key = hasher.finish();
    }
}

impl PartialEq for State {
    fn eq(&self, other: &Self) -> bool {
        self.key == other.key
    }
}

impl Hash for State {
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        self.key.hash(hasher);
    }
}

/// Returns the tag and the sequence number, which identify the model's items.
fn names(items: &[Item]) -> Vec<(f32, i32)> {
    items.iter().map(|item| (item.params[0], item.x - super::item(0, 0).x)).collect()
}

/// Returns `text` with each instant replaced by its distance from now (µs). Instants that are older than any timeout become
/// equal.
fn relative(text: &str, now: Instant) -> String {
    const FORGOTTEN: i64 = -30_000_000;
    let mut parts = text.split("Instant(");
    let mut key = String::from(parts.next().unwrap_or_default());
    for part in parts {
        let (micros, rest) = part.split_once(')').expect("an instant ends");
        let micros: u64 = micros.parse().expect("an instant is a number");
        let distance = (micros as i64).saturating_sub((now - Instant::ZERO).as_micros() as i64);
        write!(key, "{}{rest}", distance.max(FORGOTTEN)).expect("a String takes everything");
    }
    key
}

/// Returns `text` with each sequence number replaced by its rank, counted from `newest`.
fn ranked(text: &str, newest: u8) -> String {
    let mut parts = text.split("seq: Wrapping(");
    let mut key = String::from(parts.next().unwrap_or_default());
    let parts = parts.map(|part| {
        let (number, rest) = part.split_once(')').expect("a number ends");
        let age = newest.wrapping_sub(number.parse().expect("a number is digits"));
        (age, rest)
    });
    let ages: BTreeSet<u8> = parts.clone().map(|(age, _)| age).collect();
    for (age, rest) in parts {
        write!(key, "{}{rest}", ages.range(..age).count()).expect("a String takes everything");
    }
    key
}

/// For the steps of a counterexample.
impl Debug for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let at = (self.now() - Instant::ZERO).as_millis();
        write!(f, "{at} ms: live {:?}, {:?}", names(self.live()), self.client)
    }
}
