//! The body of the main loop: what a firmware with mavstack looks like.

use core::ops::DerefMut;

use embedded_io::{Read, ReadReady, Write, WriteReady};
use embedded_storage::nor_flash::NorFlash;
use mavstack::camera::{CameraControl, Image};
use mavstack::clock::Time;
use mavstack::config::{Identity, LinkClass, PollBudget, StreamProfile, VehicleAddress};
use mavstack::dialect::MavProtocolCapability;
use mavstack::ext_parameters::ExtParamServer;
use mavstack::gimbal::{DeviceService, ManagerService};
use mavstack::high_latency::HighLatency;
use mavstack::logs::LogStreamer;
use mavstack::network::LinkError;
use mavstack::setpoints::Setpoints;
use mavstack::signing::LinkSigning;
use mavstack::storage::{JobSlot, RestoreErrors, Store};
use mavstack::{Address, Config, Duration, Instant, LinkConfig, LinkId, Pulse, StackOf, Vehicle};
use mavstack_traffic::Traffic;

use crate::logs::LogMemory;
use crate::status::Status;
use crate::tuning::Tuning;
use crate::vehicle::{Quadrotor, SATELLITE_CONFIG};

/// The link to the ground station.
pub const TELEMETRY: LinkId = LinkId(0);
/// The link to a companion computer.
pub const COMPANION: LinkId = LinkId(1);
/// The link to a satellite modem: slow and expensive.
pub const SATELLITE: LinkId = LinkId(2);
/// The number of serial ports: one for each of the links above.
pub const PORTS: usize = 3;
/// With a network, the first of the links for further ground stations.
#[cfg(feature = "network")]
const FIRST_STATION: u8 = PORTS as u8;
/// The links of the ground stations on a network. The first is [`TELEMETRY`], whose UART is then unused.
#[cfg(feature = "network")]
pub const STATIONS: [LinkId; 4] =
    [TELEMETRY, LinkId(FIRST_STATION), LinkId(FIRST_STATION + 1), LinkId(FIRST_STATION + 2)];
/// The number of links.
pub const LINKS: usize = PORTS + if cfg!(feature = "network") { 3 } else { 0 };

/// Maximum number of mission items, at 32 bytes each. A microcontroller has less memory for plans than a host.
pub const MISSION: usize = if cfg!(target_os = "none") { 250 } else { 1000 };
/// Maximum number of geofence items.
pub const FENCE: usize = if cfg!(target_os = "none") { 64 } else { 256 };
/// Maximum number of rally points.
pub const RALLY: usize = if cfg!(target_os = "none") { 16 } else { 64 };

/// The MAVLink services of the vehicle.
///
/// It is too large for the call stack. A firmware keeps [`VACANT`](mavstack::Stack::VACANT) in a `static`, which takes no flash, and
/// [`App::new`] begins it there.
#[derive(mavstack::Stack)]
#[stack(
    vehicle: Quadrotor,
    links: LINKS,
    plans: { mission: MISSION, fence: FENCE, rally: RALLY },
    parameters: Tuning,
    streams,
    messages,
    command_client: { slots: 2 },
    modes,
    commands: { slots: 4 },
    components,
    files: { sessions: 2, upload: 1024 },
    events: { history: 24, checks },
    logs,
    forwarding: { bytes: 512, seen: 256 },
    signing: { streams: 16 },
    manual_control,
    operator_control,
    storage,
)]
pub struct Mavlink {
    /// PING and TIMESYNC.
    pub time: Time,
    /// Setpoints of a companion computer.
    pub setpoints: Setpoints,
    /// The camera, which remembers 16 images.
    pub camera: CameraControl<[Image; 16]>,
    /// The settings of the camera.
    pub ext_parameters: ExtParamServer,
    /// The gimbal of the camera, and who controls it.
    pub gimbal_manager: ManagerService,
    /// The gimbal's own part.
    pub gimbal_device: DeviceService,
    /// The running log, streamed.
    pub log_streaming: LogStreamer,
    /// The satellite link.
    pub high_latency: HighLatency,
    /// The aircraft around the vehicle.
    pub traffic: Traffic<8>,
}

/// The flight loop of a firmware ticks it; heartbeats stop when the ticks stop.
static PULSE: Pulse = Pulse::new();

