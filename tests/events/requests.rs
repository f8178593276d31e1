//! REQUEST_EVENT and its answers. Rule EVT-4.

use super::*;
use mavstack::Message;

fn request(first_sequence: u16, last_sequence: u16) -> RequestEvent {
    RequestEvent { first_sequence, last_sequence, target_system: 1, target_component: 1 }
}

/// Requests events, and returns the sequence numbers of those that arrive, and the errors.
fn ask(site: &mut Site, from: Address, first: u16, last: u16) -> (Vec<u16>, Vec<ResponseEventError>) {
    site.gcs[0].forget();
    site.gcs[1].forget();
    site.gcs[0].send_from(from, &request(first, last));
    site.run_for(millis(400));
    assert_eq!(site.gcs[1].count_of::<Event>() + site.gcs[1].count_of::<ResponseEventError>(), 0, "the other link");
    let events = site.gcs[0].all::<Event>().iter().map(|(_, event)| event.sequence).collect();
    (events, site.gcs[0].all::<ResponseEventError>().into_iter().map(|(_, error)| error).collect())
}

fn error(to: Address, sequence: u16, oldest: u16) -> ResponseEventError {
    ResponseEventError {
        sequence,
        sequence_oldest_available: oldest,
        target_system: to.system.wire(),
        target_component: to.component.wire(),
        reason: MavEventErrorReason::UNAVAILABLE,
    }
}

/// A vehicle whose history has the events 11 to 30.
fn full() -> Site {
    let mut site = site();
    count(&mut site, 0..14);
    site.run_for(millis(400));
    count(&mut site, 14..28);
    site.run_for(millis(400));
    site
}

/// EVT-4: events in the history are sent again, one or several, on the link of the request; a far older part is one error.
#[test]
fn events_are_sent_again_on_request() {
    let mut site = full();
    assert_eq!(ask(&mut site, STATION, 30, 30), (vec![30], vec![]));
    assert_eq!(ask(&mut site, STATION, 11, 11), (vec![11], vec![]));
    assert_eq!(ask(&mut site, STATION, 20, 25), ((20..=25).collect(), vec![]));
    assert_eq!(ask(&mut site, OTHER_STATION, 10, 10), (vec![], vec![error(OTHER_STATION, 10, 11)]));
    assert_eq!(ask(&mut site, STATION, 1, 5), (vec![], vec![error(STATION, 1, 11)]));
    assert_eq!(ask(&mut site, STATION, 1, 13), (vec![11, 12, 13], vec![error(STATION, 1, 11)]));
    assert_eq!(ask(&mut site, STATION, 60_000, 12), (vec![11, 12], vec![error(STATION, 60_000, 11)]));
    assert_eq!(ask(&mut site, STATION, 29, 28), (vec![29, 30], vec![]), "from 29 around to 28, up to the newest");
}

/// EVT-4: requests on both sides of the wrap of the sequence numbers, and across it, are answered like others.
#[test]
fn requests_are_answered_across_the_wrap() {
    let mut site = site();
    // With two reports of the checks, the newest is 65,536 + 9. The history has 20.
    count(&mut site, 0..65_543);
    site.run_for(secs(1));
    assert_eq!(ask(&mut site, STATION, 65_535, 0), (vec![65_535, 0], vec![]));
    assert_eq!(ask(&mut site, STATION, 65_530, 3), ((65_530..=65_535).chain(0..=3).collect(), vec![]));
    assert_eq!(ask(&mut site, STATION, 65_526, 9), ((65_526..=65_535).chain(0..=9).collect(), vec![]));
    assert_eq!(ask(&mut site, STATION, 9, 10), (vec![9], vec![]));
    assert_eq!(ask(&mut site, STATION, 10, 10), (vec![], vec![]), "not recorded yet");
    assert_eq!(ask(&mut site, STATION, 65_525, 65_525), (vec![], vec![error(STATION, 65_525, 65_526)]));
    assert_eq!(ask(&mut site, STATION, 65_500, 0).1, [error(STATION, 65_500, 65_526)]);
}

/// EVT-4: an event that was not recorded yet gets no answer; an error would make libevents' receiver request the history again.
#[test]
fn future_events_get_no_answer() {
    let mut site = full();
    assert_eq!(ask(&mut site, STATION, 31, 31), (vec![], vec![]));
    assert_eq!(ask(&mut site, STATION, 31, 90), (vec![], vec![]));
    assert_eq!(ask(&mut site, STATION, 29, 40), (vec![29, 30], vec![]));
}

/// EVT-4: a request from before a reboot, while nothing has happened yet, is told the number of the next event.
#[test]
fn empty_history_says_what_comes_next() {
    #[derive(mavstack::Stack)]
    #[stack(vehicle: Rover, links: 1, events: { history: 4 })]
    struct Quiet;
    let mut world = World::<1, Quiet>::of(Setup::new());
    world.gcs[0].send(&request(40_000, 40_000));
    world.run_for(millis(100));
    assert_eq!(world.expect::<ResponseEventError>(0, millis(1)), error(STATION, 40_000, 1));
}

