//! The pilot's receiver on a UART, beside ground stations: rules J-10 to J-13, with models of ExpressLRS and of mLRS.

use crate::support::radio::*;
use crate::support::*;
use mavstack::dialect::*;
use mavstack::manual_control::{ControlSource, ManualCounters, ManualInput};
use mavstack::message::SystemId;
use mavstack::{Address, Instant, LinkId, Message, Peer};
use proptest::prelude::*;

#[derive(mavstack::Stack)]
#[stack(
    vehicle: TestVehicle,
    links: 2,
    streams,
    commands: { slots: 2 },
    manual_control,
    operator_control,
)]
struct Piloted {
    setpoints: mavstack::setpoints::Setpoints,
}

/// QGroundControl's joystick on the first link, and receivers on the second.
const JOYSTICK: Peer = Peer { address: STATION, link: LinkId(0) };
const RECEIVER: Peer = Peer { address: ELRS, link: LinkId(1) };
const MLRS_RECEIVER: Peer = Peer { address: MLRS, link: LinkId(1) };
const GCS_SYSTEM: ControlSource = ControlSource::System(SystemId::new(255));

/// The time that a receiver needs to take over, and the time without input after which sticks are free (ms).
const TAKEOVER: u64 = 500;
const TIMEOUT: u64 = 500;

trait Radio {
    fn write(&mut self, millis: u64) -> Vec<u8>;
    fn read(&mut self, _: usize) {}
}

impl Radio for ExpressLrs {
    fn write(&mut self, millis: u64) -> Vec<u8> {
        ExpressLrs::write(self, millis)
    }

    fn read(&mut self, len: usize) {
        ExpressLrs::read(self, len);
    }
}

impl Radio for Mlrs {
    fn write(&mut self, millis: u64) -> Vec<u8> {
        Mlrs::write(self, millis)
    }
}

/// A vehicle, QGroundControl on its first link, and a receiver on its second.
struct Scene<R> {
    world: World<2, Piloted>,
    receiver: R,
    /// Whether QGroundControl sends heartbeats, and its joystick.
    has_station: bool,
    has_joystick: bool,
    millis: u64,
    /// The frames of the vehicle that the receiver has read.
    read: usize,
    holder: Option<Peer>,
    /// Each change of the holder, and when it was (ms).
    held: Vec<(u64, Option<Peer>)>,
}

impl<R: Radio> Scene<R> {
    fn new(receiver: R, receivers: &[Peer], source: ControlSource) -> Self {
        let mut setup = Setup::new();
        setup.links[1] = mavstack::LinkConfig::uart(460_800);
        let mut world = World::<2, Piloted>::of(setup);
        world.stack.manual_input_mut().set_receivers(receivers);
        world.stack.manual_input_mut().set_source(source);
        let (has_station, has_joystick) = (false, false);
        Self { world, receiver, has_station, has_joystick, millis: 0, read: 0, holder: None, held: Vec::new() }
    }

    /// Runs for some milliseconds.
    fn run(&mut self, millis: u64) {
        for _ in 0..millis {
            self.millis += 1;
            self.world.step_to(Instant::from_millis(self.millis));
            self.note();
            if self.has_station && self.millis.is_multiple_of(1_000) {
                self.send(0, STATION, &Gcs::heartbeat());
            }
            if self.has_joystick && self.millis % 40 == 3 {
                self.send(0, STATION, &ManualControl { target: 1, x: -300, z: 500, ..ManualControl::default() });
            }
            let bytes = self.receiver.write(self.millis);
            self.deliver(1, &bytes);
            let frames = &self.world.gcs[1].received[self.read..];
            self.read += frames.len();
            frames.iter().for_each(|frame| self.receiver.read(frame.raw.len()));
            self.note();
        }
    }

    fn send<M: Message>(&mut self, link: usize, from: Address, message: &M) {
        let frame = self.world.gcs[link].frame_from(from, message);
        self.deliver(link, &frame);
    }