const CONFIG: Config = Config { identity: IDENTITY, budget: BUDGET, ..Config::new(Address::new(1, COMPONENT), &PULSE) };

/// The budget of each link per poll. A network brings frames faster than the UARTs: up to 4 Mbit/s, at a poll each millisecond.
const BUDGET: PollBudget = if cfg!(feature = "network") {
    PollBudget::for_link(4_000_000, Duration::from_millis(1))
} else {
    PollBudget::DEFAULT
};

/// The vehicle's component id. Its system id is a parameter.
const COMPONENT: u8 = 1;

/// Longitude between the start positions of neighbours in a fleet (deg·1e7): ten metres.
const SPACING: i32 = 1_328;

/// The version of this crate, and the ids of the vehicle with system id 1.
const IDENTITY: Identity = Identity {
    flight_sw_version: mavstack::firmware_version!(),
    board_version: 1,
    uid: 0x6D61_7673_7461_636B,
    uid2: *b"mavstack demo 0001",
    capabilities: MavProtocolCapability::SET_POSITION_TARGET_LOCAL_NED
        .with(MavProtocolCapability::SET_POSITION_TARGET_GLOBAL_INT),
    ..Identity::NONE
};

/// Once a signing key is set, frames must be signed on both radio links. The companion link stays open to unsigned frames,
/// and only it accepts a key. Components of the vehicle are believed there: the companion, a gimbal.
const LINK_CONFIGS: [LinkConfig; LINKS] = [
    TELEMETRY_CONFIG,
    LinkConfig::uart(921_600)
        .with_streams(StreamProfile::Onboard)
        .with_own_system(true)
        .with_signing(LinkSigning::OPEN.with_provisioning()),
    // MAVLink 1 would save one credit per report. But it cannot carry MAVLink 2 frames of other components, or signatures.
    LinkConfig::uart(2_400).with_class(LinkClass::HighLatency).with_signing(LinkSigning::SIGNED),
    #[cfg(feature = "network")]
    TELEMETRY_CONFIG,
    #[cfg(feature = "network")]
    TELEMETRY_CONFIG,
    #[cfg(feature = "network")]
    TELEMETRY_CONFIG,
];

/// On a network, each station may have 100 kB/s. That bounds the cost of lists and transfers; the network could carry more.
const TELEMETRY_CONFIG: LinkConfig =
    LinkConfig::uart(if cfg!(feature = "network") { 1_000_000 } else { 115_200 }).with_signing(LinkSigning::SIGNED);

/// The vehicle and its stack, to which `S` points.
#[derive(Debug)]
pub struct App<S = &'static mut StackOf<Mavlink>> {
    stack: S,
    vehicle: Quadrotor,
    /// The flight loop ticks it; heartbeats stop when the ticks stop.
    pulse: &'static Pulse,
    saving: Saving,
    /// When to log the status next.
    #[cfg(feature = "defmt")]
    status_due: Instant,
}

/// How far parameters have been written before a reboot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Saving {
    NoStorage,
    /// No reboot was requested.
    Idle,
    Busy,
    Done,
}

impl<S: DerefMut<Target = StackOf<Mavlink>>> App<S> {
    /// Creates the vehicle of a firmware, which boots at [`Instant::ZERO`], with a stack that is not begun. Create one per
    /// program: it uses a pulse in a `static`.
    pub fn new(stack: S) -> Self {
        Self::begin(stack, CONFIG, &PULSE)
    }

    /// Creates a vehicle of a fleet in one program: with the pulse of its flight loop, and a system id from 1 to 254. Hardware id and
    /// start position follow from the system id. What [`restore`](Self::restore) finds replaces the system id and the position.
    pub fn in_fleet(stack: S, pulse: &'static Pulse, system: u8) -> Self {
        let others = system.saturating_sub(1);
        let mut identity = Identity { uid: IDENTITY.uid.wrapping_add(others.into()), ..IDENTITY };
        let [.., last] = &mut identity.uid2;
        *last = last.wrapping_add(others);
        let address = VehicleAddress::new(Address::new(system, COMPONENT)).unwrap_or(CONFIG.address);
        let mut app = Self::begin(stack, Config { identity, address, pulse: Some(pulse), ..CONFIG }, pulse);
        let parameters = app.stack.parameters_mut();
        let start = parameters.get(Tuning::SIH_LOC_LON0).saturating_add(i32::from(others).saturating_mul(SPACING));
        parameters.set(Tuning::SIH_LOC_LON0, start);
        app.set_system(system);
        app
    }

