//! What a service does to have its content stored, and the state of storage (G-18).

use super::log::{Entry, Log};
use super::plans;
use crate::dialect::{MavModeFlag, MavSeverity};
use crate::service::mission::WithoutPlans;
use crate::service::{Absent, Cx, Service, WithoutSigning};
use crate::time::Instant;
use crate::types::{Firmware, Vehicle};

/// Why stored content was not restored, or not completely. A STATUSTEXT reports it, too.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum RestoreError {
    /// A part of the storage could not be read, and nothing is in use that may be older than it.
    ///
    /// Reading is repeated every second. What can be read then is restored late. After the fourth attempt a page that
    /// cannot be read counts as damaged, or as cut off by a loss of power. While no page at all can be read, reading is
    /// repeated every ten seconds. Nothing is written before.
    // Not 0, so that no error is 0, and a stack without storage is all zeros.
    Unreadable = 1,
    /// The newest content is damaged. Plans and parameters are restored from an older record, if there is one. The
    /// damage is reported at each start until new content is stored.
    Damaged,
    /// Newer firmware wrote the content in a format that this version does not know. It remains until new content is
    /// stored.
    Foreign,
    /// The region has data that is no log. It is erased unit by unit as the log grows.
    OtherData,
}

impl core::fmt::Display for RestoreError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Unreadable => "the storage cannot be read, reading is repeated: check the driver and the wiring",
            Self::Damaged => "the stored data is damaged: store it again",
            Self::Foreign => "newer firmware wrote the stored data: install that firmware, or store the data again",
            Self::OtherData => "the region holds other data, which will be erased: check the region's address",
        })
    }
}

impl core::error::Error for RestoreError {}

/// What was not restored, and why. A STATUSTEXT reports each, too. Everything else was restored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct RestoreErrors {
    /// The signing key. Links that need one stay closed (G-18).
    pub signing: Option<RestoreError>,
    /// The parameters. They have their defaults, or the values of an older record if the newest one is damaged.
    pub parameters: Option<RestoreError>,
    /// The plans. They are empty, or those of an older record if the newest one is damaged. There may have been another
    /// geofence.
    pub plans: Option<RestoreError>,
    /// One of the firmware's own records.
    pub records: Option<RestoreError>,
    /// The region as a whole.
    pub region: Option<RestoreError>,
}

impl RestoreErrors {
    pub(crate) const NONE: Self = Self { signing: None, parameters: None, plans: None, records: None, region: None };

    /// Returns whether everything was restored. Call it in each pass of the loop, because content that cannot be read at
    /// first may be restored later:
    ///
    /// ```
    /// # use mavstack::StackOf;
    /// # #[derive(mavstack::Stack)]
    /// # #[stack(vehicle: Rover, links: 1, storage)]
    /// # struct Mavlink;
    /// # struct Rover { may_arm: bool }
    /// # impl mavstack::Vehicle for Rover { fn state(&self) -> Option<mavstack::VehicleState> { None } }
    /// # impl mavstack::Commands for Rover {
    /// #     fn command(&mut self, _: &mut mavstack::Context<'_>, _: &mavstack::Command) -> mavstack::Outcome {
    /// #         mavstack::dialect::MavResult::UNSUPPORTED.into()
    /// #     }
    /// # }
    /// # fn pass(stack: &StackOf<Mavlink>, rover: &mut Rover) {
    /// rover.may_arm = !stack.is_restoring() && stack.restore_errors().is_empty();
    /// # }
    /// ```
    pub fn is_empty(&self) -> bool {
        *self == Self::NONE
    }

    /// Returns an error if there is any.
    pub(crate) fn result(self) -> Result<(), Self> {
        if self.is_empty() { Ok(()) } else { Err(self) }
    }
}

impl core::fmt::Display for RestoreErrors {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self { signing, parameters, plans, records, region } = self;
        let mut separator = "";
        let parts = [
            ("signing key", signing),
            ("parameters", parameters),
            ("plans", plans),
            ("records", records),
            ("region", region),
        ];
        for (name, error) in parts {
            if let Some(error) = error {
                write!(f, "{separator}{name}: {error}")?;
                separator = "; ";
            }
        }
        Ok(())
    }
}

impl core::error::Error for RestoreErrors {}