    fn deliver(&mut self, link: usize, bytes: &[u8]) {
        let (now, world) = (self.world.now(), &mut self.world);
        let mut rest = bytes;
        while !rest.is_empty() {
            rest = &rest[world.stack.receive(now, LinkId(link as u8), rest, &mut world.vehicle)..];
        }
    }

    fn note(&mut self) {
        let holder = self.input().holder(self.world.now());
        if self.holder != holder {
            self.holder = holder;
            self.held.push((self.millis, holder));
        }
    }

    fn input(&self) -> &ManualInput {
        self.world.stack.manual_input()
    }

    fn counters(&self) -> ManualCounters {
        self.input().counters()
    }

    /// The first channel (µs).
    fn channel(&self) -> Option<u16> {
        self.input().rc_channels(self.world.now()).and_then(|channels| channels.channel(1))
    }

    /// The texts that the station has received.
    fn texts(&self) -> Vec<String> {
        let texts = self.world.gcs[0].all::<Statustext>();
        texts.iter().map(|(_, text)| text.text.as_str().unwrap().to_owned()).collect()
    }

    /// The changes of the holder since the last call.
    fn changes(&mut self) -> Vec<(u64, Option<Peer>)> {
        std::mem::take(&mut self.held)
    }
}

fn elrs(source: ControlSource) -> Scene<ExpressLrs> {
    Scene::new(ExpressLrs::new(), &[RECEIVER], source)
}

fn mlrs(channels: MlrsChannels) -> Scene<Mlrs> {
    Scene::new(Mlrs::new(channels), &[MLRS_RECEIVER, RECEIVER], ControlSource::GroundStation)
}

/// J-10: a receiver needs no heartbeat. None of 2,000 frames is refused without a ground station, and it makes none alive.
#[test]
fn receiver_steers_without_a_heartbeat() {
    let mut scene = elrs(ControlSource::GroundStation);
    while scene.counters().taken < 2_000 {
        scene.run(1);
        assert!(scene.millis < 26_000);
    }
    assert_eq!(scene.counters(), counted::<ManualCounters>(|counters| counters.taken = 2_000));
    let [(first, Some(RECEIVER))] = *scene.changes() else { panic!("{:?}", scene.held) };
    assert!(first <= 10, "{first} ms");
    assert_eq!(scene.channel(), Some(1_500));
    let (stack, now) = (&scene.world.stack, scene.world.now());
    assert!(
        !stack.has_ground_station(now) && !stack.has_controller(now, GCS_SYSTEM),
        "a receiver is no ground station"
    );
    assert!(stack.peers(now).all(|peer| !peer.is_alive), "its RADIO_STATUS shows nothing");
}

/// J-10: the ground station is lost at second 10. The receiver's sticks go on: its own frames show that it is alive.
#[test]
fn receiver_outlives_the_ground_station() {
    let mut scene = elrs(ControlSource::GroundStation);
    scene.has_station = true;
    scene.run(10_000);
    assert!(scene.world.stack.has_ground_station(scene.world.now()));
    scene.has_station = false;
    scene.run(10_000);
    assert!(!scene.world.stack.has_ground_station(scene.world.now()));
    assert_eq!(scene.changes().len(), 1, "it holds the sticks from the beginning to the end");
    assert_eq!((scene.counters().not_allowed, scene.channel()), (0, Some(1_500)));
}

