//! What is sent on which link, in which order, and how fast. Rules EVT-1 to EVT-3 and EVT-5.

use super::*;
use mavstack::config::{LinkClass, TxVersion};
use mavstack::events::{EventSet, LogLevel};

const _: () = assert!(LogLevel::Disabled as u8 == 9);

/// EVT-1: an event has the id of its name, both levels, and its arguments without gaps.
#[test]
fn event_has_id_levels_and_arguments() {
    let mut site = site();
    site.gcs[0].forget();
    let now = site.now();
    let (reason, wheels) = (Reason::COMMAND, Wheels::LEFT | Wheels::RIGHT);
    site.stack.event(now, &Returning { reason, distance: 1.5, wheels, offset: -2 });
    site.run_for(millis(20));
    site.stack.with_context(now, |cx| cx.event(&Full { a: u64::MAX, b: -2, c: -3, d: -4, e: 5 }));
    site.stack.with_context(now, |cx| cx.event(&Parked));
    site.run_for(millis(20));
    let events = site.gcs[0].all::<Event>();
    let [(_, returning), (_, full), (_, parked)] = events[..] else { panic!("{events:?}") };

    // FNV-1a of "returning", "full" and "parked".
    let ids = [returning.id, full.id, parked.id];
    assert_eq!(ids, [0x0143_45B9, 0x0179_B33C, 0x010A_B790]);
    assert_eq!([returning.log_levels, full.log_levels, parked.log_levels], [0x74, 0x90, 0x55]);
    assert_eq!(returning.arguments[..10], [1, 0, 0, 0xC0, 0x3F, 3, 0, 0xFE, 0xFF, 0]);
    let mut expected = [0; 40];
    expected[..8].fill(0xFF);
    expected[8..16].copy_from_slice(&(-2_i64).to_le_bytes());
    expected[16..20].copy_from_slice(&(-3_i32).to_le_bytes());
    expected[20] = 0xFC;
    expected[21] = 5;
    assert_eq!(full.arguments, expected);
    assert_eq!(parked.arguments, [0; 40]);
    assert_eq!(returning.event_time_boot_ms, now.time_boot_ms());
    assert_eq!((returning.destination_system, returning.destination_component), (0, 0));
    assert_eq!(full.sequence, returning.sequence + 1);
    assert_eq!(RoverEvents::COMPONENT, 1);
}

/// EVT-2: every normal link sends each event once and in order.
#[test]
fn each_link_sends_all_events_in_order() {
    let mut site = site();
    count(&mut site, 0..15);
    site.run_for(millis(300));
    count(&mut site, 15..30);
    site.run_for(millis(300));
    for link in [0, 1] {
        assert_eq!(counted(&site, link), (0..30).collect::<Vec<_>>());
        let sequences: Vec<_> = site.gcs[link].all::<Event>().iter().map(|(_, event)| event.sequence).collect();
        assert!(sequences.iter().copied().eq(1..=sequences.len() as u16), "{sequences:?}");
    }
    assert_eq!(site.stack.event_counters(), support::counted(|_| ()));
}

/// EVT-2, L-2, S-10: nothing on a high-latency link, nor on one that sends MAVLink 1.
#[test]
fn links_that_cannot_carry_events_send_none() {
    let links = [
        LinkConfig::uart(2_400).with_class(LinkClass::HighLatency),
        LinkConfig::uart(57_600).with_version(TxVersion::V1),
    ];
    let mut site = Site::of(Setup { links, ..Setup::new() });
    count(&mut site, 0..5);
    site.gcs[1].send(&RequestEvent { last_sequence: 3, target_system: 1, target_component: 1, first_sequence: 1 });
    site.run_for(secs(10));
    for gcs in &site.gcs {
        assert_eq!(gcs.count_of::<Event>() + gcs.count_of::<CurrentEventSequence>(), 0);
        assert!(gcs.received.iter().all(|frame| frame.header.id < 256));
    }
    assert_eq!(site.stack.link_counters(LinkId(1)).unwrap().out_of_place, 1);
    assert!(site.stack.next_deadline(site.now()) > site.now(), "nothing is pending");
}

/// EVT-2, V-1: a link that switches to MAVLink 2 sends what the history still has.
#[test]
fn link_that_switches_to_version_2_sends_the_history() {
    let auto = LinkConfig::uart(115_200).with_version(TxVersion::Auto);
    let mut site = Site::of(Setup { links: [auto; 2], ..Setup::new() });
    site.run_for(millis(100));
    count(&mut site, 0..10);
    site.run_for(secs(1));
    assert_eq!(site.gcs[0].count_of::<Event>(), 0);
    site.gcs[0].send(&Gcs::heartbeat());
    site.run_for(secs(1));
    assert_eq!(counted(&site, 0), (0..10).collect::<Vec<_>>());
}

