//! The interface between storage and the services whose content is stored (G-18).

use core::num::Saturating;

use super::restore_error::RestoreError;
use crate::dialect::{MavMissionResult, MavModeFlag, MavSeverity};
use crate::message::Digest;
use crate::service::mission::{PlanFault, WithoutPlans};
use crate::service::param::ExternalService;
use crate::service::{Absent, Cx, Service, WithoutSigning};
use crate::time::Instant;
use crate::types::{Firmware, Vehicle};

/// A request to write a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PendingWrite {
    /// Which of the service's records, counted from 0.
    pub(crate) record: u8,
    /// Stands for the content: other content has another number.
    pub(crate) version: u16,
    /// Whether to erase all older content afterwards.
    pub(crate) is_secret: bool,
}

/// A page that a service has filled with its content.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FilledPage {
    /// The number of bytes.
    pub(crate) len: u8,
    /// Whether it is the last page of the record.
    pub(crate) is_last: bool,
}

/// One page of stored content that is loaded.
#[derive(Debug)]
pub struct LoadedPage<'a> {
    /// Which of the service's records, counted from 0.
    pub(crate) record: u8,
    pub(crate) bytes: &'a [u8],
    pub(crate) is_first: bool,
    pub(crate) is_last: bool,
    /// Whether an earlier attempt to read the content failed. Then content that has changed since is newer.
    pub(crate) is_retry: bool,
    /// The state that the service needs with the next page.
    pub(crate) progress: &'a mut LoadProgress,
}

/// The state of a service between two pages of a record that is loaded. Only the plans need it: their items are checked
/// one by one.
#[derive(Clone, Copy, Debug)]
pub struct LoadProgress {
    /// The number of items of each plan, and the id of each.
    pub(super) counts: [u32; 3],
    pub(super) ids: [u32; 3],
    /// The index of the plan whose items are next, and the number of its items so far.
    pub(super) plan: Saturating<u8>,
    pub(super) items: Saturating<u16>,
    pub(super) digest: Digest,
    /// Why the plan is not used, or [`NO_FAULT`]. An `Option` would not be all zero bits.
    pub(super) fault: PlanFault,
    /// Whether a plan of the record was refused, so that the live plans are not the stored ones.
    pub(super) has_refused_plan: bool,
}

/// The content of a record is not in its format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DamagedContent;

/// Stands for no fault of a plan.
pub(super) const NO_FAULT: PlanFault = PlanFault { seq: None, result: MavMissionResult::ACCEPTED };

impl LoadProgress {
    pub(super) const NEW: Self = Self {
        counts: [0; 3],
        ids: [0; 3],
        plan: Saturating(0),
        items: Saturating(0),
        digest: Digest::VACANT,
        fault: NO_FAULT,
        has_refused_plan: false,
    };
}

/// The result of loading the content of a service.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LoadResult {
    /// Content was loaded.
    Loaded,
    /// Nothing is stored.
    Empty,
    /// Content was not loaded, or is damaged.
    Failed(RestoreError),
}

/// The texts that report the state of stored content.
#[derive(Clone, Copy, Debug)]
pub struct RestoreTexts {
    pub(super) unreadable: &'static str,
    pub(super) damaged: &'static str,
    pub(super) readable: &'static str,
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
    const TEXTS: RestoreTexts = RestoreTexts { unreadable: "", damaged: "", readable: "" };

    /// Returns when a write is due. It stays in the past until storage begins it.
    fn write_deadline(&self) -> Instant {
        Instant::NEVER
    }

    /// Prepares for stored content: storage is attached, and nothing was read yet.
    fn attach(&mut self, cx: &mut Cx<'_, F>) {
        let _ = cx;
    }

    /// Takes the next page of a record.
    ///
    /// # Errors
    ///
    /// `DamagedContent` if the page cannot be used. Then the record's next pages are not read.
    fn load(&mut self, cx: &mut Cx<'_, F>, page: LoadedPage<'_>) -> Result<(), DamagedContent> {
        let _ = (cx, page);
        Ok(())
    }

    /// Called after the last page, or if there is nothing to load. `is_retry`: an earlier attempt to read failed.
    fn loaded(&mut self, cx: &mut Cx<'_, F>, result: LoadResult, is_retry: bool) {
        let _ = (cx, result, is_retry);
    }

    /// Whether to load the stored content again now.
    fn is_reload_requested(&self, cx: &mut Cx<'_, F>) -> bool {
        let _ = cx;
        false
    }

    /// Whether stored content may be loaded now. `is_retry`: an earlier attempt to read failed.
    fn may_load(&self, cx: &Cx<'_, F>, is_retry: bool) -> bool {
        let _ = (cx, is_retry);
        true
    }

    /// Cancels a write that the vehicle no longer permits.
    fn cancel_if_refused<'l>(&mut self, cx: &mut Cx<'_, F>, links: impl Iterator<Item = &'l mut Self::Link>)
    where
        Self::Link: 'l,
    {
        let _ = (cx, links);
    }

    /// Returns the record to write now, or the record that is being written.
    fn pending_write(&mut self, cx: &mut Cx<'_, F>) -> Option<PendingWrite> {
        let _ = cx;
        None
    }

    /// Fills a page of a record; `None` if there is no such page.
    fn fill(&mut self, cx: &mut Cx<'_, F>, record: u8, page: u16, bytes: &mut [u8]) -> Option<FilledPage> {
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

    /// Called when storage may have other content than the service. A write that was no longer wanted is complete; or
    /// one that failed may be found after a restart; or stored content was lost. Requests a write.
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
    fn prepare_load<'l>(&mut self, cx: &mut Cx<'_, F>, links: impl Iterator<Item = &'l mut Self::Link>) -> bool
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
/// The backend stores its parameters itself.
impl<F: Firmware> Persistent<F> for ExternalService where Self: Service<F> {}

/// Whether the vehicle is known to be disarmed. While it may be armed, stored content must not replace the content with
/// which it flies.
pub(super) fn is_disarmed(vehicle: &impl Vehicle) -> bool {
    vehicle.state().is_some_and(|state| !state.base_mode.contains(MavModeFlag::SAFETY_ARMED))
}

/// Sends a text about stored content.
pub(crate) fn report<F: Firmware>(cx: &mut Cx<'_, F>, severity: MavSeverity, text: &'static str) {
    event!("storage: {=str}", text);
    cx.text(severity, text.as_bytes());
}

impl RestoreTexts {
    /// Reports the result of loading content.
    pub(crate) fn report<F: Firmware>(&self, cx: &mut Cx<'_, F>, result: LoadResult, is_retry: bool) {
        match result {
            LoadResult::Loaded | LoadResult::Empty if is_retry => report(cx, MavSeverity::INFO, self.readable),
            LoadResult::Loaded | LoadResult::Empty => {}
            // The first failure to read was reported.
            LoadResult::Failed(RestoreError::Unreadable) if is_retry => {}
            LoadResult::Failed(RestoreError::Unreadable) => report(cx, MavSeverity::ERROR, self.unreadable),
            LoadResult::Failed(_) => report(cx, MavSeverity::ERROR, self.damaged),
        }
    }
}
