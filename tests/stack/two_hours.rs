//! Two hours at 57,600 baud with three ground stations on one link that do everything at once: rules C-3, D-3, D-4, H-1, H-15,
//! P-10 to P-14, Q-4, Q-5, Q-8, T-1, T-2, T-5.
//!
//! Each station behaves like the program that it is named after. Twelve times the link is flooded with streams, and twelve
//! times a radio reports a full buffer; in between, streams keep their rates. The time is simulated: the test takes seconds.

mod client;

use crate::support::*;
use client::{Act, Books, Client, Habits, Transfers};
use mavstack::dialect::*;
use mavstack::frame::{MAX_FRAME_LEN, RxCounters};
use mavstack::network::LinkCounters;
use mavstack::plan::PlanCounters;
use mavstack::{Address, Duration, Instant, LinkConfig, LinkId, Message, plan_memory};
use std::collections::BTreeMap;

type Served = Tested<plan_memory!(mission: 60), 8, Timed>;

const END: Duration = secs(2 * 3_600);
/// Bytes/s in each direction.
const RATE: u64 = 5_760;
/// The longest time between two polls.
const POLL: Duration = Duration::from_millis(8);

/// How long the link accepts nothing, now and then, while the radio's buffer is full.
const STALL: Duration = Duration::from_millis(250);

/// HOME_POSITION is in no group, so REQUEST_DATA_STREAM does not end the flood.
const FLOOD: &[(u32, f32)] = &[(Attitude::ID, 1_000.0), (GlobalPositionInt::ID, 1_000.0), (HomePosition::ID, 1_000.0)];
const CALM: &[(u32, f32)] = &[
    (Attitude::ID, 50_000.0),
    (GlobalPositionInt::ID, 200_000.0),
    (SysStatus::ID, 1_000_000.0),
    (BatteryStatus::ID, 2_000_000.0),
    (HomePosition::ID, -1.0),
];

/// Requests parameters of all components; retransmits a command after three seconds, three times.
const QGROUNDCONTROL: Habits = Habits {
    address: Address::new(255, 190),
    command_timeout: secs(3),
    command_retries: 3,
    param_timeout: secs(1),
    list_component: 0,
    params: &[("CRUISE", MavParamType::REAL32, 0.5, 20.0), ("FENCE_ACT", MavParamType::INT32, 0.0, 4.0)],
    transfers: Transfers::QGroundControl,
    routine: &[
        (secs(1), Act::Commands(1)),
        (secs(20), Act::SetRates(&[(BatteryStatus::ID, 500_000.0)])),
        (secs(90), Act::Calibrate),
        (secs(9), Act::List),
        (millis(1_700), Act::Read),
        (secs(4), Act::Set),
        (secs(3), Act::Transfer),
    ],
};

/// Has timeouts of half a second, and sends TIMESYNC and PING.
const MAVSDK: Habits = Habits {
    address: Address::new(245, 190),
    command_timeout: millis(500),
    command_retries: 3,
    param_timeout: millis(500),
    list_component: 1,
    params: &[("RTL_ALT", MavParamType::REAL32, 0.0, 120.0)],
    transfers: Transfers::Mavsdk,
    routine: &[
        (millis(700), Act::Commands(2)),
        (secs(40), Act::Calibrate),
        (secs(7), Act::List),
        (secs(1), Act::Read),
        (millis(900), Act::Set),
        (secs(2), Act::Transfer),
        (secs(5), Act::Ping),
        (secs(5), Act::Timesync),
    ],
};

/// Retransmits no command, requests all streams every 15 seconds, and downloads with five requests in flight.
const MAVPROXY: Habits = Habits {
    address: Address::new(254, 230),
    command_timeout: secs(5),
    command_retries: 0,
    param_timeout: secs(1),
    list_component: 1,
    params: &[("LAND_SPEED", MavParamType::REAL32, 0.1, 3.0)],
    transfers: Transfers::MavProxy,
    routine: &[
        (secs(2), Act::Commands(1)),
        (secs(15), Act::RequestDataStreams(8)),
        (secs(11), Act::SetMode),
        (secs(13), Act::List),
        (secs(6), Act::Read),
        (secs(7), Act::Set),
        (millis(2_500), Act::Transfer),
        (secs(10), Act::Timesync),
        (secs(15), Act::Ping),
    ],
};

