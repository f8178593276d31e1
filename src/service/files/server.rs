//! Executes requests when they are received (F-1 to F-7, F-13), and runs the operations that take more than one call (P-22).

use core::num::Wrapping;
use core::task::Poll;

use heapless::vec::VecView;

use super::checksum::{Checksum, LONGEST_CHECKSUM};
use super::directory::Directory;
use super::file::{File, Origin};
use super::packet::{MAX_DATA, Request};
use super::path;
use super::session::{
    self, Admission, Answer, CHECKSUM_TURN, Content, IDLE, Lease, Session, State, TAKEOVER, TURN, Ticks, ticks,
};
use super::upload::{STALLED, Taken, Upload, UploadState};
use super::vehicle::{FileAccess, FileChange, Files};
use super::virtual_files::{self, VirtualFile};
use crate::crc32::Crc32;
use crate::dialect::{MavFtpErr, MavFtpOpcode, MavSeverity};
use crate::message::zero_extend;
use crate::service::rate_limit::RETRY;
use crate::service::{Cx, Handled, Received, increment};
use crate::time::Instant;
use crate::types::{Firmware, LinkMask, Peer, Trust};

/// The number of sessions, besides the open ones, that hold answers to clients without an open file.
const WITHOUT_FILE: usize = 2;

/// Returns the number of sessions of a server with so many open files.
pub const fn sessions(open_files: usize) -> usize {
    assert!(open_files > 0, "a client needs a session: `files: {{ sessions: 2 }}`, or leave `files` out");
    assert!(
        open_files <= 16,
        "one request may close all open files, of which 16 are the most: `files: {{ sessions: 2 }}`"
    );
    open_files.saturating_add(WITHOUT_FILE)
}

counters! {
    /// Counters of the file service. They wrap.
    FileCounters {
        /// Files that were opened.
        count opened,
        /// Completed uploads: of parameters, for example.
        count uploads,
        /// Uploads that were refused as a whole.
        drop refused_uploads,
        /// Files that were not opened because all sessions were in use.
        drop no_session,
        /// Sessions that ended because their client was silent for ten seconds, and uploads that received no part for eight.
        drop timed_out,
        /// Open files that gave way to another client.
        drop taken_over,
    }
}

/// The file service: declared by `files` in [`#[stack]`](macro@crate::Stack), and read through
/// [`Stack::files`](crate::Stack::files).
#[derive(Debug)]
pub struct FileStatus {
    /// When a session may end.
    pub(super) wake: Instant,
    /// When to retry an operation that waits for data or for storage.
    pub(super) retry_at: Instant,
    pub(super) counters: FileCounters,
}

impl FileStatus {
    pub(super) const NEW: Self = Self { wake: Instant::ZERO, retry_at: Instant::ZERO, counters: FileCounters::ZERO };

    /// Returns the counters.
    pub const fn counters(&self) -> FileCounters {
        self.counters
    }
}

/// An operation that takes more than one call: one at a time. With this representation no field has the discriminant in its niche,
/// so `Nothing` is all zero bits.
#[derive(Clone, Copy, Debug)]
#[repr(u8)]
pub(super) enum Operation<V> {
    Nothing,
    Checksum(Checksum<V>),
    BeginUpload { client: Peer, file: V },
    FinishUpload { client: Peer, file: V },
}

impl<V> Operation<V> {
    pub(super) const fn is_running(&self) -> bool {
        !matches!(self, Self::Nothing)
    }
}

/// The response to a request that is not refused.
enum Response {
    Answer(Content),
    /// The operation answers it.
    Later,
    /// It is not executed, and the client sends it again.
    Dropped,
}

/// The service at work. A firmware has one, so its code is compiled once: with the number of sessions as a constant it
/// is 300 bytes smaller than with a slice of them.
pub(super) struct Server<'a, 'c, F: Firmware, V, const N: usize> {
    pub(super) cx: &'a mut Cx<'c, F>,
    pub(super) status: &'a mut FileStatus,
    pub(super) operation: &'a mut Operation<V>,
    pub(super) sessions: &'a mut [Session<V>; N],
    pub(super) upload: &'a mut Upload,
    /// The bytes of the upload that the virtual directory still needs.
    pub(super) content: &'a mut VecView<u8>,
}

