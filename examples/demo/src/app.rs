//! The loop's body: what a firmware with mavstack looks like.

use embedded_io::{Read, ReadReady, Write, WriteReady};
use embedded_storage::nor_flash::NorFlash;
#[cfg(feature = "defmt")]
use mavstack::Duration;
use mavstack::dialect::HomePosition;
use mavstack::{
    Address, Config, Durability, Identity, Instant, LinkClass, LinkConfig, LinkError, LinkId, LinkSigning, ParamStore,
    PlanStorage, PlanStore, Pulse, RestoreError, SigningStore, Stack, StreamProfile, Vehicle, VehicleAddress,
};

use crate::status::Status;
use crate::tuning::Tuning;
use crate::vehicle::Quadrotor;

/// The link to the ground station.
pub const TELEMETRY: LinkId = LinkId(0);
/// The link to a companion computer.
pub const COMPANION: LinkId = LinkId(1);
/// The link to a satellite modem: slow and dear.
pub const SATELLITE: LinkId = LinkId(2);
/// How many links there are.
pub const LINKS: usize = 3;

/// Ticked by the flight loop.
static PULSE: Pulse = Pulse::new();

const CONFIG: Config = Config { identity: IDENTITY, ..Config::new(Address::new(1, COMPONENT), &PULSE) };

/// The vehicle's component id; its system id is a parameter.
const COMPONENT: u8 = 1;

/// Version 0.1.0, in development, of the only vehicle of its kind.
const IDENTITY: Identity = Identity {
    flight_sw_version: 0x0001_0000,
    board_version: 1,
    uid: 0x6D61_7673_7461_636B,
    uid2: *b"mavstack demo 0001",
    ..Identity::NONE
};

/// Once there is a key, whoever speaks over the air has to sign. The key comes by the companion's wire, which stays open.
const LINK_CONFIGS: [LinkConfig; LINKS] = [
    LinkConfig::uart(115_200).with_signing(LinkSigning::SIGNED),
    LinkConfig::uart(921_600).with_streams(StreamProfile::Onboard).with_signing(LinkSigning::OPEN.with_provisioning()),
    // In MAVLink 1 a report would cost a credit less; but then answers of others, in MAVLink 2, could not go that way, and
    // nothing would be signed.
    LinkConfig::uart(2_400).with_class(LinkClass::HighLatency).with_signing(LinkSigning::SIGNED),
];

/// The vehicle and its stack, with plans in a memory of type `P`. There is one in a program: they would share the pulse.
#[derive(Debug)]
pub struct App<P: PlanStorage> {
    stack: Stack<LINKS, P>,
    vehicle: Quadrotor,
    saving: Saving,
    /// When the status is to be logged next.
    #[cfg(feature = "defmt")]
    status_due: Instant,
}

/// Whether parameters are being written before it restarts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Saving {
    /// There is no storage.
    Never,
    /// It does not restart.
    No,
    Busy,
    Done,
}

impl<P: PlanStorage> App<P> {
    /// Switched on at [`Instant::ZERO`].
    pub const fn new() -> Self {
        Self {
            stack: Stack::new(CONFIG, LINK_CONFIGS),
            vehicle: Quadrotor::new(),
            saving: Saving::Never,
            #[cfg(feature = "defmt")]
            status_due: Instant::ZERO,
        }
    }

    /// One pass of the loop, where there is only one: [`fly`](Self::fly) and [`poll`](Self::poll); to be followed by
    /// [`serve`](Self::serve) for each link.
    pub fn control(&mut self, now: Instant) {
        self.fly(now);
        self.poll(now);
    }

    /// One pass of the flight loop. True when it left something to tell: who speaks for it and sleeps is to be woken.
    // Neither this nor `poll` and `serve` is inlined: a loop with all of them in it would take their stack together.
    #[inline(never)]
    pub fn fly(&mut self, now: Instant) -> bool {
        let before = self.vehicle.state();
        let (mission, fence, rally) = (self.stack.mission(), self.stack.fence(), self.stack.rally());
        self.vehicle.control_step(now, mission.items(), fence.items(), rally.items());
        PULSE.tick();
        let mut has_news = self.vehicle.state() != before;
        while let Some(seq) = self.vehicle.take_reached() {
            self.stack.mission_item_reached(now, seq);
            has_news = true;
        }
        while let Some((severity, text)) = self.vehicle.take_text() {
            self.stack.send_text(now, severity, text);
            has_news = true;
        }
        if self.vehicle.take_new_home() {
            self.stack.announce::<HomePosition, Quadrotor>();
            has_news = true;
        }
        has_news
    }

