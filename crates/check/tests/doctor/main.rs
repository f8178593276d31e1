//! The doctor on a sound board, and on boards that are each made faulty in one way that people report.

mod board;
mod caution;
mod program;
mod values;

use board::{BAUD, BoardFirmware, Fault, SLOW_BAUD, board, board_on};
use mavstack::dialect::{
    Attitude, BatteryStatus, GlobalPositionInt, GpsRawInt, HomePosition, MavCmd, SysStatus, VfrHud,
};
use mavstack::{Duration, Message};
use mavstack_check::Severity::{Error, Warning};
use mavstack_check::{Depth, Options, Outcome, Permission, Report, Severity, examine};
use mavstack_station::command::Place;
use mavstack_station::kit::{LineConfig, Rig};
use mavstack_station::plans::waypoint;
use mavstack_station::streams::Interval;
use mavstack_station::{Client, GroundStation};

/// What the rover streams.
const STREAMS: [u32; 7] = [
    SysStatus::ID,
    BatteryStatus::ID,
    Attitude::ID,
    GlobalPositionInt::ID,
    GpsRawInt::ID,
    VfrHud::ID,
    HomePosition::ID,
];

fn options(fault: Fault) -> Options {
    let baud = if fault == Fault::Streams { SLOW_BAUD } else { BAUD };
    // These boards send no heartbeats.
    let permission = match fault {
        Fault::NoPoll | Fault::ClockMillis => Permission::User,
        _ => Permission::Heartbeat,
    };
    Options { line_rate: Some(baud / 10), depth: Depth::WithPlan, permission }
}

/// Examines a board. Prints what was found, for a test that fails.
fn report(fault: Fault) -> Report {
    report_of(&mut board(fault), options(fault))
}

/// Examines a board in a rig.
fn report_of(rig: &mut Rig<BoardFirmware>, options: Options) -> Report {
    let report = examine(rig, &options, &mut |_| {});
    println!("after {} s:", rig.now().as_millis() / 1_000);
    for finding in &report.findings {
        println!("  {:?} {}: {}", finding.severity, finding.id, finding.observed);
    }
    for measured in &report.measured {
        println!("    {}: {:.1} {}", measured.name, measured.value, measured.unit);
    }
    println!("    skipped: {:?}", report.skipped);
    report
}

/// Asserts that these errors and warnings are found, and no others.
#[track_caller]
fn finds(fault: Fault, expected: &[(&str, Severity)]) {
    only(&report(fault), expected);
}

/// As [`finds`], of a report.
#[track_caller]
fn only(report: &Report, expected: &[(&str, Severity)]) {
    let found: Vec<_> = report.problems().map(|finding| (finding.id, finding.severity)).collect();
    assert_eq!(found, expected);
    assert_eq!(report.outcome, if expected.is_empty() { Outcome::Sound } else { Outcome::Findings });
}

#[test]
fn nothing_on_a_sound_board() {
    let report = report(Fault::None);
    only(&report, &[]);
    // What the clients have learned.
    let notes: Vec<_> = report.findings.iter().map(|finding| finding.id).collect();
    assert_eq!(notes, ["mavproxy-integers", "hidden"]);
}

#[test]
fn nothing_on_slow_lines_and_fast_ones() {
    let lines =
        [LineConfig::uart(9_600), LineConfig::uart(115_200), LineConfig::radio(57_600, Duration::from_millis(80))];
    for line in lines {
        let rate = u32::try_from(line.down.bytes_per_second).expect("a rate");
        for line_rate in [Some(rate), None] {
            let mut rig = board_on(Fault::None, line.with_rx_fifo(2_048));
            let report = report_of(&mut rig, Options { line_rate, ..options(Fault::None) });
            assert_eq!(report.problems().count(), 0, "{rate} bytes/s, {line_rate:?}: {:?}", report.findings);
        }
    }
}

/// A radio that loses frames is that, and nothing else. The seed is fixed: few losses are in one direction by chance.
#[test]
fn a_radio_that_loses_frames() {
    let radio = LineConfig::radio(57_600, Duration::from_millis(40)).with_rx_fifo(512);
    for loss in [0.05, 0.2] {
        let mut rig = board_on(Fault::None, radio.with_loss(loss)).with_seed(2);
        let report = report_of(&mut rig, options(Fault::None));
        only(&report, &[("requests-lost", Warning), ("frames-lost", Warning)]);
    }
}

