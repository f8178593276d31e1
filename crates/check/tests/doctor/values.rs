//! Values that a ground station shows wrongly, and promises that are not kept.

use mavstack::dialect::{
    Attitude, BatteryStatus, Common, Heartbeat, MavAutopilot, MavCmd, MavFtpErr, MavMissionResult, MavModeProperty,
    MavResult, MavStandardMode, SysStatus, SystemTime, Timesync,
};
use mavstack::frame::{Decoder, Header, Version, encode};
use mavstack::message::{Dialect, LatLon};
use mavstack::{Address, Duration, Instant, Message, PlanType};
use mavstack_check::chunks::{Burst, Chunks};
use mavstack_check::evidence::Evidence;
use mavstack_check::trace::Trace;
use mavstack_check::{Depth, Options, Report, Severity, examine, judge};
use mavstack_rover::Rover;
use mavstack_station::connect::Connected;
use mavstack_station::modes::Mode;
use mavstack_station::{Client, Failure, Received, SeenText};

use crate::board::{Fault, board};

/// Examines a rover with another sensor value.
fn quick(change: impl FnOnce(&mut Rover)) -> Report {
    let mut rig = board(Fault::None);
    change(&mut rig.firmware_mut().rover);
    let options = Options { depth: Depth::Quick, ..Options::default() };
    examine(&mut rig, &options, &mut |_| {})
}

#[track_caller]
fn observes(report: &Report, id: &str, part: &str) {
    let finding = report.finding(id).unwrap_or_else(|| panic!("{id} is not among {:?}", report.findings));
    assert!(finding.observed.contains(part), "{}", finding.observed);
}

#[test]
fn degrees_in_place_of_radians() {
    let attitude = Attitude { roll: 0.5, pitch: -3.0, yaw: 271.0, ..Attitude::default() };
    let mut evidence = evidence();
    evidence.idle.frames.push(received(&attitude));
    observes(&judge(&evidence), "units", "271.0");
}

#[test]
fn degrees_in_place_of_degrees_1e7() {
    let place = LatLon { latitude: 47, longitude: 8 };
    observes(&quick(|rover| rover.motion.position = Some(place)), "units", "47, 8");
}

#[test]
fn volts_in_place_of_millivolts() {
    let report = quick(|rover| rover.battery.voltage = 0.012);
    observes(&report, "units", "12 mV");
    // The battery may be missing on the bench.
    assert_eq!(report.finding("units").map(|finding| finding.severity), Some(Severity::Warning));
}

#[test]
fn a_position_at_0_0() {
    let zero = LatLon { latitude: 0, longitude: 0 };
    let report = quick(|rover| {
        rover.motion.position = Some(zero);
        rover.gps.position = Some(zero);
    });
    observes(&report, "position-zero", "GLOBAL_POSITION_INT, GPS_RAW_INT with a fix");
    assert_eq!(report.finding("position-zero").map(|finding| finding.severity), Some(Severity::Warning));
}

#[test]
fn latitude_and_longitude_swapped() {
    let swapped = LatLon { latitude: 85_456_000, longitude: 473_977_000 };
    observes(&quick(|rover| rover.gps.position = Some(swapped)), "positions-differ", "85456000, 473977000");
}

/// Returns the finding of voltages, of a vehicle with 12.4 V and this battery.
fn voltages(battery: BatteryStatus) -> Option<String> {
    let status = received(&SysStatus { voltage_battery: 12_400, ..SysStatus::default() });
    let evidence = with(&[(Instant::ZERO, status), (Instant::ZERO, received(&battery))]);
    judge(&evidence).finding("voltages-differ").map(|finding| finding.observed.clone())
}

#[test]
fn voltages_of_cells() {
    const NO: u16 = u16::MAX;
    let battery = |cells: &[u16], more: [u16; 4]| {
        let mut voltages = [NO; 10];
        voltages[..cells.len()].copy_from_slice(cells);
        BatteryStatus { voltages, voltages_ext: more, ..BatteryStatus::default() }
    };
    assert_eq!(voltages(battery(&[12_400], [0; 4])), None);
    assert_eq!(voltages(battery(&[4_133, 4_133, 4_134], [0; 4])), None);
    let wrong = voltages(battery(&[12_400; 3], [0; 4])).expect("three times as much");
    assert!(wrong.contains("37200 mV"), "{wrong}");
    // 14 cells of 885 mV.
    assert_eq!(voltages(battery(&[885; 10], [885; 4])), None);
    // The second of three cells is not measured.
    assert_eq!(voltages(battery(&[4_133, NO, 4_133], [0; 4])), None);
    // SYS_STATUS has the first battery's voltage.
    assert_eq!(voltages(BatteryStatus { id: 1, ..battery(&[24_800], [0; 4]) }), None);
}

