//! The doctor on a sound board, and on boards that are each made faulty in one way that people report.

mod board;
mod program;
mod values;

use board::{BAUD, BoardFirmware, Fault, SLOW_BAUD, board, board_on};
use mavstack::Duration;
use mavstack::dialect::{Attitude, GlobalPositionInt, SysStatus};
use mavstack_check::{Depth, Options, Outcome, Report, examine};
use mavstack_station::GroundStation;
use mavstack_station::command::Place;
use mavstack_station::kit::{LineConfig, Rig};
use mavstack_station::plans::waypoint;

fn options(fault: Fault) -> Options {
    let baud = if fault == Fault::Streams { SLOW_BAUD } else { BAUD };
    Options { line_rate: Some(baud / 10), depth: Depth::WithPlan }
}

/// Examines a board. Prints what was found, for a test that fails.
fn report(fault: Fault) -> Report {
    report_of(&mut board(fault), options(fault))
}

/// Examines a board in a rig.
fn report_of(rig: &mut Rig<BoardFirmware>, options: Options) -> Report {
    let report = examine(rig, &options, &mut |_| {}).expect("the rig's transport does not fail");
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

/// Asserts that the finding is the first one, and that nothing else is found but `consequences`.
#[track_caller]
fn finds(fault: Fault, id: &str, consequences: &[&str]) {
    only(&report(fault), id, consequences);
}

/// As [`finds`], of a report.
#[track_caller]
fn only(report: &Report, id: &str, consequences: &[&str]) {
    assert_eq!(report.outcome, Outcome::Findings);
    let found: Vec<_> = report.problems().map(|finding| finding.id).collect();
    assert!(found.contains(&id), "{found:?}");
    assert!(found.iter().all(|other| *other == id || consequences.contains(other)), "{found:?}");
}

#[test]
fn nothing_on_a_sound_board() {
    let report = report(Fault::None);
    assert_eq!(report.problems().count(), 0);
    assert_eq!(report.outcome, Outcome::Sound);
}

#[test]
fn nothing_on_slow_lines_and_fast_ones() {
    let lines =
        [LineConfig::uart(9_600), LineConfig::uart(115_200), LineConfig::radio(57_600, Duration::from_millis(80))];
    for line in lines {
        let rate = u32::try_from(line.down.bytes_per_second).expect("a rate");
        for line_rate in [Some(rate), None] {
            let mut rig = board_on(Fault::None, line.with_rx_fifo(2_048));
            let report = report_of(&mut rig, Options { line_rate, depth: Depth::WithPlan });
            assert_eq!(report.problems().count(), 0, "{rate} bytes/s, {line_rate:?}: {:?}", report.findings);
        }
    }
}

/// A radio that loses frames is that, and nothing else.
#[test]
fn a_radio_that_loses_frames() {
    let radio = LineConfig::radio(57_600, Duration::from_millis(40)).with_rx_fifo(512);
    for loss in [0.05, 0.2] {
        let report = report_of(&mut board_on(Fault::None, radio.with_loss(loss)), options(Fault::None));
        only(&report, "frames-lost", &["requests-lost"]);
    }
}

/// Two writers at the vehicle's UART: only what it sends is damaged.
#[test]
fn damage_from_the_vehicle_alone() {
    let mut line = LineConfig::uart(BAUD).with_rx_fifo(512);
    line.down.faults.byte_loss = 0.002;
    only(&report_of(&mut board_on(Fault::None, line), options(Fault::None)), "damage-from-vehicle", &[]);
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
        let report = examine(&mut rig, &Options { depth, ..options(Fault::None) }, &mut |_| {}).expect("a report");
        assert_eq!(report.problems().count(), 0, "{:?}", report.findings);
        assert_eq!(state(&mut rig), before, "{depth:?}");
        assert_eq!(rig.reboots(), 0);
    }
}

#[test]
fn an_armed_vehicle_is_only_listened_to() {
    let mut rig = board(Fault::None);
    rig.arm().expect("it arms");
    let written = rig.now();
    let report = examine(&mut rig, &options(Fault::None), &mut |_| {}).expect("a report");
    assert!(rig.seen().vehicles().all(|vehicle| vehicle.is_armed()));
    assert!(report.skipped.iter().any(|what| what.contains("it is armed")), "{:?}", report.skipped);
    assert!(rig.now() - written < Duration::from_secs(20));
}

#[test]
fn a_baud_rate_slightly_off() {
    finds(Fault::Baud, "damage-both-ways", &[]);
}

#[test]
fn a_fifo_that_overruns() {
    finds(Fault::Fifo, "receive-overrun", &[]);
}

#[test]
fn a_fifo_that_holds_no_frame() {
    finds(Fault::TinyFifo, "no-answers", &[]);
}

#[test]
fn a_dma_buffer_that_is_cut() {
    finds(Fault::DmaCut, "receive-cut", &[]);
}

#[test]
fn a_poll_every_200_ms() {
    finds(Fault::SlowPoll, "poll-slow", &["receive-overrun"]);
}

#[test]
fn a_forgotten_poll() {
    finds(Fault::NoPoll, "no-heartbeat", &[]);
}

#[test]
fn a_stall_in_an_erase() {
    finds(Fault::Erase, "stall", &[]);
}

#[test]
fn a_clock_in_milliseconds() {
    finds(Fault::ClockMillis, "clock-unit", &[]);
}

#[test]
fn streams_above_the_rate_of_the_line() {
    finds(Fault::Streams, "streams-above-rate", &[]);
}

#[test]
fn a_wrong_component_id() {
    finds(Fault::Component, "component-id", &[]);
}

#[test]
fn heartbeats_from_a_timer() {
    finds(Fault::Timer, "heartbeats-from-timer", &[]);
}

/// The heartbeats go on while the main loop stands still.
#[test]
fn heartbeats_from_a_timer_during_a_stall() {
    finds(Fault::TimerErase, "heartbeats-from-timer", &["stall"]);
}

#[test]
fn heartbeats_from_a_timer_while_the_loop_hangs() {
    finds(Fault::TimerHangs, "heartbeats-from-timer", &[]);
}

#[test]
fn a_log_on_the_same_port() {
    finds(Fault::Log, "stray-bytes", &[]);
}

#[test]
fn a_board_without_power() {
    let report = report(Fault::Dead);
    assert_eq!((report.outcome, report.findings[0].id), (Outcome::Silent, "silent"));
}
