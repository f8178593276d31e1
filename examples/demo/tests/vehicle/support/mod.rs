//! The demo vehicle in simulated time, driven through its hooks, without a stack.

pub mod wire;

use mavstack::command::CommandPosition;
use mavstack::config::LinkClass;
use mavstack::dialect::{
    Common, MavCmd, MavFrame, MavResult, MavSeverity, MissionItemReached, MissionState, Statustext,
};
use mavstack::frame::Decoder;
use mavstack::message::{ComponentId, Dialect};
use mavstack::plan::PlanFault;
use mavstack::{
    Address, Command, Commands, Config, Context, Duration, Instant, Item, LinkConfig, LinkId, ModeRequest, Modes, Peer,
    PlanChange, PlanType, Plans, Pulse, StackOf,
};
use mavstack_demo::{Mode, Quadrotor, Tuning, Vector};

const LINK: LinkId = LinkId(0);

pub const STATION: Peer = Peer { address: Address::new(255, 190), link: LINK };

pub const HOME: (i32, i32) = (473_977_420, 85_455_940);

/// The declaration of the test vehicle: plans, parameters, and a lossless link.
#[derive(mavstack::Stack)]
#[stack(
    vehicle: Quadrotor,
    links: 1,
    plans: { mission: 100, fence: 100, rally: 10 },
    parameters: Tuning,
    commands: { slots: 4 },
    texts: TEXTS,
)]
pub struct Bench;

const TEXTS: usize = 4;

pub struct Flight {
    pub vehicle: Quadrotor,
    pub stack: Box<StackOf<Bench>>,
    pub millis: u64,
    decoder: Decoder,
    /// Items reached since the last [`reached`](Self::reached).
    reached: Vec<u16>,
    /// Texts sent since the last [`texts`](Self::texts).
    texts: Vec<String>,
}

impl Flight {
    pub fn new() -> Self {
        let config = Config::new(Address::new(1, 1), Box::leak(Box::new(Pulse::new())));
        Self {
            vehicle: Quadrotor::new(),
            stack: Box::new(StackOf::<Bench>::new(config, [LinkConfig::uart(921_600)])),
            millis: 0,
            decoder: Decoder::new(Duration::from_secs(1)),
            reached: Vec::new(),
            texts: Vec::new(),
        }
    }

    /// Returns an armed vehicle with a GPS fix.
    pub fn armed() -> Self {
        let mut flight = Self::new();
        flight.run(2_500);
        assert_eq!(flight.command(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::ACCEPTED);
        flight
    }

    /// Returns a vehicle that hovers at 10 m.
    pub fn airborne() -> Self {
        let mut flight = Self::armed();
        assert_eq!(flight.command(MavCmd::NAV_TAKEOFF, &[]), MavResult::ACCEPTED);
        flight.until("up", 10, |vehicle| vehicle.mode() == Mode::Hold);
        flight
    }

    /// Returns a vehicle at 10 m that flies `plan`.
    pub fn flying(plan: &[Item]) -> Self {
        let mut flight = Self::airborne();
        flight.upload(plan);
        assert_eq!(flight.start(None, None), MavResult::ACCEPTED);
        flight
    }

    pub fn run(&mut self, millis: u64) {
        for _ in 0..millis {
            self.step(1);
        }
    }

    /// Runs one pass of the flight loop, `millis` after the last one.
    pub fn step(&mut self, millis: u64) {
        self.millis += millis;
        let now = self.now();
        self.stack.with_context(now, |cx| self.vehicle.control_step(cx));
        self.vehicle.store_counts(self.stack.parameters_mut());
        self.stack.poll(now, &mut self.vehicle);
        self.collect_texts();
    }

    /// Runs until `condition` holds; panics after `seconds`.
    pub fn until(&mut self, what: &str, seconds: u64, condition: impl Fn(&Quadrotor) -> bool) {
        let deadline = self.millis + seconds * 1_000;
        while !condition(&self.vehicle) {
            assert!(self.millis < deadline, "not {what} after {seconds} s: {:?}", self.vehicle);
            self.run(10);
        }
    }

    /// Runs until the mission ends. Returns how long that took (s).
    pub fn until_end(&mut self, seconds: u64) -> f32 {
        let start = self.millis;
        self.until("at the end", seconds, |vehicle| vehicle.mode() != Mode::Mission);
        (self.millis - start) as f32 / 1_000.0
    }

    /// Runs until item `seq` is current. Returns how long that took (s).
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
        let result = self.hook(|vehicle, cx| vehicle.command(cx, &command).result);
        self.collect_texts();
        result
    }

    pub fn set_mode(&mut self, mode: Mode) -> MavResult {
        let request = ModeRequest { from: STATION, class: LinkClass::Normal, age: None, is_broadcast: false };
        let mode = Quadrotor::MODES.iter().find(|row| row.custom_mode == mode.number()).unwrap();
        let result = self.hook(|vehicle, cx| vehicle.set_mode(cx, mode, &request).result);
        self.collect_texts();
        result
    }

    /// Starts the mission as the stack does after MAV_CMD_MISSION_START.
    pub fn start(&mut self, first: Option<u16>, last: Option<u16>) -> MavResult {
        let result =
            self.hook(|vehicle, cx| vehicle.start_mission(cx, &command(MavCmd::MISSION_START, [0.0; 4]), first, last));
        self.collect_texts();
        result
    }

    /// Handles MISSION_SET_CURRENT, as passed on by the stack.
    pub fn set_current(&mut self, seq: u16, reset: bool) -> MavResult {
        let result = self.hook(|vehicle, cx| vehicle.set_current(cx, seq, reset));
        self.collect_texts();
        result
    }