/// The texts that report the state of stored content.
#[derive(Clone, Copy, Debug)]
pub struct Texts {
    pub(super) unreadable: &'static str,
    pub(super) damaged: &'static str,
    pub(super) readable: &'static str,
}

impl Texts {
    const NONE: Self = Self { unreadable: "", damaged: "", readable: "" };
}

/// Content to write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Write {
    /// Which of the service's records, counted from 0.
    pub(crate) record: u8,
    /// Stands for the content: other content has another number.
    pub(crate) version: u16,
    /// Whether to erase all older content afterwards.
    pub(crate) is_secret: bool,
}

/// One page of stored content that is loaded.
#[derive(Debug)]
pub struct Part<'a> {
    /// Which of the service's records, counted from 0.
    pub(crate) record: u8,
    pub(crate) bytes: &'a [u8],
    pub(crate) is_first: bool,
    pub(crate) is_last: bool,
    /// Whether an earlier attempt to read it failed, so that content that has changed since is newer.
    pub(crate) is_late: bool,
}

/// A service whose content is stored: one record, or a few of the same form. One that stores nothing keeps the default
/// methods.
pub trait Persistent<F: Firmware>: Service<F> {
    /// The kind of its first record. The others follow.
    const KIND: u8 = 0;

    /// The number of its records, at most 8; 0 if nothing is stored.
    const RECORDS: u8 = 0;

    /// The version of its content.
    const SCHEMA: u16 = 0;

    /// Maximum length of a record in bytes.
    const MAX_LEN: u32 = 0;

    /// Whether an older record is of use if a newer one is damaged.
    const USES_OLDER: bool = true;

    /// The texts that report its state.
    const TEXTS: Texts = Texts::NONE;

    /// Returns when a write is due. It stays in the past until storage begins it.
    fn write_deadline(&self) -> Instant {
        Instant::NEVER
    }

    /// Storage is attached. Nothing was read yet.
    fn attach(&mut self, cx: &mut Cx<'_, F>) {
        let _ = cx;
    }

    /// Takes the next page of a record. Returns whether the content is valid so far.
    fn load(&mut self, cx: &mut Cx<'_, F>, part: &Part<'_>, plans: &mut plans::Loading) -> bool {
        let _ = (cx, part, plans);
        true
    }

    /// Called after the last page, or if there is nothing to load. The result is true if content was loaded.
    fn loaded(&mut self, cx: &mut Cx<'_, F>, result: Result<bool, RestoreError>, is_late: bool) {
        let _ = (cx, result, is_late);
    }

    /// Whether to load the stored content again now.
    fn is_reload_requested(&self, cx: &mut Cx<'_, F>) -> bool {
        let _ = cx;
        false
    }

    /// Whether stored content may be loaded now.
    fn may_load(&self, cx: &Cx<'_, F>, is_late: bool) -> bool {
        let _ = (cx, is_late);
        true
    }

    /// Cancels a write that the vehicle no longer permits.
    fn cancel_if_refused<'l>(&mut self, cx: &mut Cx<'_, F>, links: impl Iterator<Item = &'l mut Self::Link>)
    where
        Self::Link: 'l,
    {
        let _ = (cx, links);
    }

    /// Returns the content to write now, or the content that is being written.
    fn pending_write(&mut self, cx: &mut Cx<'_, F>) -> Option<Write> {
        let _ = cx;
        None
    }

    /// Fills a page of a record. Returns the number of bytes, and whether it is the last page; `None` if there is no such
    /// page.
    fn fill(&mut self, cx: &mut Cx<'_, F>, record: u8, page: u16, bytes: &mut [u8]) -> Option<(u8, bool)> {
        let _ = (cx, record, page, bytes);
        None
    }

    /// Called with the result of the pending write.
    fn on_written<'l>(&mut self, cx: &mut Cx<'_, F>, links: impl Iterator<Item = &'l mut Self::Link>, is_saved: bool)
    where
        Self::Link: 'l,
    {
        let _ = (cx, links, is_saved);
    }

    /// Called when storage may have other content than the service: a write is complete though it was no longer wanted, or
    /// one that failed may be found after a restart, or stored content was lost. Requests a write.
    fn save_again(&mut self, cx: &mut Cx<'_, F>) {
        let _ = cx;
    }

