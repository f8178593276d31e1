//! Simulated clients: uploads, pings, and a counter of answers.

use mavstack::dialect::{
    AutopilotVersion, CommandAck, CommandLong, MavCmd, MavMissionResult, MissionAck, MissionCount, MissionItemInt,
    MissionRequestInt, ParamValue, Ping,
};
use mavstack::{Address, Duration, Instant, LinkId, Message};

use crate::world::{Client, Network, Received, VEHICLE, World, item_of};

/// A client that uploads a mission as ground stations do. It repeats MISSION_COUNT until the first request, then answers requests.
pub struct Upload {
    link: LinkId,
    from: Address,
    count: u16,
    variant: u16,
    /// The client falls silent after this many items.
    silent_after: u16,
    pub is_silent: bool,
    /// The vehicle has requested an item.
    pub has_request: bool,
    /// Number of items sent, without repetitions.
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
            silent_after: u16::MAX,
            is_silent: false,
            has_request: false,
            sent: 0,
            due: Instant::ZERO,
            result: None,
        }
    }

    pub fn silent_after(mut self, items: u16) -> Self {
        self.silent_after = items;
        self
    }

    /// Returns the number of items sent, without repetitions.
    pub fn items_sent(&self) -> u16 {
        self.sent
    }

    /// Runs until the upload ends, and returns the result.
    pub fn finish(&mut self, world: &mut World) -> MavMissionResult {
        let end = world.now + Duration::from_secs(30);
        while self.result.is_none() {
            assert!(world.now < end, "an upload of {} items does not end: {} sent", self.count, self.sent);
            world.pass(&mut [self]);
        }
        self.result.unwrap_or(MavMissionResult::ERROR)
    }

    /// Runs until the client falls silent.
    pub fn run_until_silent(&mut self, world: &mut World) {
        let end = world.now + Duration::from_secs(30);
        while !self.is_silent {
            assert!(world.now < end && self.result.is_none(), "not silent after {} items", self.silent_after);
            world.pass(&mut [self]);
        }
    }
}

impl Client for Upload {
    fn on_frame(&mut self, frame: &Received<'_>, network: &mut Network) {
        if self.is_silent || self.result.is_some() || frame.link != self.link {
            return;
        }
        let is_ours = |system, component| Address::new(system, component) == self.from;
        if let Some(request) = frame.get::<MissionRequestInt>()
            && is_ours(request.target_system, request.target_component)
        {
            self.has_request = true;
            if request.seq >= self.silent_after {
                self.is_silent = true;
                return;
            }
            self.sent = self.sent.max(request.seq + 1);
            self.due = frame.now + Duration::from_secs(1);
            network.send(self.link, self.from, &item_of(request.seq, self.variant));
            self.is_silent = self.sent == self.count && self.silent_after == self.count;
        } else if let Some(ack) = frame.get::<MissionAck>()
            && is_ours(ack.target_system, ack.target_component)
        {
            self.result = Some(ack.r#type);
        }
    }

    fn tick(&mut self, now: Instant, network: &mut Network) {
        if self.is_silent || self.result.is_some() || now < self.due {
            return;
        }
        self.due = now + Duration::from_millis(500);
        if !self.has_request {
            let (target_system, target_component, count) = (1, 1, self.count);
            let message = MissionCount { target_system, target_component, count, ..MissionCount::default() };
            network.send(self.link, self.from, &message);
        } else if self.sent == self.count {
            // The acknowledgement may be lost: repeating the last item requests it again.
            network.send(self.link, self.from, &item_of(self.count - 1, self.variant));
        }
    }
}

/// Uploads a mission and returns the result.
pub fn upload(world: &mut World, link: LinkId, from: Address, count: u16, variant: u16) -> MavMissionResult {
    Upload::new(link, from, count, variant).finish(world)
}

/// A client that sends PING and counts the answers.
pub struct Pinger {
    pub link: LinkId,
    pub from: Address,
    pub period: Duration,
    due: Instant,
    pub sent: u32,
    pub answers: u32,
    is_answered: bool,
    /// Maximum round-trip time.
    pub slowest: Duration,
    asked: Instant,
}

impl Pinger {
    pub fn new(link: LinkId, from: Address, period: Duration) -> Self {
        let (due, asked, slowest) = (Instant::ZERO, Instant::ZERO, Duration::ZERO);
        Self { link, from, period, due, sent: 0, answers: 0, is_answered: true, slowest, asked }
    }
}

impl Client for Pinger {
    fn on_frame(&mut self, frame: &Received<'_>, _: &mut Network) {
        if let Some(ping) = frame.get::<Ping>()
            && frame.link == self.link
            && Address::new(ping.target_system, ping.target_component) == self.from
            && ping.seq == self.sent
            && !self.is_answered
        {
            self.is_answered = true;
            self.answers += 1;
            self.slowest = self.slowest.max(frame.now - self.asked);
        }
    }

    fn tick(&mut self, now: Instant, network: &mut Network) {
        if now >= self.due {
            self.due = now + self.period;
            self.sent += 1;
            (self.asked, self.is_answered) = (now, false);
            network.send(self.link, self.from, &Ping { seq: self.sent, ..Ping::default() });
        }
    }
}

/// Returns MAV_CMD_REQUEST_MESSAGE for a message id.
pub fn request_message(id: u32) -> CommandLong {
    CommandLong {
        target_system: 1,
        target_component: 1,
        command: MavCmd::REQUEST_MESSAGE,
        param1: id as f32,
        ..CommandLong::default()
    }
}

/// A client that counts answers on all links.
#[derive(Default)]
pub struct Counter {
    /// Number of COMMAND_ACK.
    pub acks: u32,
    /// Number of answers of any type.
    pub answers: u32,
}

impl Client for Counter {
    fn on_frame(&mut self, frame: &Received<'_>, _: &mut Network) {
        // Forwarded frames of other senders do not count.
        if frame.source != VEHICLE {
            return;
        }
        self.acks += u32::from(frame.id == CommandAck::ID);
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
        self.answers += u32::from(answers.contains(&frame.id));
    }
}
