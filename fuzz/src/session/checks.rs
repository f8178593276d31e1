//! What must hold, whatever happens:
//!
//! - All that leaves is whole frames with right checksums, numbered without a gap (S-15).
//! - A heartbeat is never late on a free line while the flight loop ticks, and none begins half a second after it stopped (H-1,
//!   H-5).
//! - A satellite gets commands, their answers and HIGH_LATENCY2 only (L-4).
//! - A frame of others leaves as it came, and by no link that it only came by.
//! - A command is carried out once at most, and each that was carried out is answered once, on its link (C-3, D-3).
//! - A plan that is live is one that was uploaded whole, and after a restart it is the old one or the new (M-39, SEC-11).

use super::{Call, LINKS, SATELLITE, Tag, Uart, VEHICLE, parts, reference};
use mavstack::dialect::{
    CommandAck, CommandCancel, CommandInt, CommandLong, Common, Heartbeat, HighLatency2, MavMissionType,
};
use mavstack::{Dialect, Duration, Instant, Item, Message, PlanType};

/// Numbers of commands that only this gives out begin here.
pub const FIRST: u16 = 50_000;

/// A command that was given once.
struct Unique {
    link: usize,
    calls: u32,
    acks: u32,
}

/// What was seen so far.
pub struct Checks {
    is_durable: bool,
    /// The flash refused something.
    pub has_faults: bool,
    ticked: Instant,
    /// Since when nothing holds back a heartbeat, or there was one.
    heartbeat: [Instant; LINKS],
    /// Of the last frame of our own.
    seq: [Option<u8>; LINKS],
    commands: Vec<Unique>,
    /// Uploads that were begun.
    pub tags: Vec<Tag>,
    live: [Vec<Item>; 3],
    /// Frames of others that left, and restarts.
    pub forwarded: u32,
    pub restarts: u32,
    /// All that the vehicle was asked about as a whole.
    candidates: [Vec<Vec<Item>>; 3],
}

fn index(plan: PlanType) -> usize {
    match plan {
        PlanType::Mission => 0,
        PlanType::Fence => 1,
        PlanType::Rally => 2,
    }
}

