//! The demo vehicle with its flash, its lines and the time; and who is at the other ends of the lines.

use mavstack::dialect::{Common, Heartbeat, MavCmd, MavFrame, MavMissionType, MissionItemInt, Statustext};
use mavstack::{
    Address, Decoder, Dialect, Durability, Duration, Instant, LinkId, Message, ParamStore, ParamTable, PlanStore,
    SigningKey, SigningStore, Version, encode, encode_signed,
};
use mavstack_demo::{LINKS, Tuning};
use mavstack_qemu::memory::DemoApp;

use crate::flash::{self, Flash};
use crate::line::{Line, Random};

pub const VEHICLE: Address = Address::new(1, 1);
pub const STATION: Address = Address::new(255, 190);
pub const OTHER: Address = Address::new(254, 190);

type Plans = PlanStore<Flash>;
type Settings = ParamStore<Flash>;
type Key = SigningStore<Flash>;

/// What a scenario is made of: the places for the vehicle and its lines, and its flash.
pub struct Parts {
    pub app: &'static mut DemoApp,
    pub lines: &'static mut [Line; LINKS],
    pub flash: [Flash; 3],
}

impl Parts {
    /// All flash erased, and nothing fails.
    pub fn erase(&mut self) {
        use embedded_storage::nor_flash::NorFlash;
        flash::heal();
        for part in &mut self.flash {
            part.erase(0, Flash::LEN).expect("nothing fails");
        }
    }
}

/// The lines of the vehicle's configuration.
pub const LINES: [Line; LINKS] = [Line::new(115_200), Line::new(921_600), Line::new(2_400)];

/// Signs what somebody sends.
pub struct Signer {
    pub key: SigningKey,
    pub timestamp: u64,
}

/// The lines, and what all who use them share.
pub struct Air {
    pub lines: &'static mut [Line; LINKS],
    pub random: Random,
    pub signer: Option<Signer>,
    /// Keeps what goes up.
    pub tape: Option<&'static mut Tape>,
    seq: u8,
}

/// Frames that went up, one behind the other.
pub struct Tape {
    pub bytes: [u8; 2048],
    pub len: usize,
    pub frames: u32,
}

impl Air {
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
        let frame = &frame[..len.expect("it fits")];
        if let Some(tape) = &mut self.tape {
            tape.bytes[tape.len..tape.len + frame.len()].copy_from_slice(frame);
            tape.len += frame.len();
            tape.frames += 1;
        }
        self.lines[usize::from(link.0)].send(frame, &mut self.random);
    }
}

/// A frame that came down.
pub struct Heard<'a> {
    pub now: Instant,
    pub link: LinkId,
    pub id: u32,
    pub source: Address,
    pub payload: &'a [u8],
}

impl Heard<'_> {
    /// What the vehicle says, when it is this.
    pub fn get<M: Message>(&self) -> Option<M> {
        (self.id == M::ID && self.source == VEHICLE).then(|| M::decode(self.payload))
    }
}

/// Somebody on the ground.
pub trait Ear {
    fn hear(&mut self, heard: &Heard<'_>, air: &mut Air);

    fn tick(&mut self, _now: Instant, _air: &mut Air) {}
}

/// The vehicle's heartbeats on a link, and its texts.
#[derive(Clone, Copy)]
pub struct Tally {
    pub beats: u32,
    pub last: Option<Instant>,
    pub longest: Duration,
    pub shortest: Duration,
    pub texts: u32,
}

impl Tally {
    const ZERO: Self = Self { beats: 0, last: None, longest: Duration::ZERO, shortest: Duration::MAX, texts: 0 };
}

/// The vehicle, its lines and the time.
pub struct World {
    app: &'static mut DemoApp,
    settings: Settings,
    key: Key,
    plans: Plans,
    pub now: Instant,
    /// From pass to pass.
    pub step: Duration,
    pub air: Air,
    decoders: [Decoder; LINKS],
    pub tally: [Tally; LINKS],
    /// There was something to write in the last pass.
    pub is_writing: bool,
}

impl World {
    /// The vehicle is switched on at `now`, with what is in its flash.
    pub fn start(parts: Parts, now: Instant) -> Self {
        let Parts { app, lines, flash: [plans, settings, key] } = parts;
        flash::renew(app);
        *lines = LINES;
        let mut world = Self {
            app,
            settings: Settings::new(settings, 0..Settings::region_len(Tuning::INFO.len())),
            key: Key::new(key, 0..Key::REGION_LEN),
            plans: Plans::new(plans, 0..Plans::region_len(250, 64, 16)),
            now,
            step: Duration::from_millis(10),
            air: Air { lines, random: Random::new(0x2545_F491), signer: None, tape: None, seq: 0 },
            decoders: [(); LINKS].map(|()| Decoder::new(Duration::from_secs(1))),
            tally: [Tally::ZERO; LINKS],
            is_writing: false,
        };
        world.app.restore_parameters(now, &mut world.settings).expect("the flash can be read");
        world.app.restore_signing(now, &mut world.key).expect("the flash can be read");
        world.app.restore(now, &mut world.plans, Durability::Durable).expect("the flash can be read");
        world
    }

