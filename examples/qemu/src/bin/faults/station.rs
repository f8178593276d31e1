//! Who is on the ground: those who upload, those who ask, those who flood.

use mavstack::dialect::{
    AutopilotVersion, CommandAck, CommandLong, MavCmd, MavMissionResult, MissionAck, MissionCount, MissionItemInt,
    MissionRequestInt, ParamValue, Ping,
};
use mavstack::{Address, Duration, Instant, LinkId, Message};

use crate::world::{Air, Ear, Heard, VEHICLE, World, item_of};

/// Somebody who uploads a mission, as ground stations do: MISSION_COUNT until it is asked for an item, then what it is asked for.
pub struct Upload {
    link: LinkId,
    from: Address,
    count: u16,
    variant: u16,
    /// It falls silent when it has sent so many items.
    dies_after: u16,
    pub is_dead: bool,
    /// It was asked for an item.
    pub is_asked: bool,
    /// So many items were sent, each counted once.
    sent: u16,
    due: Instant,
    pub result: Option<MavMissionResult>,
}

impl Upload {
    pub fn new(link: LinkId, from: Address, count: u16, variant: u16) -> Self {
        Self {
            link,
            from,
            count,
            variant,
            dies_after: u16::MAX,
            is_dead: false,
            is_asked: false,
            sent: 0,
            due: Instant::ZERO,
            result: None,
        }
    }

    pub fn dying_after(mut self, items: u16) -> Self {
        self.dies_after = items;
        self
    }

    /// So many items were sent, each counted once.
    pub fn items_sent(&self) -> u16 {
        self.sent
    }

    /// Goes on until its end.
    pub fn finish(&mut self, world: &mut World) -> MavMissionResult {
        let end = world.now.after(Duration::from_secs(30));
        while self.result.is_none() {
            assert!(world.now < end, "an upload of {} items has no end: {} are sent", self.count, self.sent);
            world.pass(&mut [self]);
        }
        self.result.unwrap_or(MavMissionResult::ERROR)
    }

    /// Goes on until it is dead.
    pub fn die(&mut self, world: &mut World) {
        let end = world.now.after(Duration::from_secs(30));
        while !self.is_dead {
            assert!(world.now < end && self.result.is_none(), "it was to die after {} items", self.dies_after);
            world.pass(&mut [self]);
        }
    }
}

impl Ear for Upload {
    fn hear(&mut self, heard: &Heard<'_>, air: &mut Air) {
        if self.is_dead || self.result.is_some() || heard.link != self.link {
            return;
        }
        let is_ours = |system, component| Address::new(system, component) == self.from;
        if let Some(request) = heard.get::<MissionRequestInt>()
            && is_ours(request.target_system, request.target_component)
        {
            self.is_asked = true;
            if request.seq >= self.dies_after {
                self.is_dead = true;
                return;
            }
            self.sent = self.sent.max(request.seq + 1);
            self.due = heard.now.after(Duration::from_secs(1));
            air.send(self.link, self.from, &item_of(request.seq, self.variant));
            self.is_dead = self.sent == self.count && self.dies_after == self.count;
        } else if let Some(ack) = heard.get::<MissionAck>()
            && is_ours(ack.target_system, ack.target_component)
        {
            self.result = Some(ack.r#type);
        }
    }

    fn tick(&mut self, now: Instant, air: &mut Air) {
        if self.is_dead || self.result.is_some() || now < self.due {
            return;
        }
        self.due = now.after(Duration::from_millis(500));
        if !self.is_asked {
            let (target_system, target_component, count) = (1, 1, self.count);
            let message = MissionCount { target_system, target_component, count, ..MissionCount::default() };
            air.send(self.link, self.from, &message);
        } else if self.sent == self.count {
            // The last answer may be lost: the last item asks for it once more.
            air.send(self.link, self.from, &item_of(self.count - 1, self.variant));
        }
    }
}

/// Uploads a mission from beginning to end.
pub fn upload(world: &mut World, link: LinkId, from: Address, count: u16, variant: u16) -> MavMissionResult {
    Upload::new(link, from, count, variant).finish(world)
}

/// Somebody who pings, and counts the answers.
pub struct Pinger {
    pub link: LinkId,
    pub from: Address,
    pub period: Duration,
    due: Instant,
    pub sent: u32,
    pub answers: u32,
    is_answered: bool,
    /// From question to answer.
    pub slowest: Duration,
    asked: Instant,
}

impl Pinger {
    pub fn new(link: LinkId, from: Address, period: Duration) -> Self {
        let (due, asked, slowest) = (Instant::ZERO, Instant::ZERO, Duration::ZERO);
        Self { link, from, period, due, sent: 0, answers: 0, is_answered: true, slowest, asked }
    }
}

impl Ear for Pinger {
    fn hear(&mut self, heard: &Heard<'_>, _: &mut Air) {
        if let Some(ping) = heard.get::<Ping>()
            && heard.link == self.link
            && Address::new(ping.target_system, ping.target_component) == self.from
            && ping.seq == self.sent
            && !self.is_answered
        {
            self.is_answered = true;
            self.answers += 1;
            self.slowest = self.slowest.max(heard.now.since(self.asked));
        }
    }

    fn tick(&mut self, now: Instant, air: &mut Air) {
        if now >= self.due {
            self.due = now.after(self.period);
            self.sent += 1;
            (self.asked, self.is_answered) = (now, false);
            air.send(self.link, self.from, &Ping { seq: self.sent, ..Ping::default() });
        }
    }
}

/// A command that any vehicle answers: tell us who you are.
pub fn request_message(id: u32) -> CommandLong {
    CommandLong {
        target_system: 1,
        target_component: 1,
        command: MavCmd::REQUEST_MESSAGE,
        param1: id as f32,
        ..CommandLong::default()
    }
}

/// Counts what comes down of a few kinds, on any link.
#[derive(Default)]
pub struct Counter {
    /// COMMAND_ACK
    pub acks: u32,
    /// All but what the vehicle says unasked: answers.
    pub answers: u32,
}

impl Ear for Counter {
    fn hear(&mut self, heard: &Heard<'_>, _: &mut Air) {
        // What others say is passed on, whatever its signature.
        if heard.source != VEHICLE {
            return;
        }
        self.acks += u32::from(heard.id == CommandAck::ID);
        let answers = [
            CommandAck::ID,
            ParamValue::ID,
            MissionAck::ID,
            MissionCount::ID,
            MissionItemInt::ID,
            MissionRequestInt::ID,
            AutopilotVersion::ID,
            Ping::ID,
        ];
        self.answers += u32::from(answers.contains(&heard.id));
    }
}