    /// What of the stack's work belongs to no link; as [`Stack::poll`].
    #[inline(never)]
    pub fn poll(&mut self, now: Instant) {
        if self.vehicle.is_going_down() && self.saving == Saving::No {
            self.saving = Saving::Busy;
            self.stack.save_parameters(now, &mut self.vehicle);
        }
        self.stack.poll(now, &mut self.vehicle);
        #[cfg(feature = "defmt")]
        if now >= self.status_due {
            self.status_due = now.after(Duration::from_secs(1));
            self.status(now).log();
        }
    }

    /// The vehicle at a glance.
    pub fn status(&self, now: Instant) -> Status {
        Status::of(now, &self.stack, &self.vehicle)
    }

    /// Whether the flight loop is to stand still from here on, for good: [`Tuning::SIM_HANG`], for a look at what becomes of
    /// everything else. Whoever flies sees to it, in the way that he would hang.
    pub fn hangs(&self) -> bool {
        self.vehicle.tuning().get(Tuning::SIM_HANG) != 0
    }

    /// Whether the processor is to be reset now: somebody asked for it, has his answer, and parameters that he set are
    /// stored (C-30).
    pub fn wants_reboot(&self) -> bool {
        self.saving != Saving::Busy && self.vehicle.wants_reboot(|link| self.stack.has_answered(link))
    }

    /// Reads the plans back, once after a start; as [`Stack::restore_plans`].
    ///
    /// # Errors
    ///
    /// What is stored is damaged, or could not be read; a text says so too.
    pub fn restore<F: NorFlash>(
        &mut self,
        now: Instant,
        store: &mut PlanStore<F>,
        durability: Durability,
    ) -> Result<(), RestoreError<F::Error>> {
        self.stack.restore_plans(now, store, durability, &mut self.vehicle)
    }

    /// Writes plans that are to be durable, a step at a time; as [`Stack::persist_plans`]. True when there is more to do at once.
    pub fn persist<F: NorFlash>(&mut self, now: Instant, store: &mut PlanStore<F>) -> bool {
        self.stack.persist_plans(now, store, &mut self.vehicle)
    }

    /// Reads the parameters back, once after a start and before everything else, for some have their effect only then; as
    /// [`Stack::restore_parameters`].
    ///
    /// # Errors
    ///
    /// What is stored is damaged, or could not be read; a text says so too.
    pub fn restore_parameters<F: NorFlash>(
        &mut self,
        now: Instant,
        store: &mut ParamStore<F>,
    ) -> Result<(), RestoreError<F::Error>> {
        let result = self.stack.restore_parameters(now, store, &mut self.vehicle);
        self.saving = Saving::No;
        let id = u8::try_from(self.vehicle.tuning().get(Tuning::MAV_SYS_ID));
        if let Some(address) = id.ok().and_then(|id| VehicleAddress::new(Address::new(id, COMPONENT))) {
            self.stack.set_address(address);
        }
        result
    }

    /// Writes parameters that have changed, a step at a time; as [`Stack::persist_parameters`]. True when there is more to do
    /// at once.
    pub fn persist_parameters<F: NorFlash>(&mut self, now: Instant, store: &mut ParamStore<F>) -> bool {
        let is_busy = self.stack.persist_parameters(now, store, &mut self.vehicle);
        if !is_busy && self.saving == Saving::Busy {
            self.saving = Saving::Done;
        }
        is_busy
    }

    /// Reads the signing key back, once after a start; as [`Stack::restore_signing`].
    ///
    /// # Errors
    ///
    /// What is stored is damaged, or could not be read; a text says so too.
    pub fn restore_signing<F: NorFlash>(
        &mut self,
        now: Instant,
        store: &mut SigningStore<F>,
    ) -> Result<(), RestoreError<F::Error>> {
        self.stack.restore_signing(now, store, &mut self.vehicle)
    }

    /// Writes the signing key and its time, a step at a time; as [`Stack::persist_signing`]. True when there is more to do at
    /// once.
    pub fn persist_signing<F: NorFlash>(&mut self, now: Instant, store: &mut SigningStore<F>) -> bool {
        self.stack.persist_signing(now, store, &mut self.vehicle)
    }

    /// Moves bytes between a link and its transport; never waits.
    ///
    /// # Errors
    ///
    /// As [`Stack::poll_link`].
    #[inline(never)]
    pub fn serve<U: Read + Write + ReadReady + WriteReady>(
        &mut self,
        now: Instant,
        link: LinkId,
        uart: &mut U,
    ) -> Result<(), LinkError<U::Error>> {
        self.stack.poll_link(now, link, uart, &mut self.vehicle)
    }

    /// The stack and the vehicle, for transports that need more than [`serve`](Self::serve).
    pub fn parts(&mut self) -> (&mut Stack<LINKS, P>, &mut Quadrotor) {
        (&mut self.stack, &mut self.vehicle)
    }

    /// The vehicle.
    pub fn vehicle(&self) -> &Quadrotor {
        &self.vehicle
    }
}

impl<P: PlanStorage> Default for App<P> {
    fn default() -> Self {
        Self::new()
    }
}
