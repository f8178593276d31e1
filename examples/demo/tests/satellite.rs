//! The satellite link: reports by command and by themselves, what they say and cost, and what is not done for whom comes
//! that way.

#[path = "support/wire.rs"]
mod wire;

use mavstack::dialect::*;
use mavstack::{Message, Param, ParamType, Parameters};
use mavstack_demo::{Mode, SATELLITE, TELEMETRY, Tuning};
use wire::{NORMAL, Received, STATION, Wire, command_long};

const START: &[f32] = &[1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
const STOP: &[f32] = &[0.0; 7];
const NAN: f32 = f32::NAN;

fn set<T: ParamType>(wire: &mut Wire, param: Param<Tuning, T>, value: T) {
    assert!(wire.app.parts().1.parameters_mut().unwrap().set(param, value));
}

/// Five seconds from one report to the next.
fn reports_often() -> Wire {
    let mut wire = Wire::switched_on();
    set(&mut wire, Tuning::MAV_2_HL_FREQ, 0.2);
    wire.run(200);
    wire
}

fn control(wire: &mut Wire, link: mavstack::LinkId, params: &[f32]) -> MavResult {
    wire.long_by(link, 1, MavCmd::CONTROL_HIGH_LATENCY, params)
}

/// Beats for so long as a ground station on the telemetry link.
fn beat(wire: &mut Wire, seconds: u64) {
    for _ in 0..seconds {
        wire.send(TELEMETRY, &Heartbeat { r#type: MavType::GCS, ..Heartbeat::default() });
        wire.run(1_000);
    }
}

/// What left by satellite since this was asked last.
fn by_satellite(wire: &mut Wire) -> Vec<Received> {
    let (found, rest) = std::mem::take(&mut wire.received).into_iter().partition(|frame| frame.link == SATELLITE);
    wire.received = rest;
    found
}

fn ids(frames: &[Received]) -> Vec<u32> {
    frames.iter().map(|frame| frame.id).collect()
}

/// The one report that follows a START.
fn report(wire: &mut Wire) -> HighLatency2 {
    wire.take::<HighLatency2>();
    assert_eq!(control(wire, SATELLITE, START), MavResult::ACCEPTED);
    wire.run(400);
    let [(_, report)] = wire.take::<HighLatency2>()[..] else { panic!("not one report") };
    control(wire, SATELLITE, STOP);
    report
}

/// L-3, L-14: a ground station that is lost changes nothing where the vehicle is not told to report then.
#[test]
fn nothing_leaves_until_it_is_asked_for() {
    let mut wire = Wire::new();
    beat(&mut wire, 10);
    wire.run(60_000);
    assert!(by_satellite(&mut wire).is_empty());
}

/// L-10, L-11, L-15, L-23: START over the satellite, STOP over the radio; meanwhile the radio goes on.
#[test]
fn handover_to_the_satellite_and_back() {
    let mut wire = reports_often();
    wire.received.clear();
    assert_eq!(control(&mut wire, SATELLITE, START), MavResult::ACCEPTED);
    let began = wire.millis;
    wire.run(20_900);
    assert!(wire.count::<Heartbeat>(TELEMETRY) >= 20 && wire.count::<Attitude>(TELEMETRY) >= 80);
    let sent = by_satellite(&mut wire);
    assert_eq!(ids(&sent), [HighLatency2::ID; 5], "nothing else leaves there");
    for (n, frame) in (0..).zip(&sent) {
        // 54 bytes at 2,400 bit/s are 225 ms.
        assert!((n * 5_000..n * 5_000 + 300).contains(&(frame.millis - began)), "{}", frame.millis - began);
        assert_eq!(frame.source, mavstack::Address::new(1, 1));
    }
    // Again: one more at once.
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

/// L-14: by itself, when the last ground station on the other links is lost; off when there is one again.
#[test]
fn it_reports_by_itself_when_nobody_is_left() {
    let mut wire = reports_often();
    set(&mut wire, Tuning::MAV_HL_LOSS_T, 10);
    beat(&mut wire, 10);
    // 5 s until it is lost, and the 10.
    wire.run(13_500);
    assert!(by_satellite(&mut wire).is_empty());
    wire.run(1_500);
    assert_eq!(ids(&by_satellite(&mut wire)), [HighLatency2::ID]);
    wire.run(10_000);
    assert_eq!(ids(&by_satellite(&mut wire)), [HighLatency2::ID; 2]);
    beat(&mut wire, 10);
    assert!(by_satellite(&mut wire).is_empty());
}

/// L-20 to L-22, L-25, and the table before them: what the ground reads of a flight.
#[test]
fn reports_say_how_the_vehicle_is() {
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
    let told = report(&mut wire);
    let (x, y) = (wire.vehicle().local_position(), wire.vehicle().global_position().unwrap());
    assert!((told.latitude - y.latitude).abs() < 20 && (told.longitude - y.longitude).abs() < 1_500, "{told:?}");
    assert!((f32::from(told.altitude) - y.altitude).abs() < 3.0 && told.target_altitude == 528, "{told:?}");
    assert_eq!((told.heading, told.target_heading), (45, 45), "90 degrees");
    assert_eq!(told.target_distance, ((200.0 - x.east) / 10.0).round() as u16);
    // 8 m/s at the end; the mean of the time before is less.
    assert!((5..=40).contains(&told.groundspeed) && told.airspeed == told.groundspeed, "{told:?}");
    assert_eq!((told.airspeed_sp, told.windspeed, told.wind_heading), (40, 0, 0));
    assert_eq!(told.climb_rate, 30, "the fastest in the time before");
    assert_eq!((told.eph, told.epv, told.temperature_air), (9, 14, -128));
    assert_eq!((told.failure_flags, told.wp_num), (HlFailureFlag::EMPTY, u16::MAX));
    assert!((95..=100).contains(&told.battery) && told.throttle > 0, "{told:?}");
    let age = wire.millis - u64::from(told.timestamp);
    assert!(age < 1_000, "{age} ms");
}

/// The vehicle's own count is what left, to the byte.
#[test]
fn what_it_costs_is_counted() {
    let mut wire = reports_often();
    assert_eq!(control(&mut wire, SATELLITE, START), MavResult::ACCEPTED);
    let ack = 1;
    wire.run(31_000);
    let reports = wire.count::<HighLatency2>(SATELLITE);
    let lengths: Vec<usize> = by_satellite(&mut wire).iter().map(|frame| frame.raw.len()).collect();
    assert!(reports >= 6 && lengths.len() == reports, "{lengths:?}");
    let tuning = wire.vehicle().tuning();
    let ack_len = tuning.get(Tuning::STAT_HL_BYTES) as usize - lengths.iter().sum::<usize>();
    assert!((12 + 3..=12 + 10).contains(&ack_len), "{ack_len}");
    assert_eq!(tuning.get(Tuning::STAT_HL_CREDITS) as usize, ack + 2 * reports, "51 to 54 bytes are two");
}

/// L-4: whatever is asked there, nothing leaves but answers to commands.
#[test]
fn what_is_asked_there_is_not_answered() {
    let mut wire = Wire::switched_on();
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
    assert!(by_satellite(&mut wire).is_empty(), "each had its answer");
    // Texts go elsewhere.
    assert_eq!(wire.long_by(SATELLITE, 1, MavCmd::RUN_PREARM_CHECKS, &[]), MavResult::ACCEPTED);
    wire.run(1_000);
    assert!(by_satellite(&mut wire).is_empty());
    for link in NORMAL {
        assert_eq!(wire.count::<Statustext>(link), 1);
    }
}

/// L-16: on the ground it does not begin to fly for somebody whose command may be minutes old; in the air it obeys.
#[test]
fn it_does_not_take_off_for_a_command_that_may_be_old() {
    let mut wire = Wire::switched_on();
    let denied = MavResult::DENIED;
    assert_eq!(wire.long_by(SATELLITE, 1, MavCmd::COMPONENT_ARM_DISARM, &[1.0]), denied);
    assert_eq!(wire.long_by(SATELLITE, 1, MavCmd::COMPONENT_ARM_DISARM, &[1.0, 21_196.0]), denied);
    assert_eq!(wire.said(), ["Arming refused: by satellite"], "over the radio, and once");
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

/// C-12, C-24: the same START over both links is one START.
#[test]
fn the_same_start_over_two_links_is_one() {
    let mut wire = reports_often();
    for link in [TELEMETRY, SATELLITE] {
        wire.send_as(link, STATION, &command_long(1, MavCmd::CONTROL_HIGH_LATENCY, START));
        wire.run(1_000);
    }
    assert_eq!(wire.take::<CommandAck>().len(), 2, "each is answered");
    assert_eq!(ids(&by_satellite(&mut wire)), [HighLatency2::ID]);
}
