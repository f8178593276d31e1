//! The doctor harms no vehicle: it sends nothing to an armed one, and restores what it has changed or says what it has not.

use mavstack::dialect::{Attitude, CommandLong, MavCmd};
use mavstack::frame::{Version, encode};
use mavstack::{Address, Duration, Instant, Message};
use mavstack_check::Severity::Warning;
use mavstack_check::{Outcome, Report, Step, examine};
use mavstack_station::kit::Rig;
use mavstack_station::streams::Interval;
use mavstack_station::{Drive, Failure, GroundStation, Station};
use std::cell::Cell;

use crate::board::{BoardFirmware, Fault, board};
use crate::{only, options, report_of};

/// A rig in which something happens during the examination.
struct Eventful<'a, H> {
    rig: &'a mut Rig<BoardFirmware>,
    /// The current step, and when it began.
    step: &'a Cell<Step>,
    began: (Step, Instant),
    /// Is called in each pass with the step and the time since it began.
    happens: H,
}

impl<H: FnMut(&mut Rig<BoardFirmware>, Step, Duration) -> Result<(), Failure>> Drive for Eventful<'_, H> {
    fn station(&mut self) -> &mut Station {
        self.rig.station()
    }

    fn step(&mut self) -> Result<Instant, Failure> {
        if self.began.0 != self.step.get() {
            self.began = (self.step.get(), self.rig.now());
        }
        (self.happens)(self.rig, self.began.0, self.rig.now() - self.began.1)?;
        self.rig.step()
    }
}

/// Examines a sound board to which something happens.
fn examine_with(
    rig: &mut Rig<BoardFirmware>,
    happens: impl FnMut(&mut Rig<BoardFirmware>, Step, Duration) -> Result<(), Failure>,
) -> Report {
    let step = Cell::new(Step::Listening);
    let began = (Step::Listening, rig.now());
    let mut drive = Eventful { rig, step: &step, began, happens };
    let report = examine(&mut drive, &options(Fault::None), &mut |next| step.set(next));
    println!("{report:#?}");
    report
}

/// Returns the bytes that were sent to the vehicle.
fn sent(rig: &Rig<BoardFirmware>) -> u64 {
    rig.line(0).ends().1.written()
}

/// Arms the vehicle, as the pilot does with the sticks.
fn arm(rig: &Rig<BoardFirmware>) {
    let command = CommandLong {
        command: MavCmd::COMPONENT_ARM_DISARM,
        param1: 1.0,
        target_system: 1,
        target_component: 1,
        ..CommandLong::default()
    };
    let mut frame = [0; 64];
    let len = encode(&command, Version::V2, Address::new(255, 1), 0, &mut frame).expect("room");
    rig.line(0).send(&frame[..len]);
}

/// Takes the frames that a dialogue has sent, and leaves all but those commands that `keep` returns false for.
fn filter(rig: &mut Rig<BoardFirmware>, mut keep: impl FnMut(&CommandLong) -> bool) {
    let bytes = rig.station().take_output();
    let mut rest = bytes.as_slice();
    while let [0xFD, len, _, _, _, _, _, a, b, c, ..] = *rest {
        let (frame, next) = rest.split_at(usize::from(len) + 12);
        let is_command = u32::from_le_bytes([a, b, c, 0]) == CommandLong::ID;
        if !is_command || keep(&CommandLong::decode(&frame[10..frame.len() - 2])) {
            rig.station().send_raw(frame);
        }
        rest = next;
    }
}

#[test]
fn an_armed_vehicle_receives_nothing() {
    let mut rig = board(Fault::None);
    rig.arm().expect("it arms");
    let before = sent(&rig);
    let report = report_of(&mut rig, options(Fault::None));
    assert_eq!(sent(&rig), before);
    assert!(report.skipped.iter().any(|what| what.contains("the vehicle is armed")), "{:?}", report.skipped);
    assert!(report.measured.iter().any(|row| row.name == "received while idle"), "{:?}", report.measured);
    only(&report, &[("armed", Warning)]);
}

/// Nothing is sent before the first heartbeat, and none comes from this board.
#[test]
fn a_vehicle_that_does_not_say_that_it_is_disarmed_receives_nothing() {
    for fault in [Fault::NoPoll, Fault::Dead] {
        let mut rig = board(fault);
        let report = report_of(&mut rig, options(Fault::None));
        assert_eq!(sent(&rig), 0, "{fault:?}");
        assert!(report.skipped.iter().any(|what| what.contains("--disarmed")), "{:?}", report.skipped);
        assert!(report.findings[0].observed.contains("No request was sent"), "{:?}", report.findings);
    }
}