/// J-11: a gap of 0.6 s in the receiver's frames lends the sticks to QGroundControl's joystick of the same system. When it is back, it
/// takes over after 500 ms, and the joystick is refused.
#[test]
fn receiver_takes_over_when_it_is_back() {
    for source in [GCS_SYSTEM, ControlSource::GroundStation] {
        let mut scene = elrs(source);
        (scene.has_station, scene.has_joystick) = (true, true);
        // The joystick begins: the receiver takes over after 500 ms of its frames.
        scene.receiver.is_connected = false;
        scene.run(2_000);
        scene.receiver.is_connected = true;
        scene.run(8_000);
        let [(_, Some(JOYSTICK)), (taken, Some(RECEIVER))] = *scene.changes() else { panic!("{:?}", scene.held) };
        assert!((2_000 + TAKEOVER..2_000 + TAKEOVER + 20).contains(&taken), "{taken} ms");

        scene.receiver.is_connected = false;
        scene.run(600);
        let refused = scene.counters().not_holder;
        scene.receiver.is_connected = true;
        scene.run(9_400);
        let changes = scene.changes();
        let [(lost, None), (lent, Some(JOYSTICK)), (back, Some(RECEIVER))] = *changes else { panic!("{changes:?}") };
        assert!((10_000 + TIMEOUT - 10..=10_000 + TIMEOUT + 10).contains(&lost), "lost at {lost} ms");
        assert!((1..=40).contains(&(lent - lost)), "lent at {lent} ms");
        assert!((10_600 + TAKEOVER..10_600 + TAKEOVER + 20).contains(&back), "back at {back} ms");
        // All of the joystick's 25 a second, but for the first and the last.
        let refused = scene.counters().not_holder - refused;
        assert!(refused >= (20_000 - back as u32) / 40, "{refused}");
        assert_eq!(scene.input().manual_control(scene.world.now()), None, "no stick of the joystick");
        assert_eq!(scene.channel(), Some(1_500));
    }
}

/// J-11: an own joystick of the second rank is refused while the receiver is alive, whoever came first and however long.
#[test]
fn joystick_is_refused_while_the_receiver_is_alive() {
    let mut scene = elrs(ControlSource::GroundStation);
    (scene.has_station, scene.has_joystick) = (true, true);
    scene.run(60_000);
    let changes = scene.changes();
    assert!(matches!(changes[..], [(_, Some(RECEIVER))]), "{changes:?}");
    assert_eq!(scene.counters().not_holder + scene.counters().not_allowed, 1_500);
    // Without the receiver the joystick steers as before.
    scene.receiver.is_connected = false;
    scene.run(10_000);
    let changes = scene.changes();
    let [(lost, None), (lent, Some(JOYSTICK))] = *changes else { panic!("{changes:?}") };
    assert!(lost <= 60_000 + TIMEOUT + 10 && lent <= lost + 40, "{changes:?}");
    assert_eq!(scene.input().manual_control(scene.world.now()).unwrap().x, Some(-300));
}

/// J-11: a receiver that is heard for less than 500 ms at a time does not take over.
#[test]
fn short_returns_do_not_take_over() {
    let mut scene = elrs(ControlSource::GroundStation);
    (scene.has_station, scene.has_joystick) = (true, true);
    scene.receiver.is_connected = false;
    scene.run(2_000);
    scene.changes();
    for _ in 0..10 {
        scene.receiver.is_connected = true;
        scene.run(TAKEOVER - 20);
        scene.receiver.is_connected = false;
        scene.run(TIMEOUT + 20);
    }
    assert_eq!(scene.changes(), [], "the joystick steers all the time");
    // A gap that is shorter does not matter.
    scene.receiver.is_connected = true;
    scene.run(200);
    scene.receiver.is_connected = false;
    scene.run(TIMEOUT - 40);
    scene.receiver.is_connected = true;
    scene.run(20);
    let changes = scene.changes();
    assert!(matches!(changes[..], [(_, Some(RECEIVER))]), "{changes:?}");
}