/// Returns the evidence of a vehicle that streams 10 frames a second, and of 2 s of silence while a parameter was stored, after which
/// the next frame has this number.
fn silence(seq_after: u8) -> Evidence {
    let frame = |at: u64, seq: u8| {
        let frame = received(&Attitude::default());
        let header = Header { seq, ..frame.header };
        Received { at: Instant::from_millis(at), header, ..frame }
    };
    let mut evidence = evidence();
    evidence.idle.frames = (0..100).map(|index| frame(u64::from(index) * 100, index)).collect();
    evidence.idle.ended = Instant::from_millis(10_000);
    let frames = vec![frame(10_000, 100), frame(12_000, seq_after), frame(12_100, seq_after + 1)];
    let (began, ended) = (Instant::from_millis(9_900), Instant::from_millis(12_200));
    evidence.storing = Some(Trace { began, ended, frames, ..Trace::default() });
    evidence
}

/// A silence in which frames were lost is no stall.
#[test]
fn a_stall_is_told_from_lost_frames() {
    observes(
        &judge(&silence(101)),
        "stall",
        "No answer or telemetry was received for 2.0 s while a parameter was stored.",
    );
    // One of them was lost behind the stall.
    observes(&judge(&silence(102)), "stall", "2.0 s");
    assert_eq!(judge(&silence(120)).finding("stall"), None);
}

/// An unknown value is allowed, and said.
#[test]
fn unknown_values_are_a_note() {
    let report = quick(|rover| rover.motion = mavstack::telemetry::Motion::UNKNOWN);
    observes(&report, "unknown-values", "position");
    assert_eq!(report.problems().count(), 0, "{:?}", report.findings);
}

/// It is not refused as one without a position.
#[test]
fn a_plan_is_uploaded_to_a_vehicle_without_a_position() {
    let mut rig = board(Fault::None);
    rig.firmware_mut().rover.motion = mavstack::telemetry::Motion::UNKNOWN;
    let options = Options { depth: Depth::WithPlan, ..Options::default() };
    let report = examine(&mut rig, &options, &mut |_| {});
    assert!(report.skipped.iter().all(|what| !what.contains("plan")), "{:?}", report.skipped);
}

/// A frame that waited in the USB until the port was opened does not make the clock seem fast.
#[test]
fn a_stale_frame_says_nothing_of_the_clock() {
    let attitude = |at: u64, time_boot_ms| Received {
        at: Instant::from_millis(at),
        ..received(&Attitude { time_boot_ms, ..Attitude::default() })
    };
    let current = (0..40_u32).map(|count| attitude(5_250 + u64::from(count) * 250, 5_250 + count * 250));
    let frames: Vec<_> = [attitude(5_000, 200)].into_iter().chain(current).collect();
    let rate = mavstack_check::trace::clock_rate(&frames, Duration::from_secs(2)).expect("ten seconds of frames");
    assert!((rate - 1.0).abs() < 0.001, "{rate}");
}

/// Returns a message as a station receives it: for values that the library does not send.
fn received(message: &impl Message) -> Received {
    let mut frame = [0; 280];
    let len = encode(message, Version::V2, Address::new(1, 1), 0, &mut frame).expect("room");
    let mut decoder = Decoder::default();
    assert_eq!(decoder.push(&frame[..len], Instant::ZERO), len);
    let mut budget = Decoder::MIN_BUDGET;
    let frame = decoder.next(Instant::ZERO, Common::MESSAGES, &mut budget, |_| false).expect("a frame");
    Received { at: Instant::ZERO, header: *frame.header(), payload: frame.payload().to_vec(), is_signed: false }
}

/// Returns evidence with this message, received at this time.
fn with(messages: &[(Instant, Received)]) -> Evidence {
    let mut evidence = evidence();
    let frames = messages.iter().map(|(at, frame)| Received { at: *at, ..frame.clone() });
    evidence.idle.frames.extend(frames);
    evidence.idle.ended = Instant::ZERO + Duration::from_secs(10);
    evidence
}

#[test]
fn microseconds_in_timesync() {
    let answer = |tc1| received(&Timesync { tc1, ts1: 1, ..Timesync::default() });
    let after = Instant::ZERO + Duration::from_secs(4);
    let wrong = with(&[(Instant::ZERO, answer(1_000_000)), (after, answer(5_000_000))]);
    observes(&judge(&wrong), "timesync-unit", "1000000 ns a second");
    let right = with(&[(Instant::ZERO, answer(1_000_000)), (after, answer(4_001_000_000))]);
    assert_eq!(judge(&right).finding("timesync-unit"), None);
}

#[test]
fn seconds_in_the_unix_time() {
    let time = |time_unix_usec| received(&SystemTime { time_unix_usec, time_boot_ms: 0 });
    observes(&judge(&with(&[(Instant::ZERO, time(1_790_000_000))])), "unix-time", "1790000000");
    for right in [0, 1_790_000_000_000_000] {
        assert_eq!(judge(&with(&[(Instant::ZERO, time(right))])).finding("unix-time"), None);
    }
}