/// Only what is sent to the vehicle is lost, too much of it to change anything.
#[test]
fn requests_that_are_lost() {
    let mut line = LineConfig::uart(BAUD).with_rx_fifo(512);
    line.up.faults.frame_loss = 0.4;
    let report = report_of(&mut board_on(Fault::None, line), options(Fault::None));
    only(&report, &[("requests-lost", Warning)]);
    assert!(report.skipped.iter().any(|what| what.contains("too many requests are lost")), "{:?}", report.skipped);
}

/// Two writers at the vehicle's UART: only what it sends is damaged.
#[test]
fn damage_from_the_vehicle_alone() {
    let mut line = LineConfig::uart(BAUD).with_rx_fifo(512);
    line.down.faults.byte_loss = 0.002;
    only(&report_of(&mut board_on(Fault::None, line), options(Fault::None)), &[("damage-from-vehicle", Error)]);
}

/// What it changes, it restores.
#[test]
fn the_vehicle_is_left_as_it_was() {
    for depth in [Depth::Quick, Depth::Full, Depth::WithPlan] {
        let mut rig = board(Fault::None);
        rig.upload_mission(&[waypoint(Place::relative(47.397_7, 8.545_6, 0.0))]).expect("a mission");
        rig.set("SPEED_MAX", 3.5_f32).expect("a parameter");
        let state = |rig: &mut Rig<BoardFirmware>| {
            let intervals =
                [rig.interval::<Attitude>(), rig.interval::<GlobalPositionInt>(), rig.interval::<SysStatus>()];
            (rig.parameters(), rig.download_mission(), intervals)
        };
        let before = state(&mut rig);
        let report = examine(&mut rig, &Options { depth, ..options(Fault::None) }, &mut |_| {});
        assert_eq!(report.problems().count(), 0, "{:?}", report.findings);
        assert_eq!(state(&mut rig), before, "{depth:?}");
        assert_eq!(rig.reboots(), 0);
    }
}

#[test]
fn a_baud_rate_slightly_off() {
    finds(Fault::Baud, &[("damage-both-ways", Error)]);
}

#[test]
fn a_fifo_that_overruns() {
    finds(Fault::Fifo, &[("receive-overrun", Error)]);
}

/// It holds some requests, but not the one for the version.
#[test]
fn a_fifo_that_holds_short_frames() {
    let line = LineConfig::uart(BAUD).with_rx_fifo(32);
    only(&report_of(&mut board_on(Fault::Fifo, line), options(Fault::Fifo)), &[("receive-overrun", Error)]);
}

#[test]
fn a_fifo_that_holds_no_frame() {
    finds(Fault::TinyFifo, &[("no-answers", Error)]);
}

#[test]
fn a_dma_buffer_that_is_cut() {
    finds(Fault::DmaCut, &[("receive-cut", Error)]);
}

#[test]
fn a_poll_every_200_ms() {
    finds(Fault::SlowPoll, &[("receive-overrun", Error), ("poll-slow", Error)]);
}

/// The queue holds what arrives in the meantime.
#[test]
fn a_poll_every_200_ms_with_a_long_queue() {
    let line = LineConfig::uart(BAUD).with_rx_fifo(2_048);
    only(&report_of(&mut board_on(Fault::SlowPoll, line), options(Fault::SlowPoll)), &[("poll-slow", Error)]);
}

#[test]
fn a_forgotten_poll() {
    finds(Fault::NoPoll, &[("no-heartbeat", Error)]);
}

/// It streams nothing, and answers what it is asked.
#[test]
fn a_forgotten_poll_of_a_vehicle_that_only_answers() {
    let mut rig = board(Fault::NoPoll);
    for id in STREAMS {
        rig.command(MavCmd::SET_MESSAGE_INTERVAL, &[id as f32, -1.0]).expect("an interval");
    }
    rig.on(0).replace_station(Client::QGroundControl);
    only(&report_of(&mut rig, options(Fault::NoPoll)), &[("no-heartbeat", Error)]);
}

#[test]
fn a_stall_in_an_erase() {
    finds(Fault::Erase, &[("stall", Error)]);
}

