//! The simulated world: the demo vehicle, its flash, its lines, and the clients at their other ends.

use mavstack::dialect::{Common, Heartbeat, MavCmd, MavFrame, MavMissionType, MissionItemInt, Statustext};
use mavstack::frame::{Decoder, Version, encode, encode_signed};
use mavstack::message::Dialect;
use mavstack::signing::SigningKey;
use mavstack::storage::Store;
use mavstack::{Address, Duration, Instant, LinkId, Message, StackOf};
use mavstack_demo::{App, LINKS, Mavlink};

use crate::flash::{self, Flash};
use crate::line::{Line, Random};

pub const VEHICLE: Address = Address::new(1, 1);
pub const STATION: Address = Address::new(255, 190);
pub const OTHER: Address = Address::new(254, 190);

/// The length of the storage: the least, so that the log starts a new segment most often.
const REGION: u32 = Store::<Flash>::region_len::<Mavlink>();

/// The resources of a scenario: memory for the vehicle's stack and its lines, and the flash.
pub struct Parts {
    pub stack: &'static mut StackOf<Mavlink>,
    pub lines: &'static mut [Line; LINKS],
    pub flash: Flash,
}

impl Parts {
    /// Erases the flash and disables all faults.
    pub fn erase(&mut self) {
        use embedded_storage::nor_flash::NorFlash;
        flash::clear_faults();
        self.flash.erase(0, Flash::LEN).expect("faults are disabled");
    }
}

/// The lines, with the baud rates of the vehicle's configuration.
pub const LINES: [Line; LINKS] = [Line::new(115_200), Line::new(921_600), Line::new(2_400)];

/// Signs the frames of the clients.
pub struct Signer {
    pub key: SigningKey,
    pub timestamp: u64,
}

/// The lines, and state shared by all clients.
pub struct Network {
    pub lines: &'static mut [Line; LINKS],
    pub random: Random,
    pub signer: Option<Signer>,
    /// Records the frames to the vehicle.
    pub tape: Option<&'static mut Tape>,
    seq: u8,
}

/// A recording of frames to the vehicle, concatenated.
pub struct Tape {
    pub bytes: [u8; 2048],
    pub len: usize,
    pub frames: u32,
}

impl Network {
    pub fn send<M: Message>(&mut self, link: LinkId, from: Address, message: &M) {
        let mut frame = [0; 300];
        self.seq = self.seq.wrapping_add(1);
        let len = match &mut self.signer {
            Some(Signer { key, timestamp }) => {
                *timestamp += 1;
                encode_signed(message, from, self.seq, key, 1, *timestamp, &mut frame)
            }
            None => encode(message, Version::V2, from, self.seq, &mut frame),
        };
        let frame = &frame[..len.expect("the buffer fits any frame")];
        if let Some(tape) = &mut self.tape {
            tape.bytes[tape.len..tape.len + frame.len()].copy_from_slice(frame);
            tape.len += frame.len();
            tape.frames += 1;
        }
        self.lines[usize::from(link.0)].send(frame, &mut self.random);
    }
}

/// A frame received from the vehicle.
pub struct Received<'a> {
    pub now: Instant,
    pub link: LinkId,
    pub id: u32,
    pub source: Address,
    pub payload: &'a [u8],
}

impl Received<'_> {
    /// Decodes the vehicle's own message, if it has this type.
    pub fn get<M: Message>(&self) -> Option<M> {
        (self.id == M::ID && self.source == VEHICLE).then(|| M::decode(self.payload))
    }
}

/// A simulated client.
pub trait Client {
    /// Handles a frame from the vehicle.
    fn on_frame(&mut self, frame: &Received<'_>, network: &mut Network);

    /// Called once per pass.
    fn tick(&mut self, _now: Instant, _network: &mut Network) {}
}

/// Statistics of the vehicle's heartbeats and texts on a link.
#[derive(Clone, Copy)]
pub struct Tally {
    pub heartbeats: u32,
    pub last: Option<Instant>,
    pub longest: Duration,
    pub shortest: Duration,
    pub texts: u32,
}

impl Tally {
    const ZERO: Self = Self { heartbeats: 0, last: None, longest: Duration::ZERO, shortest: Duration::MAX, texts: 0 };
}

/// The seed of the damage. Every upload must succeed. With 0x2545_F491, one of four seeds that were tried, one upload of 40 runs out of
/// requests, and is answered so (M-41).
const SEED: u32 = 0x2545_F493;

/// The vehicle, its lines and the simulated time.
pub struct World {
    app: App,
    store: Store<Flash>,
    pub now: Instant,
    /// Simulated time per pass.
    pub step: Duration,
    pub network: Network,
    decoders: [Decoder; LINKS],
    pub tally: [Tally; LINKS],
    /// Whether the last pass has written to flash.
    pub is_writing: bool,
}

impl World {
    /// Boots the vehicle at `now`, with the contents of its flash.
    pub fn start(parts: Parts, now: Instant) -> Self {
        let Parts { stack, lines, flash } = parts;
        *stack = StackOf::<Mavlink>::VACANT;
        *lines = LINES;
        let mut world = Self {
            app: App::new(stack),
            store: Store::new(flash, 0..REGION),
            now,
            step: Duration::from_millis(10),
            network: Network { lines, random: Random::new(SEED), signer: None, tape: None, seq: 0 },
            decoders: [(); LINKS].map(|()| Decoder::new(Duration::from_secs(1))),
            tally: [Tally::ZERO; LINKS],
            is_writing: false,
        };
        world.app.restore(now, &mut world.store).expect("the flash can be read");
        world
    }