impl<F: Firmware<Vehicle: Files>, V: VirtualFile<F>, const N: usize> Server<'_, '_, F, V, N> {
    /// Handles a packet.
    pub(super) fn on_packet(&mut self, received: &Received<'_>, rate: u32) -> Handled {
        let request = Request::decode(received, rate);
        if request.head.opcode.0 >= MavFtpOpcode::ACK.0 {
            // It is an answer, which has none.
            return Handled::Yes;
        }
        let now = ticks(self.cx.now);
        let is_in_control =
            F::HAS_CONTROL && self.cx.shared.controllers.is_owner(received.from.address.system, received.trust);
        let Some((index, session)) = session::find_or_begin(self.sessions, &request, is_in_control, now) else {
            return Handled::NoRoom;
        };
        self.status.wake = Instant::ZERO;
        let slots = match session.admit(&request, now) {
            Admission::Executed { slots } => slots,
            Admission::Repeated => return Handled::Yes,
            Admission::NoSlot => return Handled::NoRoom,
        };
        let is_protected = F::HAS_CONTROL && request.is_change() && !received.may_change;
        let executed = if is_protected { Err(MavFtpErr::FILEPROTECTED) } else { self.execute(index, &request) };
        let content = match executed {
            Ok(Response::Answer(content)) => Some(content),
            Ok(Response::Later) => None,
            Ok(Response::Dropped) => return Handled::NoRoom,
            Err(error) => {
                event!("files: request {=u8} of {} refused: {=u8}", request.head.opcode.0, received.from, error.0);
                Some(Content::Refused(error))
            }
        };
        if let Some(session) = self.sessions.get_mut(index) {
            session.put(slots, Answer::new(&request, content));
        }
        Handled::Yes
    }

    /// Executes a request of a session.
    fn execute(&mut self, index: usize, request: &Request<'_>) -> Result<Response, MavFtpErr> {
        let Some(session) = self.sessions.get_mut(index) else { return Ok(Response::Dropped) };
        let head = &request.head;
        // It waits for a checksum no more, unless it asks again.
        session.checksum_refused = Wrapping(0);
        if usize::from(head.size) > MAX_DATA {
            return Err(MavFtpErr::INVALIDDATASIZE);
        }
        match head.opcode {
            MavFtpOpcode::NONE => Ok(Response::Answer(Content::Empty)),
            MavFtpOpcode::TERMINATESESSION => {
                // The end of an upload is answered when the upload is applied.
                let is_finishing = matches!(self.operation, Operation::FinishUpload { .. })
                    && session.answer_in(State::Running).is_some();
                let is_receiving = self.is_receiving(index);
                self.close(index);
                match is_receiving {
                    false if is_finishing => Ok(Response::Later),
                    false => Ok(Response::Answer(Content::Empty)),
                    // With an ACK the client would believe that its upload is complete.
                    true => Err(MavFtpErr::FAIL),
                }
            }
            MavFtpOpcode::RESETSESSION => {
                for other in 0..N {
                    let other_session = self.sessions.get(other);
                    if other_session.is_some_and(|other| other.is_of(request.session.client, request.trust)) {
                        self.close(other);
                    }
                }
                Ok(Response::Answer(Content::Empty))
            }
            MavFtpOpcode::READFILE | MavFtpOpcode::BURSTREADFILE => {
                match &mut session.file.origin {
                    Origin::Virtual(file) => file.begin_to_read(head.requested_len()),
                    Origin::Hook { .. } | Origin::Static { .. } => {}
                    Origin::Upload(_) => return Err(MavFtpErr::FAIL),
                    Origin::Closed => return Err(MavFtpErr::INVALIDSESSION),
                }
                // In the slot of a burst, this answer is sent again and again, each time with the next part.
                Ok(Response::Answer(Content::FilePart))
            }
            MavFtpOpcode::WRITEFILE => {
                let response = self.write(index, request)?;
                if let Some(session) = self.sessions.get_mut(index) {
                    session.lease.bytes += u32::from(request.head.size);
                }
                Ok(response)
            }
            _ => self.execute_on_path(index, request),
        }
    }