    /// Called while its stored content must be loaded before anything is written, and cannot be loaded.
    fn on_blocked<'l>(&mut self, cx: &mut Cx<'_, F>, links: impl Iterator<Item = &'l mut Self::Link>)
    where
        Self::Link: 'l,
    {
        let _ = (cx, links);
    }

    /// Called before content is loaded. Returns whether it is still wanted, if it could not be read before.
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

/// The state of storage in the stack, declared by `storage`: the log, and what is loaded or written.
// Small fields are first: shorter instructions reach them there.
#[derive(Debug)]
#[repr(C)]
pub struct Storage {
    /// The service that is loaded or written, and which of its records.
    pub(crate) service: u8,
    pub(crate) record: u8,
    /// The service whose turn to write it is.
    pub(crate) turn: u8,
    /// Whether the first attempt to read has failed.
    pub(crate) is_late: bool,
    pub(crate) errors: RestoreErrors,
    /// The version that is written.
    pub(crate) version: u16,
    /// The records that are still to be loaded: eight bits for each service.
    pub(crate) to_load: u32,
    pub(crate) log: Log,
    pub(crate) loading: plans::Loading,
}

impl Storage {
    pub(crate) const NEW: Self = Self {
        log: Log::NEW,
        to_load: 0,
        is_late: false,
        service: 0,
        record: 0,
        version: 0,
        turn: 0,
        loading: plans::Loading::NEW,
        errors: RestoreErrors::NONE,
    };

    /// Whether the content is being read for the first time.
    pub(crate) fn is_restoring(&self) -> bool {
        self.log.is_starting() || self.log.is_loading() || (self.to_load != 0 && !self.is_late)
    }
}

/// What [`Persistent`] says of a service, in one value.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Kind {
    pub(crate) first: u8,
    pub(crate) records: u8,
    pub(crate) schema: u16,
    /// Maximum length of a record in pages.
    pub(crate) pages: u16,
    pub(crate) uses_older: bool,
}

impl Kind {
    #[allow(
        clippy::arithmetic_side_effects,
        clippy::as_conversions,
        clippy::panic,
        reason = "const-evaluated; checked"
    )]
    pub(crate) const fn of<F: Firmware, S: Persistent<F>>() -> Self {
        let pages = S::MAX_LEN.div_ceil(super::page::PAYLOAD as u32);
        assert!(pages <= 0x7FFF, "the stored content of a service is at most 7 MB");
        assert!(S::RECORDS <= 8);
        Self {
            first: S::KIND,
            records: S::RECORDS,
            schema: S::SCHEMA,
            pages: if pages > 0 { pages as u16 } else { 1 },
            uses_older: S::USES_OLDER,
        }
    }

    /// Whether this is the kind of one of its records.
    pub(crate) const fn has(&self, kind: u8) -> bool {
        kind.wrapping_sub(self.first) < self.records
    }

    /// Returns how a record of this service can be loaded.
    pub(crate) fn judge(&self, entry: &Entry) -> Result<bool, RestoreError> {
        match entry.pages {
            0 if entry.is_damaged => Err(RestoreError::Damaged),
            0 => Ok(false),
            _ if entry.is_damaged && !self.uses_older => Err(RestoreError::Damaged),
            _ if entry.schema != self.schema => Err(RestoreError::Foreign),
            _ => Ok(true),
        }
    }
}

/// Sends a text about stored content.
pub(crate) fn report<F: Firmware>(cx: &mut Cx<'_, F>, severity: MavSeverity, text: &'static str) {
    event!("storage: {=str}", text);
    cx.text(severity, text.as_bytes());
}

impl Texts {
    /// Reports the result of loading content.
    pub(crate) fn report<F: Firmware>(&self, cx: &mut Cx<'_, F>, result: Result<bool, RestoreError>, is_late: bool) {
        let (severity, text) = match result {
            Ok(_) if is_late => (MavSeverity::INFO, self.readable),
            Ok(_) => return,
            // It was reported when reading failed first.
            Err(RestoreError::Unreadable) if is_late => return,
            Err(RestoreError::Unreadable) => (MavSeverity::ERROR, self.unreadable),
            Err(_) => (MavSeverity::ERROR, self.damaged),
        };
        report(cx, severity, text);
    }
}
