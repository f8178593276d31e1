//! MANUAL_CONTROL and RC_CHANNELS_OVERRIDE against a simple reference model of J-1 to J-4: whatever bytes are received, from
//! any sender at any time, no value is older than the timeout, out of range, or from an unauthorised sender.

use crate::support::*;
use mavstack::__private::NoPlans;
use mavstack::dialect::{ManualControl, RcChannelsOverride};
use mavstack::manual_control::{ControlSource, ManualCounters};
use mavstack::message::SystemId;
use mavstack::{Address, Duration, Instant, LinkId, Message, Peer, Stack};
use proptest::prelude::*;

/// Two stations, another component of the first one, the companion computer, and an unauthorised sender.
const SENDERS: [Address; 5] =
    [STATION, OTHER_STATION, Address::new(255, 25), Address::new(1, 191), Address::new(77, 190)];

/// A received frame.
#[derive(Clone, Debug)]
struct Event {
    /// Time since the previous event (µs).
    wait: u64,
    from: Address,
    link: u8,
    is_override: bool,
    is_v1: bool,
    payload: Vec<u8>,
}

impl Event {
    /// Returns the decoded payload, and the target system and component.
    fn read(&self) -> (Vec<u8>, u8, u8) {
        let (len, system, component) = if self.is_override { (38, 16, Some(17)) } else { (30, 10, None) };
        let mut payload = self.payload.clone();
        payload.resize(len, 0);
        (payload.clone(), payload[system], component.map_or(0, |at| payload[at]))
    }

    fn frame(&self) -> Vec<u8> {
        let (id, crc_extra) = if self.is_override {
            (RcChannelsOverride::ID, RcChannelsOverride::CRC_EXTRA)
        } else {
            (ManualControl::ID, ManualControl::CRC_EXTRA)
        };
        let source = [self.from.system.wire(), self.from.component.wire()];
        if self.is_v1 {
            reference::v1(id as u8, source, &self.payload, crc_extra)
        } else {
            reference::v2(id, [0, 0], source, &self.payload, crc_extra)
        }
    }
}

/// The reference model, as simple as possible.
struct Model {
    source: ControlSource,
    timeout: u64,
    now: u64,
    /// The present sender, and when it was last received.
    holder: Option<(Peer, u64)>,
    /// The time, x y z r s t aux1 to aux6, and the buttons.
    sticks: Option<(u64, [Option<i16>; 12], u32)>,
    channels: [Option<(u64, u16)>; 18],
    counters: ManualCounters,
    not_ours: u32,
}

impl Model {
    fn on(&mut self, event: &Event) {
        let (payload, system, component) = event.read();
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
        let holder = self.holder.filter(|&(_, at)| self.now - at < self.timeout).map(|(holder, _)| holder);
        if system == 0 {
            self.counters.broadcast += 1;
        } else if !may {
            self.counters.not_allowed += 1;
        } else if holder.is_some_and(|holder| holder != from) {
            self.counters.not_holder += 1;
        } else {
            self.counters.taken += 1;
            self.holder = Some((from, self.now));
            if event.is_override { self.on_channels(&payload) } else { self.on_sticks(&payload) }
        }
    }

    fn on_sticks(&mut self, payload: &[u8]) {
        let u16_at = |at: usize| u16::from_le_bytes([payload[at], payload[at + 1]]);
        let mut axes = [None; 12];
        for (index, axis) in axes.iter_mut().enumerate() {
            let at = if index < 4 { 2 * index } else { 14 + 2 * (index - 4) };
            if index >= 4 && payload[13] & 1 << (index - 4) == 0 {
                continue;
            }
            match u16_at(at) as i16 {
                raw @ -1_000..=1_000 => *axis = Some(raw),
                i16::MAX => {}
                _ => self.counters.bad_axes += 1,
            }
        }
        self.sticks = Some((self.now, axes, u32::from(u16_at(8)) + 65_536 * u32::from(u16_at(11))));
    }

    fn on_channels(&mut self, payload: &[u8]) {
        for (index, channel) in self.channels.iter_mut().enumerate() {
            let at = if index < 8 { 2 * index } else { 18 + 2 * (index - 8) };
            match (u16::from_le_bytes([payload[at], payload[at + 1]]), index) {
                (0, 0..8) | (65_534, _) => *channel = None,
                (0 | 65_535, _) => {}
                (raw, _) => *channel = Some((self.now, raw)),
            }
        }
    }

    fn is_fresh(&self, at: u64) -> bool {
        self.now - at < self.timeout
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
        stack.manual_input_mut().set_source(source);
        stack.manual_input_mut().set_timeout(Duration::from_micros(timeout));
        let mut vehicle = TestVehicle::new();
        let heartbeat = World::new(setup).gcs[0].frame_from(STATION, &Gcs::heartbeat());
        stack.receive(Instant::ZERO, LinkId(0), &heartbeat, &mut vehicle);
        let (channels, counters) = ([None; 18], ManualCounters::default());
        let model = Model { source, timeout, now: 0, holder: None, sticks: None, channels, counters, not_ours: 0 };
        Self { stack, vehicle, model }
    }

    fn on(&mut self, event: &Event) -> Result<(), TestCaseError> {
        self.model.now += event.wait;
        // Checked before the event, when values may just have timed out, and after it.
        self.check()?;
        let (now, frame) = (Instant::from_micros(self.model.now), event.frame());
        let taken = self.stack.receive(now, LinkId(event.link), &frame, &mut self.vehicle);
        prop_assert_eq!(taken, frame.len());
        self.model.on(event);
        self.check()
    }