    /// Executes a request with a path.
    fn execute_on_path(&mut self, index: usize, request: &Request<'_>) -> Result<Response, MavFtpErr> {
        let path = path::parse(request.data).ok_or(MavFtpErr::FILENOTFOUND)?;
        let client = request.session.client;
        match request.head.opcode {
            MavFtpOpcode::OPENFILERO => self.open(index, request, path, FileAccess::Read),
            MavFtpOpcode::OPENFILEWO => self.open(index, request, path, FileAccess::Write),
            MavFtpOpcode::CREATEFILE => self.open(index, request, path, FileAccess::Create),
            MavFtpOpcode::CALCFILECRC => self.begin_checksum(index, path, client),
            MavFtpOpcode::LISTDIRECTORY | MavFtpOpcode::LISTDIRECTORYWITHTIME => {
                let content = match path::is_virtual(path) {
                    true => virtual_files::find::<F, V>(path).map(Content::VirtualEntries),
                    false => Directory::find(self.cx, path).map(Content::Entries),
                };
                content.map(Response::Answer).ok_or(MavFtpErr::FILENOTFOUND)
            }
            MavFtpOpcode::REMOVEFILE
            | MavFtpOpcode::TRUNCATEFILE
            | MavFtpOpcode::CREATEDIRECTORY
            | MavFtpOpcode::REMOVEDIRECTORY
            | MavFtpOpcode::RENAME => {
                if !F::Vehicle::WRITES {
                    return Err(MavFtpErr::FILEPROTECTED);
                }
                let change = change_of::<F>(path, request)?;
                if is_own::<F>(path) {
                    return Err(MavFtpErr::FILEPROTECTED);
                }
                let (vehicle, mut context) = self.cx.hook();
                vehicle.change(&mut context, change, client)?;
                Ok(Response::Answer(Content::Empty))
            }
            _ => Err(MavFtpErr::UNKNOWNCOMMAND),
        }
    }

    /// Opens a file in a session (F-6).
    fn open(
        &mut self,
        index: usize,
        request: &Request<'_>,
        path: &[u8],
        access: FileAccess,
    ) -> Result<Response, MavFtpErr> {
        let Some(session) = self.sessions.get(index) else { return Ok(Response::Dropped) };
        if session.opened_by == Some(request.digest) {
            // It is open, but the answer was forgotten.
            return Ok(Response::Answer(Content::number(session.file.size)));
        }
        // A client that opens another file does not close the one before, or its request to do so was lost. If nothing has arrived
        // of an upload, it asks again with another number.
        if self.upload.received == 0 && session.is_uploading() {
            self.upload.state = UploadState::Refused;
        }
        self.close(index);
        let (now, client) = (ticks(self.cx.now), request.session.client);
        if self.sessions.iter().filter(|session| !session.is_open()).count() <= WITHOUT_FILE {
            let Some(victim) = self.victim(now, client) else {
                increment(&mut self.status.counters.no_session);
                return Err(MavFtpErr::NOSESSIONSAVAILABLE);
            };
            // First: the vehicle may have no room for another open file.
            increment(&mut self.status.counters.taken_over);
            self.close(victim);
            self.end_time(victim);
        }
        if V::UPLOADS
            && access != FileAccess::Read
            && path::is_virtual(path)
            && self.upload.state != UploadState::Complete
            && let Some(rival) = self.sessions.iter().position(Session::is_uploading)
            && self.gives_way(rival, now, client)
        {
            // There is one upload at a time.
            increment(&mut self.status.counters.taken_over);
            self.close(rival);
            self.end_time(rival);
        }
        let may_upload = V::UPLOADS && !self.sessions.iter().any(Session::is_uploading);
        let file = File::open(self.cx, path, access, client, may_upload)?;
        let mut response = Response::Answer(Content::number(file.size));
        if V::UPLOADS
            && let Origin::Upload(file) = file.origin
        {
            self.abort_checksum();
            if self.operation.is_running() {
                // The upload could not be finished either.
                return Ok(Response::Dropped);
            }
            *self.upload = Upload { state: UploadState::Opening, received: 0, grown: now };
            self.content.clear();
            *self.operation = Operation::BeginUpload { client, file };
            response = Response::Later;
        }
        increment(&mut self.status.counters.opened);
        // The time that its client holds files goes on, with whichever number it opens the next one.
        let is_held = |other: &&Session<V>| other.lease.has_begun() && other.id.is_some_and(|id| id.client == client);
        let held = self.sessions.iter().filter(is_held).map(|other| now - other.lease.held).max();
        if let Some(session) = self.sessions.get_mut(index) {
            session.set_file(file, request, now);
            session.lease.held = now - held.unwrap_or_default();
        }
        Ok(response)
    }

