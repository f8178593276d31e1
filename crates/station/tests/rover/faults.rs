//! The faults that a rig injects: what the vehicle and its station notice of each.

use mavstack::dialect::{MavParamType, ParamSet, SysStatus};
use mavstack::{Duration, Instant, Text};
use mavstack_rover::Tuning;
use mavstack_station::kit::{LineConfig, Rig};
use mavstack_station::{Client, Drive, GroundStation};

use crate::SECOND;
use crate::rig::Tested;

fn connected(line: LineConfig) -> Rig<Tested> {
    let mut rig = Rig::new(Tested::boot).with_line(line, Client::QGroundControl);
    rig.connect().unwrap();
    rig
}

/// Returns the times of the vehicle's heartbeats.
fn heartbeats(rig: &Rig<Tested>) -> &[Instant] {
    rig.seen().vehicles().next().map_or(&[], |vehicle| &vehicle.heartbeats)
}

fn set_speed(rig: &mut Rig<Tested>, speed: f32) {
    let set = ParamSet {
        target_system: 1,
        target_component: 1,
        param_id: Text::new("SPEED_MAX"),
        param_type: MavParamType::REAL32,
        param_value: speed,
    };
    rig.station().send(&set);
}

fn speed(rig: &Rig<Tested>) -> f32 {
    rig.firmware().stack.parameters().get(Tuning::SPEED_MAX)
}

#[test]
fn equal_seeds_give_equal_runs() {
    let run = |seed| {
        let line = LineConfig::uart(57_600).with_loss(0.2).with_damage(0.001).with_chunks(7);
        let mut rig = Rig::new(Tested::boot).with_line(line, Client::Mavsdk).with_seed(seed);
        rig.run_for(SECOND * 20);
        let vehicle = rig.seen().vehicles().next().unwrap();
        (vehicle.frames, vehicle.lost, vehicle.heartbeats.clone())
    };
    assert_eq!(run(7), run(7));
    assert_ne!(run(7), run(8));
}

/// A stall of the processor delays the heartbeats. What overruns the UART meanwhile is lost, and nothing else.
#[test]
fn a_stalled_processor_loses_what_its_uart_cannot_hold() {
    let mut rig = connected(LineConfig::uart(57_600).with_rx_fifo(64));
    rig.run_for(SECOND);
    assert_eq!(rig.line(0).overruns(), 0);
    rig.stall(SECOND * 3);
    for _ in 0..10 {
        set_speed(&mut rig, 5.0);
        rig.run_for(Duration::from_millis(100));
    }
    rig.run_for(SECOND * 4);
    assert!(rig.line(0).overruns() > 100);
    assert_eq!(speed(&rig), 5.0, "the first request was buffered");
    let gaps = heartbeats(&rig).windows(2).map(|pair| pair[1] - pair[0]);
    assert!((SECOND * 3..SECOND * 4).contains(&gaps.max().unwrap()));
}

/// "Poll every 200 ms" is among the usual mistakes: the UART's FIFO overruns.
#[test]
fn slow_polls_overrun_the_uart() {
    let mut rig = connected(LineConfig::uart(57_600).with_rx_fifo(64));
    rig.set_poll_interval(Duration::from_millis(200));
    for speed in 0..20 {
        set_speed(&mut rig, 1.0 + speed as f32 / 10.0);
        rig.run_for(Duration::from_millis(20));
    }
    assert!(rig.line(0).overruns() > 0);
}

#[test]
fn a_cut_line_is_silent_until_it_is_restored() {
    let mut rig = connected(LineConfig::uart(57_600));
    rig.line(0).cut();
    let count = rig.seen().count::<SysStatus>();
    rig.run_for(SECOND * 10);
    assert_eq!(rig.seen().count::<SysStatus>(), count);
    assert!(!rig.firmware().stack.has_ground_station(rig.since_boot()));
    rig.line(0).restore();
    rig.until(SECOND * 3, |rig| rig.seen().count::<SysStatus>() > count);
}

/// RAM is lost, flash is kept, and the time since boot starts again.
#[test]
fn the_vehicle_comes_back_after_a_power_cut() {
    let mut rig = connected(LineConfig::uart(57_600));
    set_speed(&mut rig, 5.0);
    rig.run_for(SECOND * 3);
    rig.cut_power();
    rig.run_for(SECOND * 3);
    let count = heartbeats(&rig).len();
    assert!(!rig.has_power() && rig.reboots() == 0);
    rig.restore_power();
    assert_eq!((speed(&rig), rig.since_boot(), rig.reboots()), (5.0, Instant::ZERO, 1));
    rig.until(SECOND * 2, |rig| heartbeats(rig).len() > count);
    set_speed(&mut rig, 6.0);
    rig.run_for(Duration::from_millis(50));
    rig.reset();
    assert_eq!(speed(&rig), 5.0, "it was not stored yet");
}

/// The power fails at places all over a write: the old value or the new one is restored.
#[test]
fn a_power_cut_keeps_the_old_value_or_the_new_one() {
    let (mut old, mut new) = (0, 0);
    for steps in (0..).step_by(7) {
        let mut rig = connected(LineConfig::default()).with_pass(Duration::from_millis(10));
        set_speed(&mut rig, 3.0);
        rig.run_for(SECOND * 3);
        set_speed(&mut rig, 4.0);
        rig.flash().cut_power_after(steps);
        let is_cut = rig.reaches(SECOND * 20, |rig| !rig.has_power());
        rig.restore_power();
        match speed(&rig) {
            3.0 => old += 1,
            4.0 => new += 1,
            other => panic!("{other} after {steps} steps"),
        }
        if !is_cut {
            break;
        }
    }
    assert!(old > 20 && new > 0, "{old}, {new}");
}

#[test]
fn a_goal_that_is_not_reached_fails_the_test() {
    let failure = std::panic::catch_unwind(|| {
        connected(LineConfig::default()).until(SECOND, |rig| rig.seen().has_text("never"));
    });
    assert_eq!(failure.unwrap_err().downcast_ref::<String>().unwrap(), "not reached within 1000 ms");
}
