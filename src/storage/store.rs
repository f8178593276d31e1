//! The store: one region of the storage, with a [record](super::record) for each kind of content.

use core::ops::Range;

use embedded_storage::nor_flash::NorFlash;

use super::record::{CHUNK, Format, Job, ROW, Record, RestoreError, Step, wipe};
use crate::dialect::{MavModeFlag, MavSeverity};
use crate::service::mission::WithoutPlans;
use crate::service::{Absent, Cx, Service, WithoutSigning};
use crate::time::Instant;
use crate::types::{Firmware, Vehicle};

/// The number of kinds.
pub(crate) const KINDS: usize = 3;

/// A region of the storage, for everything that a firmware stores: the signing key, the parameters, and the plans.
///
/// The storage is a [`NorFlash`] with a `WRITE_SIZE` that divides 256 and a `READ_SIZE` that divides 32.
/// [`Stack::restore`](crate::Stack::restore) reads all of it, and [`Stack::persist`](crate::Stack::persist) writes in
/// steps of at most one erase unit or 256 bytes.
///
/// ```
/// # use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
/// # use mavstack::*;
/// use mavstack::storage::Store;
///
/// # struct Flash;
/// # impl ErrorType for Flash { type Error = NorFlashErrorKind; }
/// # impl ReadNorFlash for Flash {
/// #     const READ_SIZE: usize = 1;
/// #     fn read(&mut self, _: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> { bytes.fill(0xFF); Ok(()) }
/// #     fn capacity(&self) -> usize { 65_536 }
/// # }
/// # impl NorFlash for Flash {
/// #     const WRITE_SIZE: usize = 8;
/// #     const ERASE_SIZE: usize = 2_048;
/// #     fn erase(&mut self, _: u32, _: u32) -> Result<(), NorFlashErrorKind> { Ok(()) }
/// #     fn write(&mut self, _: u32, _: &[u8]) -> Result<(), NorFlashErrorKind> { Ok(()) }
/// # }
/// # struct Rover;
/// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
/// # impl Commands for Rover {
/// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
/// #         mavstack::dialect::MavResult::UNSUPPORTED.into()
/// #     }
/// # }
/// # impl Parameters for Rover { type Table = Tuning; }
/// # parameters! { pub struct Tuning { CRUISE: f32 = 5.0, 0.5..=15.0, "m/s"; } }
/// # static PULSE: Pulse = Pulse::new();
/// # let now = Instant::ZERO;
/// # let (mut rover, is_running) = (Rover, false);
/// # let mut stack = Mavlink::new(Config::new(Address::new(1, 1), &PULSE), [LinkConfig::uart(57_600)]);
/// stack! {
///     struct Mavlink for Rover { links: 1, parameters: Tuning }
/// }
///
/// const START: u32 = 0x8000;
/// const LEN: u32 = Store::<Flash>::region_len::<Mavlink>();
/// const _: () = assert!(LEN == 2 * 2_048);
///
/// let mut store = Store::new(Flash, START..START + LEN);
/// if let Err(errors) = stack.restore(now, &mut store, &mut rover) {
///     // What could not be read; a text has reported it.
///     assert!(errors.parameters.is_some());
/// }
/// while is_running {
///     // … fly, and poll the stack
///     stack.persist(now, &mut store, &mut rover);
/// }
/// ```
///
/// # Plans
///
/// The three plans are one record, so that they are replaced together. If power fails at any step, either the old or the
/// new plans are complete:
///
/// ```text
///                 older record, or torn ── erased in advance, header first ──▶ erased
///   spare slot:      ▲                                                           │ there are plans to store
///                    │                                                           ▼
///                 the new record is valid, ◀── header ── read back ◀── body, 256 bytes per step
///                 and the other slot is the spare
/// ```
///
/// [`Config::durability`](crate::Config::durability) determines when an upload is acknowledged and goes live.
///
/// # Parameters
///
/// They are written about a second after a change, and at most every ten seconds (SEC-12). In the long run they are
/// written at most once every [`storage_refill`](crate::Config::storage_refill) (C-15).
///
/// ```text
///            a value changes           after 1 s, and 10 s after the last write     complete
///   stored ──────────────────▶ changed ─────────────────────────────────────▶ writing ─────▶ stored
///                                 ▲       PREFLIGHT_STORAGE: immediately         │
///                                 └─── failed: text, and a retry after 10 s ─────┘
/// ```
///
/// A value that changes while it is written may or may not be in the record; the parameters are then written again.
///
/// # Key
///
/// The signing key and its timestamp are one record, so they always belong together (G-13). It is written when the key
/// was changed, and every 55 s while there is one. Each of its slots is erased every 110 s. FRAM endures that, but flash
/// rated for 10,000 cycles lasts twelve days of powered and disarmed time. Peers can hardly increase this rate: see
/// [`storage_refill`](crate::Config::storage_refill).
///
/// The key is stored unencrypted.
///
#[doc = include_str!("layout.md")]
#[doc = ""]
#[doc = include_str!("params.md")]
#[doc = ""]
#[doc = include_str!("signing.md")]
pub struct Store<F> {
    pub(crate) flash: F,
    region: Range<u32>,
    pub(crate) records: [Record; KINDS],
    /// The kind whose turn it is.
    pub(crate) turn: usize,
    /// Number of steps in this turn.
    steps: u8,
}

