//! The firmware's clock is set back: a 32-bit counter of microseconds wraps, or a timer is reset. Rule X-7.

use crate::support::*;
use mavstack::__private::NoPlans;
use mavstack::clock::WallClock;
use mavstack::dialect::*;
use mavstack::io::{DatagramSocket, UdpLinks};
use mavstack::manual_control::ControlSource;
use mavstack::{Duration, Instant, LinkId, Message};

const LINK: LinkId = LinkId(0);
/// When a 32-bit counter of microseconds wraps.
const WRAP: u64 = 1 << 32;
const TEXT: &str = "Clock was set back: check the firmware's timer";

type Drone = Tested<NoPlans, 8, Steered>;

/// A vehicle whose clock may differ from the simulated time.
struct Site {
    world: World<1, Drone>,
    /// How far the firmware's clock is behind.
    behind: Duration,
}

impl Site {
    fn new(start: Instant) -> Self {
        let mut world = World::<1, Drone>::of(Setup { start, ..Setup::new() });
        world.stack.manual_input_mut().set_source(ControlSource::GroundStation);
        world.stack.setpoints.set_source(ControlSource::GroundStation);
        world.gcs[0].heartbeat_period = Some(secs(1));
        Self { world, behind: Duration::ZERO }
    }

    /// What the firmware's clock shows.
    fn shown(&self) -> Instant {
        Instant::from_micros(self.world.now().as_micros() - self.behind.as_micros())
    }

    fn step(&mut self) {
        let world = &mut self.world;
        world.clock.set(world.now() + millis(1));
        let now = self.shown();
        let world = &mut self.world;
        world.pulse.tick();
        world.stack.poll(now, &mut world.vehicle);
        assert_eq!(world.stack.poll_link(now, LINK, &mut world.uarts[0], &mut world.vehicle), Ok(()));
        let deadline = world.stack.next_deadline(now);
        assert!(deadline >= now && deadline <= now + secs(2), "{deadline:?} at {now:?}");
        let now = world.now();
        world.gcs[0].poll(now);
    }

    fn run_for(&mut self, duration: Duration) {
        let end = self.world.now() + duration;
        while self.world.now() < end {
            self.step();
        }
    }