#[test]
fn nothing_is_sent_from_the_moment_the_vehicle_is_armed() {
    for step in [Step::Idle, Step::Intervals, Step::Bursts, Step::Load, Step::Storing, Step::Plan, Step::Clients] {
        let mut rig = board(Fault::None);
        let (mut is_armed, mut sent_then) = (false, None);
        let report = examine_with(&mut rig, |rig, now, since| {
            if now == step && !is_armed && since > Duration::from_millis(50) {
                is_armed = true;
                arm(rig);
            }
            if rig.seen().vehicles().any(|vehicle| vehicle.is_armed()) {
                sent_then = sent_then.or(Some(sent(rig)));
            }
            Ok(())
        });
        // The pass in which the heartbeat arrives ends the examination.
        assert_eq!(sent_then.unwrap_or(sent(&rig)), sent(&rig), "{step:?}");
        assert!(rig.seen().vehicles().any(|vehicle| vehicle.is_armed()), "{step:?}");
        assert!(report.skipped.iter().any(|what| what.contains("the vehicle is armed")), "{:?}", report.skipped);
        assert!(report.finding("armed").is_some(), "{:?}", report.findings);
        let is_changed = [Step::Load, Step::Storing, Step::Plan].contains(&step);
        assert_eq!(report.finding("not-restored").is_some(), is_changed, "{step:?}: {:?}", report.findings);
        let before = sent(&rig);
        rig.run_for(Duration::from_secs(3));
        assert_eq!(sent(&rig), before, "{step:?}");
    }
}

/// A vehicle that falls silent may be armed meanwhile.
#[test]
fn nothing_is_changed_without_heartbeats() {
    for (hangs_in, expected) in
        [(Step::Storing, &["heartbeats-stopped", "not-restored"][..]), (Step::Clients, &["heartbeats-stopped"])]
    {
        let mut rig = board(Fault::None);
        let report = examine_with(&mut rig, |rig, step, _| {
            if step == hangs_in {
                rig.hang_flight_loop();
            }
            Ok(())
        });
        assert!(report.skipped.iter().any(|what| what.contains("no heartbeat")), "{:?}", report.skipped);
        assert_eq!(report.problems().map(|finding| finding.id).collect::<Vec<_>>(), expected);
    }
}

/// A heartbeat from before the examination may be out of date.
#[test]
fn a_vehicle_whose_heartbeats_have_stopped_receives_nothing() {
    let mut rig = board(Fault::None);
    rig.connect().expect("it is disarmed");
    rig.hang_flight_loop();
    rig.run_for(Duration::from_secs(3));
    let before = sent(&rig);
    let report = report_of(&mut rig, options(Fault::None));
    assert_eq!(sent(&rig), before);
    assert!(report.skipped.iter().any(|what| what.contains("--disarmed")), "{:?}", report.skipped);
}

#[test]
fn a_failure_of_the_line_keeps_the_report() {
    let mut rig = board(Fault::None);
    let report = examine_with(&mut rig, |_, step, since| match step {
        Step::Storing if since > Duration::from_secs(1) => Err(Failure::Transport("unplugged".into())),
        _ => Ok(()),
    });
    assert_eq!(report.outcome, Outcome::Failed);
    let ids: Vec<_> = report.problems().map(|finding| finding.id).collect();
    assert_eq!(ids, ["line-failed", "not-restored"]);
    assert!(report.findings[0].observed.contains("unplugged"));
    assert!(report.findings[1].observed.contains("SPEED_MAX was 2"), "{}", report.findings[1].observed);
    assert!(report.measured.iter().any(|row| row.name == "received on a full line"));
}

/// The first request to restore the rate is lost.
#[test]
fn a_rate_is_restored_until_the_vehicle_says_so() {
    let mut rig = board(Fault::None);
    let report = examine_with(&mut rig, |rig, step, since| {
        let is_lost = step == Step::Load && since > Duration::from_secs(6) && since < Duration::from_secs(9);
        rig.line(0).set_up(|wire| wire.faults.frame_loss = if is_lost { 1.0 } else { 0.0 });
        Ok(())
    });
    assert_eq!(report.finding("not-restored"), None);
    assert_eq!(rig.interval::<Attitude>(), Ok(Some(Interval::Every(Duration::from_millis(250)))));
}

/// A vehicle that does not know MAV_CMD_REQUEST_MESSAGE.
#[test]
fn a_rate_is_read_by_the_old_command() {
    let mut rig = board(Fault::None);
    let report = examine_with(&mut rig, |rig, _, _| {
        filter(rig, |command| command.command != MavCmd::REQUEST_MESSAGE);
        Ok(())
    });
    assert!(report.skipped.iter().all(|what| !what.contains("a full line")), "{:?}", report.skipped);
    assert_eq!(report.finding("not-restored"), None);
    assert_eq!(rig.interval::<Attitude>(), Ok(Some(Interval::Every(Duration::from_millis(250)))));
}

/// The line takes no command any more once the rate is changed.
#[test]
fn a_rate_that_is_not_restored_is_reported() {
    let mut rig = board(Fault::None);
    let mut commands = 0;
    let report = examine_with(&mut rig, |rig, step, _| {
        filter(rig, |_| {
            commands += u32::from(step == Step::Load);
            commands <= 1
        });
        Ok(())
    });
    let finding = report.finding("not-restored").expect("it is not restored");
    assert!(finding.observed.contains("message 30 came every 250000 µs"), "{}", finding.observed);
}