    /// Returns the session whose file gives way to another client (F-6, X-3): of those that may, the one that was idle for the
    /// longest.
    fn victim(&mut self, now: Ticks, client: Peer) -> Option<usize> {
        let has_none = session::count_open(self.sessions, client) == 0;
        let mut victim: Option<(usize, Ticks)> = None;
        for index in 0..N {
            let Some(session) = self.sessions.get(index).filter(|session| session.is_open()) else { continue };
            let (idle, id) = (session.idle_for(now), session.id);
            // An upload cannot go on in a new session, and is the only one.
            let has_had_turn = !session.is_uploading() && now - session.lease.held >= TURN;
            let may_give_way = idle >= TAKEOVER
                || self.gives_way(index, now, client)
                || (has_none && has_had_turn)
                || (has_none && id.is_some_and(|id| session::count_open(self.sessions, id.client) > 1));
            if may_give_way && victim.is_none_or(|(_, longest)| idle > longest) {
                victim = Some((index, idle));
            }
        }
        victim.map(|(index, _)| index)
    }

    /// The file of this session has given way: the time of its client begins with the next file that it opens.
    fn end_time(&mut self, index: usize) {
        let Some(id) = self.sessions.get(index).and_then(|session| session.id) else { return };
        for session in self.sessions.iter_mut() {
            if !session.is_open() && session.id.is_some_and(|other| other.client == id.client) {
                session.lease = Lease::NONE;
            }
        }
    }

    /// Whether an open file gives way to another client although it is in use.
    fn gives_way(&mut self, index: usize, now: Ticks, client: Peer) -> bool {
        let Some(session) = self.sessions.get_mut(index) else { return false };
        let (system, shared) = (client.address.system, &self.cx.shared);
        session.lease.is_slow(now)
            || session.id.is_some_and(|id| shared.takes_precedence::<F>(system, id.client.address.system))
    }

    /// Writes to the open file of a session.
    fn write(&mut self, index: usize, request: &Request<'_>) -> Result<Response, MavFtpErr> {
        let Some(session) = self.sessions.get(index) else { return Ok(Response::Dropped) };
        let client = request.session.client;
        match session.file.origin {
            Origin::Closed => Err(MavFtpErr::INVALIDSESSION),
            Origin::Hook { number, is_writable: true } if F::Vehicle::WRITES => {
                let mut bytes = [0; MAX_DATA];
                zero_extend(request.data, &mut bytes);
                let bytes = bytes.get(..usize::from(request.head.size)).unwrap_or_default();
                let (vehicle, mut context) = self.cx.hook();
                vehicle.write(&mut context, number, request.head.offset, bytes, client)?;
                Ok(Response::Answer(Content::Empty))
            }
            Origin::Upload(file) if V::UPLOADS => {
                if matches!(self.operation, Operation::BeginUpload { .. } | Operation::FinishUpload { .. }) {
                    // Nothing is taken that could not be finished.
                    return Ok(Response::Dropped);
                }
                match self.upload.take(self.cx, &file, self.content, request)? {
                    Taken::Dropped => Ok(Response::Dropped),
                    Taken::More => Ok(Response::Answer(Content::Empty)),
                    Taken::Last => {
                        self.abort_checksum();
                        self.upload.state = UploadState::Complete;
                        *self.operation = Operation::FinishUpload { client, file };
                        Ok(Response::Later)
                    }
                }
            }
            _ => Err(MavFtpErr::FILEPROTECTED),
        }
    }

    /// Begins a checksum. A repeated request does not restart the running checksum, and the answer carries the number
    /// of the last
    /// request: MAVSDK repeats a request with a new number, and takes only the answer with that number.
    fn begin_checksum(&mut self, index: usize, path: &[u8], from: Peer) -> Result<Response, MavFtpErr> {
        let mut path_crc = Crc32::new();
        path_crc.add(path);
        let path_crc = path_crc.sum();
        if let Operation::Checksum(running) = self.operation
            && running.session == index
        {
            // The client reads nothing while it waits for a checksum.
            if let Some(session) = self.sessions.get_mut(index) {
                session.drop_data();
            }
            if running.path_crc == path_crc {
                return Ok(Response::Later);
            }
            running.file.close(self.cx);
            *self.operation = Operation::Nothing;
        }
        let now = ticks(self.cx.now);
        if !self.has_checksum_turn(index, now, from) {
            if let Some(session) = self.sessions.get_mut(index) {
                session.checksum_refused = now;
            }
            return Ok(Response::Dropped);
        }
        // First: the vehicle may have no room for another open file.
        self.abort_checksum();
        if let Some(session) = self.sessions.get_mut(index) {
            session.checksum_began = now;
        }
        let may_upload = false;
        let file = File::open(self.cx, path, FileAccess::Read, from, may_upload)?;
        *self.operation = Operation::Checksum(Checksum::new(index, path_crc, now, file));
        Ok(Response::Later)
    }