    /// The same on flash that was erased before.
    pub fn fresh(mut parts: Parts) -> Self {
        parts.erase();
        Self::start(parts, Instant::ZERO)
    }

    /// The power goes; what is left.
    pub fn end(self) -> Parts {
        let flash = [self.plans.into_inner(), self.settings.into_inner(), self.key.into_inner()];
        Parts { app: self.app, lines: self.air.lines, flash }
    }

    /// Switched off and on again.
    pub fn restarted(self) -> Self {
        flash::heal();
        Self::start(self.end(), Instant::ZERO)
    }

    pub fn app(&mut self) -> &mut DemoApp {
        self.app
    }

    /// One pass of all.
    pub fn pass(&mut self, ears: &mut [&mut dyn Ear]) {
        self.now = self.now.after(self.step);
        self.app.fly(self.now);
        self.talk(self.now, ears);
    }

    /// What is not flight, at `now`.
    pub fn talk(&mut self, now: Instant, ears: &mut [&mut dyn Ear]) {
        let Self { app, settings, key, plans, air, decoders, tally, .. } = self;
        app.poll(now);
        for (link, line) in (0..).map(LinkId).zip(air.lines.iter_mut()) {
            line.pass(self.step);
            // Twice: as often as a byte wakes the loop would be more often.
            for _ in 0..2 {
                app.serve(now, link, line).expect("the line has no errors");
            }
        }
        self.is_writing = app.persist(now, plans);
        self.is_writing |= app.persist_parameters(now, settings);
        self.is_writing |= app.persist_signing(now, key);
        self.now = now;
        for (link, decoder) in (0..).map(LinkId).zip(decoders) {
            let at = usize::from(link.0);
            loop {
                let mut count = 0;
                while count < 64
                    && let Some(byte) = air.lines[at].take(&mut air.random)
                {
                    assert!(decoder.push(&[byte], now) == 1, "the ground is as fast as the line");
                    count += 1;
                    while let Some(frame) = decoder.next(now, Common::MESSAGES, &mut u32::MAX.clone(), |_| false) {
                        let (id, source, payload) = (frame.id(), frame.source(), frame.payload());
                        let heard = Heard { now, link, id, source, payload };
                        if source == VEHICLE {
                            note(&mut tally[at], &heard);
                        }
                        ears.iter_mut().for_each(|ear| ear.hear(&heard, air));
                    }
                }
                if count == 0 {
                    break;
                }
            }
        }
        ears.iter_mut().for_each(|ear| ear.tick(now, air));
    }

    /// Passes for so long.
    pub fn run(&mut self, time: Duration, ears: &mut [&mut dyn Ear]) {
        let end = self.now.after(time);
        while self.now < end {
            self.pass(ears);
        }
    }

    /// How many items the live mission has if they are those of `variant`.
    pub fn live(&mut self, variant: u16) -> Option<u16> {
        let items = self.app.parts().0.mission().items();
        let is_same = (0..).zip(items).all(|(seq, item)| {
            let MissionItemInt { x, y, z, param1, command, .. } = item_of(seq, variant);
            let [first, ..] = item.params;
            (item.x, item.y, item.z, first, item.command) == (x, y, z, param1, command)
        });
        is_same.then_some(items.len() as u16)
    }

    /// The longest time from one heartbeat to the next, or from the last one to now.
    pub fn longest_silence(&self, link: LinkId) -> Duration {
        let tally = &self.tally[usize::from(link.0)];
        let since = tally.last.map_or(Duration::MAX, |last| self.now.since(last));
        tally.longest.max(since)
    }

    /// From now on heartbeats and texts are counted anew.
    pub fn count_anew(&mut self) {
        for tally in &mut self.tally {
            *tally = Tally { last: Some(self.now), ..Tally::ZERO };
        }
    }
}

fn note(tally: &mut Tally, heard: &Heard<'_>) {
    if heard.id == Heartbeat::ID {
        if let Some(last) = tally.last.replace(heard.now) {
            let gap = heard.now.since(last);
            tally.longest = tally.longest.max(gap);
            // What it is counted from is none.
            if tally.beats > 0 {
                tally.shortest = tally.shortest.min(gap);
            }
        }
        tally.beats += 1;
    }
    tally.texts += u32::from(heard.id == Statustext::ID);
}

/// A waypoint of the mission `variant`.
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