#[test]
fn a_clock_in_milliseconds() {
    finds(Fault::ClockMillis, &[("clock-unit", Error)]);
}

#[test]
fn streams_above_the_rate_of_the_line() {
    finds(Fault::Streams, &[("streams-above-rate", Error)]);
}

#[test]
fn a_wrong_component_id() {
    finds(Fault::Component, &[("component-id", Error)]);
}

#[test]
fn heartbeats_from_a_timer() {
    finds(Fault::Timer, &[("heartbeats-from-timer", Error)]);
}

/// The heartbeats go on while the main loop stands still.
#[test]
fn heartbeats_from_a_timer_during_a_stall() {
    finds(Fault::TimerErase, &[("heartbeats-from-timer", Error), ("stall", Error)]);
}

#[test]
fn heartbeats_from_a_timer_while_the_loop_hangs() {
    finds(Fault::TimerHangs, &[("heartbeats-from-timer", Error)]);
}

#[test]
fn a_log_on_the_same_port() {
    finds(Fault::Log, &[("stray-bytes", Warning)]);
}

#[test]
fn a_board_without_power() {
    let report = report(Fault::Dead);
    assert_eq!((report.outcome, report.findings[0].id), (Outcome::Silent, "silent"));
}

/// Damage that only a full line shows.
#[test]
fn a_driver_that_loses_bytes_on_a_full_line() {
    let report = report(Fault::BusyTx);
    only(&report, &[("damage-from-vehicle", Error)]);
    let observed = &report.findings[0].observed;
    assert!(observed.contains("On a full line"), "{observed}");
}

/// The answer times spread as those of a poll every 160 ms do.
#[test]
fn a_radio_with_time_slots_is_no_slow_poll() {
    let report = report(Fault::SlottedRadio);
    only(&report, &[]);
    assert!(report.finding("answers-spread").is_some(), "{:?}", report.findings);
}

#[test]
fn heartbeats_that_are_late_while_a_parameter_is_stored() {
    let report = report(Fault::SlowLoop);
    only(&report, &[("heartbeats-late", Error)]);
    let late = report.measured.iter().find(|row| row.name == "longest time between heartbeats while storing");
    assert!(late.is_some_and(|row| row.value > 3_000.0), "{:?}", report.measured);
}

/// Only the autopilot is examined, but the gimbal takes its share of the line.
#[test]
fn a_gimbal_of_the_same_system() {
    let report = report(Fault::Gimbal);
    only(&report, &[]);
    let received = report.measured.iter().find(|row| row.name == "received while idle");
    assert!(received.is_some_and(|row| row.value > 1_800.0), "{:?}", report.measured);
}

#[test]
fn a_parameter_that_cannot_be_restored() {
    let report = report(Fault::KeepsValue);
    only(&report, &[("not-restored", Error)]);
    assert!(report.findings[0].observed.contains("SPEED_MAX was 2"), "{}", report.findings[0].observed);
}

#[test]
fn a_fence_that_is_announced_and_not_served() {
    let report = report(Fault::Promises);
    only(&report, &[("capability-not-served", Error)]);
    assert!(report.findings[0].observed.contains("MISSION_FENCE"), "{}", report.findings[0].observed);
}

/// Without ATTITUDE another message fills the line; if nothing is streamed, nothing can.
#[test]
fn a_line_is_filled_with_what_is_streamed() {
    let received = |report: &Report| {
        let row = report.measured.iter().find(|row| row.name == "received on a full line");
        row.map(|row| row.value).expect("a full line")
    };
    let mut rig = board(Fault::None);
    rig.set_interval::<Attitude>(Interval::Off).expect("an interval");
    let report = report_of(&mut rig, options(Fault::None));
    only(&report, &[]);
    assert!(received(&report) > f64::from(BAUD) / 10.0 * 0.4);
    assert_eq!(report.skipped, Vec::<String>::new());

    for id in STREAMS {
        rig.command(MavCmd::SET_MESSAGE_INTERVAL, &[id as f32, -1.0]).expect("an interval");
    }
    let report = report_of(&mut rig, options(Fault::None));
    assert!(received(&report) < f64::from(BAUD) / 10.0 * 0.2);
    assert!(report.skipped.iter().any(|what| what.contains("a full line from the vehicle")), "{:?}", report.skipped);
}