    /// Sets the system id, from 1 to 254, in place of the one that [`restore`](Self::restore) has found. It is stored when a ground
    /// station changes a parameter. Call it before the vehicle communicates.
    pub fn set_system(&mut self, system: u8) {
        self.stack.parameters_mut().set(Tuning::MAV_SYS_ID, system.into());
        self.take_address();
    }

    /// Leaves out the camera and the gimbal until the next boot. Plans with items for them are then refused. Call it before
    /// [`restore`](Self::restore).
    pub fn leave_out_components(&mut self) {
        self.stack.leave_out_components();
        self.vehicle.leave_out_components();
    }

    /// Returns the system id of the parameter, which takes effect at the next boot.
    pub fn next_system(&self) -> Option<u8> {
        u8::try_from(self.stack.parameters().get(Tuning::MAV_SYS_ID)).ok()
    }

    fn begin(mut stack: S, config: Config, pulse: &'static Pulse) -> Self {
        stack.begin(config, LINK_CONFIGS);
        stack.high_latency.set_config(SATELLITE_CONFIG);
        Self {
            stack,
            vehicle: Quadrotor::new(),
            pulse,
            saving: Saving::NoStorage,
            #[cfg(feature = "defmt")]
            status_due: Instant::ZERO,
        }
    }

    /// Takes the system id of the parameter.
    fn take_address(&mut self) {
        if let Some(address) = self.next_system().and_then(|id| VehicleAddress::new(Address::new(id, COMPONENT))) {
            self.stack.set_address(address);
        }
    }

    /// Keeps flight logs in this memory, which may hold logs from before a reset. Call it once after boot; by default there are none.
    pub fn keep_logs(&mut self, memory: &'static LogMemory) {
        self.vehicle.keep_logs(memory);
    }

    /// Runs one pass of a single-loop firmware: [`fly`](Self::fly), then [`poll`](Self::poll). Call
    /// [`serve`](Self::serve) for each link afterwards.
    pub fn control(&mut self, now: Instant) {
        self.fly(now);
        self.poll(now);
    }

    /// Runs one pass of the flight loop. Returns true when the stack has something new to send: wake the task that
    /// transmits.
    // This, `poll` and `serve` are not inlined: a loop that inlines all three needs the sum of their stack frames.
    #[inline(never)]
    pub fn fly(&mut self, now: Instant) -> bool {
        let Self { stack, vehicle, .. } = self;
        let before = vehicle.state();
        vehicle.take_sticks(now, stack);
        vehicle.take_setpoint(now, stack);
        stack.with_context(now, |cx| vehicle.control_step(cx));
        self.pulse.tick();
        vehicle.report_calibration(stack.long_commands_mut());
        vehicle.report_arming(stack.long_commands_mut());
        vehicle.watch_payload(now, stack);
        vehicle.carry_out_gimbal_item(now, stack);
        vehicle.report_camera(stack);
        vehicle.store_counts(stack.parameters_mut());
        vehicle.watch_satellite(stack);
        vehicle.record(now, stack);
        vehicle.state() != before || self.has_something_due(now)
    }

    /// Not inlined: the flight loop above has the deepest call stack.
    #[inline(never)]
    fn has_something_due(&self, now: Instant) -> bool {
        self.stack.next_deadline(now) <= now
    }

    /// Runs the stack's timers, which belong to no link; see [`Stack::poll`](mavstack::Stack::poll).
    #[inline(never)]
    pub fn poll(&mut self, now: Instant) {
        if self.vehicle.is_rebooting() && self.saving == Saving::Idle {
            self.saving = Saving::Busy;
            self.stack.save_parameters(now);
        }
        self.stack.poll(now, &mut self.vehicle);
        #[cfg(feature = "defmt")]
        if now >= self.status_due {
            self.status_due = now + Duration::from_secs(1);
            self.status(now).log();
        }
    }

