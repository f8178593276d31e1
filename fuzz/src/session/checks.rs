//! The invariants of a session:
//!
//! - The vehicle sends only complete frames with valid checksums and consecutive sequence numbers (S-15).
//! - While the flight loop ticks and the link accepts output, heartbeats are in time (H-1).
//! - The satellite link carries only commands, their answers and HIGH_LATENCY2 (L-4).
//! - Frames are forwarded unchanged, and not to the only link on which they were received.
//! - A command is executed at most once. Each executed command is answered once, on its link (C-3, D-3).
//! - While a system is in control, no other one changes the vehicle, nor the plans (O-5, X-5).
//! - Answers count on links that carried the request; those of our own system's components, and what they tell, on links that trust it
//!
//! - No poll calls more than 32 hooks. What peers cause on the satellite link is within its budget (L-17).
//! - Whatever hostile peers have done, another one's requests are answered within 20 s: see `hostile.rs`.
//! - A live plan was uploaded completely. After a reboot it is the old plan or the new one (M-39, SEC-11).

use super::{Call, LINKS, SATELLITE, Tag, Uart, VEHICLE, parts, reference};
use mavstack::dialect::{
    CommandAck, CommandCancel, CommandInt, CommandLong, Common, GimbalDeviceAttitudeStatus, Heartbeat, HighLatency2,
    MavMissionType, MavResult,
};
use mavstack::message::{Dialect, SystemId};
use mavstack::{Address, Duration, Instant, Item, Message, PlanType};

/// The first of the command ids that are used only once.
pub const FIRST: u16 = 50_000;

/// A command that was sent once.
struct Unique {
    link: usize,
    calls: u32,
    acks: u32,
}

/// The observations so far.
pub struct Checks {
    is_durable: bool,
    /// Whether a write error was injected.
    pub has_faults: bool,
    ticked: Instant,
    /// Time of the last heartbeat on each link, or since when nothing prevents one.
    heartbeat: [Instant; LINKS],
    /// Sequence number of the vehicle's last frame on each link.
    seq: [Option<u8>; LINKS],
    commands: Vec<Unique>,
    /// Uploads that were started.
    pub tags: Vec<Tag>,
    live: [Vec<Item>; 3],
    /// The plans that were last known to be stored: the live ones, unless they could not be read after a reboot.
    stored: [Vec<Item>; 3],
    /// Number of forwarded frames.
    pub forwarded: u32,
    /// Number of reboots.
    pub restarts: u32,
    /// All plans that the vehicle was asked to check.
    candidates: [Vec<Vec<Item>>; 3],
    /// The links that carried a command to each component that the vehicle asks.
    carried: [[bool; LINKS]; 2],
    /// When the vehicle started, and the credits that forwarded frames have cost on the satellite link since then.
    started: Instant,
    pub credits: u64,
    /// Number of commands that were refused because another system was in control, and of answers and claims that counted.
    pub refused: u32,
    pub told: u32,
}

/// The components that the vehicle asks: another system's, for even tokens, and one of our own, for odd ones.
pub const ASKED: [Address; 2] = [Address::new(10, 1), Address::new(1, 154)];

/// The incompatibility flag of a signed frame.
const FLAG_SIGNED: u8 = 1;

/// The link on which components sign.
const SIGNED: usize = 3;
const PRIVATE: usize = 1;

/// Asserts that a poll has not called too many hooks.
pub fn assert_bounded(calls: &[Call]) {
    assert!(calls.len() <= 32, "{} hooks in a poll", calls.len());
}

/// Whether a line has received a message from this address.
fn has_received<M: Message>(line: &Uart, from: Address) -> bool {
    let [a, b, c, _] = M::ID.to_le_bytes();
    let (system, component) = (from.system.wire(), from.component.wire());
    line.history.windows(10).any(|window| match *window {
        [0xFD, _, _, _, _, s, k, x, y, z] => (s, k, [x, y, z]) == (system, component, [a, b, c]),
        [0xFE, _, _, s, k, id, ..] => (s, k, u32::from(id)) == (system, component, M::ID),
        _ => false,
    })
}

/// Whether a line has received a signed frame from this address, which is believed on every link.
fn has_signed(line: &Uart, from: Address) -> bool {
    let from = (from.system.wire(), from.component.wire());
    line.history.windows(7).any(|window| match *window {
        [0xFD, _, flags, _, _, system, component] => flags & FLAG_SIGNED != 0 && (system, component) == from,
        _ => false,
    })
}

fn index(plan: PlanType) -> usize {
    match plan {
        PlanType::Mission => 0,
        PlanType::Fence => 1,
        PlanType::Rally => 2,
    }
}

/// Compares items bitwise, so that NaN equals NaN.
fn same(a: &[Item], b: &[Item]) -> bool {
    let bits = |item: &Item| {
        let Item { frame, command, autocontinue, params: [a, b, c, d], x, y, z } = *item;
        (frame, command, autocontinue, [a, b, c, d, z].map(f32::to_bits), x, y)
    };
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| bits(a) == bits(b))
}

