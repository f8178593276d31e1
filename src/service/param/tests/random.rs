//! Random events in random order: values on the wire equal the table, and accepted requests are answered.

use super::*;
use proptest::prelude::*;

#[derive(Clone, Debug)]
enum Event {
    List,
    Read(i16, String),
    Set(String, u8, u32),
    /// The vehicle sets something.
    Own(i8),
    Reset,
    /// A link sends its next answer, or a value of its list.
    Next,
    Poll(u64),
}

fn name() -> impl Strategy<Value = String> {
    let names = Table::INFO.iter().map(|info| String::from(info.name())).chain(["_HASH_CHECK".into(), "X".into()]);
    prop::sample::select(names.collect::<Vec<_>>())
}

fn bits() -> impl Strategy<Value = u32> {
    prop_oneof![
        0u32..300,
        (-300i32..0).prop_map(i32::cast_unsigned),
        (-150.0f32..150.0).prop_map(f32::to_bits),
        any::<u32>()
    ]
}

fn event() -> impl Strategy<Value = (bool, Event)> {
    let event = prop_oneof![
        2 => Just(Event::List),
        4 => (-2i16..10, name()).prop_map(|(index, name)| Event::Read(index, name)),
        8 => (name(), 0u8..11, bits()).prop_map(|(name, r#type, bits)| Event::Set(name, r#type, bits)),
        2 => (-12i8..12).prop_map(Event::Own),
        1 => Just(Event::Reset),
        20 => Just(Event::Next),
        4 => (0u64..50).prop_map(Event::Poll),
    ];
    (any::<bool>(), event)
}

/// A pending answer of a link.
#[derive(Clone, Debug, PartialEq)]
enum Wanted {
    ValueOf(u16),
    Hash,
    Refusal(i16, String),
}

/// The link, index and name of a pending refusal.
type Refusal = (usize, i16, String);

impl<const CAST: bool, const HASH: bool> Bench<CAST, HASH> {
    fn refusals(&mut self) -> Vec<Refusal> {
        let table = self.table.table_mut();
        let name = |name: [u8; 16]| String::from(Text::<16>::from_wire(name).as_str().expect("ASCII"));
        table.state.refusals.iter().map(|r| (usize::from(r.to.link.0), r.index, name(r.name))).collect()
    }
}

struct Clients {
    wanted: [Vec<Wanted>; 2],
    /// The last value of every parameter that each link has sent.
    sent_values: [Vec<Out>; 2],
    /// The names that each client has set.
    set: [Vec<String>; 2],
}

impl Clients {
    fn want(&mut self, link: usize, wanted: Wanted) {
        self.wanted[link].push(wanted);
    }

    /// A refusal on a link without one evicts the other link's last refusal, if that link has all slots.
    fn evict(&mut self, before: &[Refusal], after: &[Refusal]) {
        let link_of = |refusals: &[Refusal]| refusals.get(3).map(|refusal| refusal.0);
        let (Some(link), Some((_, index, name))) = (link_of(before), before.get(3).cloned()) else { return };
        if link_of(after) != Some(link) {
            assert!(before.iter().all(|refusal| refusal.0 == link), "the link had none");
            let wanted = Wanted::Refusal(index, name);
            if let Some(place) = self.wanted[link].iter().position(|other| *other == wanted) {
                self.wanted[link].remove(place);
            }
        }
        assert!(after.len() == 4, "none is lost");
    }

    fn see<const CAST: bool, const HASH: bool>(&mut self, bench: &mut Bench<CAST, HASH>, link: usize, out: Out) {
        let answers = match out {
            Value(u16::MAX, ref name, ..) => {
                assert_eq!(name, "_HASH_CHECK");
                Wanted::Hash
            }
            Value(index, ..) => {
                assert_eq!(out, bench.value(index), "the wire equals the table");
                self.sent_values[link][usize::from(index)] = out;
                Wanted::ValueOf(index)
            }
            Error(_, error, index, name) => {
                if error == DOES_NOT_EXIST {
                    let refusal = Wanted::Refusal(index, name);
                    let place = self.wanted[link].iter().position(|wanted| *wanted == refusal);
                    self.wanted[link].remove(place.expect("one for each request"));
                } else {
                    assert!(self.set[link].contains(&name), "{name}: no client set it");
                }
                return;
            }
        };
        self.wanted[link].retain(|wanted| *wanted != answers);
    }
}

fn run<const CAST: bool, const HASH: bool>(events: Vec<(bool, Event)>) {
    let mut bench = Bench::<CAST, HASH>::of(Version::V2);
    let sent_values = [bench.values(), bench.values()];
    let mut clients = Clients { wanted: Default::default(), sent_values, set: Default::default() };
    let index_of = |name: &str| Table::INFO.iter().position(|info| info.name() == name).map(|index| index as u16);
    for (is_b, event) in events {
        let (link, from) = if is_b { (1, B) } else { (0, A) };
        let before = bench.refusals();
        let is_request = matches!(event, Event::Read(..) | Event::Set(..));
        match event {
            Event::List => assert_eq!(bench.send(from, &LIST), Handled::Yes),
            Event::Read(index, name) => {
                if bench.send(from, &read(index, &name)) == Handled::Yes {
                    let found = u16::try_from(index)
                        .map_or_else(|_| index_of(&name), |index| Some(index).filter(|index| *index < COUNT));
                    clients.want(
                        link,
                        match found {
                            Some(index) => Wanted::ValueOf(index),
                            None if index < 0 && name == "_HASH_CHECK" && !CAST => Wanted::Hash,
                            None => Wanted::Refusal(index.max(-1), name),
                        },
                    );
                }
            }
            Event::Set(name, ..) if name == "_HASH_CHECK" && !CAST => {
                // A wrong one changes nothing (P-20).
                let was_active = bench.lists[link].is_active();
                assert_eq!(bench.send(from, &set(&name, MavParamType::UINT32, 0)), Handled::Yes);
                assert_eq!(bench.lists[link].is_active(), was_active);
            }
            Event::Set(name, r#type, bits) => {
                if bench.send(from, &set(&name, MavParamType(r#type), bits)) == Handled::Yes {
                    match index_of(&name) {
                        Some(index) => (0..2).for_each(|link| clients.want(link, Wanted::ValueOf(index))),
                        None => clients.want(link, Wanted::Refusal(-1, name.clone())),
                    }
                    clients.set[link].push(name);
                }
            }
            Event::Own(value) => {
                bench.table.set(Table::SMALL, value);
            }
            Event::Reset => assert_eq!(bench.command([4.0, -1.0, 0.0, 0.0]), Some(MavResult::ACCEPTED)),
            Event::Next => {
                if let Some(out) = bench.next(link).or_else(|| bench.next_listed(link)) {
                    clients.see(&mut bench, link, out);
                }
            }
            Event::Poll(millis) => bench.wait(millis),
        }
        if is_request {
            clients.evict(&before, &bench.refusals());
        }
        for index in 0..COUNT {
            let (info, bits) = bench.table.table_mut().get(index).expect("exists");
            assert!(info.is_valid(bits), "{} is out of its range", info.name());
        }
    }
    for link in 0..2 {
        for (_, out) in bench.run(link, 1_000) {
            clients.see(&mut bench, link, out);
        }
        assert!(!bench.lists[link].is_active());
        assert_eq!(bench.lists[link].due(), Instant::NEVER);
    }
    assert_eq!(clients.wanted, [vec![], vec![]], "accepted requests are answered");
    let values = bench.values();
    assert_eq!(clients.sent_values, [values.clone(), values], "every link has sent every value");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    /// P-14, P-16, D-3.
    #[test]
    fn the_wire_equals_the_table(events in prop::collection::vec(event(), 0..80)) {
        run::<false, false>(events);
    }

    #[test]
    fn the_wire_equals_the_table_with_a_hash(events in prop::collection::vec(event(), 0..80)) {
        run::<false, true>(events);
    }

    #[test]
    fn the_wire_equals_the_table_with_casts(events in prop::collection::vec(event(), 0..80)) {
        run::<true, false>(events);
    }
}