/// EVT-4: two receivers on a link are answered, and each error goes to its own. A third request in the same moment is dropped and
/// counted.
#[test]
fn two_requests_are_pending_at_a_time() {
    let mut site = full();
    site.gcs[0].forget();
    let third = Address::new(200, 190);
    for (from, first, last) in
        [(STATION, 3, 3), (OTHER_STATION, 4, 12), (STATION, 3, 3), (third, 5, 5), (third, 12, 12)]
    {
        let frame = site.gcs[0].frame_from(from, &request(first, last));
        let now = site.now();
        site.stack.receive(now, LinkId(0), &frame, &mut site.vehicle);
    }
    site.run_for(millis(300));
    let errors = site.gcs[0].all::<ResponseEventError>().into_iter().map(|(_, error)| error).collect::<Vec<_>>();
    assert_eq!(errors, [error(STATION, 3, 11), error(OTHER_STATION, 4, 11)]);
    let events: Vec<_> = site.gcs[0].all::<Event>().iter().map(|(_, event)| event.sequence).collect();
    assert_eq!(events, [11, 12]);
    assert_eq!(site.stack.link_counters(LinkId(0)).unwrap().no_answer_slot, 2);
}

/// EVT-4: whatever range is requested, the answer ends.
#[test]
fn largest_range_ends() {
    let mut site = full();
    for first in [0, 1, 10, 11, 12, 30, 31, 32_767, 40_000, 65_535] {
        let (events, errors) = ask(&mut site, STATION, first, first.wrapping_sub(1));
        site.run_for(secs(1));
        assert!(events.len() <= 20 && errors.len() <= 1, "{first}: {events:?} {errors:?}");
    }
}

/// EVT-2, EVT-4: what a receiver has missed comes before what is new, which it could not use.
#[test]
fn requested_events_come_before_new_ones() {
    let mut site = full();
    site.gcs[0].forget();
    let frame = site.gcs[0].frame_from(STATION, &request(28, 29));
    count(&mut site, 28..30);
    let now = site.now();
    site.stack.receive(now, LinkId(0), &frame, &mut site.vehicle);
    site.run_for(millis(300));
    let events: Vec<_> = site.gcs[0].all::<Event>().iter().map(|(_, event)| event.sequence).collect();
    assert_eq!(events, [28, 29, 31, 32]);
}

/// emergencies are sent at once while a receiver requests old events 80 times a second. Before: 29 of 30 later than 1 s.
#[test]
fn emergencies_come_before_old_events() {
    let mut site = full();
    let mut late = 0;
    for number in 0..30_u32 {
        let newest = site.gcs[0].all::<Event>().len();
        let at = site.now();
        site.stack.event(at, &Full { a: u64::from(number), b: 0, c: 0, d: 0, e: 0 });
        let is_it = |event: &Event| event.log_levels & 0xF == 0 && event.arguments[0] == number as u8;
        let mut is_sent = false;
        for ms in 0..200_u16 {
            if ms % 12 == 0 {
                let newest = 28 + number as u16;
                site.gcs[0].send(&request(newest.saturating_sub(18), newest));
            }
            site.run_for(millis(1));
            is_sent |= site.gcs[0].all::<Event>().iter().skip(newest).any(|(_, event)| is_it(event));
        }
        late += u32::from(!is_sent);
    }
    assert_eq!(late, 0, "of 30 later than 200 ms");
}

/// streams fill a radio, and another link requests the checks 10 times a second, whose events have a tenth of it. An
/// emergency does not wait for them. Before: 8 of 10 later than 500 ms.
#[test]
fn emergencies_do_not_wait_for_other_links() {
    #[derive(mavstack::Stack)]
    #[stack(vehicle: Rover, links: 2, events: { history: 20, checks }, streams)]
    struct Streaming;
    let radio = Wire { bytes_per_second: 5_760, tx_fifo: 512, ..Wire::default() };
    let lines = [LineConfig { down: radio, ..LineConfig::default() }, LineConfig::default()];
    let links = [57_600, 921_600].map(LinkConfig::uart);
    let mut site = World::<2, Streaming>::of(Setup { links, lines, ..Setup::new() });
    site.run_for(secs(1));
    for id in [Attitude::ID, GlobalPositionInt::ID] {
        let interval = [id as f32, 5_000.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        site.gcs[0].command_long(MavCmd::SET_MESSAGE_INTERVAL, interval);
        site.run_for(millis(500));
    }
    let mut late = Vec::new();
    for number in 0..10_u64 {
        site.gcs[0].forget();
        let mut is_sent = None;
        for ms in 0..1_000 {
            if ms % 100 == 0 {
                site.gcs[1].command_long(MavCmd::RUN_PREARM_CHECKS, [0.0; 7]);
            }
            if ms == 500 {
                let at = site.now();
                site.stack.event(at, &Full { a: number, b: 0, c: 0, d: 0, e: 0 });
            }
            site.step();
            let is_it = |event: &Event| event.log_levels & 0xF == 0 && u64::from(event.arguments[0]) == number;
            if is_sent.is_none() && site.gcs[0].all::<Event>().iter().any(|(_, event)| is_it(event)) {
                is_sent = Some(ms - 500);
            }
        }
        late.push(is_sent);
    }
    assert!(late.iter().all(|ms| ms.is_some_and(|ms| ms <= 200)), "{late:?} ms");
}