    /// A script of requests, in which the clock is set back by `step` after five seconds. Returns what was received, without
    /// the text about the clock.
    fn script(mut self, step: Duration) -> (Vec<(Instant, u32)>, Self) {
        let attitude = [30.0, 100_000.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        self.world.gcs[0].command_long(MavCmd::SET_MESSAGE_INTERVAL, attitude);
        self.run_for(secs(5));
        self.behind = step;
        for round in 0..20 {
            let now = self.shown();
            self.world.stack.text(now, MavSeverity::INFO, &format!("Round {}", round / 4));
            self.world.gcs[0].command_long(MavCmd::NAV_LAND, [round as f32; 7]);
            self.world.gcs[0].send(&ParamRequestList { target_system: 1, target_component: 1 });
            self.run_for(millis(470));
        }
        let text = |frame: &&Received| {
            frame.decode::<Statustext>().is_none_or(|text| !text.text.as_str().unwrap().starts_with("Clock"))
        };
        let received =
            self.world.gcs[0].received.iter().filter(text).map(|frame| (frame.at, frame.header.id)).collect();
        (received, self)
    }

    fn texts(&self) -> usize {
        let texts = self.world.gcs[0].all::<Statustext>();
        texts.iter().filter(|(_, text)| text.text.as_str() == Some(TEXT)).count()
    }
}

/// a clock that is set back by a second or more, to zero or not, changes neither what is sent nor when: heartbeats,
/// streams, answers and repeated texts go on. One text says so, and it is counted once.
#[test]
fn clock_that_is_set_back_stops_nothing() {
    let start = Instant::from_micros(WRAP - 5_000_000);
    let (expected, site) = Site::new(start).script(Duration::ZERO);
    assert!(expected.len() > 150 && site.texts() == 0 && site.world.stack.clock_steps() == 0);
    for step in [1_000_000, 1_000_001, 60_000_000, WRAP] {
        let (received, site) = Site::new(start).script(Duration::from_micros(step));
        assert_eq!((site.texts(), site.world.stack.clock_steps()), (1, 1), "{step} µs");
        // The text takes the line for a few milliseconds.
        let ids = |frames: &[(Instant, u32)], id: u32| {
            frames.iter().filter(|(_, other)| *other == id).map(|(at, _)| *at).collect::<Vec<_>>()
        };
        for id in [Heartbeat::ID, Attitude::ID, CommandAck::ID, Statustext::ID, ParamValue::ID] {
            let (sent, expected) = (ids(&received, id), ids(&expected, id));
            assert_eq!(sent.len(), expected.len(), "{step} µs, message {id}");
            for (sent, expected) in sent.iter().zip(&expected) {
                assert!((*sent - *expected).max(*expected - *sent) <= millis(20), "{step} µs, message {id}");
            }
        }
    }
}

/// less than a second is clamped: time stands still for as long, and nobody is told.
#[test]
fn small_step_back_is_clamped() {
    for step in [1, 1_000, 400_000, 998_000] {
        let (received, site) = Site::new(Instant::ZERO).script(Duration::from_micros(step));
        assert_eq!((site.texts(), site.world.stack.clock_steps()), (0, 0));
        let beats: Vec<_> = received.iter().filter(|(_, id)| *id == Heartbeat::ID).map(|(at, _)| *at).collect();
        let longest = beats.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap();
        assert!(beats.len() >= 13 && longest <= Duration::from_micros(1_002_000 + step), "{longest:?}");
    }
}

/// X-7, H-18: across a wrap, a station times out five seconds after its last heartbeat, neither at once nor an hour later. What the
/// firmware asks is judged by its own clock, and what it is told is by that clock, too.
#[test]
fn peers_time_out_across_a_wrap() {
    let mut site = Site::new(Instant::from_micros(WRAP - 3_000_000));
    site.run_for(millis(2_500));
    site.world.gcs[0].heartbeat_period = None;
    let last = site.world.stack.peers(site.shown()).next().and_then(|info| info.last_heartbeat()).expect("a station");
    for _ in 0..8_000 {
        if site.world.now().as_micros() >= WRAP {
            site.behind = Duration::from_micros(WRAP);
        }
        site.step();
        // The step itself takes no time.
        let silent = site.world.now() - last;
        let is_alive = site.world.stack.has_ground_station(site.shown());
        assert!(silent < millis(5_002) || !is_alive, "{:?}", site.world.now());
        assert!(silent >= secs(5) || is_alive, "{:?}", site.world.now());
    }
    site.world.gcs[0].send(&Gcs::heartbeat());
    site.step();
    site.step();
    let info = site.world.stack.peers(site.shown()).next().expect("a station");
    assert_eq!((info.last_heartbeat(), info.last_heard(), info.is_alive), (Some(site.shown()), site.shown(), true));
}

/// X-7, J-3, J-7: sticks and setpoints from before the step are not valid after it, and later ones expire as always.
#[test]
fn sticks_and_setpoints_do_not_outlive_a_step() {
    for step in [1_001_000, WRAP] {
        let mut site = Site::new(Instant::from_micros(WRAP));
        let sticks = ManualControl { target: 1, x: 5, z: 500, ..Default::default() };
        let setpoint = SetPositionTargetLocalNed { target_system: 1, target_component: 1, ..Default::default() };
        let valid = |site: &Site| {
            let (stack, now) = (&site.world.stack, site.shown());
            let sticks = stack.manual_input().manual_control(now);
            assert_eq!(stack.manual_input().holder(now).is_some(), sticks.is_some());
            assert!(sticks.is_none_or(|sticks| sticks.at <= now && now - sticks.at < millis(500)));
            let setpoint = stack.setpoints.current(now);
            assert!(setpoint.is_none_or(|setpoint| setpoint.at <= now && setpoint.age(now) < millis(500)));
            [sticks.is_some(), setpoint.is_some()]
        };
        site.run_for(millis(1_500));
        for (round, expected) in [[true; 2], [true; 2]].into_iter().enumerate() {
            site.world.gcs[0].send(&sticks);
            site.world.gcs[0].send(&setpoint);
            site.run_for(millis(10));
            assert_eq!(valid(&site), expected, "round {round}");
            if round == 0 {
                site.behind = Duration::from_micros(step);
                site.step();
                assert_eq!(valid(&site), [false; 2]);
            }
        }
        site.run_for(millis(600));
        assert_eq!(valid(&site), [false; 2]);
    }
}

/// the time of day goes on from where it was, until it is set again.
#[test]
fn time_of_day_goes_on() {
    const NOON: u64 = 1_700_000_000_000_000;
    let mut clock = WallClock::new();
    let at = Instant::from_micros;
    assert_eq!(clock.unix_usec(at(WRAP - 9)), None);
    clock.set(at(WRAP - 5), NOON);
    assert_eq!(clock.unix_usec(at(WRAP - 1)), Some(NOON + 4));
    assert_eq!(clock.unix_usec(at(0)), Some(NOON + 4), "continued");
    assert_eq!(clock.unix_usec(at(7)), Some(NOON + 11));
    assert_eq!(clock.message(at(8)).time_unix_usec, NOON + 12);
    clock.set(at(9), NOON + 20);
    assert_eq!((clock.unix_usec(at(10)), clock.unix_usec(at(9))), (Some(NOON + 21), Some(NOON + 21)), "clamped");
    // A clock that is first set after the step.
    clock.set(at(5), NOON);
    assert_eq!(clock.unix_usec(at(2_000_010)), Some(NOON + 2_000_000), "{clock:?}");
}

/// A socket with nothing in it but a queue.
#[derive(Default)]
struct Socket(Vec<Vec<u8>>);

impl DatagramSocket for Socket {
    type Endpoint = u8;

