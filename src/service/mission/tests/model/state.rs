//! A state of the model: the engine, the client, the frames on the line, and what may still go wrong.

use super::*;
use core::fmt::{self, Debug, Write};
use std::collections::BTreeSet;
use std::hash::DefaultHasher;
use std::string::String;

/// What a frame says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Msg {
    /// MISSION_COUNT.
    Count(u16),
    /// MISSION_ITEM_INT of the upload that is this task.
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

/// A frame on the line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Flying {
    pub(super) msg: Msg,
    pub(super) sent: Instant,
    /// The vehicle's have none: nobody looks at them.
    pub(super) number: Option<Number>,
    /// Others may overtake it.
    pub(super) is_late: bool,
}

/// All of it at one moment.
#[derive(Clone)]
pub(super) struct State {
    pub(super) bench: Bench,
    pub(super) client: Client,
    /// In the order in which they were sent.
    pub(super) line: Vec<Flying>,
    /// The sequence number of the client's last frame.
    pub(super) number: u8,
    /// Whether the client numbers its frames.
    pub(super) is_counting: bool,
    /// What may still go wrong.
    pub(super) faults: u8,
    /// What storage holds, where there is one.
    pub(super) stored: Vec<Item>,
    /// What tells this state from others.
    pub(super) key: u64,
}

impl State {
    pub(super) fn now(&self) -> Instant {
        self.bench.now
    }

    pub(super) fn live(&self) -> &[Item] {
        self.bench.live(PlanType::Mission).0
    }

    /// When the engine does something though nothing comes. MISSION_CURRENT is no part of the model.
    pub(super) fn engine_due(&self) -> Option<Instant> {
        let missions = &self.bench.missions;
        let upload = missions.upload.as_ref().map(Upload::deadline);
        let commit = missions.commit.as_ref().map(|_| missions.commit_deadline());
        let again = missions.again.as_ref().map(|(at, ..)| *at);
        [upload, commit, again].into_iter().flatten().min()
    }

    /// Whether the engine is at rest.
    pub(super) fn is_idle(&self) -> bool {
        let missions = &self.bench.missions;
        missions.upload.is_none() && missions.commit.is_none() && missions.again.is_none()
    }

    pub(super) fn fly(&mut self, msg: Msg) {
        let sent = self.now();
        self.number = self.number.wrapping_add(u8::from(self.is_counting && msg.is_to_vehicle()));
        let number = msg.is_to_vehicle().then_some(Number(A.link, self.number));
        self.line.push(Flying { msg, sent, number, is_late: false });
    }

    pub(super) fn remove(&mut self, flying: Flying) {
        let at = self.line.iter().position(|other| *other == flying).expect("it is on the line");
        self.line.remove(at);
    }

    /// Time goes by. Frames that were late for too long are lost.
    pub(super) fn wait_until(&mut self, at: Instant) {
        self.bench.now = at.max(self.bench.now);
        self.line.retain(|flying| at.since(flying.sent) <= LIFETIME);
    }

    /// A frame arrives.
    pub(super) fn arrive(&mut self, Flying { msg, number, .. }: Flying, op: Option<Op>) {
        self.bench.number = number.map_or(0, |number| number.1);
        match msg {
            Msg::Count(len) => self.bench.send(A, &count(MISSION, len.into())),
            Msg::Item { op, seq } => self.bench.send(A, &int(MISSION, seq.into(), &item(tag(op), seq))),
            Msg::Clear => self.bench.send(A, &clear(MISSION)),
            Msg::Nack => self.bench.send(A, &ack(MISSION, UNSUPPORTED)),
            Msg::OldRequest => {
                if matches!(self.client.phase, Phase::Uploading { .. }) {
                    self.fly(Msg::Nack);
                }
            }
            Msg::Request(seq) => {
                let reply = op.and_then(|op| self.client.on_request(self.now(), seq, op));
                reply.into_iter().for_each(|msg| self.fly(msg));
            }
            Msg::Ack(result) => {
                let result = MavMissionResult(result);
                let now = self.now();
                op.into_iter().for_each(|op| self.client.on_ack(now, result, op));
            }
        }
        self.after();
    }

