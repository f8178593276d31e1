//! Setpoints against a simple reference model of J-6 to J-8: whatever bytes are received, from any sender at any time, no
//! setpoint is older than the timeout, from another sender than the owner, or not finite.

use super::manual_properties::source;
use crate::support::*;
use mavstack::__private::NoPlans;
use mavstack::dialect::{SetAttitudeTarget, SetPositionTargetGlobalInt, SetPositionTargetLocalNed};
use mavstack::manual_control::ControlSource;
use mavstack::message::SystemId;
use mavstack::setpoints::{Place, SetpointCounters, Target};
use mavstack::{Address, Duration, Instant, LinkId, Message, Peer, Stack};
use proptest::prelude::*;

/// Two stations, another component of the first one, the companion computer, and an unauthorised sender.
const SENDERS: [Address; 5] =
    [STATION, OTHER_STATION, Address::new(255, 25), Address::new(1, 191), Address::new(77, 190)];

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Local,
    Global,
    Attitude,
}

/// A received frame.
#[derive(Clone, Debug)]
struct Event {
    /// Time since the previous event (µs).
    wait: u64,
    from: Address,
    link: u8,
    kind: Kind,
    is_v1: bool,
    payload: Vec<u8>,
}

impl Event {
    /// The whole payload.
    fn read(&self) -> Vec<u8> {
        let mut payload = self.payload.clone();
        payload.resize(53, 0);
        payload
    }

    /// Where the target system is; the component follows it.
    fn target(&self) -> usize {
        if self.kind == Kind::Attitude { 36 } else { 50 }
    }

    fn frame(&self) -> Vec<u8> {
        let (id, crc_extra) = match self.kind {
            Kind::Local => (SetPositionTargetLocalNed::ID, SetPositionTargetLocalNed::CRC_EXTRA),
            Kind::Global => (SetPositionTargetGlobalInt::ID, SetPositionTargetGlobalInt::CRC_EXTRA),
            Kind::Attitude => (SetAttitudeTarget::ID, SetAttitudeTarget::CRC_EXTRA),
        };
        let source = [self.from.system.wire(), self.from.component.wire()];
        if self.is_v1 {
            reference::v1(id as u8, source, &self.payload, crc_extra)
        } else {
            reference::v2(id, [0, 0], source, &self.payload, crc_extra)
        }
    }
}

/// What a setpoint gives: numbers in their order on the wire, as bits.
type Given = Vec<Option<u32>>;

/// The reference model, as simple as possible.
struct Model {
    source: ControlSource,
    timeout: u64,
    now: u64,
    /// The sender, the time, and what it gave.
    setpoint: Option<(Peer, u64, Kind, Given)>,
    counters: SetpointCounters,
    not_ours: u32,
}

impl Model {
    fn current(&self) -> Option<&(Peer, u64, Kind, Given)> {
        self.setpoint.as_ref().filter(|(_, at, ..)| self.now - at < self.timeout)
    }

    fn on(&mut self, event: &Event) {
        let payload = event.read();
        let (system, component) = (payload[event.target()], payload[event.target() + 1]);
        if system > 1 || component > 1 {
            self.not_ours += 1;
            return;
        }
        let from = Peer { address: event.from, link: LinkId(event.link) };
        let sender = event.from.system;
        let may = match self.source {
            ControlSource::System(only) => sender == only,
            ControlSource::Systems { first, last } => (first..=last).contains(&sender),
            // Only this system sends heartbeats, on the first link.
            ControlSource::GroundStation => sender == SystemId::new(255) && event.link == 0,
            ControlSource::Nobody => false,
        };
        let counters = &mut self.counters;
        if system == 0 {
            counters.broadcast += 1;
        } else if !may {
            counters.not_allowed += 1;
        } else if self.setpoint.as_ref().is_some_and(|(owner, at, ..)| self.now - at < self.timeout && *owner != from) {
            counters.not_owner += 1;
        } else {
            let given = given(event.kind, &payload);
            let reals: Vec<f32> = given.iter().map(|bits| f32::from_bits(bits.unwrap_or(0))).collect();
            let skipped = if event.kind == Kind::Global { 2 } else { 0 };
            let bad = reals.iter().skip(skipped).position(|real| !real.is_finite()).map(|at| at + skipped);
            let out = is_out_of_range(event.kind, &given, &reals);
            // The first field that is wrong decides.
            match (bad, out) {
                (Some(bad), out) if out.is_none_or(|out| bad <= out) => counters.not_finite += 1,
                (_, Some(_)) => counters.out_of_range += 1,
                _ => {
                    counters.taken += 1;
                    self.setpoint = Some((from, self.now, event.kind, given));
                }
            }
        }
    }
}

