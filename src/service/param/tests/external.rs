//! Parameters that live elsewhere: a due value is sent, and the last value of each reaches every link.

use super::super::external::ExternalService;
use super::super::{ExternalParams, ParamBackend, ParamMemory, ParamUpdate, ParamWrite};
use super::*;
use proptest::prelude::*;

const COUNT: u16 = 5;

/// A vehicle with settings whose names are not sorted.
struct Rover {
    values: [u8; COUNT as usize],
    update: ParamUpdate,
}

impl ParamBackend for Rover {
    fn param_count(&self) -> u16 {
        COUNT
    }

    fn param_info(&self, index: u16) -> Option<ParamInfo> {
        let name = ["D", "B", "E", "A", "C"].get(usize::from(index))?;
        ParamInfo::new(name, 0u8, 0..=9).ok()
    }

    fn param_bits(&self, index: u16) -> Option<u32> {
        self.values.get(usize::from(index)).map(|value| value.bits())
    }

    fn set_param(&mut self, _: &mut Context<'_>, write: &ParamWrite) -> Result<(), MavParamError> {
        self.values[usize::from(write.index())] = write.value();
        Ok(())
    }

    fn take_update(&mut self) -> ParamUpdate {
        core::mem::replace(&mut self.update, ParamUpdate::Nothing)
    }
}

impl crate::Vehicle for Rover {
    fn state(&self) -> Option<VehicleState> {
        None
    }
}

struct Board;

impl Firmware for Board {
    type Vehicle = Rover;
    type Plans = NoPlans;
    type Parameters = ExternalParams<6>;
    type Credits = [crate::types::Credits; 0];
}

struct Bench {
    params: ExternalService,
    marks: ExternalParams<6>,
    rover: Rover,
    rest: Rest,
    now: Instant,
    lists: [ParamList; 2],
    ports: [Port; 2],
    /// The last value of each parameter that each link has sent.
    sent: [[Option<u32>; COUNT as usize]; 2],
}

impl Bench {
    fn new() -> Self {
        Self {
            params: Service::<Board>::NEW,
            marks: ParamMemory::VACANT,
            rover: Rover { values: [0; COUNT as usize], update: ParamUpdate::Nothing },
            rest: Rest::new(),
            now: Instant::from_millis(60_000),
            lists: [const { ParamList::NEW }; 2],
            ports: [0, 1].map(|link| port(LinkId(link), Version::V2)),
            sent: [[None; COUNT as usize]; 2],
        }
    }

    fn send<M: Message>(&mut self, link: usize, message: &M) {
        let from = [A, B][link];
        let mut bytes = [0; MAX_FRAME_LEN];
        let len = encode(message, Version::V2, from.address, 0, &mut bytes).expect("fits");
        with_frame(&bytes[..len], |frame| {
            let mut cx = self.rest.cx::<Board>(self.now, &mut self.marks, &mut self.rover);
            let received = Received {
                frame,
                from,
                trust: crate::types::Trust::Open,
                counts: true,
                may_change: true,
                target: target_of(frame),
                age: None,
            };
            self.params.on_frame(&mut cx, &mut self.ports[link], &mut self.lists[link], &received);
        });
    }

    fn poll(&mut self) {
        let mut cx = self.rest.cx::<Board>(self.now, &mut self.marks, &mut self.rover);
        self.params.poll(&mut cx, self.lists.iter_mut());
    }

    /// A link has room: the first turn with something to send sends it.
    fn next(&mut self, link: usize) -> bool {
        [Turn::ParamAnswer, Turn::LateParamList, Turn::ParamList].into_iter().any(|turn| self.take(link, turn))
    }