/// J-10: one component on one link. Another component of its system, and the same address on another link, are not the receiver.
#[test]
fn only_the_receiver_itself_is_the_receiver() {
    let mut scene = elrs(ControlSource::Nobody);
    scene.run(1);
    let channels = RcChannelsOverride { target_system: 1, chan1_raw: 1_200, ..RcChannelsOverride::default() };
    for (link, from) in [(0, ELRS), (1, STATION), (1, MLRS), (1, Address::new(255, 0)), (1, Address::new(254, 68))] {
        let before = scene.counters().not_allowed;
        scene.send(link, from, &channels);
        assert_eq!(scene.counters().not_allowed, before + 1, "{from:?} on link {link}");
    }
    assert!(scene.input().is_receiver(RECEIVER) && !scene.input().is_receiver(JOYSTICK));
    assert!(!scene.input().is_receiver(Peer { address: Address::new(0, 0), link: LinkId(0) }), "a vacant place");
    scene.run(30);
    assert_eq!(scene.channel(), Some(1_500));
    // Without it nobody may steer.
    scene.world.stack.manual_input_mut().set_receivers(&[]);
    let (taken, refused) = (scene.counters().taken, scene.counters().not_allowed);
    scene.run(100);
    assert_eq!((scene.counters().taken, scene.channel()), (taken, None));
    assert!(scene.counters().not_allowed > refused);
}

/// J-10: mLRS addresses its channels to all. Those of the receiver are accepted, those of others are not (J-4), and MANUAL_CONTROL
/// must name the vehicle (J-1).
#[test]
fn receiver_may_address_its_channels_to_all() {
    for channels in [MlrsChannels::Override, MlrsChannels::Radio] {
        let mut scene = mlrs(channels);
        scene.has_station = true;
        scene.receiver.pulse = 1_900;
        scene.run(2_000);
        let address = scene.receiver.address();
        assert_eq!(scene.counters(), counted::<ManualCounters>(|counters| counters.taken = 100), "{channels:?}");
        assert_eq!(scene.channel(), Some(1_900));
        scene.send(1, address, &ManualControl { target: 0, ..ManualControl::default() });
        scene.send(0, STATION, &RcChannelsOverride::default());
        assert_eq!(scene.counters().broadcast, 2);
    }
}

/// J-12: RADIO_RC_CHANNELS with OUTDATED does not refresh: the sticks are free 500 ms after the last frame of the transmitter.
#[test]
fn outdated_channels_refresh_nothing() {
    for period in [9, 20, 32, 53] {
        let mut scene = mlrs(MlrsChannels::Radio);
        scene.receiver.period = period;
        scene.run(2_000);
        scene.receiver.is_connected = false;
        scene.changes();
        scene.run(600);
        let changes = scene.changes();
        let [(lost, None)] = *changes else { panic!("{changes:?}") };
        assert!((2_000 + TIMEOUT - period..=2_000 + TIMEOUT).contains(&lost), "{period} ms: lost at {lost} ms");
        // It has not failed yet, and a frame in time revives it at once.
        scene.receiver.is_connected = true;
        scene.run(period);
        let changes = scene.changes();
        assert!(matches!(changes[..], [(_, Some(MLRS_RECEIVER))]), "{changes:?}");
        // Half of the frames suffice.
        for _ in 0..100 {
            scene.receiver.is_connected ^= true;
            scene.run(period);
        }
        assert_eq!(scene.changes(), []);
    }
}

/// J-12: a frame with FAILSAFE is the loss of the link, at once. After it the receiver steers again at once, or after 500 ms if
/// another sender has the sticks.
#[test]
fn failsafe_frees_the_sticks_at_once() {
    for has_joystick in [false, true] {
        let mut scene = mlrs(MlrsChannels::Radio);
        (scene.has_station, scene.has_joystick) = (true, has_joystick);
        scene.run(2_000);
        // A receiver that says so within 500 ms. It hears its transmitter again 40 ms later.
        let failed = RadioRcChannels { flags: RadioRcChannelsFlags::FAILSAFE, count: 16, ..RadioRcChannels::default() };
        scene.changes();
        scene.send(1, MLRS, &failed);
        assert_eq!((scene.channel(), scene.input().holder(scene.world.now())), (None, None));
        scene.note();
        scene.receiver.is_connected = false;
        scene.run(40);
        scene.receiver.is_connected = true;
        scene.run(1_000);
        let changes = scene.changes();
        if has_joystick {
            let [(2_000, None), (lent, Some(JOYSTICK)), (back, Some(MLRS_RECEIVER))] = *changes else {
                panic!("{changes:?}")
            };
            assert!(lent <= 2_040 && (2_040 + TAKEOVER..=2_060 + TAKEOVER).contains(&back), "{changes:?}");
        } else {
            let [(2_000, None), (back, Some(MLRS_RECEIVER))] = *changes else { panic!("{changes:?}") };
            assert!((2_041..=2_061).contains(&back), "{changes:?}");
        }
    }
}