    fn check(&self) -> Result<(), TestCaseError> {
        let (model, input) = (&self.model, self.stack.manual_input());
        let now = Instant::from_micros(model.now);
        let seen = input.manual_control(now);
        let sticks = seen.map(|seen| {
            let [a, b, c, d, e, f] = seen.aux;
            (seen.at.as_micros(), [seen.x, seen.y, seen.z, seen.r, seen.s, seen.t, a, b, c, d, e, f], seen.buttons)
        });
        prop_assert_eq!(sticks, model.sticks.filter(|&(at, ..)| model.is_fresh(at)));
        let holder = model.holder.filter(|&(_, at)| model.is_fresh(at)).map(|(holder, _)| holder);
        prop_assert_eq!(input.holder(now), holder);
        prop_assert!(seen.is_none_or(|seen| Some(seen.from) == holder), "from another sender");
        let channels = input.rc_channels(now);
        for (number, channel) in (1..).zip(model.channels) {
            let expected = channel.filter(|&(at, _)| model.is_fresh(at)).map(|(_, raw)| raw);
            prop_assert_eq!(channels.and_then(|seen| seen.channel(number)), expected, "channel {}", number);
        }
        prop_assert!(channels.is_none_or(|seen| (1..=18).any(|number| seen.channel(number).is_some())));
        prop_assert_eq!(input.counters(), model.counters);
        let counters = [0, 1].map(|link| self.stack.link_counters(LinkId(link)).unwrap());
        prop_assert_eq!(counters[0].not_ours + counters[1].not_ours, model.not_ours);
        prop_assert_eq!(counters[0].out_of_place + counters[1].out_of_place, 0);
        prop_assert_eq!(self.vehicle.calls.len(), 1, "only the station's heartbeat");
        Ok(())
    }
}

/// A special value, or any.
fn number() -> impl Strategy<Value = u16> {
    let edges = [0, 1, 1_000, 1_001, 1_500, 0x7FFE, 0x7FFF, 0x8000, 0xFC17, 0xFC18, 0xFFFD, 0xFFFE, 0xFFFF];
    prop_oneof![4 => prop::sample::select(edges.to_vec()), 1 => any::<u16>()]
}

/// A plausible payload: special values, usually to the vehicle, truncated anywhere.
fn plausible() -> impl Strategy<Value = Vec<u8>> {
    let target = || prop_oneof![8 => Just(1u8), 1 => Just(0), 1 => Just(2)];
    (prop::collection::vec(number(), 19), target(), target(), any::<u8>(), prop_oneof![3 => Just(38), 1 => 0..39usize])
        .prop_map(|(numbers, system, component, bits, len)| {
            let mut payload: Vec<u8> = numbers.into_iter().flat_map(u16::to_le_bytes).collect();
            // For both messages: each has a value where the other has its target.
            (payload[10], payload[16], payload[17]) = (system, system, component);
            payload[13] = bits;
            payload.truncate(len);
            payload
        })
}

/// Random bytes, often to the vehicle.
fn anything() -> impl Strategy<Value = Vec<u8>> {
    (prop::collection::vec(any::<u8>(), 0..=255), any::<bool>()).prop_map(|(mut payload, is_ours)| {
        for at in [10, 16, 17] {
            if let Some(byte) = payload.get_mut(at).filter(|_| is_ours) {
                *byte = 1;
            }
        }
        payload
    })
}

fn event(payload: impl Strategy<Value = Vec<u8>>, timeout: u64) -> impl Strategy<Value = Event> {
    let wait = prop_oneof![
        2 => Just(0),
        4 => 0..timeout,
        1 => prop::sample::select(vec![timeout - 1, timeout, timeout + 1]),
        1 => 0..3 * timeout,
    ];
    let from = prop::sample::select(SENDERS.to_vec());
    (wait, from, 0..2u8, any::<bool>(), any::<bool>(), payload).prop_map(
        |(wait, from, link, is_override, is_v1, mut payload)| {
            if is_v1 {
                payload.resize(if is_override { 18 } else { 11 }, 0);
            }
            Event { wait, from, link, is_override, is_v1, payload }
        },
    )
}

pub(super) fn source() -> impl Strategy<Value = ControlSource> {
    let range = |first, last| ControlSource::Systems { first: SystemId::new(first), last: SystemId::new(last) };
    prop_oneof![
        1 => Just(ControlSource::Nobody),
        2 => Just(ControlSource::System(SystemId::new(255))),
        4 => Just(range(254, 255)),
        2 => Just(range(1, 255)),
        2 => Just(ControlSource::GroundStation),
    ]
}

/// A policy, a timeout (µs), and frames of both kinds.
fn story(payload: impl Strategy<Value = Vec<u8>> + Clone) -> impl Strategy<Value = (ControlSource, u64, Vec<Event>)> {
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

    /// J-1 to J-4: messages of real senders.
    #[test]
    fn plausible_messages_follow_the_model(story in story(plausible().boxed())) {
        run(story)?;
    }

    /// J-1 to J-4, S-6, S-7: any bytes of any length.
    #[test]
    fn random_bytes_follow_the_model(story in story(anything().boxed())) {
        run(story)?;
    }
}