/// Omits the storage, whose `Debug` may show the key (SEC-15).
impl<F> core::fmt::Debug for Store<F> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("Store")
    }
}

#[cfg(feature = "defmt")]
impl<F> defmt::Format for Store<F> {
    fn format(&self, f: defmt::Formatter<'_>) {
        defmt::write!(f, "Store");
    }
}

impl<F: NorFlash> Store<F> {
    /// Returns a store in this region of the storage, which must begin at an erase unit and have
    /// [`region_len`](Self::region_len) bytes. Content that does not fit a shorter region is not stored, which a text
    /// reports. Reads nothing yet.
    pub const fn new(flash: F, region: Range<u32>) -> Self {
        Self { flash, region, records: [const { Record::NONE }; KINDS], turn: 0, steps: 0 }
    }

    /// Returns the storage.
    pub const fn flash(&self) -> &F {
        &self.flash
    }

    /// Returns the storage. Do not write to the store's region: that may damage what is stored.
    pub const fn flash_mut(&mut self) -> &mut F {
        &mut self.flash
    }

    /// Returns the storage and drops the store.
    pub fn into_inner(self) -> F {
        self.flash
    }

    /// Ends the turn of a kind that did `step`, unless it has more to do. Even then it ends after some steps: content
    /// that changes all the time must not keep the others waiting.
    pub(crate) const fn took_turn(&mut self, step: Step) {
        self.steps = self.steps.wrapping_add(1);
        if !matches!(step, Step::Busy) || self.steps == 0 {
            self.steps = 0;
            self.turn = if self.turn < KINDS - 1 { self.turn.saturating_add(1) } else { 0 };
        }
    }

    /// Divides the region among the records of the kinds: their formats, and the longest bodies.
    #[inline(never)]
    pub(crate) fn divide(&mut self, kinds: [(Format, u32); KINDS]) {
        let Range { mut start, end } = self.region;
        for (record, (format, max_len)) in self.records.iter_mut().zip(kinds) {
            let next = start.saturating_add(Record::region_len::<F>(max_len));
            *record = Record::new::<F>(start..next.min(end), format);
            start = next;
        }
    }
}

/// What was not restored, and why. A STATUSTEXT reports each, too. Everything else was restored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct RestoreErrors<E> {
    /// The signing key: links that need one stay closed (G-18).
    pub signing: Option<RestoreError<E>>,
    /// The parameters, which have their defaults.
    pub parameters: Option<RestoreError<E>>,
    /// The plans, which are empty. There may have been a geofence.
    pub plans: Option<RestoreError<E>>,
}

impl<E: core::fmt::Debug> core::fmt::Display for RestoreErrors<E> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self { signing, parameters, plans } = self;
        let mut separator = "";
        for (name, error) in [("signing key", signing), ("parameters", parameters), ("plans", plans)] {
            if let Some(error) = error {
                write!(f, "{separator}{name}: {error}")?;
                separator = "; ";
            }
        }
        Ok(())
    }
}

impl<E: core::fmt::Debug> core::error::Error for RestoreErrors<E> {}

/// The texts that report the state of stored content.
#[derive(Clone, Copy, Debug)]
pub struct Texts {
    pub(super) unreadable: &'static str,
    pub(super) damaged: &'static str,
    pub(super) readable: &'static str,
}