/// J-12: failsafe values of mLRS never steer, however long they are sent; without flags, RC_CHANNELS_OVERRIDE cannot say that.
#[test]
fn failsafe_values_of_a_receiver_do_not_steer() {
    let mut scene = mlrs(MlrsChannels::Radio);
    scene.receiver.has_failsafe_values = true;
    scene.run(2_000);
    scene.changes();
    scene.receiver.is_connected = false;
    scene.receiver.pulse = 900;
    scene.run(10_000);
    let changes = scene.changes();
    let [(lost, None)] = *changes else { panic!("{changes:?}") };
    assert!(lost <= 2_000 + TIMEOUT, "{lost} ms");
    scene.receiver.is_connected = true;
    scene.run(20);
    assert_eq!(scene.channel(), Some(900));

    // The setting "no sig" is needed: then the sticks are free 1,250 ms later than with RADIO_RC_CHANNELS.
    let mut scene = mlrs(MlrsChannels::Override);
    scene.run(2_000);
    scene.changes();
    scene.receiver.is_connected = false;
    scene.run(10_000);
    let changes = scene.changes();
    let [(lost, None)] = *changes else { panic!("{changes:?}") };
    assert!((2_000 + Mlrs::TIMEOUT_MS + TIMEOUT - 20..=2_000 + Mlrs::TIMEOUT_MS + TIMEOUT).contains(&lost), "{lost}");
}

/// J-12: RADIO_RC_CHANNELS is preferred to RC_CHANNELS_OVERRIDE of the same component, also when it says FAILSAFE.
#[test]
fn radio_channels_are_preferred() {
    let mut scene = mlrs(MlrsChannels::Radio);
    let other = RcChannelsOverride { target_system: 1, chan1_raw: 1_100, ..RcChannelsOverride::default() };
    scene.run(100);
    for flags in [0, 1, 2, 3] {
        let before = scene.counters().not_holder;
        let flags = RadioRcChannelsFlags(flags);
        scene.send(1, MLRS, &RadioRcChannels { flags, count: 1, ..RadioRcChannels::default() });
        let channel = scene.channel();
        scene.send(1, MLRS, &other);
        assert_eq!((scene.counters().not_holder, scene.channel()), (before + 1, channel), "{flags:?}");
        assert_ne!(channel, Some(1_100));
    }
    // Without RADIO_RC_CHANNELS for the timeout, the other message steers again.
    scene.receiver.channels = MlrsChannels::Override;
    let end = scene.world.now() + millis(TIMEOUT);
    scene.world.step_to(Instant::from_micros(end.as_micros() - 1));
    scene.send(1, MLRS, &other);
    assert_eq!(scene.channel(), None);
    scene.world.step_to(end);
    scene.send(1, MLRS, &other);
    assert_eq!(scene.channel(), Some(1_100));
}

/// J-12: only a receiver may send RADIO_RC_CHANNELS.
#[test]
fn others_may_not_send_radio_channels() {
    let mut scene = elrs(GCS_SYSTEM);
    scene.receiver.is_connected = false;
    scene.has_station = true;
    scene.run(1_500);
    scene.send(0, STATION, &RadioRcChannels { target_system: 1, count: 16, ..RadioRcChannels::default() });
    assert_eq!((scene.counters().not_allowed, scene.channel()), (1, None));
}