/// Returns the place of the first number that is out of range.
fn is_out_of_range(kind: Kind, given: &Given, reals: &[f32]) -> Option<usize> {
    let degrees = |at: usize| f64::from(given[at].unwrap_or(0).cast_signed()) / 1e7;
    match kind {
        Kind::Local => None,
        Kind::Global if degrees(0).abs() > 90.0 => Some(0),
        Kind::Global => (degrees(1).abs() > 180.0).then_some(1),
        Kind::Attitude => {
            let length = reals[..4].iter().fold(0.0, |sum, real| sum + real * real);
            let is_turned = given[0].is_none() || (0.99_f32 * 0.99..=1.01 * 1.01).contains(&length);
            let thrust = (7..11).find(|&at| reals[at].abs() > 1.0);
            if is_turned { thrust } else { Some(3) }
        }
    }
}

fn given(kind: Kind, payload: &[u8]) -> Given {
    let bits = |at: usize| u32::from_le_bytes(payload[at..at + 4].try_into().unwrap());
    if kind != Kind::Attitude {
        let mask = u16::from_le_bytes([payload[48], payload[49]]);
        let ignores = [0, 1, 2, 3, 4, 5, 6, 7, 8, 10, 11];
        return ignores.iter().zip(1..).map(|(bit, at)| (mask >> bit & 1 == 0).then(|| bits(4 * at))).collect();
    }
    let mask = payload[38];
    (0..11)
        .map(|number| {
            let is_given = match number {
                0..4 => mask & 0x80 == 0,
                4..7 => mask >> (number - 4) & 1 == 0,
                7 => mask & 0x60 == 0,
                _ => mask & 0x20 != 0,
            };
            // The extension follows the base fields, which end at 39.
            is_given.then(|| bits(if number < 8 { 4 + 4 * number } else { 39 + 4 * (number - 8) }))
        })
        .collect()
}

/// What the stack says that the setpoint gives.
fn seen(target: Target) -> (Kind, Given) {
    let real = |real: Option<f32>| real.map(f32::to_bits);
    match target {
        Target::Position(seen) => {
            let (kind, place) = match seen.place {
                Place::Local(place) => (Kind::Local, place.map(real)),
                Place::Global { latitude, longitude, altitude } => {
                    let degrees = |degrees: Option<i32>| degrees.map(i32::cast_unsigned);
                    (Kind::Global, [degrees(latitude), degrees(longitude), real(altitude)])
                }
            };
            let motion = seen.velocity.into_iter().chain(seen.acceleration).chain([seen.yaw, seen.yaw_rate]);
            (kind, place.into_iter().chain(motion.map(real)).collect())
        }
        Target::Attitude(seen) => {
            let attitude = seen.attitude.map_or([None; 4], |attitude| attitude.map(Some));
            let body = seen.thrust_body.map_or([None; 3], |thrust| thrust.map(Some));
            let all = attitude.into_iter().chain(seen.rates).chain([seen.thrust]).chain(body);
            (Kind::Attitude, all.map(real).collect())
        }
    }
}

/// The stack and the model side by side; both links are equal.
struct Pair {
    stack: Box<Stack<Tested<NoPlans, 8, Steered>, 2>>,
    vehicle: TestVehicle,
    model: Model,
}

impl Pair {
    fn new(source: ControlSource, timeout: u64) -> Self {
        let setup = Setup::<2>::new();
        let mut stack: Box<Stack<Tested<NoPlans, 8, Steered>, 2>> = Box::new(Stack::VACANT);
        stack.begin(setup.config, setup.links);
        stack.setpoints.set_source(source);
        stack.setpoints.set_timeout(Duration::from_micros(timeout));
        let mut vehicle = TestVehicle::new();
        let heartbeat = World::new(setup).gcs[0].frame_from(STATION, &Gcs::heartbeat());
        stack.receive(Instant::ZERO, LinkId(0), &heartbeat, &mut vehicle);
        let counters = SetpointCounters::default();
        let model = Model { source, timeout, now: 0, setpoint: None, counters, not_ours: 0 };
        Self { stack, vehicle, model }
    }

    fn on(&mut self, event: &Event) -> Result<(), TestCaseError> {
        self.model.now += event.wait;
        // Checked before the event, when the setpoint may just have expired, and after it.
        self.check()?;
        let (now, frame) = (Instant::from_micros(self.model.now), event.frame());
        let taken = self.stack.receive(now, LinkId(event.link), &frame, &mut self.vehicle);
        prop_assert_eq!(taken, frame.len());
        self.model.on(event);
        self.check()
    }

    fn check(&self) -> Result<(), TestCaseError> {
        let (model, setpoints) = (&self.model, &self.stack.setpoints);
        let now = Instant::from_micros(model.now);
        let found = setpoints.current(now).map(|found| {
            let (kind, given) = seen(found.target);
            (found.from, found.at.as_micros(), kind, given)
        });
        prop_assert_eq!(found.as_ref(), model.current());
        prop_assert_eq!(setpoints.owner(now), model.current().map(|(owner, ..)| *owner));
        prop_assert_eq!(setpoints.counters(), model.counters);
        let counters = [0, 1].map(|link| self.stack.link_counters(LinkId(link)).unwrap());
        prop_assert_eq!(counters[0].not_ours + counters[1].not_ours, model.not_ours);
        prop_assert_eq!(self.vehicle.calls.len(), 1, "only the station's heartbeat");
        Ok(())
    }
}