    /// Whether a checksum of this session may begin: none is running, or one that has had its time or is of a system that is not in
    /// control; and of the clients that wait for one, none has waited for longer.
    fn has_checksum_turn(&self, index: usize, now: Ticks, from: Peer) -> bool {
        let running = match &*self.operation {
            Operation::Nothing => None,
            Operation::Checksum(running) => Some(running),
            _ => return false,
        };
        let (system, shared) = (from.address.system, &self.cx.shared);
        if let Some(running) = running {
            let holder = self.sessions.get(running.session).and_then(|session| session.id);
            let holder = holder.map_or(system, |id| id.client.address.system);
            if shared.takes_precedence::<F>(system, holder) {
                return true;
            }
            if now - running.began < CHECKSUM_TURN || shared.takes_precedence::<F>(holder, system) {
                return false;
            }
        }
        let last = self.sessions.get(index).map_or(now, |session| session.checksum_began);
        let waits = |other: &Session<V>| {
            let asked = other.checksum_refused;
            asked.0 > 0 && now - asked < TAKEOVER && now - other.checksum_began > now - last
        };
        !self.sessions.iter().any(waits)
    }

    /// Aborts a running checksum: opening and storing a file has priority.
    fn abort_checksum(&mut self) {
        if let Operation::Checksum(checksum) = self.operation {
            checksum.file.close(self.cx);
            *self.operation = Operation::Nothing;
            self.answer(Err(MavFtpErr::FAIL));
        }
    }

    /// Answers the request that began an operation, and those that wait for its end. Their client may be gone.
    fn answer(&mut self, result: Result<Content, MavFtpErr>) {
        let content = result.unwrap_or_else(Content::Refused);
        for session in self.sessions.iter_mut() {
            while let Some(answer) = session.answer_in(State::Running) {
                (answer.state, answer.content) = (State::Pending, content);
            }
        }
    }

    /// Runs a step of the operation. The last step answers the client.
    pub(super) fn run_operation(&mut self) {
        let result = match self.operation {
            Operation::Checksum(checksum) => {
                let (begin, now) = (checksum.offset, ticks(self.cx.now));
                let result = checksum.add_part(self.cx);
                if result.is_ready() {
                    checksum.file.close(self.cx);
                } else if checksum.offset == begin {
                    // The log has no data yet (LOG-9).
                    self.status.retry_at = self.cx.now + RETRY;
                } else if now - checksum.began < LONGEST_CHECKSUM
                    && let Some(session) = self.sessions.get_mut(checksum.session)
                    && !session.is_open()
                {
                    session.touched = now;
                }
                result.map_ok(Content::number)
            }
            &mut Operation::BeginUpload { client, file } if V::UPLOADS => self.begin_upload(client, file),
            Operation::FinishUpload { client, file } if V::UPLOADS => {
                let result = file.finish(self.cx, *client, self.content);
                match result {
                    // The next poll continues.
                    Poll::Pending if self.cx.shared.has_acted => {}
                    // It waits for storage.
                    Poll::Pending => self.status.retry_at = self.cx.now + RETRY,
                    Poll::Ready(Ok(())) => increment(&mut self.status.counters.uploads),
                    Poll::Ready(Err(_)) => {
                        increment(&mut self.status.counters.refused_uploads);
                        self.upload.state = UploadState::Refused;
                    }
                }
                result.map_ok(|()| Content::Empty)
            }
            _ => return,
        };
        if let Poll::Ready(result) = result {
            *self.operation = Operation::Nothing;
            self.answer(result);
        }
    }