/// A service whose content is stored. One that stores nothing keeps the default methods.
pub trait Persistent<F: Firmware>: Service<F> {
    /// The format of its record.
    const FORMAT: Format = Format { kind: 0, schema: 0 };

    /// Maximum length of the record's body in bytes; 0 if nothing is stored.
    const MAX_LEN: u32 = 0;

    /// The texts that report its state.
    const TEXTS: Texts = Texts { unreadable: "", damaged: "", readable: "" };

    /// Takes the stored content: `found` is the result of `Body::open`. `is_late`: an earlier attempt to read it
    /// failed, so that content that has changed since is newer.
    ///
    /// # Errors
    ///
    /// The content is damaged or cannot be read.
    fn load<N: NorFlash>(
        &mut self,
        cx: &mut Cx<'_, F>,
        body: &mut Body<'_, N>,
        found: Found<N::Error>,
        is_late: bool,
    ) -> Result<(), RestoreError<N::Error>> {
        let _ = (cx, body, is_late);
        found.map(|_| ())
    }

    /// Whether the stored content is to be loaded again now.
    fn is_reload_requested(&self, cx: &mut Cx<'_, F>) -> bool {
        let _ = cx;
        false
    }

    /// Whether content that could not be read may be read and loaded now.
    fn may_load_late(&self, cx: &Cx<'_, F>) -> bool {
        let _ = cx;
        false
    }

    /// Whether storage is not to be used now.
    fn is_paused(&self, now: Instant) -> bool {
        let _ = now;
        false
    }

    /// Cancels a write that the vehicle no longer permits. Returns true if there was one.
    fn cancel_if_refused<'l>(&mut self, cx: &mut Cx<'_, F>, links: impl Iterator<Item = &'l mut Self::Link>) -> bool
    where
        Self::Link: 'l,
    {
        let _ = (cx, links);
        false
    }

    /// Returns the content to write now, if there is any.
    fn pending_write(&mut self, cx: &mut Cx<'_, F>) -> Option<Job> {
        let _ = cx;
        None
    }

    /// Returns a row of the content to write; `None` if it has fewer rows.
    fn row(&self, cx: &mut Cx<'_, F>, index: u32) -> Option<[u8; ROW]> {
        let _ = (cx, index);
        None
    }

    /// Called with the result of the pending write; also when erasing in advance has failed.
    fn on_written<'l>(&mut self, cx: &mut Cx<'_, F>, links: impl Iterator<Item = &'l mut Self::Link>, is_saved: bool)
    where
        Self::Link: 'l,
    {
        let _ = (cx, links, is_saved);
    }

    /// Called when content that could not be read is to be read again. Returns whether to [load](Self::load) it.
    fn on_readable<'l>(&mut self, cx: &mut Cx<'_, F>, links: impl Iterator<Item = &'l mut Self::Link>) -> bool
    where
        Self::Link: 'l,
    {
        let _ = (cx, links);
        true
    }
}

impl<F: Firmware> Persistent<F> for Absent {}
impl<F: Firmware> Persistent<F> for WithoutPlans {}
impl<F: Firmware> Persistent<F> for WithoutSigning {}

/// Whether the vehicle is known to be disarmed. Otherwise stored content must not replace what it flies with.
pub(super) fn is_disarmed(vehicle: &impl Vehicle) -> bool {
    vehicle.state().is_some_and(|state| !state.base_mode.contains(MavModeFlag::SAFETY_ARMED))
}

/// The length of the record's body, if there is one.
pub(super) type Found<E> = Result<Option<u32>, RestoreError<E>>;

/// A record that is read.
#[derive(Debug)]
pub struct Body<'a, N> {
    record: &'a mut Record,
    flash: &'a mut N,
}

impl<'a, N: NorFlash> Body<'a, N> {
    pub(crate) const fn new(record: &'a mut Record, flash: &'a mut N) -> Self {
        Self { record, flash }
    }

    /// Finds the newest record, and returns the length of its body; `None` if nothing is stored. Reads all of it.
    ///
    /// # Errors
    ///
    /// There is no whole record of this version, and the storage is not empty; or it cannot be read.
    #[inline(never)]
    pub(super) fn open(&mut self) -> Found<N::Error> {
        Ok(self.record.open(self.flash)?.map(|header| header.len))
    }