/// NaN is equal to NaN here.
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
            forwarded: 0,
            restarts: 0,
            candidates: Default::default(),
        }
    }

    pub fn ticked(&mut self, now: Instant) {
        self.ticked = now;
    }

    /// The number of a command that will be given once.
    pub fn new_command(&mut self, link: usize) -> u16 {
        self.commands.push(Unique { link, calls: 0, acks: 0 });
        FIRST + self.commands.len() as u16 - 1
    }

    /// Whether there was one.
    pub fn has_commands(&self) -> bool {
        !self.commands.is_empty()
    }

    /// How many of them were answered.
    #[cfg(test)]
    pub fn answered(&self) -> usize {
        self.commands.iter().filter(|unique| unique.acks > 0).count()
    }

    fn unique(&mut self, number: u16) -> Option<&mut Unique> {
        self.commands.get_mut(usize::from(number.checked_sub(FIRST)?))
    }

    /// The stack has called the vehicle.
    pub fn called(&mut self, call: Call) {
        match call {
            Call::Command(command) => {
                if let Some(unique) = self.unique(command.id.0) {
                    unique.calls += 1;
                    assert_eq!((unique.calls, unique.link), (1, usize::from(command.from.link.0)), "{command:?}");
                }
            }
            Call::CheckPlan(plan, items) => self.candidates[index(plan)].push(items),
            Call::PlanChanged { plan, items, .. } => {
                self.is_whole(plan, &items);
                self.live[index(plan)] = items;
            }
            _ => {}
        }
    }

    /// All items are of one upload, all of them, in their order.
    fn is_whole(&self, plan: PlanType, items: &[Item]) {
        let Some(first) = items.iter().find(|item| item.y >= Tag::Y) else { return };
        let number = first.y - Tag::Y;
        let tag = self.tags.iter().find(|tag| i32::from(tag.number) == number).expect("an upload that was begun");
        let wanted = [MavMissionType::MISSION, MavMissionType::FENCE, MavMissionType::RALLY][index(plan)];
        assert_eq!((tag.plan, usize::from(tag.count)), (wanted, items.len()), "a part of an upload is live: {items:?}");
        for (seq, item) in (0..).zip(items) {
            assert_eq!((item.x, item.y - Tag::Y), (seq, number), "parts of two uploads are live: {items:?}");
        }
    }

    /// What the stack says is live, is what the vehicle was told.
    pub fn is_live(&self, live: &[&[Item]; 3]) {
        for (ours, theirs) in self.live.iter().zip(live) {
            assert!(same(ours, theirs), "live without a word: {theirs:?}, not {ours:?}");
        }
    }

    /// The vehicle started anew, with these plans.
    pub fn restarted(&mut self, now: Instant, found: [Vec<Item>; 3]) {
        for ((found, live), candidates) in found.iter().zip(&self.live).zip(&self.candidates) {
            let is_old = same(found, live);
            let is_new = candidates.last().is_some_and(|new| same(found, new));
            let was_any = found.is_empty() || candidates.iter().any(|any| same(found, any));
            let is_bound = self.is_durable && !self.has_faults;
            // A plan may have been cleared.
            assert!(is_old || is_new || was_any && (!is_bound || found.is_empty()), "{found:?} after {live:?}");
        }
        self.live = found;
        self.restarts += 1;
        self.heartbeat = [now; LINKS];
        self.seq = [None; LINKS];
        // Who had no answer yet gets none.
        for unique in &mut self.commands {
            unique.acks = unique.calls;
        }
    }

    /// Which frame comes first now is not known.
    pub fn restarted_link(&mut self, link: usize) {
        self.seq[link] = None;
    }

    /// A frame has left.
    pub fn sent(&mut self, now: Instant, link: usize, frame: &[u8], lines: &[Uart; LINKS]) {
        let (source, id, payload) = parts(frame).expect("a whole frame");
        if let Some(row) = Common::MESSAGES.get(id) {
            let end = if frame[0] == 0xFD { 10 } else { 6 } + payload.len();
            let sum = reference::crc(&[&frame[1..end], &[row.crc_extra()]].concat());
            assert_eq!(frame[end..end + 2], sum.to_le_bytes(), "checksum of message {id}");
        }
        let for_satellites = [CommandAck::ID, CommandLong::ID, CommandInt::ID, CommandCancel::ID, HighLatency2::ID];
        assert!(link != SATELLITE || for_satellites.contains(&id), "message {id} by satellite");
        if source != VEHICLE {
            let came = |other: usize| lines[other].history.windows(frame.len()).any(|window| window == frame);
            assert!((0..LINKS).any(|other| other != link && came(other)), "message {id} goes back by link {link}");
            self.forwarded += 1;
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
            CommandAck::ID => {
                let ack = CommandAck::decode(payload);
                if let Some(unique) = self.unique(ack.command.0) {
                    unique.acks += 1;
                    assert!(unique.acks <= unique.calls && unique.link == link, "{ack:?} on link {link}");
                }
            }
            _ => {}
        }
    }

    /// A poll is over. `is_well`: nothing holds back a heartbeat on this link.
    pub fn passed(&mut self, now: Instant, link: usize, dt: Duration, is_well: bool) {
        if !is_well || link == SATELLITE {
            self.heartbeat[link] = now;
            return;
        }
        // A poll for the end of a frame, one for the vehicle that was ill, and how late a poll may be.
        let late = Duration::from_millis(1_100 + 3 * dt.as_millis());
        let since = now.since(self.heartbeat[link]);
        assert!(since <= late, "no heartbeat on link {link} for {} ms", since.as_millis());
    }

    /// All is over, and everything that was owed has gone out.
    pub fn finish(&self) {
        for (unique, number) in self.commands.iter().zip(FIRST..) {
            assert_eq!(unique.acks, unique.calls, "answers to command {number} on link {}", unique.link);
        }
    }
}