/// What a client has learned, with one mode.
fn evidence() -> Evidence {
    let (vehicle, heartbeat) = (Address::new(1, 1), Heartbeat { custom_mode: 5, ..Heartbeat::default() });
    let mode = Mode {
        custom_mode: 5,
        name: "Hold".into(),
        standard_mode: MavStandardMode::NON_STANDARD,
        properties: MavModeProperty::EMPTY,
    };
    let connected = Connected {
        vehicle,
        heartbeat,
        version: Some(mavstack::dialect::AutopilotVersion::default()),
        metadata: None,
        modes: vec![mode],
        parameters: Vec::new(),
        plans: [const { None }; 3],
        failures: Vec::new(),
    };
    Evidence {
        any_byte: true,
        vehicle: Some(vehicle),
        heartbeat: Some(heartbeat),
        connected: vec![(Client::QGroundControl, connected)],
        ..Evidence::default()
    }
}

#[test]
fn a_mode_that_is_not_listed() {
    let mut evidence = evidence();
    assert_eq!(judge(&evidence).finding("mode-not-listed"), None);
    evidence.heartbeat = Some(Heartbeat { custom_mode: 6, ..Heartbeat::default() });
    observes(&judge(&evidence), "mode-not-listed", "mode 6");
}

#[test]
fn a_capability_that_is_not_served() {
    let mut evidence = evidence();
    evidence.services = vec![("MISSION_FENCE", Err(Failure::timeout("MISSION_REQUEST_LIST", 5))), ("FTP", Ok(()))];
    observes(&judge(&evidence), "capability-not-served", "MISSION_FENCE: MISSION_REQUEST_LIST was not answered");
}

/// The request of a service is longer than the FIFO.
#[test]
fn a_service_that_is_not_reached() {
    let burst = |bytes, answered| Burst { bytes, tried: 4, answered, fastest: None };
    let mut evidence = evidence();
    evidence.services = vec![("COMMAND_INT", Err(Failure::timeout("COMMAND_INT", 5)))];
    evidence.chunks = Some(Chunks { bursts: vec![burst(32, 4), burst(64, 0)] });
    assert_eq!(judge(&evidence).finding("capability-not-served"), None);
}

/// A refusal for another reason shows that the service is there.
#[test]
fn a_service_that_refuses_is_served() {
    let command = |result| Failure::Command { command: MavCmd::REQUEST_MESSAGE, result, text: None };
    let plan = |result| Failure::Plan { plan: PlanType::Fence, seq: None, result, text: None };
    let file = |error| Failure::File { path: "/".into(), error, text: None };
    let served = [
        command(MavResult::DENIED),
        command(MavResult::TEMPORARILY_REJECTED),
        command(MavResult::FAILED),
        plan(MavMissionResult::DENIED),
        file(MavFtpErr::FAIL),
    ];
    let unserved =
        [command(MavResult::UNSUPPORTED), plan(MavMissionResult::UNSUPPORTED), file(MavFtpErr::UNKNOWNCOMMAND)];
    let is_found = |failure: &Failure| {
        let services = vec![("SERVICE", Err(failure.clone()))];
        judge(&Evidence { services, ..evidence() }).finding("capability-not-served").is_some()
    };
    assert!(!served.iter().any(is_found));
    assert!(unserved.iter().all(is_found));
}

#[test]
fn what_qgroundcontrol_does_not_get() {
    let mut evidence = evidence();
    evidence.connected[0].1.modes.clear();
    let refused = Failure::Command { command: MavCmd::REQUEST_MESSAGE, result: MavResult::UNSUPPORTED, text: None };
    evidence.connected[0].1.failures.push(refused);
    let report = judge(&evidence);
    observes(&report, "no-parameters", "loading parameters");
    observes(&report, "no-modes", "no mode");
    observes(&report, "hidden", "UNSUPPORTED");
    assert_eq!(report.finding("hidden").map(|finding| finding.severity), Some(Severity::Note));
}

/// ArduPilot need not list its modes.
#[test]
fn modes_that_qgroundcontrol_knows() {
    let mut evidence = evidence();
    evidence.connected[0].1.modes.clear();
    evidence.connected[0].1.heartbeat.autopilot = MavAutopilot::ARDUPILOTMEGA;
    assert_eq!(judge(&evidence).finding("no-modes"), None);
}

#[test]
fn what_the_stack_says() {
    let mut evidence = evidence();
    evidence.texts.push(SeenText {
        at: Instant::ZERO + Duration::from_secs(1),
        from: Address::new(1, 1),
        severity: mavstack::dialect::MavSeverity::ERROR,
        text: "Clock was set back: check the firmware's timer".into(),
    });
    observes(&judge(&evidence), "vehicle-text", "Clock was set back");
}

#[test]
fn what_could_not_be_restored() {
    let mut evidence = evidence();
    evidence.unrestored.push("SPEED_MAX was 2".into());
    observes(&judge(&evidence), "not-restored", "SPEED_MAX was 2");
}