    /// What the engine owes goes on the line.
    pub(super) fn after(&mut self) {
        self.bench.vehicle.changes.clear();
        self.bench.vehicle.asked.clear();
        for (_, _, out) in self.bench.drain() {
            self.fly(match out {
                Out::Ask(seq) => Msg::Request(seq),
                Out::AskLegacy(_) => Msg::OldRequest,
                Out::Ack(result, _) => Msg::Ack(result.0),
                other => panic!("{other:?}"),
            });
        }
    }

    /// Takes note of all that anybody's future depends on, times as they are from now; of sequence numbers their order. That
    /// leaves out counters and texts, downloads and MISSION_CURRENT, and the ids of plans, which follow from their items.
    pub(super) fn note(&mut self) {
        let Missions { upload, commit, saving, done, again, .. } = &self.bench.missions;
        let mut text = std::format!("{upload:?}{commit:?}{saving:?}{done:?}{again:?}{:?}", self.bench.replies);
        let mut line = self.line.clone();
        line.sort_by_key(|flying| {
            flying.is_late.then_some((flying.sent, flying.msg, flying.number.map(|number| number.1)))
        });
        let mut memory = self.bench.memory.clone();
        let staged = memory.parts(&mut Missions::new()).map(|(_, plans)| names(plans.staging.as_slice()));
        let plans = (names(self.live()), names(&self.stored), staged);
        // The ranks of the numbers do not show which of them the upload counts as its own COUNTs.
        let is_own = |flying: &Flying| {
            let counts = self.bench.missions.upload.as_ref().map(|upload| upload.counts);
            counts.zip(flying.number).is_some_and(|(counts, number)| counts.contains(number.1))
        };
        let own: Vec<bool> = line.iter().map(is_own).collect();
        write!(text, "{:?}{line:?}{own:?}{plans:?}{}", self.client, self.faults).expect("a String takes everything");
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

/// What tells the model's items apart: tag and number.
fn names(items: &[Item]) -> Vec<(f32, i32)> {
    items.iter().map(|item| (item.params[0], item.x - super::item(0, 0).x)).collect()
}

/// `text` with each instant as its distance from now (µs). What is longer ago than anything is remembered is equally long
/// ago.
fn relative(text: &str, now: Instant) -> String {
    const FORGOTTEN: i64 = -30_000_000;
    let mut parts = text.split("Instant(");
    let mut key = String::from(parts.next().unwrap_or_default());
    for part in parts {
        let (micros, rest) = part.split_once(')').expect("an instant ends");
        let micros: u64 = micros.parse().expect("an instant is a number");
        let distance = (micros as i64).saturating_sub(now.since(Instant::ZERO).as_micros() as i64);
        write!(key, "{}{rest}", distance.max(FORGOTTEN)).expect("a String takes everything");
    }
    key
}

/// `text` with each sequence number as its place in the order of those that are there, from `newest` on.
fn ranked(text: &str, newest: u8) -> String {
    let mut parts = text.split("Number(");
    let mut key = String::from(parts.next().unwrap_or_default());
    let parts = parts.map(|part| {
        let (link, rest) = part.split_once("), ").expect("a number follows the link");
        let (number, rest) = rest.split_once(')').expect("a number ends");
        let age = newest.wrapping_sub(number.parse().expect("a number is one"));
        (link, age, rest)
    });
    let ages: BTreeSet<u8> = parts.clone().map(|(_, age, _)| age).collect();
    for (link, age, rest) in parts {
        write!(key, "{link}{}{rest}", ages.range(..age).count()).expect("a String takes everything");
    }
    key
}

/// For the steps of a counterexample.
impl Debug for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let at = self.now().since(Instant::ZERO).as_millis();
        write!(f, "{at} ms: live {:?}, {:?}", names(self.live()), self.client)
    }
}