/// J-12: ±4096 is 860 to 2140 µs, as ArduPilot takes it; 32 channels. Others are counted, and `count` is respected.
#[test]
fn radio_channels_are_centred_at_zero() {
    let mut scene = mlrs(MlrsChannels::Override);
    scene.receiver.is_connected = false;
    scene.run(2_000);
    let mut channels = [0; 32];
    channels[..7].copy_from_slice(&[-4_096, 4_096, 3_840, -1, 1, 4_097, -4_097]);
    channels[31] = 6;
    let message = RadioRcChannels { target_system: 1, count: 32, channels, ..RadioRcChannels::default() };
    scene.send(1, MLRS, &message);
    let seen = scene.input().rc_channels(scene.world.now()).unwrap();
    let expected =
        [Some(860), Some(2_140), Some(2_100), Some(1_500), Some(1_500), None, None, Some(1_500), Some(1_500)];
    assert_eq!(std::array::from_fn(|index| seen.channel(index as u8 + 1)), expected);
    assert_eq!(
        (seen.channel(0), seen.channel(18), seen.channel(32), seen.channel(33)),
        (None, Some(1_500), Some(1_500), None)
    );
    assert_eq!(scene.counters().bad_axes, 2);
    // RC_CHANNELS has 18 of them.
    let message = seen.to_message(scene.world.now(), &[]);
    assert_eq!(
        (message.chancount, message.chan2_raw, message.chan6_raw, message.chan18_raw),
        (18, 2_140, u16::MAX, 1_500)
    );
    // A count of 2, and one that is too large. Their age is that of each channel (J-3).
    scene.run(300);
    scene.send(1, MLRS, &RadioRcChannels { target_system: 1, count: 2, ..RadioRcChannels::default() });
    scene.run(300);
    let seen = scene.input().rc_channels(scene.world.now()).unwrap();
    assert_eq!([1, 2, 3, 32].map(|number| seen.channel(number)), [Some(1_500), Some(1_500), None, None]);
    scene.send(1, MLRS, &RadioRcChannels { target_system: 1, count: 255, ..RadioRcChannels::default() });
    assert_eq!(scene.input().rc_channels(scene.world.now()).unwrap().channel(32), Some(1_500));
}

proptest! {
    #![proptest_config(cases(200))]

    /// J-12, S-6: channels of any payload of any length are those of the decoded message.
    #[test]
    fn radio_channels_are_those_of_the_message(
        numbers in prop::collection::vec(-5_000..5_000i16, 32),
        (count, len) in (any::<u8>(), 0..=73usize),
    ) {
        let mut payload: Vec<u8> = vec![0, 0, 0, 0, 0, 0, 1, 1, count];
        payload.extend(numbers.into_iter().flat_map(i16::to_le_bytes));
        payload.truncate(len);
        let mut scene = mlrs(MlrsChannels::Radio);
        let frame = reference::v2(RadioRcChannels::ID, [0, 0], [51, 68], &payload, RadioRcChannels::CRC_EXTRA);
        scene.run(1);
        // Its last frame has expired.
        scene.world.step_to(Instant::from_millis(5_000));
        scene.deliver(1, &frame);
        let message = RadioRcChannels::decode(&payload);
        let seen = scene.input().rc_channels(scene.world.now());
        for (number, &value) in (1..=32).zip(&message.channels) {
            let is_given = number <= message.count && (-4_096..=4_096).contains(&value);
            let pulse = (1_500 + i32::from(value) * 5 / 32) as u16;
            prop_assert_eq!(seen.and_then(|seen| seen.channel(number)), is_given.then_some(pulse));
        }
    }
}

