//! The demo vehicle flown in simulated time.

use mavstack::dialect::{MavCmd, MavFrame, MavModeFlag, MavResult, MavState, MissionState};
use mavstack::{
    Address, Command, CommandPosition, Commands, Instant, Item, LinkId, Peer, PlanChange, PlanType, Plans, Vehicle,
};
use mavstack_demo::{Mode, Quadrotor, Vector};

const HOME: (i32, i32) = (473_977_420, 85_455_940);

/// A vehicle, its plan and the time.
struct Flight {
    vehicle: Quadrotor,
    plan: Vec<Item>,
    millis: u64,
}

impl Flight {
    fn new() -> Self {
        Self { vehicle: Quadrotor::new(), plan: Vec::new(), millis: 0 }
    }

    /// With a GPS fix, armed.
    fn ready() -> Self {
        let mut flight = Self::new();
        flight.run(2_500);
        assert_eq!(flight.command(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::ACCEPTED);
        flight
    }

    /// Armed, 10 m up.
    fn airborne() -> Self {
        let mut flight = Self::ready();
        assert_eq!(flight.command(MavCmd::NAV_TAKEOFF, &[]), MavResult::ACCEPTED);
        flight.until("up", 10, |vehicle| vehicle.mode() == Mode::Hold);
        flight
    }

    fn run(&mut self, millis: u64) {
        for _ in 0..millis {
            self.millis += 1;
            self.vehicle.control_step(Instant::from_millis(self.millis), &self.plan);
        }
    }

    /// Until `condition`, which has to come within `seconds`.
    fn until(&mut self, what: &str, seconds: u64, condition: impl Fn(&Quadrotor) -> bool) {
        let deadline = self.millis + seconds * 1_000;
        while !condition(&self.vehicle) {
            assert!(self.millis < deadline, "not {what} after {seconds} s: {:?}", self.vehicle);
            self.run(10);
        }
    }

    fn command(&mut self, id: MavCmd, params: &[f32]) -> MavResult {
        let mut all = [0.0; 7];
        all[..params.len()].copy_from_slice(params);
        let [p1, p2, p3, p4, param5, param6, z] = all;
        self.send(Command { position: CommandPosition::Long { param5, param6 }, z, ..command(id, [p1, p2, p3, p4]) })
    }

    fn send(&mut self, command: Command) -> MavResult {
        self.vehicle.command(&command).result
    }

    fn upload(&mut self, plan: &[Item]) {
        for (seq, item) in plan.iter().enumerate() {
            assert_eq!(self.vehicle.check_item(PlanType::Mission, seq as u16, item), Ok(()), "item {seq}");
        }
        self.plan = plan.to_vec();
        self.vehicle.plan_changed(PlanChange { plan: PlanType::Mission, items: &self.plan, first: 0 });
    }

    fn height(&self) -> f32 {
        -self.vehicle.local_position().down
    }

    fn mission(&self) -> (u16, MissionState) {
        let progress = self.vehicle.progress();
        (progress.current, progress.state)
    }
}

fn command(id: MavCmd, params: [f32; 4]) -> Command {
    Command {
        id,
        params,
        position: CommandPosition::Long { param5: 0.0, param6: 0.0 },
        z: 0.0,
        from: Peer { address: Address::new(255, 190), link: LinkId(0) },
        is_broadcast: false,
        confirmation: 0,
    }
}

fn waypoint(north: i32, east: i32, z: f32) -> Item {
    Item {
        frame: MavFrame::GLOBAL_RELATIVE_ALT,
        command: MavCmd::NAV_WAYPOINT,
        autocontinue: 1,
        params: [0.0, 0.0, 0.0, f32::NAN],
        x: HOME.0 + north,
        y: HOME.1 + east,
        z,
    }
}

#[test]
fn it_arms_with_a_gps_fix_and_not_before() {
    let mut flight = Flight::new();
    flight.run(1_900);
    assert_eq!(flight.vehicle.global_position(), None);
    assert_eq!(flight.command(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::TEMPORARILY_REJECTED);
    assert!(flight.vehicle.take_text().is_some(), "the operator is told why");
    assert_eq!(flight.vehicle.state().unwrap().system_status, MavState::BOOT);
    flight.run(200);
    assert_eq!(flight.vehicle.global_position().map(|position| (position.latitude, position.longitude)), Some(HOME));
    assert_eq!(flight.vehicle.state().unwrap().system_status, MavState::STANDBY);
    for _ in 0..2 {
        assert_eq!(flight.command(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::ACCEPTED, "also again (C-11)");
    }
    let state = flight.vehicle.state().unwrap();
    assert!(state.base_mode.contains(MavModeFlag::SAFETY_ARMED));
    assert_eq!(state.system_status, MavState::ACTIVE);
}

/// C-31, C-9.
#[test]
fn arming_takes_0_or_1_and_nothing_else() {
    let mut flight = Flight::ready();
    for p1 in [0.5, 2.0, -1.0, f32::NAN, f32::INFINITY] {
        assert_eq!(flight.command(MavCmd::COMPONENT_ARM_DISARM, &[p1]), MavResult::DENIED, "{p1}");
    }
    assert_eq!(flight.command(MavCmd::COMPONENT_ARM_DISARM, &[0.0, 5.0]), MavResult::DENIED);
    assert!(flight.vehicle.is_armed());
    assert_eq!(flight.command(MavCmd::COMPONENT_ARM_DISARM, &[0.0, f32::NAN]), MavResult::ACCEPTED);
    assert!(!flight.vehicle.is_armed());
    let to_all = Command { is_broadcast: true, ..command(MavCmd::COMPONENT_ARM_DISARM, [1.0, 0.0, 0.0, 0.0]) };
    assert_eq!(flight.send(to_all), MavResult::DENIED);
}

#[test]
fn in_flight_it_is_disarmed_by_force_only_and_falls() {
    let mut flight = Flight::airborne();
    assert_eq!(flight.command(MavCmd::COMPONENT_ARM_DISARM, &[0.0]), MavResult::DENIED);
    assert!(flight.vehicle.is_armed());
    assert_eq!(flight.command(MavCmd::COMPONENT_ARM_DISARM, &[0.0, 21_196.0]), MavResult::ACCEPTED);
    flight.run(2_000);
    assert!(flight.vehicle.is_landed() && !flight.vehicle.is_armed());
}

#[test]
fn it_takes_off_holds_and_lands() {
    let mut flight = Flight::ready();
    assert_eq!(
        flight.command(MavCmd::NAV_TAKEOFF, &[0.0, 0.0, 0.0, f32::NAN, f32::NAN, f32::NAN, 5.0]),
        MavResult::ACCEPTED
    );
    flight.until("up", 10, |vehicle| vehicle.mode() == Mode::Hold);
    flight.run(20_000);
    assert!((flight.height() - 5.0).abs() < 0.6, "{}", flight.height());
    assert_eq!(flight.command(MavCmd::NAV_LAND, &[]), MavResult::ACCEPTED);
    flight.until("down", 30, |vehicle| !vehicle.is_armed());
    assert!(flight.vehicle.is_landed());
    assert_eq!(flight.command(MavCmd::NAV_LAND, &[]), MavResult::ACCEPTED, "it has landed (C-11)");
}

/// A position without a frame of its own is above home; COMMAND_INT says which it means (C-6, C-7).
#[test]
fn take_off_minds_the_frame_of_its_altitude() {
    let table = [
        (MavFrame::GLOBAL, 500.0, MavResult::ACCEPTED, 12.0),
        (MavFrame::GLOBAL_RELATIVE_ALT, 7.0, MavResult::ACCEPTED, 7.0),
        (MavFrame::GLOBAL, 100.0, MavResult::DENIED, 0.0),
        (MavFrame::LOCAL_NED, 7.0, MavResult::COMMAND_UNSUPPORTED_MAV_FRAME, 0.0),
    ];
    for (frame, z, result, height) in table {
        let mut flight = Flight::ready();
        let position = CommandPosition::Int { frame, x: i32::MAX, y: i32::MAX };
        let command = Command { position, z, ..command(MavCmd::NAV_TAKEOFF, [f32::NAN; 4]) };
        assert_eq!(flight.send(command), result, "{frame:?} {z}");
        flight.run(10_000);
        assert!((flight.height() - height).abs() < 0.6, "{frame:?} {z}: {}", flight.height());
    }
}

#[test]
fn what_needs_an_armed_vehicle_waits_for_one() {
    let mut flight = Flight::new();
    flight.run(2_500);
    flight.upload(&[waypoint(0, 0, 5.0)]);
    for id in [MavCmd::NAV_TAKEOFF, MavCmd::NAV_RETURN_TO_LAUNCH, MavCmd::MISSION_START] {
        assert_eq!(flight.command(id, &[]), MavResult::TEMPORARILY_REJECTED, "{id:?}");
    }
    assert_eq!(flight.command(MavCmd::DO_REPEAT_SERVO, &[]), MavResult::UNSUPPORTED);
}

#[test]
fn a_mission_of_three_waypoints_is_flown_to_its_end() {
    let mut flight = Flight::airborne();
    let corners = [waypoint(2_000, 0, 12.0), waypoint(2_000, 2_000, 15.0), waypoint(0, 2_000, 12.0)];
    flight.upload(&corners);
    assert_eq!(flight.mission(), (0, MissionState::NOT_STARTED));
    assert_eq!(flight.command(MavCmd::MISSION_START, &[0.0, 0.0]), MavResult::ACCEPTED);
    for (seq, corner) in corners.iter().enumerate() {
        assert_eq!(flight.mission(), (seq as u16, MissionState::ACTIVE));
        let is_there = |vehicle: &Quadrotor| {
            let position = vehicle.global_position().unwrap();
            // 200 units of latitude are 2.2 m.
            (position.latitude - corner.x).abs() < 200
                && (position.longitude - corner.y).abs() < 300
                && (position.altitude - 488.0 - corner.z).abs() < 2.1
        };
        flight.until("there", 30, |vehicle| is_there(vehicle) && usize::from(vehicle.progress().current) == seq);
        flight.until("on", 5, |vehicle| usize::from(vehicle.progress().current) > seq || vehicle.mode() == Mode::Hold);
    }
    assert_eq!(flight.mission(), (2, MissionState::COMPLETE));
    let end = flight.vehicle.local_position();
    flight.run(10_000);
    assert!(flight.vehicle.local_position().distance(end) < 3.0, "it stays where the plan ended");
    assert!(flight.vehicle.is_armed() && flight.height() > 10.0);
}

#[test]
fn a_plan_from_ground_to_ground() {
    let mut flight = Flight::ready();
    let item = |command, item: Item| Item { command, ..item };
    flight.upload(&[
        item(MavCmd::NAV_TAKEOFF, Item { x: i32::MAX, y: i32::MAX, ..waypoint(0, 0, 6.0) }),
        Item { command: MavCmd::DO_CHANGE_SPEED, params: [1.0, 3.0, 0.0, 0.0], ..waypoint(0, 0, 0.0) },
        Item { params: [4.0, 0.0, 0.0, 0.0], ..waypoint(3_000, 0, 6.0) },
        item(MavCmd::NAV_RETURN_TO_LAUNCH, Item { frame: MavFrame::MISSION, x: 0, y: 0, ..waypoint(0, 0, 0.0) }),
    ]);
    assert_eq!(flight.command(MavCmd::MISSION_START, &[]), MavResult::ACCEPTED);
    flight.until("at the speed", 10, |vehicle| vehicle.progress().current == 2);
    let mut fastest: f32 = 0.0;
    while flight.mission().0 == 2 {
        flight.run(10);
        let Vector { north, east, .. } = flight.vehicle.velocity();
        fastest = fastest.max((north * north + east * east).sqrt());
    }
    assert!((2.9..3.1).contains(&fastest), "it keeps to the speed that the plan sets: {fastest}");
    flight.until("down", 60, |vehicle| !vehicle.is_armed());
    assert_eq!(flight.mission(), (3, MissionState::COMPLETE));
    assert!(flight.vehicle.local_position().distance(Vector::ZERO) < 1.5);
}

#[test]
fn it_holds_at_a_waypoint_as_long_as_that_says() {
    let mut flight = Flight::airborne();
    flight.upload(&[Item { params: [7.0, 0.0, 0.0, 0.0], ..waypoint(0, 0, 10.0) }, waypoint(500, 0, 10.0)]);
    flight.command(MavCmd::MISSION_START, &[]);
    let start = flight.millis;
    flight.until("on", 20, |vehicle| vehicle.progress().current == 1);
    assert!((7_000..7_200).contains(&(flight.millis - start)), "{}", flight.millis - start);
}

#[test]
fn a_mission_is_paused_and_gone_on_with() {
    let mut flight = Flight::airborne();
    flight.upload(&[waypoint(0, 0, 10.0), waypoint(9_000, 0, 10.0)]);
    flight.command(MavCmd::MISSION_START, &[]);
    flight.run(2_000);
    let custom = f32::from(MavModeFlag::CUSTOM_MODE_ENABLED.0);
    assert_eq!(flight.command(MavCmd::DO_SET_MODE, &[custom, Mode::Hold as u8 as f32]), MavResult::ACCEPTED);
    assert_eq!(flight.mission(), (1, MissionState::PAUSED));
    let here = flight.vehicle.local_position();
    flight.run(10_000);
    assert!(flight.vehicle.local_position().distance(here) < 12.0, "it stops");
    assert_eq!(flight.command(MavCmd::DO_SET_MODE, &[custom, Mode::Mission as u8 as f32]), MavResult::ACCEPTED);
    assert_eq!(flight.mission(), (1, MissionState::ACTIVE));
    flight.until("there", 30, |vehicle| vehicle.progress().state == MissionState::COMPLETE);
}

/// Other autopilots' mode numbers, as MAVSDK sends them to all but ArduPilot, are refused and not misunderstood.
#[test]
fn modes_of_other_autopilots_are_denied() {
    let mut flight = Flight::airborne();
    for params in [[1.0, 4.0, 4.0], [1.0, 4.0, 0.0], [1.0, 100.0, 3.0], [0.0, 100.0, 0.0], [1.0, f32::NAN, 0.0]] {
        assert_eq!(flight.command(MavCmd::DO_SET_MODE, &params), MavResult::DENIED, "{params:?}");
    }
    assert_eq!(flight.vehicle.mode(), Mode::Hold);
}

#[test]
fn mission_start_refuses_items_that_are_not_there() {
    let mut flight = Flight::airborne();
    assert_eq!(flight.command(MavCmd::MISSION_START, &[]), MavResult::FAILED);
    flight.upload(&[waypoint(0, 0, 10.0), waypoint(500, 0, 10.0)]);
    for params in [[2.0, 0.0], [-1.0, 0.0], [0.5, 0.0], [1e9, 0.0], [0.0, 2.0], [0.0, f32::INFINITY]] {
        assert_eq!(flight.command(MavCmd::MISSION_START, &params), MavResult::DENIED, "{params:?}");
    }
    assert_eq!(flight.command(MavCmd::MISSION_START, &[1.0, 1.0]), MavResult::ACCEPTED);
    assert_eq!(flight.mission(), (1, MissionState::ACTIVE));
}

/// M-39, M-94: a new plan under way is begun at its start; without a plan the vehicle stays where it is.
#[test]
fn the_plan_may_change_in_flight() {
    let mut flight = Flight::airborne();
    flight.upload(&[waypoint(0, 0, 10.0), waypoint(9_000, 0, 10.0), waypoint(9_000, 9_000, 10.0)]);
    flight.command(MavCmd::MISSION_START, &[]);
    flight.run(3_000);
    flight.upload(&[waypoint(0, 500, 10.0)]);
    assert_eq!(flight.mission(), (0, MissionState::ACTIVE));
    flight.run(1_000);
    flight.upload(&[]);
    flight.run(5_000);
    assert_eq!(flight.vehicle.mode(), Mode::Hold);
    assert!(flight.vehicle.is_armed() && (flight.height() - 10.0).abs() < 1.0);
}

#[test]
fn the_battery_drains_faster_in_the_air_and_says_when_it_is_low() {
    let mut flight = Flight::ready();
    let before = flight.vehicle.battery().remaining;
    flight.run(60_000);
    let ground = before - flight.vehicle.battery().remaining;
    flight.command(MavCmd::NAV_TAKEOFF, &[]);
    flight.run(5_000);
    let before = flight.vehicle.battery().remaining;
    flight.run(60_000);
    assert!(before - flight.vehicle.battery().remaining > 3.0 * ground && ground > 0.0);
    flight.vehicle.take_text();
    flight.until("low", 1_200, |vehicle| vehicle.battery().remaining < 0.15);
    assert_eq!(flight.vehicle.take_text().map(|(_, text)| text), Some("Battery low"));
    assert_eq!(flight.vehicle.state().unwrap().system_status, MavState::CRITICAL);
}

/// The same steps in time, the same flight; and how often the loop goes round does not matter.
#[test]
fn flights_are_repeatable() {
    let fly = |period: u64| {
        let mut flight = Flight::airborne();
        flight.upload(&[waypoint(2_000, 1_000, 12.0), waypoint(0, 500, 9.0)]);
        flight.command(MavCmd::MISSION_START, &[]);
        for _ in 0..20_000 / period {
            flight.millis += period;
            flight.vehicle.control_step(Instant::from_millis(flight.millis), &flight.plan);
        }
        (flight.vehicle.local_position(), flight.vehicle.attitude(), flight.vehicle.battery())
    };
    assert_eq!(fly(1), fly(1));
    assert_eq!(fly(1), fly(5));
}