    /// Reads a row of the record that [`open`](Self::open) has found. Returns false if it has fewer rows.
    #[inline(never)]
    pub(super) fn row(&mut self, index: u32, row: &mut [u8; ROW]) -> Result<bool, N::Error> {
        self.record.row(self.flash, index, row)
    }

    /// Returns whether there is damage besides the record that was found.
    pub(super) const fn is_damaged(&self) -> bool {
        self.record.is_damaged()
    }

    /// Returns whether a slot could not be read.
    pub(super) const fn is_impaired(&self) -> bool {
        self.record.is_impaired()
    }
}

/// Reads the content of a service, and reports the result by a text.
#[inline(never)]
pub(crate) fn read<F: Firmware, S: Persistent<F>, N: NorFlash>(
    cx: &mut Cx<'_, F>,
    service: &mut S,
    body: &mut Body<'_, N>,
    is_late: bool,
) -> Result<(), RestoreError<N::Error>> {
    // The stack that finding needs is free again while the content is loaded.
    let found = if S::MAX_LEN > 0 { body.open() } else { Ok(None) };
    let result = service.load(cx, body, found, is_late);
    let (severity, text) = match result {
        Ok(()) if is_late => (MavSeverity::INFO, S::TEXTS.readable),
        Ok(()) => return result,
        Err(RestoreError::Storage(_)) if is_late => return result,
        Err(RestoreError::Storage(_)) => (MavSeverity::ERROR, S::TEXTS.unreadable),
        Err(_) => (MavSeverity::ERROR, S::TEXTS.damaged),
    };
    report(cx, severity, text);
    result
}

#[inline(never)]
fn report<F: Firmware>(cx: &mut Cx<'_, F>, severity: MavSeverity, text: &'static str) {
    event!("storage: {=str}", text);
    cx.texts.push(cx.now, cx.shared.normal, severity, text.as_bytes());
}

/// Does at most one step for a service: erases at most one unit or writes at most 256 bytes. Returns
/// [`Idle`](Step::Idle) if there is nothing to do, [`Busy`](Step::Busy) if there is more, and [`Unread`](Step::Unread) if
/// the caller must [`read`] the content.
#[inline(never)]
pub(crate) fn persist<'l, F: Firmware<Vehicle: Vehicle>, S: Persistent<F, Link: 'l>, N: NorFlash>(
    cx: &mut Cx<'_, F>,
    service: &mut S,
    links: impl Iterator<Item = &'l mut S::Link>,
    body: &mut Body<'_, N>,
) -> Step {
    let may_write = cx.vehicle.may_persist();
    let may_step =
        if body.record.is_unread() { service.may_load_late(cx) } else { may_write && !service.is_paused(cx.now) };
    if S::MAX_LEN == 0 || !may_step {
        return Step::Idle;
    }
    if service.is_reload_requested(cx) {
        let _ = read(cx, service, body, false);
    }
    let job = if may_write { service.pending_write(cx) } else { None };
    let step = match (body.record.step(body.flash, cx.now, job), job) {
        (Step::Write(first), Some(job)) => write(cx, service, body, first..job.len / 32),
        (step, _) => step,
    };
    match step {
        Step::Idle | Step::Busy | Step::Write(_) => {}
        Step::Done => service.on_written(cx, links, true),
        Step::Failed => service.on_written(cx, links, false),
        Step::Unread if service.on_readable(cx, links) => {}
        Step::Unread => return Step::Busy,
    }
    step
}

/// Writes up to 256 bytes of these rows. Not inlined: its stack is not needed for the other steps.
#[inline(never)]
fn write<F: Firmware, S: Persistent<F>, N: NorFlash>(
    cx: &mut Cx<'_, F>,
    service: &S,
    body: &mut Body<'_, N>,
    rows: Range<u32>,
) -> Step {
    let mut chunk = [0xFF; CHUNK];
    let mut is_whole = true;
    for (index, place) in rows.zip(chunk.as_chunks_mut::<ROW>().0) {
        match service.row(cx, index) {
            Some(row) => *place = row,
            None => is_whole = false,
        }
    }
    let step = body.record.write(body.flash, is_whole.then_some(&chunk));
    wipe(&mut chunk);
    step
}