/// J-11: the first receiver has the higher rank, and the second one steers while it is silent.
#[test]
fn receivers_have_ranks() {
    let second = Peer { address: ELRS, link: LinkId(0) };
    let mut scene = Scene::new(ExpressLrs::new(), &[RECEIVER, second], ControlSource::Nobody);
    let channels = RcChannelsOverride { target_system: 1, chan1_raw: 1_200, ..RcChannelsOverride::default() };
    scene.run(1_000);
    scene.send(0, ELRS, &channels);
    assert_eq!(scene.channel(), Some(1_500));
    scene.receiver.is_connected = false;
    scene.changes();
    for _ in 0..60 {
        scene.run(10);
        scene.send(0, ELRS, &channels);
        scene.note();
    }
    assert_eq!(scene.channel(), Some(1_200));
    scene.receiver.is_connected = true;
    for _ in 0..60 {
        scene.run(10);
        scene.send(0, ELRS, &channels);
        scene.note();
    }
    let changes = scene.changes();
    let [(_, None), (_, Some(lent)), (back, Some(RECEIVER))] = *changes else { panic!("{changes:?}") };
    assert!(lent == second && (1_600 + TAKEOVER..1_620 + TAKEOVER).contains(&back), "{changes:?}");
}

/// J-11, O-5: the receiver's rank is above operator control. Its commands and setpoints are those of its system.
#[test]
fn receiver_steers_whoever_is_in_control() {
    let mut scene = elrs(ControlSource::Systems { first: SystemId::new(1), last: SystemId::new(255) });
    (scene.has_station, scene.has_joystick) = (true, true);
    scene.run(3_000);
    scene.changes();
    let request = CommandLong {
        target_system: 1,
        target_component: 1,
        command: MavCmd(32_100),
        param1: 1.0,
        ..CommandLong::default()
    };
    scene.send(0, OTHER_STATION, &Gcs::heartbeat());
    scene.send(0, OTHER_STATION, &request);
    assert_eq!(scene.world.stack.operator(scene.world.now()), Some(SystemId::new(254)));
    scene.run(1_000);
    assert_eq!((scene.changes(), scene.channel()), (vec![], Some(1_500)));
    let dropped = scene.world.stack.operator_control().counters().messages;
    assert!((24..=26).contains(&dropped), "the joystick's: {dropped}");
    scene.send(1, ELRS, &SetPositionTargetLocalNed { target_system: 1, target_component: 1, ..Default::default() });
    assert_eq!(scene.world.stack.operator_control().counters().messages, dropped + 1);
    scene.send(1, ELRS, &CommandLong { command: MavCmd::COMPONENT_ARM_DISARM, ..request });
    assert_eq!(scene.world.stack.operator_control().counters().commands, 1);
    // RADIO_RC_CHANNELS is a stick too.
    scene.send(0, STATION, &RadioRcChannels { target_system: 1, ..Default::default() });
    assert_eq!(scene.world.stack.operator_control().counters().messages, dropped + 2);
}

/// J-13: the hook and a text say who holds the sticks, and by which link; once for each change.
#[test]
fn change_of_the_holder_is_reported() {
    let mut scene = elrs(ControlSource::GroundStation);
    (scene.has_station, scene.has_joystick) = (true, true);
    scene.run(6_000);
    scene.receiver.is_connected = false;
    scene.run(6_000);
    scene.has_joystick = false;
    scene.run(6_000);
    let holders: Vec<_> = scene.world.vehicle.stick_holders.iter().map(|&(_, holder)| holder).collect();
    assert_eq!(holders, [Some(RECEIVER), None, Some(JOYSTICK), None]);
    // Within a pass of the loop.
    let changes = scene.changes();
    for (&(seen, _), (told, _)) in changes.iter().zip(&scene.world.vehicle.stick_holders) {
        assert!(told.as_millis() - seen <= 1, "{seen}: {told:?}");
    }
    assert_eq!(
        scene.texts(),
        [
            "Sticks: system 255 component 68, link 1",
            "Sticks lost",
            "Sticks: system 255 component 190, link 0",
            "Sticks lost"
        ]
    );
}

