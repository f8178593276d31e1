//! A vehicle, its plans and the time.

#![allow(dead_code, reason = "each test file uses its part of it")]

use std::collections::VecDeque;

use mavstack::dialect::{MavCmd, MavFrame, MavResult, MissionState};
use mavstack::{
    Address, Command, CommandPosition, Commands, Instant, Item, LinkClass, LinkId, ModeRequest, Peer, PlanChange,
    PlanFault, PlanType, Plans,
};
use mavstack_demo::{Mode, Quadrotor, Vector};

pub const STATION: Peer = Peer { address: Address::new(255, 190), link: LinkId(0) };

pub const HOME: (i32, i32) = (473_977_420, 85_455_940);

pub struct Flight {
    pub vehicle: Quadrotor,
    pub mission: Vec<Item>,
    pub fence: Vec<Item>,
    pub rally: Vec<Item>,
    pub millis: u64,
    /// What it reached, and not asked for yet.
    reached: Vec<u16>,
    /// What it said, and not asked for yet.
    texts: VecDeque<&'static str>,
}

impl Flight {
    pub fn new() -> Self {
        Self {
            vehicle: Quadrotor::new(),
            mission: Vec::new(),
            fence: Vec::new(),
            rally: Vec::new(),
            millis: 0,
            reached: Vec::new(),
            texts: VecDeque::new(),
        }
    }

    /// With a GPS fix, armed.
    pub fn ready() -> Self {
        let mut flight = Self::new();
        flight.run(2_500);
        assert_eq!(flight.command(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::ACCEPTED);
        flight
    }

    /// Armed, 10 m up.
    pub fn airborne() -> Self {
        let mut flight = Self::ready();
        assert_eq!(flight.command(MavCmd::NAV_TAKEOFF, &[]), MavResult::ACCEPTED);
        flight.until("up", 10, |vehicle| vehicle.mode() == Mode::Hold);
        flight
    }

    /// Armed, 10 m up, flying `plan`.
    pub fn flying(plan: &[Item]) -> Self {
        let mut flight = Self::airborne();
        flight.upload(plan);
        assert_eq!(flight.start(None, None), MavResult::ACCEPTED);
        flight
    }

    pub fn run(&mut self, millis: u64) {
        for _ in 0..millis {
            self.go_round(1);
        }
    }

    /// Once round the flight loop, `millis` after the last time.
    pub fn go_round(&mut self, millis: u64) {
        self.millis += millis;
        self.vehicle.control_step(Instant::from_millis(self.millis), &self.mission, &self.fence, &self.rally);
        self.reached.extend(core::iter::from_fn(|| self.vehicle.take_reached()));
        self.listen();
    }

    /// Until `condition`, which has to come within `seconds`.
    pub fn until(&mut self, what: &str, seconds: u64, condition: impl Fn(&Quadrotor) -> bool) {
        let deadline = self.millis + seconds * 1_000;
        while !condition(&self.vehicle) {
            assert!(self.millis < deadline, "not {what} after {seconds} s: {:?}", self.vehicle);
            self.run(10);
        }
    }

    /// Until it no longer flies the mission: how long that took, s.
    pub fn until_end(&mut self, seconds: u64) -> f32 {
        let start = self.millis;
        self.until("at the end", seconds, |vehicle| vehicle.mode() != Mode::Mission);
        (self.millis - start) as f32 / 1_000.0
    }

    /// Until item `seq` is current: how long that took, s.
    pub fn until_current(&mut self, seq: u16, seconds: u64) -> f32 {
        let start = self.millis;
        self.until(&format!("at item {seq}"), seconds, |vehicle| vehicle.progress().current == seq);
        (self.millis - start) as f32 / 1_000.0
    }

    pub fn command(&mut self, id: MavCmd, params: &[f32]) -> MavResult {
        let mut all = [0.0; 7];
        all[..params.len()].copy_from_slice(params);
        let [p1, p2, p3, p4, param5, param6, z] = all;
        self.send(Command { position: CommandPosition::Long { param5, param6 }, z, ..command(id, [p1, p2, p3, p4]) })
    }

    pub fn send(&mut self, command: Command) -> MavResult {
        let result = self.vehicle.command(&command).result;
        self.listen();
        result
    }

    pub fn set_mode(&mut self, mode: Mode) -> MavResult {
        let request = ModeRequest { from: STATION, class: LinkClass::Normal, age: None, is_broadcast: false };
        let mode = Quadrotor::MODES.iter().find(|row| row.custom_mode == mode.number()).unwrap();
        let result = self.vehicle.set_mode(mode, &request).result;
        self.listen();
        result
    }

    /// MAV_CMD_MISSION_START, as the stack hands it on.
    pub fn start(&mut self, first: Option<u16>, last: Option<u16>) -> MavResult {
        let result = self.vehicle.start_mission(&command(MavCmd::MISSION_START, [0.0; 4]), first, last);
        self.listen();
        result
    }

    /// A new mission.
    pub fn upload(&mut self, items: &[Item]) {
        self.change(PlanType::Mission, items, 0).unwrap();
    }

    /// A new plan, as the stack hands it on; what its own checks refuse does not come here.
    pub fn change(&mut self, plan: PlanType, items: &[Item], first: u16) -> Result<(), PlanFault> {
        for (seq, item) in items.iter().enumerate() {
            self.vehicle.check_item(plan, seq as u16, item)?;
        }
        let checked = self.vehicle.check_plan(plan, items);
        self.listen();
        checked?;
        let live = match plan {
            PlanType::Mission => &mut self.mission,
            PlanType::Fence => &mut self.fence,
            PlanType::Rally => &mut self.rally,
        };
        *live = items.to_vec();
        self.vehicle.plan_changed(PlanChange { plan, items: live, first });
        Ok(())
    }

    pub fn height(&self) -> f32 {
        -self.vehicle.local_position().down
    }

    pub fn mission(&self) -> (u16, MissionState) {
        let progress = self.vehicle.progress();
        assert_eq!(progress.in_mission_mode, self.vehicle.mode() == Mode::Mission);
        (progress.current, progress.state)
    }

    /// Horizontally, m from a place.
    pub fn distance(&self, north: f32, east: f32) -> f32 {
        self.vehicle.local_position().distance(Vector { north, east, down: 0.0 })
    }

    /// m/s
    pub fn speed(&self) -> f32 {
        let Vector { north, east, .. } = self.vehicle.velocity();
        north.hypot(east)
    }

    /// Where the nose points, degrees from 0 to 360.
    pub fn heading(&self) -> f32 {
        let [_, _, yaw] = self.vehicle.attitude();
        yaw.to_degrees().rem_euclid(360.0)
    }

    /// What it has reached since the last time.
    pub fn reached(&mut self) -> Vec<u16> {
        core::mem::take(&mut self.reached)
    }

    /// What it has said since the last time.
    pub fn said(&mut self) -> Vec<&'static str> {
        core::mem::take(&mut self.texts).into()
    }

