//! Chooses which stored content is loaded or written next, and passes results to its service (D-5, G-18, M-44, P-17, SEC-12).

use super::services::{Services, States};
use super::{Cx, Declares};
use crate::dialect::MavSeverity;
use crate::storage::{
    Content, Event, Job, LoadResult, LoadedPage, Next, Page, PendingWrite, Persistent, RecordLayout, RestoreError,
    RestoreTexts, Storage, report,
};
use crate::types::Vehicle;

/// All that a call that concerns storage works on.
pub(super) struct Persistence<'a, D: Declares> {
    pub(super) cx: Cx<'a, D>,
    pub(super) services: &'a mut Services<D>,
    pub(super) states: &'a mut [States<D>],
    pub(super) storage: &'a mut Storage,
}

/// The pages that a firmware's records need.
pub(super) struct RegionPages {
    /// All records, and one report of loss for each.
    pub(super) least: u32,
    pub(super) longest_record: u16,
}

/// Runs an expression with the service of a content, and with the service's state on each link if that is named too.
macro_rules! with_service {
    ($persistence:ident, $content:expr, |$service:ident, $links:ident| $body:expr) => {
        match $content {
            Content::SigningKey => with_service!($persistence, signing, $service, $links, $body),
            Content::Parameters => with_service!($persistence, param, $service, $links, $body),
            Content::Plans => with_service!($persistence, mission, $service, $links, $body),
            Content::OwnRecords => with_service!($persistence, records, $service, $links, $body),
        }
    };
    ($persistence:ident, $field:ident, $service:ident, $links:ident, $body:expr) => {{
        let $service = &mut $persistence.services.$field;
        let $links = $persistence.states.iter_mut().map(|state| &mut state.$field);
        $body
    }};
    ($persistence:ident, $content:expr, |$service:ident| $body:expr) => {
        with_service!($persistence, $content, |$service, _links| $body)
    };
}

