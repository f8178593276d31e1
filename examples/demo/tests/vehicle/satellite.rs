//! The satellite link: HIGH_LATENCY2 on command and automatically, its content and cost, and the limits for commands that
//! arrive there.

use crate::support::wire::{NORMAL, Received, STATION, Wire, command_long};
use mavstack::dialect::*;
use mavstack::param::ParamType;
use mavstack::{Message, Param};
use mavstack_demo::{Mode, SATELLITE, TELEMETRY, Tuning};

const START: &[f32] = &[1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
const STOP: &[f32] = &[0.0; 7];
const NAN: f32 = f32::NAN;

fn set<T: ParamType>(wire: &mut Wire, param: Param<Tuning, T>, value: T) {
    assert!(wire.app.parts().0.parameters_mut().set(param, value));
}

/// Returns a booted vehicle with five seconds between reports.
fn frequent_reports() -> Wire {
    let mut wire = Wire::booted();
    set(&mut wire, Tuning::MAV_2_HL_FREQ, 0.2);
    wire.run(200);
    wire
}

fn control(wire: &mut Wire, link: mavstack::LinkId, params: &[f32]) -> MavResult {
    wire.long_by(link, 1, MavCmd::CONTROL_HIGH_LATENCY, params)
}

/// Sends heartbeats of a ground station on the telemetry link for `seconds`.
fn send_heartbeats(wire: &mut Wire, seconds: u64) {
    for _ in 0..seconds {
        wire.send(TELEMETRY, &Heartbeat { r#type: MavType::GCS, ..Heartbeat::default() });
        wire.run(1_000);
    }
}

/// Takes the frames sent on the satellite link since the last call.
fn by_satellite(wire: &mut Wire) -> Vec<Received> {
    let (found, rest) = std::mem::take(&mut wire.received).into_iter().partition(|frame| frame.link == SATELLITE);
    wire.received = rest;
    found
}

fn ids(frames: &[Received]) -> Vec<u32> {
    frames.iter().map(|frame| frame.id).collect()
}

/// Starts reports, takes the first one, and stops.
fn report(wire: &mut Wire) -> HighLatency2 {
    wire.take::<HighLatency2>();
    assert_eq!(control(wire, SATELLITE, START), MavResult::ACCEPTED);
    wire.run(400);
    let [(_, report)] = wire.take::<HighLatency2>()[..] else { panic!("not one report") };
    control(wire, SATELLITE, STOP);
    report
}

/// L-3, L-14: by default a lost ground station does not start reports.
#[test]
fn nothing_is_sent_by_satellite_until_requested() {
    let mut wire = Wire::new();
    send_heartbeats(&mut wire, 10);
    wire.run(60_000);
    assert!(by_satellite(&mut wire).is_empty());
}

/// L-10, L-11, L-15, L-23: START by satellite, STOP by radio. The radio link continues meanwhile.
#[test]
fn handover_to_the_satellite_and_back() {
    let mut wire = frequent_reports();
    wire.received.clear();
    assert_eq!(control(&mut wire, SATELLITE, START), MavResult::ACCEPTED);
    let began = wire.millis;
    wire.run(20_900);
    assert!(wire.count::<Heartbeat>(TELEMETRY) >= 20 && wire.count::<Attitude>(TELEMETRY) >= 80);
    let sent = by_satellite(&mut wire);
    assert_eq!(ids(&sent), [HighLatency2::ID; 5], "nothing else is sent there");
    for (n, frame) in (0..).zip(&sent) {
        // 54 bytes at 2,400 bit/s are 225 ms.
        assert!((n * 5_000..n * 5_000 + 300).contains(&(frame.millis - began)), "{}", frame.millis - began);
        assert_eq!(frame.source, mavstack::Address::new(1, 1));
    }
    // A second START sends one more report at once.
    assert_eq!(control(&mut wire, SATELLITE, START), MavResult::ACCEPTED);
    wire.run(400);
    assert_eq!(ids(&by_satellite(&mut wire)), [HighLatency2::ID]);
    assert_eq!(control(&mut wire, TELEMETRY, STOP), MavResult::ACCEPTED);
    assert_eq!(control(&mut wire, TELEMETRY, STOP), MavResult::ACCEPTED);
    wire.run(30_000);
    assert!(by_satellite(&mut wire).is_empty());
    for params in [[2.0; 1], [NAN], [0.5], [-1.0]] {
        assert_eq!(control(&mut wire, TELEMETRY, &params), MavResult::DENIED, "{params:?}");
    }
}

/// L-14: reports start automatically when the last ground station on the other links is lost, and stop when one reconnects.
#[test]
fn reports_start_when_the_last_station_is_lost() {
    let mut wire = frequent_reports();
    set(&mut wire, Tuning::MAV_HL_LOSS_T, 10);
    send_heartbeats(&mut wire, 10);
    // The station times out after 5 s; reports start 10 s later.
    wire.run(13_500);
    assert!(by_satellite(&mut wire).is_empty());
    wire.run(1_500);
    assert_eq!(ids(&by_satellite(&mut wire)), [HighLatency2::ID]);
    wire.run(10_000);
    assert_eq!(ids(&by_satellite(&mut wire)), [HighLatency2::ID; 2]);
    send_heartbeats(&mut wire, 10);
    assert!(by_satellite(&mut wire).is_empty());
}

/// L-20 to L-22, L-25: the fields of HIGH_LATENCY2 describe the vehicle.
#[test]
fn reports_describe_the_vehicle() {
    let mut wire = Wire::new();
    wire.run(1_000);
    let before = report(&mut wire);
    assert_eq!(before.failure_flags, HlFailureFlag::GPS);
    assert_eq!((before.latitude, before.longitude, before.eph, before.epv), (0, 0, 255, 255));
    assert_eq!(before.custom_mode, (Mode::Hold.number() >> 16) as u16);
    assert_eq!((before.r#type, before.autopilot), (MavType::QUADROTOR, MavAutopilot::GENERIC));

    let mut wire = Wire::airborne();
    wire.received.clear();
    // 200 m to the east, 40 m up.
    let params = [NAN, 1.0, NAN, NAN];
    let east = 85_455_940 + (200.0 / 0.011_131_95 / 0.676_89) as i32;
    wire.int(MavCmd::DO_REPOSITION, MavFrame::GLOBAL_RELATIVE_ALT, params, 473_977_420, east, 40.0);
    wire.run(6_000);
    let report = report(&mut wire);
    let (x, y) = (wire.vehicle().local_position(), wire.vehicle().global_position().unwrap());
    assert!((report.latitude - y.latitude).abs() < 20 && (report.longitude - y.longitude).abs() < 1_500, "{report:?}");
    assert!((f32::from(report.altitude) - y.altitude).abs() < 3.0 && report.target_altitude == 528, "{report:?}");
    assert_eq!((report.heading, report.target_heading), (45, 45), "90 degrees");
    assert_eq!(report.target_distance, ((200.0 - x.east) / 10.0).round() as u16);
    // 8 m/s at the end; the mean of the reporting period is lower.
    assert!((5..=40).contains(&report.groundspeed) && report.airspeed == report.groundspeed, "{report:?}");
    assert_eq!((report.airspeed_sp, report.windspeed, report.wind_heading), (40, 0, 0));
    assert_eq!(report.climb_rate, 30, "the maximum of the reporting period");
    assert_eq!((report.eph, report.epv, report.temperature_air), (9, 14, -128));
    assert_eq!((report.failure_flags, report.wp_num), (HlFailureFlag::EMPTY, u16::MAX));
    assert!((95..=100).contains(&report.battery) && report.throttle > 0, "{report:?}");
    let age = wire.millis - u64::from(report.timestamp);
    assert!(age < 1_000, "{age} ms");
}

/// The vehicle's own counter equals the bytes sent.
#[test]
fn satellite_cost_is_counted() {
    let mut wire = frequent_reports();
    assert_eq!(control(&mut wire, SATELLITE, START), MavResult::ACCEPTED);
    let ack = 1;
    wire.run(31_000);
    let reports = wire.count::<HighLatency2>(SATELLITE);
    let lengths: Vec<usize> = by_satellite(&mut wire).iter().map(|frame| frame.raw.len()).collect();
    assert!(reports >= 6 && lengths.len() == reports, "{lengths:?}");
    let tuning = wire.app.stack().parameters();
    let ack_len = tuning.get(Tuning::STAT_HL_BYTES) as usize - lengths.iter().sum::<usize>();
    assert!((12 + 3..=12 + 10).contains(&ack_len), "{ack_len}");
    assert_eq!(tuning.get(Tuning::STAT_HL_CREDITS) as usize, ack + 2 * reports, "51 to 54 bytes cost two credits");
}

/// L-4: on the satellite link only commands are answered.
#[test]
fn only_commands_are_answered_by_satellite() {
    let mut wire = Wire::booted();
    let (target_system, target_component) = (1, 1);
    wire.send(SATELLITE, &ParamRequestList { target_system, target_component });
    wire.send(SATELLITE, &MissionRequestList { target_system, target_component, ..Default::default() });
    wire.send(SATELLITE, &MissionCount { target_system, target_component, count: 3, ..Default::default() });
    wire.send(SATELLITE, &Ping { time_usec: 5, ..Default::default() });
    wire.send(SATELLITE, &Timesync { ts1: 7, ..Default::default() });
    wire.send(SATELLITE, &Heartbeat { r#type: MavType::GCS, ..Default::default() });
    wire.send(SATELLITE, &RequestDataStream { target_system, target_component, start_stop: 1, ..Default::default() });
    wire.run(3_000);
    assert!(by_satellite(&mut wire).is_empty());
    for id in [AutopilotVersion::ID, Heartbeat::ID, Attitude::ID, HighLatency2::ID] {
        wire.long_by(SATELLITE, 1, MavCmd::REQUEST_MESSAGE, &[id as f32]);
        wire.long_by(SATELLITE, 1, MavCmd::SET_MESSAGE_INTERVAL, &[id as f32, 100_000.0]);
    }
    wire.run(3_000);
    assert!(by_satellite(&mut wire).is_empty(), "each command had its answer");
    // Texts are sent on the other links.
    assert_eq!(wire.long_by(SATELLITE, 1, MavCmd::RUN_PREARM_CHECKS, &[]), MavResult::ACCEPTED);
    wire.run(1_000);
    assert!(by_satellite(&mut wire).is_empty());
    for link in NORMAL {
        assert_eq!(wire.count::<Statustext>(link), 1);
    }
}

/// L-16: a command by satellite may be minutes old. It cannot start a flight from the ground; in flight it is executed.
#[test]
fn a_delayed_command_cannot_start_a_flight() {
    let mut wire = Wire::booted();
    let denied = MavResult::DENIED;
    assert_eq!(wire.long_by(SATELLITE, 1, MavCmd::COMPONENT_ARM_DISARM, &[1.0]), denied);
    assert_eq!(wire.long_by(SATELLITE, 1, MavCmd::COMPONENT_ARM_DISARM, &[1.0, 21_196.0]), denied);
    assert_eq!(wire.texts(), ["Arming refused: sent by satellite; use the radio"], "once, on the radio link");
    assert_eq!(wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::ACCEPTED);
    let takeoff = Mode::Takeoff.number();
    let [main, sub] = [takeoff >> 16 & 0xFF, takeoff >> 24].map(|number| number as f32);
    for (command, params) in [(MavCmd::NAV_TAKEOFF, &[][..]), (MavCmd::DO_SET_MODE, &[1.0, main, sub])] {
        assert_eq!(wire.long_by(SATELLITE, 1, command, params), denied, "{command:?}");
        wire.run(1_000);
        assert!(wire.vehicle().is_landed());
    }
    assert_eq!(wire.long(MavCmd::NAV_TAKEOFF, &[]), MavResult::ACCEPTED);
    wire.until("up", 20, |vehicle| vehicle.mode() == Mode::Hold);
    assert_eq!(wire.long_by(SATELLITE, 1, MavCmd::NAV_RETURN_TO_LAUNCH, &[]), MavResult::ACCEPTED);
    wire.until("down", 60, |vehicle| !vehicle.is_armed());
}

/// C-12, C-24: the same START on both links is executed once.
#[test]
fn a_duplicate_start_is_executed_once() {
    let mut wire = frequent_reports();
    for link in [TELEMETRY, SATELLITE] {
        wire.send_as(link, STATION, &command_long(1, MavCmd::CONTROL_HIGH_LATENCY, START));
        wire.run(1_000);
    }
    assert_eq!(wire.take::<CommandAck>().len(), 2, "each is answered");
    assert_eq!(ids(&by_satellite(&mut wire)), [HighLatency2::ID]);
}