/// The conditions of a minute.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Weather {
    Calm,
    /// More streams than the link carries.
    Flood,
    /// The radio's buffer is full.
    Radio,
}

fn weather(minute: u64) -> Weather {
    match minute % 10 {
        4 => Weather::Flood,
        8 => Weather::Radio,
        _ => Weather::Calm,
    }
}

/// Expected and received streams in the calm.
#[derive(Debug)]
struct Rates {
    /// In µs; 0 is off.
    intervals: [f64; 5],
    expected: [f64; 5],
    came: [f64; 5],
}

impl Rates {
    fn number(id: u32) -> Option<usize> {
        CALM.iter().position(|(other, _)| *other == id)
    }

    fn set(&mut self, id: u32, micros: f32) {
        self.intervals[Self::number(id).expect("one of those")] = f64::from(micros);
    }

    fn pass(&mut self, time: Duration) {
        for (expected, interval) in self.expected.iter_mut().zip(self.intervals) {
            *expected += if interval > 0.0 { time.as_micros() as f64 / interval } else { 0.0 };
        }
    }
}

/// What was received from the vehicle.
struct Log {
    /// How many received frames were examined.
    seen: usize,
    frames: u32,
    bytes: u64,
    heartbeats: u64,
    last_heartbeat: Option<Instant>,
    /// The largest deviation of a heartbeat's interval from a second, and the same while the link is stalled.
    jitter: Duration,
    stalled_jitter: Duration,
    is_stalling: bool,
    rates: Rates,
    /// Bytes of this minute, and the least and most per minute of each condition.
    minute_bytes: u64,
    flood: (u64, u64),
    calm: (u64, u64),
    /// Texts, and incomplete ones by id.
    texts: Vec<String>,
    chunks: BTreeMap<u16, String>,
}

impl Log {
    fn hear(&mut self, frame: &Received, is_judged: bool) {
        self.frames += 1;
        let bytes = frame.payload.len() as u64 + 12;
        self.bytes += bytes;
        self.minute_bytes += bytes;
        if frame.header.id == Heartbeat::ID {
            self.heartbeats += 1;
            if let Some(last) = self.last_heartbeat.replace(frame.at) {
                let micros = (frame.at - last).as_micros().abs_diff(1_000_000);
                let jitter = if self.is_stalling { &mut self.stalled_jitter } else { &mut self.jitter };
                *jitter = (*jitter).max(Duration::from_micros(micros));
            }
        } else if let Some(text) = frame.decode::<Statustext>() {
            let part = text.text.as_str().expect("UTF-8");
            let whole = self.chunks.entry(text.id).or_default();
            whole.push_str(part);
            if text.id == 0 || part.len() < 50 {
                self.texts.extend(self.chunks.remove(&text.id));
            }
        } else if let Some(number) = Rates::number(frame.header.id).filter(|_| is_judged) {
            self.rates.came[number] += 1.0;
        }
    }

    fn end_minute(&mut self, weather: Weather) {
        let bytes = std::mem::take(&mut self.minute_bytes);
        let range = match weather {
            Weather::Flood => &mut self.flood,
            Weather::Calm => &mut self.calm,
            Weather::Radio => return,
        };
        *range = (range.0.min(bytes), range.1.max(bytes));
    }
}

/// The vehicle's own behaviour: a calibration takes five seconds, and it sends a text now and then.
#[derive(Default)]
struct Flight {
    calibration: Option<Instant>,
    texts: Vec<String>,
    text_due: Instant,
}

impl Flight {
    fn step(&mut self, now: Instant, world: &mut World<1, Served>) {
        const CALIBRATION: MavCmd = MavCmd::PREFLIGHT_CALIBRATION;
        if world.stack.long_commands_mut().is_running(CALIBRATION) {
            let ran = (now - (*self.calibration.get_or_insert(now))).as_millis();
            world.stack.long_commands_mut().progress(CALIBRATION, (ran / 50) as u8);
            if ran >= 5_000 {
                world.stack.long_commands_mut().finish(CALIBRATION, MavResult::ACCEPTED);
                self.calibration = None;
            }
        }
        if now >= self.text_due {
            self.text_due = now + secs(7);
            let number = self.texts.len();
            let text = format!("Event {number} {}", "of some length ".repeat(number % 7)).trim_end().to_owned();
            world.stack.text(now, MavSeverity::NOTICE, &text);
            self.texts.push(text);
        }
    }
}

