//! Health and arming checks. Rules EVT-6 and EVT-7.

use super::*;
use mavstack::events::CheckSet;

/// A summary, read back: its arguments after the number of the chunk.
fn masks<const N: usize>(event: &Event) -> [u32; N] {
    assert_eq!(event.arguments[0], 0, "one chunk");
    std::array::from_fn(|i| u32::from_le_bytes(*event.arguments[1 + 4 * i..].first_chunk().unwrap()))
}

/// Returns the events of the next report, which arrives within `within`.
fn report(site: &mut Site, within: mavstack::Duration) -> Vec<Event> {
    site.gcs[0].forget();
    let is_whole = |site: &mut Site| {
        site.gcs[0].all::<Event>().iter().any(|(_, event)| event.id == RoverEvents::HEALTH_SUMMARY.id())
    };
    assert!(site.run_until(within, is_whole), "no report");
    let events: Vec<_> = site.gcs[0].all::<Event>().into_iter().map(|(_, event)| event).collect();
    assert_eq!(events[0].id, RoverEvents::ARMING_SUMMARY.id());
    assert_eq!(events[0].log_levels, 0x88, "not shown");
    events
}

const ALL: u32 = 0b11;

/// EVT-6: a report is the summary of arming, the failing checks, and the summary of health.
#[test]
fn report_has_summaries_and_checks() {
    let mut site = site();
    let events: Vec<_> = site.gcs[0].all::<Event>().into_iter().map(|(_, event)| event).collect();
    let [arming, health] = &events[..] else { panic!("{events:?}") };
    assert_eq!(masks(arming), [0, 0, ALL, ALL], "nothing fails");
    assert_eq!(masks(health), [0b1100, 0, 0], "none, battery, GPS, motor");

    site.vehicle.fails = vec![Fails::NoFix(Groups::AUTO, 3), Fails::Gusty, Fails::MotorHot(2, 90.0)];
    site.vehicle.cannot_run = Groups::MANUAL;
    let events = report(&mut site, secs(3));
    let [arming, no_fix, gusty, hot, health] = &events[..] else { panic!("{events:?}") };
    assert_eq!(masks(arming), [0b100, 0, 0, 0b10], "GPS has an error, no mode can arm, AUTO can run");
    assert_eq!(masks(health), [0b1100, 0b1000, 0], "the motor has an error");
    assert_eq!((no_fix.id, gusty.id, hot.id), (id_of::<NoFix>(), id_of::<Gusty>(), id_of::<MotorHot>()));
    assert_eq!((no_fix.log_levels, gusty.log_levels, hot.log_levels), (0x33, 0x44, 0x22));
    assert_eq!(no_fix.arguments[..7], [2, 0, 0, 0, 2, 3, 0], "AUTO, GPS, 3 satellites");
    assert_eq!(gusty.arguments[..6], [3, 0, 0, 0, 0, 0], "shown for all modes, of no component");
    assert_eq!(hot.arguments[..10], [3, 0, 0, 0, 3, 2, 0, 0, 0xB4, 0x42]);
}

/// EVT-6: a vehicle asks its own checks before it arms.
#[test]
fn vehicle_asks_its_own_checks() {
    let mut site = site();
    let now = site.now();
    let mut can_arm = |fails: Vec<Fails>, modes: Groups| {
        site.vehicle.fails = fails;
        let vehicle = &site.vehicle;
        site.stack.with_context(now, |cx| HealthReport::of(vehicle, cx).can_arm(modes))
    };
    assert!(can_arm(vec![Fails::Gusty], Groups::AUTO | Groups::MANUAL), "a warning");
    assert!(can_arm(vec![Fails::NoFix(Groups::AUTO, 0)], Groups::MANUAL));
    assert!(!can_arm(vec![Fails::NoFix(Groups::AUTO, 0)], Groups::AUTO | Groups::MANUAL));
    assert!(!can_arm(vec![Fails::MotorHot(1, 0.0)], Groups::MANUAL));
}

/// EVT-7: a report is sent when the checks have changed, at most every two seconds. A changed argument is no change.
#[test]
fn report_is_sent_after_a_change() {
    let mut site = site();
    site.run_for(secs(3));
    site.gcs[0].forget();
    site.expect_no::<Event>(0, secs(20));
    site.vehicle.fails = vec![Fails::NoFix(Groups::AUTO, 3)];
    assert_eq!(report(&mut site, millis(600)).len(), 3);
    let begin = site.now();
    // It changes ten times a second.
    let mut reports = 0;
    while site.now() - begin < secs(20) {
        site.vehicle.fails.push(Fails::Gusty);
        if site.vehicle.fails.len() > 6 {
            site.vehicle.fails.clear();
        }
        site.gcs[0].forget();
        site.run_for(millis(100));
        let all = site.gcs[0].all::<Event>();
        reports += all.iter().filter(|(_, event)| event.id == RoverEvents::ARMING_SUMMARY.id()).count();
    }
    assert!((8..=10).contains(&reports), "{reports} in 20 s");
    site.vehicle.fails = vec![Fails::NoFix(Groups::AUTO, 3)];
    site.run_for(secs(5));
    site.gcs[0].forget();
    site.vehicle.fails = vec![Fails::NoFix(Groups::AUTO, 4)];
    site.expect_no::<Event>(0, secs(5));
}