/// EVT-3: CURRENT_EVENT_SEQUENCE is sent every three seconds, with the last event of the link, and the reset flag until the first.
#[test]
fn sequence_is_sent_now_and_then() {
    let mut site = site();
    let begin = site.now();
    let first = site.expect::<CurrentEventSequence>(0, millis(1));
    assert_eq!((first.sequence, first.flags), (0, MavEventCurrentSequenceFlags::RESET));
    count(&mut site, 0..4);
    site.gcs[0].forget();
    site.run_for(secs(30));
    let all = site.gcs[0].all::<CurrentEventSequence>();
    let newest = site.gcs[0].all::<Event>().last().unwrap().1.sequence;
    assert_eq!(all.len(), 10);
    for ((at, current), number) in all.iter().zip(1..) {
        assert_eq!((current.sequence, current.flags), (newest, MavEventCurrentSequenceFlags::EMPTY));
        assert!((*at - begin).as_millis().abs_diff(number * 3_000) < 300, "{at:?}");
    }
}

/// EVT-3: when a link is opened, its peers learn the last sequence number at once. If none was heard before, they also learn that
/// the numbers start again, because what was sent had no receiver.
#[test]
fn sequence_is_sent_when_a_link_is_opened() {
    #[derive(mavstack::Stack)]
    #[stack(vehicle: Rover, links: 1, events: { history: 4 })]
    struct Unchecked;
    let mut world = World::<1, Unchecked>::of(Setup::new());
    let now = world.now();
    world.stack.event(now, &Parked);
    world.run_for(secs(1));
    let (reset, none) = (MavEventCurrentSequenceFlags::RESET, MavEventCurrentSequenceFlags::EMPTY);
    for (sequence, flags, is_heard) in [(1, reset, false), (1, reset, true), (2, none, false)] {
        world.stack.restart_link(LinkId(0));
        for wait in [millis(10), secs(4)] {
            world.gcs[0].forget();
            let current = world.expect::<CurrentEventSequence>(0, wait);
            assert_eq!((current.sequence, current.flags), (sequence, flags), "until the next event");
            assert_eq!(world.gcs[0].count_of::<Event>(), 0, "no event is sent again");
        }
        if is_heard {
            world.gcs[0].send(&Gcs::heartbeat());
            world.run_for(millis(50));
            let now = world.now();
            world.stack.event(now, &Parked);
            world.run_for(millis(50));
        }
    }
}

/// EVT-3, EVT-4: a link is opened again after it has failed. A station that was heard before gets the events that it has missed.
#[test]
fn events_lost_with_a_link_are_recovered() {
    let mut site = site();
    let mut receiver = receiver(Client::QGroundControl, STATION);
    site.gcs[0].send(&Gcs::heartbeat());
    for is_lost in [false, true, false] {
        count(&mut site, 0..4);
        for _ in 0..100 {
            site.run_for(millis(10));
            if !is_lost {
                receiver.poll(site.now(), &mut site.gcs[0]);
            }
        }
        if is_lost {
            site.gcs[0].forget();
            receiver.forgot();
            site.stack.restart_link(LinkId(0));
        }
    }
    let numbers = receiver.dialogue.events().iter().filter(|event| event.id == id_of::<Counted>()).map(number_of);
    assert_eq!(numbers.collect::<Vec<_>>(), [0, 1, 2, 3].repeat(3));
    assert_eq!(receiver.dialogue.lost(), 0);
}

/// EVT-2: events take at most half of a link's rate.
#[test]
fn events_take_half_of_the_rate() {
    let links = [LinkConfig::uart(57_600); 2];
    let mut site = Site::of(Setup { links, ..Setup::new() });
    site.run_for(millis(100));
    let before = site.stack.link_counters(LinkId(0)).unwrap().tx_bytes;
    for number in 0..1_000 {
        count(&mut site, number..number + 1);
        site.run_for(millis(5));
    }
    let sent = site.stack.link_counters(LinkId(0)).unwrap().tx_bytes - before;
    assert!((13_000..16_000).contains(&sent), "{sent} bytes in 5 s: half is 14,400");
}

/// EVT-5: events that were overwritten unsent are counted, and the receiver is told how many.
#[test]
fn overwritten_events_are_counted() {
    let mut site = site();
    site.run_for(secs(3));
    let mut receiver = receiver(Client::QGroundControl, STATION);
    let run = |site: &mut Site, millis: u64, receiver: &mut Receiver| {
        for _ in 0..millis {
            site.step();
            let now = site.now();
            receiver.poll(now, &mut site.gcs[0]);
        }
    };
    run(&mut site, 1, &mut receiver);
    count(&mut site, 0..50);
    run(&mut site, 2_000, &mut receiver);
    let numbers: Vec<_> =
        receiver.dialogue.events().iter().filter(|event| event.id == id_of::<Counted>()).map(number_of).collect();
    assert_eq!(numbers, (30..50).collect::<Vec<_>>(), "the history is 20 long");
    assert_eq!(receiver.dialogue.lost(), 30);
    assert_eq!(site.stack.event_counters().overwritten, 60, "on both links");
}