impl<D: Declares> Persistence<'_, D> {
    /// The pages of everything that the firmware declares.
    pub(super) const PAGES: RegionPages = {
        let (mut all, mut longest_record, mut contents): (u32, u16, &[Content]) = (0, 0, &Content::ALL);
        while let [content, rest @ ..] = contents {
            let layout = Self::layout(*content);
            if !layout.is_empty() {
                all = all.saturating_add(layout.all_pages);
                longest_record = if layout.pages > longest_record { layout.pages } else { longest_record };
            }
            contents = rest;
        }
        // A report that records of unknown kinds are lost takes a page too.
        RegionPages { least: if all == 0 { 0 } else { all.saturating_add(1) }, longest_record }
    };

    /// Returns the records of a content.
    const fn layout(content: Content) -> RecordLayout {
        match content {
            Content::SigningKey => const { RecordLayout::of::<D, D::Signing>() },
            Content::Parameters => const { RecordLayout::of::<D, D::Param>() },
            Content::Plans => const { RecordLayout::of::<D, D::Mission>() },
            Content::OwnRecords => const { RecordLayout::of::<D, D::Records>() },
        }
    }

    /// Returns the texts that report the state of a content.
    const fn texts(content: Content) -> RestoreTexts {
        match content {
            Content::SigningKey => <D::Signing as Persistent<D>>::TEXTS,
            Content::Parameters => <D::Param as Persistent<D>>::TEXTS,
            Content::Plans => <D::Mission as Persistent<D>>::TEXTS,
            Content::OwnRecords => <D::Records as Persistent<D>>::TEXTS,
        }
    }

    /// Returns the contents that this firmware stores.
    fn contents() -> impl Iterator<Item = Content> {
        Content::ALL.into_iter().filter(|content| !Self::layout(*content).is_empty())
    }

    /// Begins to read all records.
    pub(super) fn attach(&mut self) {
        for content in Self::contents() {
            *self.storage.pending_loads(content) = Self::layout(content).all;
        }
        for content in Content::ALL {
            with_service!(self, content, |service| service.attach(&mut self.cx));
        }
    }

    /// Returns the next job.
    pub(super) fn next_job(&mut self, page: &mut Page) -> Option<Job> {
        let may_write = self.cx.vehicle.may_persist();
        self.cancel_refused_writes();
        if self.storage.journal.is_foreign() {
            self.refuse_all();
        } else if self.storage.journal.is_writing() && !self.is_wanted() {
            self.storage.journal.abandon();
        }
        if self.storage.journal.is_waiting() || self.storage.journal.is_foreign() {
            for content in Self::contents() {
                if self.storage.journal.is_foreign() || !self.storage.pending_loads(content).is_empty() {
                    self.block(content);
                }
            }
        }
        if self.storage.journal.is_idle() {
            self.begin_next(may_write);
        }
        match self.storage.journal.next(self.cx.now, may_write, page) {
            Next::Job(job) => Some(job),
            Next::Idle => None,
            Next::Content(index) => {
                let Storage { content, record, .. } = *self.storage;
                let bytes = page.payload_mut();
                let filled = with_service!(self, content, |service| service.fill(&mut self.cx, record, index, bytes));
                let Some(filled) = filled else {
                    self.storage.journal.abandon();
                    self.end_write(content, false);
                    return None;
                };
                self.storage.journal.put(page, filled.len, filled.is_last);
                match self.storage.journal.next(self.cx.now, may_write, page) {
                    Next::Job(job) => Some(job),
                    Next::Idle | Next::Content(_) => None,
                }
            }
        }
    }

    /// Begins the next load or write, if there is one.
    fn begin_next(&mut self, may_write: bool) {
        for content in Self::contents() {
            if with_service!(self, content, |service| service.is_reload_requested(&mut self.cx)) {
                *self.storage.pending_loads(content) = Self::layout(content).all;
            }
        }
        for content in Self::contents() {
            if self.storage.pending_loads(content).is_empty() {
                continue;
            }
            if !self.may_load(content) {
                self.block(content);
                continue;
            }
            while let Some(record) = self.storage.pending_loads(content).take_first() {
                if self.begin_load(content, record) {
                    return;
                }
            }
        }
        // Whatever is requested from now on is not late.
        self.storage.is_retry &= self.storage.must_load();
        if may_write {
            self.begin_write();
        }
    }

    /// Begins to load a record. Returns false if there is nothing to load.
    fn begin_load(&mut self, content: Content, record: u8) -> bool {
        if !self.prepare_load(content) {
            return false;
        }
        let layout = Self::layout(content);
        let kind = layout.kind(record);
        (self.storage.content, self.storage.record) = (content, record);
        match layout.check(self.storage.journal.find(kind)) {
            Ok(true) => {
                self.storage.journal.load(kind);
                return true;
            }
            Ok(false) => self.end_load(content, LoadResult::Empty),
            Err(error) => self.end_load(content, LoadResult::Failed(error)),
        }
        false
    }

    /// Begins to write the next content that has changed. One that must be loaded first is not written.
    fn begin_write(&mut self) {
        let mut content = self.storage.turn;
        for _ in Content::ALL {
            let layout = Self::layout(content);
            if !layout.is_empty()
                && self.storage.pending_loads(content).is_empty()
                && let Some(write) = self.pending_write(content)
            {
                let storage = &mut *self.storage;
                storage.turn = content.next();
                (storage.content, storage.record, storage.version) = (content, write.record, write.version);
                let kind = layout.kind(write.record);
                if storage.journal.begin(kind, layout.schema, layout.pages, write.is_secret) {
                    return;
                }
                self.end_write(content, false);
            }
            content = content.next();
        }
    }

    /// Takes the result of the last job. The page of a record that is loaded is in the buffer.
    pub(super) fn take_result(&mut self, is_done: bool, page: &mut Page) {
        let content = self.storage.content;
        match self.storage.journal.done(self.cx.now, is_done, page) {
            Event::Nothing => {}
            Event::Found => {
                if self.storage.journal.has_other_data() {
                    self.storage.errors.region = Some(RestoreError::OtherData);
                    report(&mut self.cx, MavSeverity::WARNING, "Storage has other data, which is erased");
                }
            }
            Event::Unreadable { was_loading } => {
                if was_loading {
                    self.load_again();
                }
                for content in Self::contents() {
                    if !self.storage.pending_loads(content).is_empty() {
                        self.end_load(content, LoadResult::Failed(RestoreError::Unreadable));
                    }
                }
                self.storage.is_retry = true;
            }
            Event::Loaded { len, is_first, is_last } => self.load_page(page.payload(len), is_first, is_last),
            Event::Written => {
                self.cancel_refused_writes();
                if self.is_wanted() {
                    self.end_write(content, true);
                } else {
                    self.save_again(content);
                }
            }
            Event::Failed { is_doubtful } => {
                // A service that no longer wants it knows that already.
                if self.is_wanted() {
                    self.end_write(content, false);
                }
                if is_doubtful {
                    self.save_again(content);
                }
            }
            Event::Lost(kind) => {
                report(&mut self.cx, MavSeverity::WARNING, "Stored data was lost, and is stored again");
                if let Some(content) = Self::contents().find(|content| Self::layout(*content).has_kind(kind)) {
                    self.save_again(content);
                }
            }
        }
    }

    /// Passes the content of a page of the current record to its service.
    fn load_page(&mut self, bytes: &[u8], is_first: bool, is_last: bool) {
        let Storage { content, record, is_retry, .. } = *self.storage;
        if is_retry && !self.may_load(content) {
            // The vehicle has armed meanwhile.
            self.storage.journal.end_load();
            self.load_again();
            return self.end_load(content, LoadResult::Failed(RestoreError::Unreadable));
        }
        if is_retry {
            // A whole plan may have been uploaded while this page was read.
            self.prepare_load(content);
        }
        let loaded = with_service!(self, content, |service| {
            let progress = &mut self.storage.progress;
            service.load(&mut self.cx, LoadedPage { record, bytes, is_first, is_last, is_retry, progress })
        });
        if is_last || loaded.is_err() {
            self.storage.journal.end_load();
            let kind = Self::layout(content).kind(record);
            let is_damaged = loaded.is_err() || self.storage.journal.find(kind).is_damaged;
            let result = if is_damaged { LoadResult::Failed(RestoreError::Damaged) } else { LoadResult::Loaded };
            self.end_load(content, result);
        }
    }

    /// Adds the current record to those that are to be loaded.
    fn load_again(&mut self) {
        let Storage { content, record, .. } = *self.storage;
        self.storage.pending_loads(content).insert(record);
    }

    /// The journal is of another version: nothing can be loaded.
    fn refuse_all(&mut self) {
        if !self.storage.must_load() {
            return;
        }
        self.storage.errors.region = Some(RestoreError::Foreign);
        for content in Self::contents() {
            while self.storage.pending_loads(content).take_first().is_some() {}
            self.end_load(content, LoadResult::Failed(RestoreError::Foreign));
        }
    }

    /// Passes the result of loading to a service, and reports it.
    fn end_load(&mut self, content: Content, result: LoadResult) {
        let is_retry = self.storage.is_retry;
        with_service!(self, content, |service| service.loaded(&mut self.cx, result, is_retry));
        let error = self.storage.error(content);
        match result {
            LoadResult::Failed(failure) => *error = Some(failure),
            LoadResult::Loaded | LoadResult::Empty if *error == Some(RestoreError::Unreadable) => *error = None,
            LoadResult::Loaded | LoadResult::Empty => {}
        }
        Self::texts(content).report(&mut self.cx, result, is_retry);
    }

    /// Passes the result of a write to a service.
    fn end_write(&mut self, content: Content, is_saved: bool) {
        with_service!(self, content, |service, links| service.on_written(&mut self.cx, links, is_saved));
    }

    /// Asks the vehicle whether the writes that clients wait for are still permitted, and answers those that are not.
    fn cancel_refused_writes(&mut self) {
        for content in Self::contents() {
            with_service!(self, content, |service, links| service.cancel_if_refused(&mut self.cx, links));
        }
    }

    /// Whether the record that is being written is still the one that its service wants.
    fn is_wanted(&mut self) -> bool {
        let Storage { content, record, version, .. } = *self.storage;
        self.pending_write(content).is_some_and(|write| (write.record, write.version) == (record, version))
    }

    fn pending_write(&mut self, content: Content) -> Option<PendingWrite> {
        with_service!(self, content, |service| service.pending_write(&mut self.cx))
    }

    fn may_load(&mut self, content: Content) -> bool {
        let is_retry = self.storage.is_retry;
        with_service!(self, content, |service| service.may_load(&self.cx, is_retry))
    }

    fn prepare_load(&mut self, content: Content) -> bool {
        with_service!(self, content, |service, links| service.prepare_load(&mut self.cx, links))
    }

    fn save_again(&mut self, content: Content) {
        with_service!(self, content, |service| service.save_again(&mut self.cx));
    }

    fn block(&mut self, content: Content) {
        with_service!(self, content, |service, links| service.on_blocked(&mut self.cx, links));
    }
}