    fn receive(&mut self, buffer: &mut [u8]) -> Option<(usize, u8)> {
        let datagram = self.0.pop()?;
        buffer[..datagram.len()].copy_from_slice(&datagram);
        Some((datagram.len(), 1))
    }

    fn is_ready(&mut self) -> bool {
        true
    }

    fn send(&mut self, _: &[u8], _: u8) -> bool {
        true
    }
}

/// a UDP station that falls silent frees its link after five seconds, across a step.
#[test]
fn silent_station_frees_its_link_across_a_step() {
    let mut world = World::new(Setup::<1>::new());
    let (mut udp, mut socket) = (UdpLinks::<u8, 1>::new([LINK]), Socket::default());
    let mut heartbeat = world.gcs[0].frame_from(STATION, &Gcs::heartbeat());
    socket.0.push(std::mem::take(&mut heartbeat));
    for ms in 0..7_000 {
        let now = Instant::from_millis(if ms < 1_000 { 100_000 + ms } else { ms });
        world.pulse.tick();
        world.stack.poll(now, &mut world.vehicle);
        world.stack.poll_udp(now, &mut udp, &mut socket, &mut world.vehicle);
        // The step itself takes no time.
        assert_eq!(udp.stations().count(), usize::from(ms <= 5_000), "{ms} ms");
    }
    assert_eq!(world.stack.clock_steps(), 1);
}

/// X-7, G-17: the time of signatures is right after a step, for frames and for the firmware, which tells the time by its own clock.
#[cfg(feature = "signing")]
#[test]
fn signing_time_goes_on() {
    use crate::support::signer::*;
    use mavstack::signing::LinkSigning;
    let link = mavstack::LinkConfig::uart(115_200).with_signing(LinkSigning::REQUIRED);
    let mut rig = Rig::<1>::new([link]);
    rig.now = Instant::from_micros(WRAP - 3_000_000);
    rig.set_key(KEY);
    let (unix, began) = (1_420_070_400_000_000 + 10 * NOW, rig.now);
    let tell = |rig: &mut Rig<1>, elapsed: u64| {
        let now = rig.now;
        assert!(rig.signing().set_time(now, unix + elapsed, Duration::from_millis(100)), "{elapsed} µs");
    };
    rig.run_for(millis(100));
    tell(&mut rig, 100_000);
    rig.run_for(millis(2_800));
    assert_eq!(rig.now - began, millis(2_900));
    // The counter wraps; the firmware tells the time before the stack has noticed.
    rig.now = Instant::from_micros(100);
    tell(&mut rig, 2_900_100);
    rig.run_for(secs(1));
    tell(&mut rig, 3_900_100);
    let ahead = rig.timestamp() - NOW;
    assert!((390_000..400_000).contains(&ahead), "{ahead}");
    let at = NOW + 395_000;
    rig.receive(0, &Signer::new(KEY).at(at).frame(&Gcs::heartbeat()));
    assert_eq!(rig.counters().verified, 1);
    assert!(rig.transmit(0).iter().all(|frame| frame.signature().timestamp < at + 10_000));
}