    /// Lets a link send in this turn. Returns whether it did.
    fn take(&mut self, link: usize, turn: Turn) -> bool {
        let (port, list) = (&mut self.ports[link], &mut self.lists[link]);
        let mut cx = self.rest.cx::<Board>(self.now, &mut self.marks, &mut self.rover);
        let pending = Service::<Board>::pending(&self.params, &cx.view(), port, list, turn);
        let pending = pending.filter(|(at, _)| *at <= cx.now);
        let is_due = pending.is_some();
        let sends = pending.is_some_and(|(_, reply)| self.params.send(&mut cx, port, list, reply));
        assert_eq!(sends, is_due, "a value that is due in {turn:?} is sent");
        if sends {
            with_frame(&take(&mut port.outbox), |frame| {
                if let Some(value) = frame.decode::<ParamValue>() {
                    assert_eq!(value.param_count, COUNT);
                    self.sent[link][usize::from(value.param_index)] = Some(value.param_value.to_bits());
                }
            });
        }
        sends
    }
}

#[derive(Clone, Debug)]
enum Event {
    List(usize),
    Read(usize, i16),
    Set(usize, &'static str, u32),
    Own(u16, u8),
    All(u16, u8),
    Next(usize),
    Restart(usize),
    Poll(u64),
}

fn event() -> impl Strategy<Value = Event> {
    let name = prop::sample::select(&["A", "B", "C", "D", "E", "F"][..]);
    prop_oneof![
        1 => (0usize..2).prop_map(Event::List),
        2 => (0usize..2, -1i16..7).prop_map(|(link, index)| Event::Read(link, index)),
        3 => (0usize..2, name, 0u32..12).prop_map(|(link, name, bits)| Event::Set(link, name, bits)),
        2 => (0u16..7, 0u8..9).prop_map(|(index, value)| Event::Own(index, value)),
        2 => (0u16..5, 0u8..9).prop_map(|(index, value)| Event::All(index, value)),
        12 => (0usize..2).prop_map(Event::Next),
        1 => (0usize..2).prop_map(Event::Restart),
        6 => (0u64..40).prop_map(Event::Poll),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    /// P-11, P-16: in each turn a link sends exactly if it is due; a change of the backend reaches every link that
    /// stays open.
    #[test]
    fn what_is_due_is_sent(events in prop::collection::vec(event(), 0..120)) {
        let mut bench = Bench::new();
        let mut told = [[false; COUNT as usize]; 2];
        for event in events {
            match event {
                Event::List(link) => bench.send(link, &LIST),
                Event::Read(link, index) => bench.send(link, &read(index, "NONE")),
                Event::Set(link, name, bits) => bench.send(link, &set(name, MavParamType::UINT8, bits)),
                Event::Own(index, value) => {
                    bench.poll();
                    if let Some(place) = bench.rover.values.get_mut(usize::from(index)) {
                        *place = value;
                        told.iter_mut().for_each(|link| link[usize::from(index)] = true);
                    }
                    bench.rover.update = ParamUpdate::One(index);
                }
                Event::All(index, value) => {
                    bench.poll();
                    bench.rover.values[usize::from(index)] = value;
                    bench.rover.update = ParamUpdate::All;
                    told = [[true; COUNT as usize]; 2];
                }
                Event::Next(link) => {
                    bench.next(link);
                }
                Event::Restart(link) => {
                    bench.poll();
                    let opened = StackEvent::Opened(&bench.ports[link], &mut bench.lists[link]);
                    Service::<Board>::on_event(&mut bench.params, opened);
                    // Marks of single values stay; a list does not.
                    (told[link], bench.sent[link]) = ([false; COUNT as usize], [None; COUNT as usize]);
                }
                Event::Poll(millis) => {
                    bench.now += Duration::from_millis(millis);
                    bench.poll();
                }
            }
        }
        for _ in 0..2_000 {
            bench.now += Duration::from_millis(1);
            bench.poll();
            for link in 0..2 {
                bench.next(link);
            }
        }
        for (link, told) in told.iter().enumerate() {
            prop_assert_eq!(bench.lists[link].due(), Instant::NEVER);
            for (index, _) in told.iter().enumerate().filter(|(_, told)| **told) {
                prop_assert_eq!(bench.sent[link][index], Some(u32::from(bench.rover.values[index])));
            }
        }
    }
}