#[test]
fn two_hours_of_three_ground_stations() {
    let wire = Wire { bytes_per_second: RATE, latency: millis(2), tx_fifo: 1_024, chunk: 40, ..Wire::default() };
    let setup = Setup {
        links: [LinkConfig::uart(57_600).with_own_system(true)],
        lines: [LineConfig::both(wire)],
        step: millis(2),
        jitter: Duration::from_micros(POLL.as_micros() - 2_000),
        seed: 7,
        ..Setup::new()
    };
    let mut world = World::<1, Served>::of(setup);
    world.vehicle.has_home = true;
    world.vehicle.long.insert(MavCmd::PREFLIGHT_CALIBRATION.0);
    let mut clients: Vec<Client> = [QGROUNDCONTROL, MAVSDK, MAVPROXY]
        .into_iter()
        .zip(1..)
        .map(|(habits, seed)| Client::new(habits, seed))
        .collect();
    let mut log = Log {
        seen: 0,
        frames: 0,
        bytes: 0,
        heartbeats: 0,
        last_heartbeat: None,
        jitter: Duration::ZERO,
        stalled_jitter: Duration::ZERO,
        is_stalling: false,
        rates: Rates { intervals: [0.0; 5], expected: [0.0; 5], came: [0.0; 5] },
        minute_bytes: 0,
        flood: (u64::MAX, 0),
        calm: (u64::MAX, 0),
        texts: Vec::new(),
        chunks: BTreeMap::new(),
    };
    let mut flight = Flight::default();
    let (end, mut minute, mut radio_due) = (Instant::ZERO + END, None, Instant::ZERO);

    while world.now() < end + secs(15) {
        let before = world.now();
        world.step();
        let now = world.now();
        let is_over = now >= end;
        let (this_minute, second) = (now.as_millis() / 60_000, now.as_millis() / 1_000 % 60);
        let weather = weather(this_minute);
        if minute != Some(this_minute) && !is_over {
            if let Some(last) = minute.replace(this_minute) {
                log.end_minute(self::weather(last));
            }
            world.vehicle.calls.retain(|call| matches!(call, Call::Peer(_)));
            let rates = if weather == Weather::Flood { FLOOD } else { CALM };
            clients[1].act(now, &mut world.gcs[0], Act::SetRates(rates));
        }
        if weather == Weather::Radio && now >= radio_due && !is_over {
            radio_due = now + secs(4);
            world.gcs[0].send_from(Address::new(51, 68), &RadioStatus { txbuf: 10, ..RadioStatus::default() });
            world.uarts[0].stall_writes_until(now + STALL);
            // At that moment every client sends requests, more than the vehicle has slots for.
            clients.iter_mut().for_each(|client| client.act(now, &mut world.gcs[0], Act::Commands(8)));
        }
        if !is_over {
            flight.step(now, &mut world);
        } else {
            world.stack.long_commands_mut().finish(MavCmd::PREFLIGHT_CALIBRATION, MavResult::ACCEPTED);
        }
        // The first seconds of a minute are not judged.
        let is_judged = weather == Weather::Calm && second >= 10 && !is_over;
        if is_judged {
            log.rates.pass(now - before);
        }
        log.is_stalling = weather == Weather::Radio;
        for frame in &world.gcs[0].received[log.seen..] {
            assert_eq!(frame.header.source, VEHICLE);
            log.hear(frame, is_judged);
            clients.iter_mut().for_each(|client| client.hear(now, frame));
        }
        log.seen = world.gcs[0].received.len();
        for client in &mut clients {
            client.is_busy = !is_over;
            client.is_sure = weather == Weather::Calm && second >= 10;
            client.poll(now, &mut world.gcs[0]);
            client.rates.drain(..).for_each(|(id, micros)| log.rates.set(id, micros));
        }
        if !clients.iter().any(Client::is_transferring) {
            world.gcs[0].forget();
            log.seen = 0;
        }
    }

    // D-3: every request was answered once, or dropped and counted.
    assert!(clients.iter().all(Client::is_idle), "{clients:#?}");
    let (link, plans) = (world.stack.link_counters(LinkId(0)).unwrap(), world.stack.plan_counters());
    let books: Vec<Books> = clients.iter().map(|client| client.books).collect();
    let sum = |what: fn(&Books) -> u64| books.iter().map(what).sum::<u64>();
    let in_vain = sum(|books| books.in_vain);
    assert_eq!(in_vain, u64::from(link.no_answer_slot + plans.no_answer_slot), "{books:#?}");
    // C-3: every command without a final answer was dropped and counted.
    let commands_in_vain = sum(|books| books.commands) - sum(|books| books.acks);
    assert!((1_000..=in_vain).contains(&commands_in_vain), "{commands_in_vain} of {in_vain}");
    assert!(sum(|books| books.commands) > 30_000 && sum(|books| books.calibrations) > 200, "{books:#?}");
    assert!(sum(|books| books.sets + books.reads) > 20_000 && sum(|books| books.lists) > 2_000, "{books:#?}");
    assert!(sum(|books| books.uploads + books.downloads) > 8_000 && sum(|books| books.times) > 4_000, "{books:#?}");
    assert_eq!(plans.accepted, clients.iter().map(|client| client.accepted).sum::<u32>());
    assert!(plans.accepted > 3_000);

    // H-1, D-4: one heartbeat per second, give or take a poll and the longest frame.
    let frame = Duration::from_micros(MAX_FRAME_LEN as u64 * 1_000_000 / RATE);
    let micros = |duration: Duration| duration.as_micros();
    assert!(micros(log.jitter) <= micros(frame) + micros(POLL), "{:?}", log.jitter);
    assert!(micros(log.stalled_jitter) <= micros(frame) + micros(POLL) + micros(STALL), "{:?}", log.stalled_jitter);
    assert!((7_214..=7_216).contains(&log.heartbeats), "{} heartbeats", log.heartbeats);

    // the rates. The flood saturated the link, and the calm did not.
    for (expected, came) in log.rates.expected.into_iter().zip(log.rates.came).take(4) {
        assert!((came / expected - 1.0).abs() <= 0.05, "{:?}", log.rates);
    }
    let minute = RATE * 60;
    assert!(log.flood.0 > minute * 9 / 10 && log.flood.1 <= minute, "{:?} bytes of {minute}", log.flood);
    assert!(log.calm.0 > minute / 4 && log.calm.1 < minute * 9 / 10, "{:?} bytes of {minute}", log.calm);

    // T-5: each text was received once, and whole.
    log.texts.retain(|text| text.starts_with("Event"));
    assert_eq!(log.texts, flight.texts);

    // No counter shows any other loss.
    let quiet = counted::<LinkCounters>(|counters| {
        counters.tx_frames = link.tx_frames;
        counters.tx_bytes = link.tx_bytes;
        counters.no_answer_slot = link.no_answer_slot
    });
    assert_eq!(link, quiet);
    // Except what is still in transmission.
    let under_way = (link.tx_frames - log.frames, u64::from(link.tx_bytes) - log.bytes);
    assert!(under_way.0 <= 4 && under_way.1 <= MAX_FRAME_LEN as u64, "{under_way:?}");
    let quiet = counted::<PlanCounters>(|counters| {
        counters.accepted = plans.accepted;
        counters.no_answer_slot = plans.no_answer_slot
    });
    assert_eq!(plans, quiet);
    let rx = world.stack.rx_counters(LinkId(0)).unwrap();
    assert_eq!(rx, counted::<RxCounters>(|counters| counters.frames = rx.frames));
    assert_eq!(world.gcs[0].counters(), counted::<RxCounters>(|counters| counters.frames = log.frames));
    let peers: Vec<_> = world.stack.peers(world.now()).collect();
    assert!(peers.iter().all(|peer| peer.lost == 0), "{peers:?}");
    assert_eq!(peers.iter().map(|peer| peer.received).sum::<u32>(), rx.frames);
    assert_eq!(peers.iter().filter(|peer| peer.is_alive).count(), 3);
    assert_eq!(world.vehicle.peer_events().len(), 3, "each was found once and never timed out");
    assert_eq!(world.errors, []);
}