impl Checks {
    pub fn new(now: Instant, is_durable: bool) -> Self {
        Self {
            is_durable,
            has_faults: false,
            ticked: now,
            heartbeat: [now; LINKS],
            seq: [None; LINKS],
            commands: Vec::new(),
            tags: Vec::new(),
            live: Default::default(),
            stored: Default::default(),
            forwarded: 0,
            restarts: 0,
            candidates: Default::default(),
            carried: Default::default(),
            started: now,
            credits: 0,
            refused: 0,
            told: 0,
        }
    }

    /// Asserts that a call is one that its sender may cause, while `operator` is in control (O-5).
    pub fn assert_may(&self, call: &Call, operator: Option<SystemId>, lines: &[Uart; LINKS], is_private: bool) {
        let from = match call {
            Call::Command(command) => command.from,
            Call::MayChange(_, from) | Call::CancelCommand(_, from) | Call::SetExtParam(from) => *from,
            _ => return,
        };
        let Some(operator) = operator else { return };
        let link = usize::from(from.link.0);
        let is_ours = from.address.system == VEHICLE.system;
        let is_trusted = (link == PRIVATE && is_private) || link >= SIGNED || has_signed(&lines[link], from.address);
        let may = from.address.system == operator || (is_ours && is_trusted);
        assert!(may, "{call:?} while {operator:?} is in control");
    }

    /// Asserts that an answer or a claim came from where it counts.
    pub fn assert_asked(&mut self, call: &Call, lines: &[Uart; LINKS], is_private: bool) {
        match call {
            Call::Answered(token) => {
                let which = usize::from(token % 2);
                let is_answered = |link: usize| has_received::<CommandAck>(&lines[link], ASKED[which]);
                assert!((0..LINKS).any(|link| self.carried[which][link] && is_answered(link)), "{call:?}");
                self.told += 1;
            }
            Call::DeviceMoved => {
                let [_, gimbal] = ASKED;
                let is_told = |link: usize| has_received::<GimbalDeviceAttitudeStatus>(&lines[link], gimbal);
                let signs = |line| has_signed(line, gimbal);
                assert!((is_private && is_told(PRIVATE)) || is_told(SIGNED) || lines.iter().any(signs), "{call:?}");
                self.told += 1;
            }
            _ => {}
        }
    }

    pub fn ticked(&mut self, now: Instant) {
        self.ticked = now;
    }

    /// Returns the id of a command that will be sent once.
    pub fn new_command(&mut self, link: usize) -> u16 {
        self.commands.push(Unique { link, calls: 0, acks: 0 });
        FIRST + self.commands.len() as u16 - 1
    }

    /// Whether such a command was sent.
    pub fn has_commands(&self) -> bool {
        !self.commands.is_empty()
    }

    /// Returns how many of them were answered.
    #[cfg(test)]
    pub fn answered(&self) -> usize {
        self.commands.iter().filter(|unique| unique.acks > 0).count()
    }

    fn unique(&mut self, number: u16) -> Option<&mut Unique> {
        self.commands.get_mut(usize::from(number.checked_sub(FIRST)?))
    }

    /// Records a call of the vehicle's hooks.
    pub fn called(&mut self, call: &Call) {
        match call {
            Call::Command(command) => {
                if let Some(unique) = self.unique(command.id.0) {
                    unique.calls += 1;
                    assert_eq!((unique.calls, unique.link), (1, usize::from(command.from.link.0)), "{command:?}");
                }
            }
            Call::CheckPlan(plan, items) => self.candidates[index(*plan)].push(items.clone()),
            Call::PlanChanged { plan, items, .. } => {
                self.assert_complete(*plan, items);
                self.stored[index(*plan)].clone_from(items);
                self.live[index(*plan)].clone_from(items);
            }
            _ => {}
        }
    }

    /// Asserts that the items are those of one upload, complete and in order.
    fn assert_complete(&self, plan: PlanType, items: &[Item]) {
        let Some(first) = items.iter().find(|item| item.y >= Tag::Y) else { return };
        let number = first.y - Tag::Y;
        let tag = self.tags.iter().find(|tag| i32::from(tag.number) == number).expect("a started upload");
        let wanted = [MavMissionType::MISSION, MavMissionType::FENCE, MavMissionType::RALLY][index(plan)];
        assert_eq!((tag.plan, usize::from(tag.count)), (wanted, items.len()), "a part of an upload is live: {items:?}");
        for (seq, item) in (0..).zip(items) {
            assert_eq!((item.x, item.y - Tag::Y), (seq, number), "parts of two uploads are live: {items:?}");
        }
    }