    /// Returns a summary of the vehicle's state.
    pub fn status(&self, now: Instant) -> Status {
        Status::of(now, &self.stack, &self.vehicle)
    }

    /// Whether to simulate a hung flight loop ([`Tuning::SIM_HANG`]), which shows how everything else behaves then. The
    /// caller of [`fly`](Self::fly) must stop in the way that its own loop would hang.
    pub fn simulates_hang(&self) -> bool {
        self.stack.parameters().get(Tuning::SIM_HANG) != 0
    }

    /// Whether to reset the processor now: a reboot was requested, its acknowledgement was sent, and changed parameters
    /// are stored (C-30).
    pub fn wants_reboot(&self) -> bool {
        self.saving != Saving::Busy && self.vehicle.wants_reboot(|link| self.stack.has_answered(link))
    }

    /// Restores the signing key, the parameters and the plans from storage; see
    /// [`Stack::restore`](mavstack::Stack::restore). Call it once after boot and before anything else, because some
    /// parameters take effect only at boot.
    ///
    /// # Errors
    ///
    /// Something that is stored is damaged or cannot be read. A STATUSTEXT reports it too. The vehicle then has default
    /// parameters and no plans, or older ones. Without its key, links that require signatures stay closed.
    pub fn restore<F: NorFlash>(&mut self, now: Instant, store: &mut Store<F>) -> Result<(), RestoreErrors> {
        let result = self.stack.restore(now, store, &mut self.vehicle);
        self.saving = Saving::Idle;
        result
    }

    /// Writes one step of what has changed to storage; see [`Stack::persist`](mavstack::Stack::persist). Returns true when
    /// more work is pending.
    pub fn persist<F: NorFlash>(&mut self, now: Instant, store: &mut Store<F>) -> bool {
        let is_busy = self.stack.persist(now, store, &mut self.vehicle);
        self.note_saving(is_busy);
        is_busy
    }

    /// Takes the result of the storage job in the slot, and puts the next one in; see
    /// [`Stack::exchange_job`](mavstack::Stack::exchange_job). Returns true when the slot has a job. For a task that runs the
    /// jobs while other tasks use the vehicle.
    pub fn exchange_job(&mut self, now: Instant, slot: &mut JobSlot) -> bool {
        let has_job = self.stack.exchange_job(now, slot, &mut self.vehicle);
        self.note_saving(has_job);
        has_job
    }

    fn note_saving(&mut self, is_busy: bool) {
        if !is_busy && self.saving == Saving::Busy {
            self.saving = Saving::Done;
        }
    }

    /// Moves bytes between a link and its transport. Never blocks.
    ///
    /// # Errors
    ///
    /// See [`Stack::poll_link`](mavstack::Stack::poll_link).
    #[inline(never)]
    pub fn serve<U: Read + Write + ReadReady + WriteReady>(
        &mut self,
        now: Instant,
        link: LinkId,
        uart: &mut U,
    ) -> Result<(), LinkError<U::Error>> {
        self.stack.poll_link(now, link, uart, &mut self.vehicle)
    }

    /// Sets the time of day from a battery-backed real-time clock: `unix_usec` µs since 1970 (UTC) at `now`.
    ///
    /// Signature timestamps follow this clock (G-4). They do not follow GPS time, which can be spoofed, or the time in unsigned
    /// messages. A signed message with a later timestamp moves them forward (G-6, G-14).
    pub fn set_calendar(&mut self, now: Instant, unix_usec: u64) {
        self.vehicle.set_calendar(now, unix_usec);
        self.stack.signing_mut().set_time(now, unix_usec, Duration::MAX);
    }

    /// Returns the stack and the vehicle, for transports that need more than [`serve`](Self::serve).
    pub fn parts(&mut self) -> (&mut StackOf<Mavlink>, &mut Quadrotor) {
        (&mut self.stack, &mut self.vehicle)
    }

    /// Returns the stack, for another vehicle after a reboot.
    pub fn into_stack(self) -> S {
        self.stack
    }

    /// Returns the stack.
    pub fn stack(&self) -> &StackOf<Mavlink> {
        &self.stack
    }

    /// Returns the vehicle.
    pub fn vehicle(&self) -> &Quadrotor {
        &self.vehicle
    }
}