    /// Uploads a mission.
    pub fn upload(&mut self, items: &[Item]) {
        self.change(PlanType::Mission, items, 0).unwrap();
    }

    /// Replaces a plan as the stack does after an upload that has passed the stack's own checks.
    pub fn change(&mut self, plan: PlanType, items: &[Item], first: u16) -> Result<(), PlanFault> {
        for (seq, item) in items.iter().enumerate() {
            self.hook(|vehicle, cx| vehicle.check_item(cx, plan, seq as u16, item))?;
        }
        let checked = self.hook(|vehicle, cx| vehicle.check_plan(cx, plan, items));
        self.collect_texts();
        checked?;
        self.go_live(plan, items);
        self.hook(|vehicle, cx| {
            let items = cx.plan(plan).items();
            vehicle.plan_changed(cx, PlanChange { plan, items, first });
        });
        Ok(())
    }

    /// Makes a plan live without the hooks that check it and report it.
    pub fn go_live(&mut self, plan: PlanType, items: &[Item]) {
        let (now, mut another) = (self.now(), Quadrotor::new());
        self.stack.load_plan(now, plan, items.iter().copied(), &mut another).unwrap();
    }

    /// Calls a hook of the vehicle, as the stack does.
    fn hook<R>(&mut self, call: impl FnOnce(&mut Quadrotor, &mut Context<'_>) -> R) -> R {
        let Self { stack, vehicle, millis, .. } = self;
        stack.with_context(Instant::from_millis(*millis), |cx| call(vehicle, cx))
    }

    fn now(&self) -> Instant {
        Instant::from_millis(self.millis)
    }

    pub fn height(&self) -> f32 {
        -self.vehicle.local_position().down
    }

    pub fn mission(&self) -> (u16, MissionState) {
        let progress = self.vehicle.progress();
        assert_eq!(progress.in_mission_mode, self.vehicle.mode() == Mode::Mission);
        (progress.current, progress.state)
    }

    /// Returns the horizontal distance from a point (m).
    pub fn distance(&self, north: f32, east: f32) -> f32 {
        self.vehicle.local_position().distance(Vector { north, east, down: 0.0 })
    }

    /// Returns the horizontal speed (m/s).
    pub fn speed(&self) -> f32 {
        let Vector { north, east, .. } = self.vehicle.velocity();
        north.hypot(east)
    }

    /// Returns the heading, 0 to 360 degrees.
    pub fn heading(&self) -> f32 {
        let [_, _, yaw] = self.vehicle.attitude();
        yaw.to_degrees().rem_euclid(360.0)
    }

    /// Takes the items reached since the last call.
    pub fn reached(&mut self) -> Vec<u16> {
        core::mem::take(&mut self.reached)
    }

    /// Takes the texts sent since the last call.
    pub fn texts(&mut self) -> Vec<String> {
        core::mem::take(&mut self.texts)
    }

    /// Collects the texts and reached items that were sent.
    fn collect_texts(&mut self) {
        let before = self.texts.len();
        self.hear();
        if self.texts.len() > before {
            // The stack drops a text that it still has from the last five seconds. Other texts evict it, so that every text of the
            // vehicle is sent.
            let (now, said) = (self.now(), self.texts.len());
            for text in ["one", "two", "three", "four"] {
                self.stack.text(now, MavSeverity::DEBUG, text);
            }
            self.hear();
            assert_eq!(self.texts.len(), said + TEXTS);
            self.texts.truncate(said);
        }
    }

    fn hear(&mut self) {
        loop {
            let now = self.now();
            let bytes = self.stack.transmit(now, LINK, &mut self.vehicle).to_vec();
            if bytes.is_empty() {
                return;
            }
            self.stack.transmitted(LINK, bytes.len());
            assert_eq!(self.decoder.push(&bytes, now), bytes.len());
            while let Some(frame) = self.decoder.next(now, Common::MESSAGES, &mut u32::MAX.clone(), |_| true) {
                if let Some(MissionItemReached { seq }) = frame.decode() {
                    self.reached.push(seq);
                }
                if let Some(Statustext { text, id, .. }) = frame.decode() {
                    assert_eq!(id, 0, "a long text: {text:?}");
                    self.texts.push(text.as_str().unwrap().to_owned());
                }
            }
        }
    }
}

pub fn command(id: MavCmd, params: [f32; 4]) -> Command {
    Command {
        id,
        params,
        position: CommandPosition::Long { param5: 0.0, param6: 0.0 },
        z: 0.0,
        from: STATION,
        trust: mavstack::Trust::Open,
        class: LinkClass::Normal,
        age: None,
        component: ComponentId::new(1),
        is_broadcast: false,
        confirmation: 0,
    }
}

/// Returns an item at a position relative to home (m).
pub fn at(command: MavCmd, params: [f32; 4], north: f32, east: f32, z: f32) -> Item {
    // 1e-7 degrees of a great circle are 11.132 mm; longitude is scaled by the cosine of the latitude.
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

/// Returns a waypoint at 10 m, without a delay.
pub fn waypoint(north: f32, east: f32) -> Item {
    at(MavCmd::NAV_WAYPOINT, [0.0, 0.0, 0.0, f32::NAN], north, east, 10.0)
}

/// Returns an item without a position.
pub fn act(command: MavCmd, params: [f32; 4]) -> Item {
    Item { frame: MavFrame::MISSION, command, autocontinue: 1, params, x: 0, y: 0, z: 0.0 }
}

pub fn jump(target: u16, repeat: f32) -> Item {
    act(MavCmd::DO_JUMP, [f32::from(target), repeat, 0.0, 0.0])
}