    /// Asserts that the live plans are those reported to the vehicle.
    pub fn assert_live(&self, live: &[&[Item]; 3]) {
        for (ours, theirs) in self.live.iter().zip(live) {
            assert!(same(ours, theirs), "live but not reported: {theirs:?}; reported: {ours:?}");
        }
    }

    /// Records a reboot, after which these plans were found. `is_readable`: the storage could be read.
    pub fn restarted(&mut self, now: Instant, found: [Vec<Item>; 3], is_readable: bool) {
        let known = self.live.iter().zip(&self.stored);
        for ((found, (live, stored)), candidates) in found.iter().zip(known).zip(&self.candidates) {
            // Reading is repeated, so what could not be read may be found again.
            let is_old = same(found, live) || same(found, stored);
            let is_new = candidates.last().is_some_and(|new| same(found, new));
            let was_any = found.is_empty() || candidates.iter().any(|any| same(found, any));
            let is_bound = self.is_durable && !self.has_faults;
            // A plan may have been cleared.
            assert!(is_old || is_new || was_any && (!is_bound || found.is_empty()), "{found:?} after {live:?}");
        }
        if is_readable {
            self.stored.clone_from(&found);
        }
        self.live = found;
        self.restarts += 1;
        (self.started, self.credits) = (now, 0);
        self.heartbeat = [now; LINKS];
        self.seq = [None; LINKS];
        // Pending answers are lost with the reboot.
        for unique in &mut self.commands {
            unique.acks = unique.calls;
        }
    }

    /// Records a reset of a link, after which the next sequence number is unknown.
    pub fn restarted_link(&mut self, link: usize) {
        self.seq[link] = None;
    }

    /// Checks a frame that was sent.
    pub fn sent(&mut self, now: Instant, link: usize, frame: &[u8], lines: &[Uart; LINKS]) {
        let (source, id, payload) = parts(frame).expect("a complete frame");
        if let Some(row) = Common::MESSAGES.get(id) {
            let end = if frame[0] == 0xFD { 10 } else { 6 } + payload.len();
            let sum = reference::crc(&[&frame[1..end], &[row.crc_extra()]].concat());
            assert_eq!(frame[end..end + 2], sum.to_le_bytes(), "checksum of message {id}");
        }
        let for_satellites = [CommandAck::ID, CommandLong::ID, CommandInt::ID, CommandCancel::ID, HighLatency2::ID];
        assert!(link != SATELLITE || for_satellites.contains(&id), "message {id} by satellite");
        if source != VEHICLE {
            let came = |other: usize| lines[other].history.windows(frame.len()).any(|window| window == frame);
            assert!((0..LINKS).any(|other| other != link && came(other)), "message {id} returns on link {link}");
            self.forwarded += 1;
            if link == SATELLITE {
                self.credits += (frame.len() as u64).div_ceil(50);
                let most = 21 + (now - self.started).as_millis() / 60_000;
                assert!(self.credits <= most, "{} credits of {most}", self.credits);
            }
            return;
        }
        let seq = if frame[0] == 0xFD { frame[4] } else { frame[2] };
        if let Some(last) = self.seq[link].replace(seq) {
            assert_eq!(seq, last.wrapping_add(1), "message {id} on link {link}");
        }
        match id {
            Heartbeat::ID => {
                assert_ne!(link, SATELLITE);
                self.heartbeat[link] = now;
            }
            CommandLong::ID => {
                let command = CommandLong::decode(payload);
                let to = Address::new(command.target_system, command.target_component);
                if let Some(which) = ASKED.iter().position(|asked| *asked == to) {
                    self.carried[which][link] = true;
                }
            }
            CommandAck::ID => {
                let ack = CommandAck::decode(payload);
                if ack.result == MavResult::NOT_IN_CONTROL {
                    self.refused += 1;
                    return;
                }
                if let Some(unique) = self.unique(ack.command.0) {
                    unique.acks += 1;
                    assert!(unique.acks <= unique.calls && unique.link == link, "{ack:?} on link {link}");
                }
            }
            _ => {}
        }
    }

    /// Checks heartbeats after a poll. `is_free`: nothing prevents a heartbeat on this link.
    pub fn passed(&mut self, now: Instant, link: usize, dt: Duration, is_free: bool) {
        if !is_free || link == SATELLITE {
            self.heartbeat[link] = now;
            return;
        }
        // The tolerance is three polls: to finish a frame, for a vehicle that had no state, and for a late poll.
        let late = Duration::from_millis(1_100 + 3 * dt.as_millis());
        let since = now - self.heartbeat[link];
        assert!(since <= late, "no heartbeat on link {link} for {} ms", since.as_millis());
    }

    /// Checks that all pending answers were sent.
    pub fn finish(&self) {
        for (unique, number) in self.commands.iter().zip(FIRST..) {
            assert_eq!(unique.acks, unique.calls, "answers to command {number} on link {}", unique.link);
        }
    }
}