    /// Asks the virtual directory for permission to upload a file.
    fn begin_upload(&mut self, client: Peer, file: V) -> Poll<Result<Content, MavFtpErr>> {
        let Some(index) = self.sessions.iter().position(Session::is_uploading) else {
            // The client has closed the file meanwhile.
            return Poll::Ready(Err(MavFtpErr::FAIL));
        };
        let result = file.begin(self.cx, client);
        match result {
            Poll::Pending => {}
            Poll::Ready(Ok(())) => self.upload.state = UploadState::Receiving,
            Poll::Ready(Err(_)) => self.close(index),
        }
        result.map_ok(|()| Content::number(0))
    }

    /// Whether a session has an upload that is not complete. A client whose upload was refused knows that.
    fn is_receiving(&self, index: usize) -> bool {
        V::UPLOADS
            && self.upload.state == UploadState::Receiving
            && self.sessions.get(index).is_some_and(Session::is_uploading)
    }

    /// Closes the file of a session, and drops its pending data and its pending checksum. An upload that is not complete is refused
    /// (F-31).
    fn close(&mut self, index: usize) {
        let is_receiving = self.is_receiving(index);
        let Some(session) = self.sessions.get_mut(index) else { return };
        session.drop_data();
        session.opened_by = None;
        session.file.close(self.cx);
        if is_receiving {
            self.upload.state = UploadState::Refused;
            increment(&mut self.status.counters.refused_uploads);
            if cfg!(feature = "plan-texts")
                && let Some(id) = session.id
            {
                let text = b"Upload ended early: nothing was changed";
                self.cx.texts.push(self.cx.now, LinkMask::of(id.client.link), MavSeverity::WARNING, text);
            }
        }
        if let Operation::Checksum(checksum) = self.operation
            && checksum.session == index
        {
            checksum.file.close(self.cx);
            *self.operation = Operation::Nothing;
        }
    }

    /// Ends the sessions of silent clients, and the upload if it has stalled (F-26).
    pub(super) fn end_silent_sessions(&mut self) {
        let now = ticks(self.cx.now);
        self.status.wake = Instant::NEVER;
        for index in 0..N {
            if !self.cx.shared.may_continue() {
                // The next poll continues.
                self.status.wake = Instant::ZERO;
                return;
            }
            let Some(session) = self.sessions.get(index) else { return };
            let (has_client, is_open, idle) = (session.id.is_some(), session.is_open(), session.idle_for(now));
            if idle >= IDLE {
                if is_open && has_client {
                    increment(&mut self.status.counters.timed_out);
                }
                self.close(index);
                if let Some(session) = self.sessions.get_mut(index) {
                    session.assign(None, Trust::None);
                }
                continue;
            }
            let mut left = IDLE - idle;
            if V::UPLOADS && session.is_uploading() {
                let is_in_control =
                    session.id.is_none_or(|id| self.cx.shared.may_change::<F>(id.client.address.system));
                if !is_in_control {
                    // Another system has taken control.
                    self.close(index);
                    continue;
                }
                let stalled = now - self.upload.grown;
                if stalled >= STALLED {
                    increment(&mut self.status.counters.timed_out);
                    self.close(index);
                } else {
                    left = left.min(STALLED - stalled);
                }
            }
            self.status.wake = self.status.wake.min(self.cx.now + session::duration(left));
        }
    }
}

/// Returns the change of the file system that a request asks for.
fn change_of<'a, F: Firmware<Vehicle: Files>>(
    path: &'a [u8],
    request: &Request<'a>,
) -> Result<FileChange<'a>, MavFtpErr> {
    match request.head.opcode {
        MavFtpOpcode::REMOVEFILE => Ok(FileChange::Remove(path)),
        MavFtpOpcode::TRUNCATEFILE => Ok(FileChange::Truncate { path, size: request.head.offset }),
        MavFtpOpcode::CREATEDIRECTORY => Ok(FileChange::CreateDirectory(path)),
        MavFtpOpcode::REMOVEDIRECTORY => Ok(FileChange::RemoveDirectory(path)),
        _ => {
            let second = request.data.splitn(2, |byte| *byte == 0).nth(1);
            let to = second.and_then(path::parse).filter(|to| !is_own::<F>(to)).ok_or(MavFtpErr::FAIL)?;
            Ok(FileChange::Rename { from: path, to })
        }
    }
}

/// Whether a path is the root, one of the stack's own, or that of a static file: no client changes it.
fn is_own<F: Firmware<Vehicle: Files>>(path: &[u8]) -> bool {
    path.is_empty() || path::is_virtual(path) || F::Vehicle::FILES.iter().any(|file| file.path.as_bytes() == path)
}