/// EVT-7: MAV_CMD_RUN_PREARM_CHECKS reports at once, also what has not changed, unless the last report is younger than two seconds. The
/// vehicle decides about the answer.
#[test]
fn report_is_sent_on_command() {
    let mut site = site();
    site.vehicle.fails = vec![Fails::Gusty];
    site.run_for(secs(3));
    for result in [MavResult::ACCEPTED, MavResult::TEMPORARILY_REJECTED] {
        site.vehicle.run_checks = Some(result);
        site.run_for(secs(2));
        site.gcs[0].command_long(MavCmd::RUN_PREARM_CHECKS, [0.0; 7]);
        assert_eq!(report(&mut site, millis(50)).len(), 3);
        assert_eq!(site.expect::<CommandAck>(0, millis(10)).result, result);
    }
    site.run_for(secs(6));
    site.gcs[0].command_long(MavCmd::RUN_PREARM_CHECKS, [0.0; 7]);
    assert_eq!(site.expect::<Statustext>(0, millis(100)).text.as_str(), Some("Checked"), "the vehicle's text");
}

/// 1,000 MAV_CMD_RUN_PREARM_CHECKS a second made 1,000 reports, whose events overwrote 17 of 20 others before a slow link had sent
/// them. Now all are sent, and the reports come every two seconds.
#[test]
fn requested_reports_leave_the_history_to_others() {
    let down = Wire { bytes_per_second: 960, tx_fifo: 128, ..Wire::default() };
    let lines = [LineConfig { down, ..LineConfig::default() }, LineConfig::default()];
    let links = [9_600, 921_600].map(LinkConfig::uart);
    let mut site = Site::of(Setup { links, lines, ..Setup::new() });
    site.run_for(secs(3));
    site.gcs[0].forget();
    for number in 0..20_u64 {
        let at = site.now();
        site.stack.event(at, &Full { a: number, b: 0, c: 0, d: 0, e: 0 });
        for _ in 0..1_000 {
            site.gcs[1].command_long(MavCmd::RUN_PREARM_CHECKS, [0.0; 7]);
            site.run_for(millis(1));
        }
    }
    let sent = site.gcs[0].all::<Event>().into_iter().filter(|(_, event)| event.log_levels & 0xF == 0).count();
    assert_eq!((sent, site.stack.event_counters().overwritten), (20, 0));
    let reports =
        site.gcs[1].all::<Event>().into_iter().filter(|(_, event)| event.id == RoverEvents::HEALTH_SUMMARY.id());
    assert!((9..=11).contains(&reports.count()));
}

/// EVT-7: the report is repeated when a link was opened and a peer is heard on it, at most every two seconds.
#[test]
fn report_is_sent_when_a_link_is_opened() {
    let mut site = site();
    site.run_for(secs(3));
    for is_heard in [false, true] {
        site.gcs[0].forget();
        for _ in 0..100 {
            site.stack.restart_link(LinkId(1));
            if is_heard {
                site.gcs[1].send(&Gcs::heartbeat());
            }
            site.run_for(millis(100));
        }
        let events = site.gcs[0].count_of::<Event>();
        let expected = if is_heard { 4 * 2..=6 * 2 } else { 0..=0 };
        assert!(expected.contains(&events), "{events} events in 10 s");
    }
    site.run_for(secs(3));
    site.stack.restart_link(LinkId(0));
    site.gcs[0].send(&Gcs::heartbeat());
    assert_eq!(report(&mut site, millis(600)).len(), 2);
}

/// EVT-3, EVT-7: a vehicle restarts so fast that its station does not notice, and its link is open only after the first report.
#[test]
fn station_learns_the_checks_after_a_fast_restart() {
    let mut receiver = receiver(Client::QGroundControl, STATION);
    let last_report = |receiver: &Receiver| {
        let is_it = |event: &&Event| event.id == RoverEvents::ARMING_SUMMARY.id();
        masks::<4>(receiver.dialogue.events().iter().rfind(is_it).expect("a report"))[2]
    };
    for (fails, can_arm) in [(Vec::new(), ALL), (vec![Fails::NoFix(Groups::AUTO, 3)], 0b01)] {
        let mut site = Site::of(Setup { links: [LinkConfig::uart(115_200); 2], ..Setup::new() });
        site.vehicle.fails = fails;
        site.run_for(millis(300));
        site.gcs[0].forget();
        receiver.forgot();
        site.stack.restart_link(LinkId(0));
        site.gcs[0].send(&Gcs::heartbeat());
        for _ in 0..300 {
            site.run_for(millis(10));
            receiver.poll(site.now(), &mut site.gcs[0]);
        }
        assert_eq!(last_report(&receiver), can_arm);
    }
}

/// EVT-7: a report that is longer than the history leaves checks out, and counts them; its summaries are right.
#[test]
fn report_is_no_longer_than_the_history() {
    let mut site = site();
    site.vehicle.fails = vec![Fails::Gusty; 21];
    site.vehicle.fails.push(Fails::MotorHot(1, 99.0));
    let events = report(&mut site, secs(4));
    assert_eq!(events.len(), 20);
    assert_eq!(masks(&events[0]), [0, 0, 0, ALL], "no mode can arm");
    assert_eq!(masks(&events[19]), [0b1100, 0b1000, 0], "the motor has an error");
    assert_eq!(site.stack.event_counters().unreported, 4);
    assert_eq!(site.stack.event_counters().overwritten, 0);
}

/// EVT-7: without `checks` the command is the vehicle's.
#[test]
fn command_is_the_vehicles_without_checks() {
    #[derive(mavstack::Stack)]
    #[stack(vehicle: Rover, links: 1, events: { history: 4 })]
    struct Unchecked;
    let mut world = World::<1, Unchecked>::of(Setup::new());
    world.gcs[0].command_long(MavCmd::RUN_PREARM_CHECKS, [0.0; 7]);
    assert_eq!(world.expect::<CommandAck>(0, millis(50)).result, MavResult::UNSUPPORTED);
    world.expect_no::<Event>(0, secs(3));
}