/// J-13, T-5: a receiver at the end of its range causes no flood of texts.
#[test]
fn changes_of_the_holder_are_no_flood() {
    let mut scene = elrs(ControlSource::GroundStation);
    scene.has_station = true;
    for _ in 0..50 {
        scene.receiver.is_connected ^= true;
        scene.run(600);
    }
    assert!(scene.world.vehicle.stick_holders.len() >= 49, "each change is reported to the firmware");
    assert!(scene.texts().len() <= 2 * 30 / 5 + 2, "{:?}", scene.texts());
}

/// J-11: a change of the source does not end the turn of a receiver; a change of the receivers ends any turn.
#[test]
fn settings_apply_at_once() {
    let mut scene = elrs(ControlSource::GroundStation);
    scene.run(100);
    let input = scene.world.stack.manual_input_mut();
    input.set_source(GCS_SYSTEM);
    input.set_receivers(&[RECEIVER]);
    assert_eq!(scene.channel(), Some(1_500));
    scene.world.stack.manual_input_mut().set_receivers(&[MLRS_RECEIVER, RECEIVER, JOYSTICK]);
    assert_eq!((scene.channel(), scene.input().holder(scene.world.now())), (None, None));
    assert!(scene.input().is_receiver(RECEIVER) && !scene.input().is_receiver(JOYSTICK), "two at most");
    scene.run(20);
    assert_eq!(scene.channel(), Some(1_500));
}

/// H-13, Q-8: RADIO_STATUS at 90 Hz says nothing, and slows the streams of its own link only, and evenly. The receiver's buffer never
/// overflows.
#[test]
fn status_of_a_receiver_slows_its_streams_evenly() {
    // Packets per second, the bytes of telemetry in every second one, and the longest gap (ms) of ATTITUDE.
    for (rate, telemetry, longest) in [(500, 5, 150), (250, 5, 500), (100, 10, 900)] {
        let mut scene = elrs(ControlSource::GroundStation);
        scene.has_station = true;
        (scene.receiver.rate, scene.receiver.telemetry) = (rate, telemetry);
        // 2.5 kB a second, on both links.
        for (link, from) in [(0, STATION), (1, STATION)] {
            for (id, interval) in [(Attitude::ID, 20_000.0), (GlobalPositionInt::ID, 100_000.0), (SysStatus::ID, 1e6)] {
                let set = CommandLong {
                    target_system: 1,
                    target_component: 1,
                    command: MavCmd::SET_MESSAGE_INTERVAL,
                    param1: id as f32,
                    param2: interval,
                    ..CommandLong::default()
                };
                scene.send(link, from, &set);
            }
        }
        scene.run(20_000);
        let attitudes = |link: usize| -> Vec<_> {
            scene.world.gcs[link].all::<Attitude>().iter().map(|(at, _)| at.as_millis()).collect()
        };
        let gap = attitudes(1).windows(2).map(|pair| pair[1] - pair[0]).max().unwrap();
        assert!(gap <= longest, "{rate} packets a second: {gap} ms");
        assert_eq!(scene.receiver.overflow, 0, "{rate} packets a second");
        assert!(attitudes(0).len() >= 999, "the other link is not slowed");
        assert_eq!(scene.texts(), ["Sticks: system 255 component 68, link 1"]);
    }
}

/// H-10, H-13, J-3: without its transmitter ExpressLRS goes on with RADIO_STATUS. That keeps nothing alive.
#[test]
fn status_keeps_nothing_alive() {
    let mut scene = elrs(ControlSource::GroundStation);
    scene.run(2_000);
    scene.receiver.is_connected = false;
    scene.changes();
    scene.run(10_000);
    let changes = scene.changes();
    let [(lost, None)] = *changes else { panic!("{changes:?}") };
    assert!(lost <= 2_000 + TIMEOUT + 10, "{lost} ms");
    let peer = scene.world.stack.peers(scene.world.now()).find(|info| info.peer == RECEIVER).unwrap();
    assert!(!peer.is_alive && peer.last_heard() > Instant::from_millis(11_900));
    assert!(!scene.world.stack.has_ground_station(scene.world.now()));
}