    fn listen(&mut self) {
        self.texts.extend(core::iter::from_fn(|| self.vehicle.take_text()).map(|(_, text)| text));
    }
}

pub fn command(id: MavCmd, params: [f32; 4]) -> Command {
    Command {
        id,
        params,
        position: CommandPosition::Long { param5: 0.0, param6: 0.0 },
        z: 0.0,
        from: STATION,
        class: LinkClass::Normal,
        age: None,
        is_broadcast: false,
        confirmation: 0,
    }
}

/// An item at a place (m from home), `z` m above it.
pub fn at(command: MavCmd, params: [f32; 4], north: f32, east: f32, z: f32) -> Item {
    // On this latitude; 1e-7 degrees of the equator are 11.132 mm.
    let metre = 1.0 / 0.011_131_95;
    Item {
        frame: MavFrame::GLOBAL_RELATIVE_ALT,
        command,
        autocontinue: 1,
        params,
        x: HOME.0 + (north * metre).round() as i32,
        y: HOME.1 + (east * metre / 0.676_89).round() as i32,
        z,
    }
}

/// A waypoint 10 m up, to fly past.
pub fn waypoint(north: f32, east: f32) -> Item {
    at(MavCmd::NAV_WAYPOINT, [0.0, 0.0, 0.0, f32::NAN], north, east, 10.0)
}

/// An item without a place.
pub fn act(command: MavCmd, params: [f32; 4]) -> Item {
    Item { frame: MavFrame::MISSION, command, autocontinue: 1, params, x: 0, y: 0, z: 0.0 }
}

pub fn jump(target: u16, repeat: f32) -> Item {
    act(MavCmd::DO_JUMP, [f32::from(target), repeat, 0.0, 0.0])
}