/// A special value, or any.
fn number() -> impl Strategy<Value = u32> {
    let reals = [0.0, 0.5, -0.5, 1.0, -1.0, 1.1, 8.0, f32::MAX, f32::NAN, f32::INFINITY];
    let edges = [900_000_000, 900_000_001, -900_000_001, 1_800_000_000, 1_800_000_001, i32::MIN];
    prop_oneof![
        12 => prop::sample::select(reals[..5].to_vec()).prop_map(f32::to_bits),
        1 => prop::sample::select(reals.to_vec()).prop_map(f32::to_bits),
        1 => prop::sample::select(edges.to_vec()).prop_map(i32::cast_unsigned),
        1 => any::<u32>(),
    ]
}

/// A plausible payload: special values, usually to the vehicle, truncated anywhere.
fn plausible() -> impl Strategy<Value = (Kind, Vec<u8>)> {
    let kind = prop::sample::select(vec![Kind::Local, Kind::Global, Kind::Attitude]);
    let target = || prop_oneof![8 => Just(1u8), 1 => Just(0), 1 => Just(2)];
    let mask = prop_oneof![1 => Just(0), 2 => any::<u16>(), 1 => Just(0x0DF8)];
    let len = prop_oneof![5 => Just(53), 1 => 0..54usize];
    (kind, prop::collection::vec(number(), 14), target(), target(), mask, any::<u8>(), len).prop_map(
        |(kind, numbers, system, component, mask, frame, len)| {
            let mut payload: Vec<u8> = numbers.into_iter().flat_map(u32::to_le_bytes).collect();
            if kind == Kind::Attitude {
                payload[36..39].copy_from_slice(&[system, component, mask as u8]);
                // The extension follows without a gap.
                payload.copy_within(40..52, 39);
                payload.truncate(len.min(51));
            } else {
                payload[48..53].copy_from_slice(&[mask as u8, (mask >> 8) as u8, system, component, frame]);
                payload.truncate(len);
            }
            (kind, payload)
        },
    )
}

/// Random bytes, often to the vehicle.
fn anything() -> impl Strategy<Value = (Kind, Vec<u8>)> {
    let kind = prop::sample::select(vec![Kind::Local, Kind::Global, Kind::Attitude]);
    (kind, prop::collection::vec(any::<u8>(), 0..=255), any::<bool>()).prop_map(|(kind, mut payload, is_ours)| {
        let at = if kind == Kind::Attitude { 36 } else { 50 };
        for at in [at, at + 1] {
            if let Some(byte) = payload.get_mut(at).filter(|_| is_ours) {
                *byte = 1;
            }
        }
        (kind, payload)
    })
}

fn event(payload: impl Strategy<Value = (Kind, Vec<u8>)>, timeout: u64) -> impl Strategy<Value = Event> {
    let wait = prop_oneof![
        2 => Just(0),
        4 => 0..timeout,
        1 => prop::sample::select(vec![timeout - 1, timeout, timeout + 1]),
        1 => 0..3 * timeout,
    ];
    let from = prop::sample::select(SENDERS.to_vec());
    (wait, from, 0..2u8, any::<bool>(), payload).prop_map(|(wait, from, link, is_v1, (kind, mut payload))| {
        if is_v1 {
            payload.resize(if kind == Kind::Attitude { 39 } else { 53 }, 0);
        }
        Event { wait, from, link, kind, is_v1, payload }
    })
}

/// A policy, a timeout (µs), and frames of all kinds.
fn story(
    payload: impl Strategy<Value = (Kind, Vec<u8>)> + Clone,
) -> impl Strategy<Value = (ControlSource, u64, Vec<Event>)> {
    prop_oneof![1u64..10, 1_000..2_000_000u64, Just(500_000)].prop_flat_map(move |timeout| {
        (source(), Just(timeout), prop::collection::vec(event(payload.clone(), timeout), 1..60))
    })
}

fn run((source, timeout, events): (ControlSource, u64, Vec<Event>)) -> Result<(), TestCaseError> {
    let mut pair = Pair::new(source, timeout);
    events.iter().try_for_each(|event| pair.on(event))
}

proptest! {
    #![proptest_config(cases(200))]

    /// J-6 to J-8: messages of real senders.
    #[test]
    fn plausible_setpoints_follow_the_model(story in story(plausible().boxed())) {
        run(story)?;
    }

    /// J-6 to J-8, S-6, S-7: any bytes of any length.
    #[test]
    fn random_bytes_follow_the_model(story in story(anything().boxed())) {
        run(story)?;
    }
}
