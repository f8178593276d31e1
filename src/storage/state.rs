//! The state of storage in a stack: the journal, and the record that is loaded or written.

use core::num::Wrapping;

use super::journal::{Entry, Journal};
use super::page::PAYLOAD;
use super::persistent::{LoadProgress, Persistent};
use super::restore_error::{RestoreError, RestoreErrors};
use crate::types::Firmware;

/// The contents that are stored, one for each service. They are loaded in this order, and written in turns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Content {
    SigningKey,
    Parameters,
    Plans,
    OwnRecords,
}

impl Content {
    pub(crate) const ALL: [Self; 4] = [Self::SigningKey, Self::Parameters, Self::Plans, Self::OwnRecords];

    /// Returns the content whose turn to be written is after this one's.
    pub(crate) const fn next(self) -> Self {
        match self {
            Self::SigningKey => Self::Parameters,
            Self::Parameters => Self::Plans,
            Self::Plans => Self::OwnRecords,
            Self::OwnRecords => Self::SigningKey,
        }
    }
}

/// Records of a service: a bit for each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct RecordSet(u8);

impl RecordSet {
    pub(crate) const EMPTY: Self = Self(0);

    pub(crate) const fn is_empty(self) -> bool {
        self.0 == 0
    }

    pub(crate) fn contains(self, record: u8) -> bool {
        self.0 & bit(record) != 0
    }

    pub(crate) fn insert(&mut self, record: u8) {
        self.0 |= bit(record);
    }

    /// Removes the first record and returns it.
    pub(crate) fn take_first(&mut self) -> Option<u8> {
        let record = (0..8).find(|record| self.contains(*record))?;
        self.0 &= !bit(record);
        Some(record)
    }
}

/// The bit of a record, which is below 8.
fn bit(record: u8) -> u8 {
    1u8.checked_shl(record.into()).unwrap_or(0)
}

/// The records of a service, as [`Persistent`] declares them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RecordLayout {
    first_kind: Wrapping<u8>,
    count: u8,
    pub(crate) all: RecordSet,
    pub(crate) schema: u16,
    /// Maximum length of a record in pages.
    pub(crate) pages: u16,
    /// The number of pages that all records and a report of the loss of each take.
    pub(crate) all_pages: u32,
    uses_older: bool,
}

impl RecordLayout {
    #[allow(
        clippy::arithmetic_side_effects,
        clippy::as_conversions,
        clippy::panic,
        reason = "const-evaluated; checked"
    )]
    pub(crate) const fn of<F: Firmware, S: Persistent<F>>() -> Self {
        let pages = S::MAX_LEN.div_ceil(PAYLOAD as u32);
        assert!(pages <= 0x7FFF, "the stored content of a service is at most 7 MB");
        assert!(S::RECORDS <= 8);
        let pages = if pages > 0 { pages } else { 1 };
        Self {
            first_kind: Wrapping(S::KIND),
            count: S::RECORDS,
            all: RecordSet(((1u16 << S::RECORDS) - 1) as u8),
            schema: S::SCHEMA,
            pages: pages as u16,
            all_pages: (pages + 1) * S::RECORDS as u32,
            uses_older: S::USES_OLDER,
        }
    }

    /// Whether nothing is stored.
    pub(crate) const fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Returns the kind of a record.
    pub(crate) fn kind(&self, record: u8) -> u8 {
        (self.first_kind + Wrapping(record)).0
    }

    /// Whether this is the kind of one of the records.
    pub(crate) fn has_kind(&self, kind: u8) -> bool {
        Wrapping(kind) - self.first_kind < Wrapping(self.count)
    }

    /// Returns whether there is a record to load.
    ///
    /// # Errors
    ///
    /// The record cannot be used.
    pub(crate) fn check(&self, entry: &Entry) -> Result<bool, RestoreError> {
        match entry.pages.0 {
            0 if entry.is_damaged => Err(RestoreError::Damaged),
            0 => Ok(false),
            _ if entry.is_damaged && !self.uses_older => Err(RestoreError::Damaged),
            _ if entry.schema != self.schema => Err(RestoreError::Foreign),
            _ => Ok(true),
        }
    }
}

/// The state of storage in the stack, declared by `storage`.
// Small fields are first: shorter instructions reach them there.
#[derive(Debug)]
#[repr(C)]
pub struct Storage {
    /// The content that is loaded or written, and which of its records.
    pub(crate) content: Content,
    pub(crate) record: u8,
    /// The content whose turn to be written it is.
    pub(crate) turn: Content,
    /// Whether the first attempt to read has failed.
    pub(crate) is_retry: bool,
    /// The records that are still to be loaded, in the order of [`Content::ALL`].
    pending_loads: [RecordSet; 4],
    pub(crate) errors: RestoreErrors,
    /// The version that is written.
    pub(crate) version: u16,
    pub(crate) journal: Journal,
    pub(crate) progress: LoadProgress,
}

impl Storage {
    pub(crate) const NEW: Self = Self {
        content: Content::SigningKey,
        record: 0,
        version: 0,
        turn: Content::SigningKey,
        is_retry: false,
        pending_loads: [RecordSet::EMPTY; 4],
        errors: RestoreErrors::NONE,
        journal: Journal::NEW,
        progress: LoadProgress::NEW,
    };

    /// Returns the records of a content that are still to be loaded.
    pub(crate) fn pending_loads(&mut self, content: Content) -> &mut RecordSet {
        let [key, parameters, plans, own_records] = &mut self.pending_loads;
        match content {
            Content::SigningKey => key,
            Content::Parameters => parameters,
            Content::Plans => plans,
            Content::OwnRecords => own_records,
        }
    }

    /// Whether a record is still to be loaded.
    pub(crate) fn must_load(&self) -> bool {
        self.pending_loads != [RecordSet::EMPTY; 4]
    }

    /// Returns why a content was not restored, to change it.
    pub(crate) fn error(&mut self, content: Content) -> &mut Option<RestoreError> {
        match content {
            Content::SigningKey => &mut self.errors.signing,
            Content::Parameters => &mut self.errors.parameters,
            Content::Plans => &mut self.errors.plans,
            Content::OwnRecords => &mut self.errors.records,
        }
    }

    /// Whether the content is being read for the first time.
    pub(crate) fn is_restoring(&self) -> bool {
        self.journal.is_starting() || self.journal.is_loading() || (self.must_load() && !self.is_retry)
    }
}