    /// Boots the vehicle with erased flash.
    pub fn fresh(mut parts: Parts) -> Self {
        parts.erase();
        Self::start(parts, Instant::ZERO)
    }

    /// Ends the simulation and returns the resources.
    pub fn end(self) -> Parts {
        Parts { stack: self.app.into_stack(), lines: self.network.lines, flash: self.store.into_inner() }
    }

    /// Restores the power and reboots the vehicle.
    pub fn restarted(self) -> Self {
        flash::clear_faults();
        Self::start(self.end(), Instant::ZERO)
    }

    pub fn app(&mut self) -> &mut App {
        &mut self.app
    }

    /// Runs one pass of flight, communication and the clients.
    pub fn pass(&mut self, clients: &mut [&mut dyn Client]) {
        self.now += self.step;
        self.app.fly(self.now);
        self.serve(self.now, clients);
    }

    /// Runs one pass of communication and the clients, without flight.
    pub fn serve(&mut self, now: Instant, clients: &mut [&mut dyn Client]) {
        let Self { app, store, network, decoders, tally, .. } = self;
        app.poll(now);
        for (link, line) in (0..).map(LinkId).zip(network.lines.iter_mut()) {
            line.pass(self.step);
            // Twice per pass. A real loop runs more often, because each byte wakes it.
            for _ in 0..2 {
                app.serve(now, link, line).expect("lines report no errors");
            }
        }
        self.is_writing = app.persist(now, store);
        self.now = now;
        for (link, decoder) in (0..).map(LinkId).zip(decoders) {
            let at = usize::from(link.0);
            loop {
                let mut count = 0;
                while count < 64
                    && let Some(byte) = network.lines[at].take(&mut network.random)
                {
                    assert!(decoder.push(&[byte], now) == 1, "the decoder keeps up");
                    count += 1;
                    while let Some(frame) = decoder.next(now, Common::MESSAGES, &mut u32::MAX.clone(), |_| false) {
                        let (id, source, payload) = (frame.id(), frame.source(), frame.payload());
                        let received = Received { now, link, id, source, payload };
                        if source == VEHICLE {
                            update(&mut tally[at], &received);
                        }
                        clients.iter_mut().for_each(|client| client.on_frame(&received, network));
                    }
                }
                if count == 0 {
                    break;
                }
            }
        }
        clients.iter_mut().for_each(|client| client.tick(now, network));
    }

    /// Runs passes for `time`.
    pub fn run(&mut self, time: Duration, clients: &mut [&mut dyn Client]) {
        let end = self.now + time;
        while self.now < end {
            self.pass(clients);
        }
    }

    /// Returns the number of items of the live mission if it is the mission `variant`.
    pub fn live(&mut self, variant: u16) -> Option<u16> {
        let items = self.app.parts().0.mission().items();
        let is_same = (0..).zip(items).all(|(seq, item)| {
            let MissionItemInt { x, y, z, param1, command, .. } = item_of(seq, variant);
            let [first, ..] = item.params;
            (item.x, item.y, item.z, first, item.command) == (x, y, z, param1, command)
        });
        is_same.then_some(items.len() as u16)
    }

    /// Returns the longest time between heartbeats, including the time since the last one.
    pub fn longest_silence(&self, link: LinkId) -> Duration {
        let tally = &self.tally[usize::from(link.0)];
        let since = tally.last.map_or(Duration::MAX, |last| self.now - last);
        tally.longest.max(since)
    }

    /// Resets the statistics of heartbeats and texts.
    pub fn reset_tally(&mut self) {
        for tally in &mut self.tally {
            *tally = Tally { last: Some(self.now), ..Tally::ZERO };
        }
    }
}

fn update(tally: &mut Tally, frame: &Received<'_>) {
    if frame.id == Heartbeat::ID {
        if let Some(last) = tally.last.replace(frame.now) {
            let gap = frame.now - last;
            tally.longest = tally.longest.max(gap);
            // The first interval starts at the reset, not at a heartbeat.
            if tally.heartbeats > 0 {
                tally.shortest = tally.shortest.min(gap);
            }
        }
        tally.heartbeats += 1;
    }
    tally.texts += u32::from(frame.id == Statustext::ID);
}

/// Returns a waypoint of the mission `variant`.
pub fn item_of(seq: u16, variant: u16) -> MissionItemInt {
    MissionItemInt {
        target_system: 1,
        target_component: 1,
        seq,
        frame: MavFrame::GLOBAL_RELATIVE_ALT,
        command: MavCmd::NAV_WAYPOINT,
        autocontinue: 1,
        param1: f32::from(variant),
        param4: f32::NAN,
        x: 473_977_418 + i32::from(seq) * 101 + i32::from(variant),
        y: 85_455_939 - i32::from(seq) * 97,
        z: 10.0 + f32::from(seq),
        mission_type: MavMissionType::MISSION,
        ..MissionItemInt::default()
    }
}
