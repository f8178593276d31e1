//! A server of the MAVLink file transfer protocol: files of the vehicle, and all parameters in one file.
//!
//! Implements the server's side of <https://mavlink.io/en/services/ftp.html>, rules F-1 to F-15, and `@PARAM/param.pck` (P-22).
//! Left out: the error FailErrno, and the swap of files that MAVLink defines without a user.
//!
//! A request is executed when it is received. Its answer is kept without data, in the client's session: the data is read when
//! the link has room. A repeated request is answered again, and not executed again. A session belongs to a client, a link and
//! the number that the client has chosen.
//!
//! ```text
//!                open                     close, or 10 s without a request and a packet of a burst
//!   nothing ───────────────▶ open ──────────────────────────────────────────────▶ nothing
//!                             │ ▲ burst                 another client opens after 3 s
//!                             └─┘
//! ```

mod packet;
mod path;
mod session;
mod vehicle;

pub use session::Session;
pub use vehicle::{FileAccess, FileChange, FileEntry, Files, OpenFile, StaticFile};

use core::marker::PhantomData;

use self::packet::{Body, Head, MAX_DATA, Request};
use self::session::{Answer, Open, State};
use super::param::{Pack, PackedParams};
use super::share::{COST_OF_BYTE, MAX_LATENESS, Share};
use super::{Cx, Handled, Received, Service, Turn, View, increment};
use crate::crc32::Crc32;
use crate::dialect::{FileTransferProtocol, MavFtpErr, MavFtpOpcode, MavProtocolCapability};
use crate::link::{Outbox, Port};
use crate::message::Message;
use crate::time::Instant;
use crate::types::{Firmware, Peer};

/// The directory of the parameters, and the file in it.
const PARAM_DIRECTORY: &[u8] = b"@PARAM";
const PARAM_FILE: &[u8] = b"param.pck";

/// How much of a file a poll adds to its checksum: so many bytes, so many times.
const CHECKED_AT_A_TIME: usize = 32;
const TIMES: u8 = 8;

/// Instead of the index of a static file: the directory of the parameters, and no static directory.
const PARAM_ENTRIES: u8 = 254;
const NO_ENTRIES: u8 = 255;
/// Instead of the number of a directory: the vehicle has none.
const NO_DIRECTORY: u16 = u16::MAX;

counters! {
    /// Counters of the file service. They wrap.
    FileCounters {
        /// Files that were opened.
        count opened,
        /// Uploads of parameters that were carried out.
        count uploads,
        /// Uploads of parameters that were refused as a whole.
        drop refused_uploads,
        /// Files that were not opened, because all sessions were in use.
        drop no_session,
        /// Sessions that ended because their client was silent for ten seconds.
        drop timed_out,
        /// Sessions that another client took over after three seconds.
        drop taken_over,
    }
}

/// The file service: declared by `files` in [`stack!`](crate::stack), and read through
/// [`Stack::files`](crate::Stack::files).
#[derive(Debug)]
pub struct FileStatus {
    /// The number of sessions that can be open at a time.
    open_limit: u8,
    /// Whether any session is used: otherwise there is nothing to do.
    is_used: bool,
    counters: FileCounters,
    work: Work,
    /// The upload of parameters: the bytes received, and what became of it.
    received: u16,
    upload: Upload,
}

impl FileStatus {
    /// Whether a poll has something to compute.
    #[cfg(test)]
    pub(crate) const fn is_working(&self) -> bool {
        !matches!(self.work, Work::Nothing)
    }

    /// Returns the counters.
    pub const fn counters(&self) -> FileCounters {
        self.counters
    }
}

/// The state of the upload of parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Upload {
    Running,
    /// It is complete, and the next poll sets the parameters.
    Complete,
    Done,
    Refused,
}

/// What takes more than one call: one at a time. `Nothing` is all zero bits, as in [`Open`].
#[derive(Clone, Copy, Debug)]
#[repr(u8)]
enum Work {
    Nothing,
    /// The checksum of a file.
    Checksum {
        session: u8,
        open: Open,
        offset: u32,
        crc: Crc32,
    },
    /// The upload of parameters is complete.
    Upload {
        session: u8,
        client: Peer,
    },
    /// The length of the file of parameters.
    Measure {
        session: u8,
        pack: Pack,
    },
}

/// Serves files: `OPEN` sessions at a time, `N` of them and of answers to others, uploads of parameters of up to `UPLOAD` bytes,
/// and the parameters of the service `P`.
#[derive(Debug)]
pub struct FileServer<const OPEN: usize, const N: usize, const UPLOAD: usize, P> {
    pub(crate) status: FileStatus,
    sessions: [Session; N],
    upload: [u8; UPLOAD],
    params: PhantomData<fn() -> P>,
}

/// The state of the service on a link.
#[derive(Debug)]
pub struct FileLink {
    share: Share,
    /// The session that is asked first for data.
    first: u8,
}

/// The service without the types of its size.
struct Server<'a> {
    status: &'a mut FileStatus,
    sessions: &'a mut [Session],
    upload: &'a mut [u8],
}

impl<F, P, const OPEN: usize, const N: usize, const UPLOAD: usize> Service<F> for FileServer<OPEN, N, UPLOAD, P>
where
    F: Firmware<Vehicle: Files>,
    P: PackedParams<F> + core::fmt::Debug,
{
    type Link = FileLink;
    const VACANT: FileLink = FileLink { share: Share::NEW, first: 0 };
    const CAPABILITIES: MavProtocolCapability = MavProtocolCapability::FTP;
    const NEW: Self = {
        assert!(OPEN > 0 && OPEN < 100, "a client needs a session: `files: {{ sessions: 2 }}`, or leave `files` out");
        assert!(UPLOAD < 65_536, "an upload of parameters has less than 65,536 bytes");
        StaticFile::check(F::Vehicle::FILES);
        Self {
            status: FileStatus {
                open_limit: 0,
                is_used: false,
                counters: FileCounters::ZERO,
                work: Work::Nothing,
                received: 0,
                upload: Upload::Running,
            },
            sessions: [Session::FREE; N],
            upload: [0; UPLOAD],
            params: PhantomData,
        }
    };

    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut FileLink>) {
        if !self.status.is_used {
            return;
        }
        let mut server = self.server();
        server.end_idle(cx);
        server.work::<F, P>(cx);
    }

    fn deadline(&self) -> Instant {
        if !matches!(self.status.work, Work::Nothing) {
            return Instant::ZERO;
        }
        self.sessions.iter().fold(Instant::NEVER, |due, session| due.min(session.ends_at()))
    }

    fn on_frame(&mut self, cx: &mut Cx<'_, F>, _: &mut Port, link: &mut FileLink, received: &Received<'_>) -> Handled {
        if received.frame.id() != FileTransferProtocol::ID {
            return Handled::No;
        }
        if received.target.system.0 == 0 {
            return Handled::OutOfPlace;
        }
        if !has_data(&self.sessions, received.from) {
            link.share.begin(cx.now);
        }
        self.server().on_packet::<F, P>(cx, received)
    }

    fn next(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, link: &mut FileLink, turn: Turn) -> bool {
        match turn {
            _ if !self.status.is_used => false,
            Turn::LateFileData if cx.now < link.share.due().after(MAX_LATENESS) => false,
            _ => self.server().send::<F, P>(cx, port, link, turn != Turn::FileAnswer),
        }
    }

    fn due(&self, view: &View<'_>, port: &Port, link: &FileLink, turn: Turn) -> Instant {
        let has_data = turn != Turn::FileAnswer;
        let is_pending = self.status.is_used
            && self.sessions.iter().any(|session| session.client.link == port.id && session.is_due(has_data));
        match turn {
            _ if !is_pending => Instant::NEVER,
            Turn::LateFileData => link.share.due().after(MAX_LATENESS),
            _ => view.now,
        }
    }

    #[cfg(feature = "defmt")]
    fn drops(&self) -> u32 {
        self.status.counters.drops()
    }

    #[cfg(feature = "defmt")]
    fn log_drops(&self) {
        defmt::warn!("files: {}", self.status.counters);
    }

    /// The clients are gone. The next poll closes their files.
    fn restart(&mut self, port: &Port, _: &mut FileLink) {
        for session in self.sessions.iter_mut().filter(|session| session.client.link == port.id) {
            session.is_gone = session.is_used;
            session.drop_data();
            session.forget_all();
        }
    }
}

impl<const OPEN: usize, const N: usize, const UPLOAD: usize, P> FileServer<OPEN, N, UPLOAD, P> {
    fn server(&mut self) -> Server<'_> {
        self.status.open_limit = u8::try_from(OPEN).unwrap_or(u8::MAX);
        Server { status: &mut self.status, sessions: &mut self.sessions, upload: &mut self.upload }
    }
}

/// Whether data is pending on the link of a client.
fn has_data(sessions: &[Session], client: Peer) -> bool {
    sessions.iter().any(|session| session.client.link == client.link && session.is_due(true))
}

/// Returns the number of a session.
fn short(place: usize) -> u8 {
    u8::try_from(place).unwrap_or(u8::MAX)
}

/// What a request that was executed is answered with: a value, or an error.
type Outcome = Result<u32, MavFtpErr>;

impl Server<'_> {
    /// Ends the sessions of silent clients.
    #[inline(never)]
    fn end_idle<F: Firmware<Vehicle: Files>>(&mut self, cx: &mut Cx<'_, F>) {
        self.status.is_used =
            self.sessions.iter().any(|session| session.is_used) || !matches!(self.status.work, Work::Nothing);
        for place in 0..self.sessions.len() {
            let Some(session) = self.sessions.get(place) else { return };
            if cx.now < session.ends_at() {
                continue;
            }
            if session.is_open() && !session.is_gone {
                increment(&mut self.status.counters.timed_out);
            }
            self.close(cx, place);
            if let Some(session) = self.sessions.get_mut(place) {
                session.free();
            }
        }
    }

    /// Closes what a session has open, and drops its data that is pending.
    #[inline(never)]
    fn close<F: Firmware<Vehicle: Files>>(&mut self, cx: &mut Cx<'_, F>, place: usize) {
        let Some(session) = self.sessions.get_mut(place) else { return };
        session.drop_data();
        session.opened_by = 0;
        let open = core::mem::replace(&mut session.open, Open::Nothing);
        close(cx, &open);
    }

    /// Handles a packet.
    #[inline(never)]
    fn on_packet<F, P>(&mut self, cx: &mut Cx<'_, F>, received: &Received<'_>) -> Handled
    where
        F: Firmware<Vehicle: Files>,
        P: PackedParams<F>,
    {
        self.status.is_used = true;
        let request = Request::of(received.frame.payload());
        if request.opcode.0 >= MavFtpOpcode::ACK.0 {
            // It is an answer, which has none.
            return Handled::Yes;
        }
        let Some(place) = session::find(self.sessions, received.from, request.session) else { return Handled::NoRoom };
        let digest = request.digest();
        let now = cx.now;
        let Some(session) = self.sessions.get_mut(place) else { return Handled::NoRoom };
        session.touched = now;
        let opens =
            matches!(request.opcode, MavFtpOpcode::OPENFILERO | MavFtpOpcode::OPENFILEWO | MavFtpOpcode::CREATEFILE);
        // Reads, bursts and resets are executed again, and so is an open whose file was closed since.
        let is_executed_again = match request.opcode {
            MavFtpOpcode::BURSTREADFILE | MavFtpOpcode::RESETSESSION => true,
            _ if opens => session.opened_by != digest,
            opcode => session::is_data(opcode),
        };
        if !is_executed_again && session.is_repeated(digest) {
            return Handled::Yes;
        }
        if request.opcode == MavFtpOpcode::BURSTREADFILE && session.is_open() && usize::from(request.size) <= MAX_DATA {
            if let Open::Params(pack) = &mut session.open {
                pack.set_block(request.wanted());
            }
            session.start_burst(now, &request, digest);
            return Handled::Yes;
        }
        if matches!(request.opcode, MavFtpOpcode::TERMINATESESSION | MavFtpOpcode::RESETSESSION) {
            session.drop_data();
        }
        if !session.has_room() {
            return Handled::NoRoom;
        }
        let outcome = if opens && session.opened_by == digest {
            // Its answer was forgotten.
            Some(Ok(session.size))
        } else {
            match request.opcode {
                _ if usize::from(request.size) > MAX_DATA => Some(Err(MavFtpErr::INVALIDDATASIZE)),
                MavFtpOpcode::NONE => Some(Ok(0)),
                MavFtpOpcode::TERMINATESESSION | MavFtpOpcode::RESETSESSION => {
                    self.end(cx, place, received.from, request.opcode == MavFtpOpcode::RESETSESSION);
                    Some(Ok(0))
                }
                MavFtpOpcode::READFILE => Some(self.start_read(place, &request)),
                MavFtpOpcode::WRITEFILE => match self.write::<F, P>(cx, place, &request) {
                    Err(Dropped) => return Handled::NoRoom,
                    Ok(outcome) => outcome,
                },
                MavFtpOpcode::BURSTREADFILE => Some(Err(MavFtpErr::INVALIDSESSION)),
                _ => match self.on_path::<F, P>(cx, place, &request, digest) {
                    Err(Dropped) => return Handled::NoRoom,
                    Ok(outcome) => outcome,
                },
            }
        };
        let (state, value, error) = match outcome {
            None => (State::Working, 0, MavFtpErr::NONE),
            Some(Ok(value)) => (State::Pending, value, MavFtpErr::NONE),
            Some(Err(error)) => (State::Pending, 0, error),
        };
        if error != MavFtpErr::NONE {
            event!("files: request {=u8} of {} refused: {=u8}", request.opcode.0, received.from, error.0);
        }
        let Request { opcode, seq, offset, .. } = request;
        let size = request.wanted();
        if let Some(session) = self.sessions.get_mut(place) {
            session.put(Answer { state, opcode, error, size, seq, offset, value, digest });
        }
        Handled::Yes
    }

    /// Ends a session, or all of a client on its link.
    fn end<F: Firmware<Vehicle: Files>>(&mut self, cx: &mut Cx<'_, F>, place: usize, client: Peer, all: bool) {
        for other in 0..self.sessions.len() {
            let is_its = self.sessions.get(other).is_some_and(|session| session.is_used && session.client == client);
            if other == place || (all && is_its) {
                self.close(cx, other);
            }
        }
    }

    /// Checks a request to read.
    fn start_read(&mut self, place: usize, request: &Request<'_>) -> Outcome {
        let open = self.sessions.get_mut(place).map(|session| &mut session.open);
        match open {
            Some(Open::Params(pack)) => pack.set_block(request.wanted()),
            Some(Open::Hook { .. } | Open::Static(_)) => {}
            Some(Open::Upload) => return Err(MavFtpErr::FAIL),
            Some(Open::Nothing) | None => return Err(MavFtpErr::INVALIDSESSION),
        }
        Ok(0)
    }

    /// Writes to a file. Returns `None` if the answer must be computed.
    #[inline(never)]
    fn write<F, P>(
        &mut self,
        cx: &mut Cx<'_, F>,
        place: usize,
        request: &Request<'_>,
    ) -> Result<Option<Outcome>, Dropped>
    where
        F: Firmware<Vehicle: Files>,
        P: PackedParams<F>,
    {
        let Some(session) = self.sessions.get(place) else { return Err(Dropped) };
        let written = match session.open {
            Open::Nothing => Err(MavFtpErr::INVALIDSESSION),
            Open::Hook { number, is_writable: true } if F::Vehicle::WRITES => write_hook(cx, number, request),
            Open::Upload if P::IS_WRITABLE => {
                let client = session.client;
                // Nothing is taken that could not be finished.
                if !matches!(self.status.work, Work::Nothing) {
                    return Err(Dropped);
                }
                match self.take_upload(request)? {
                    Ok(true) => {
                        self.status.upload = Upload::Complete;
                        self.status.work = Work::Upload { session: short(place), client };
                        return Ok(None);
                    }
                    taken => taken.map(|_| ()),
                }
            }
            _ => Err(MavFtpErr::FILEPROTECTED),
        };
        Ok(Some(written.map(|()| 0)))
    }

    /// Takes a part of the uploaded parameters, in order: a later one is dropped, and the client sends it again. Returns whether
    /// they are complete.
    fn take_upload(&mut self, request: &Request<'_>) -> Result<Result<bool, MavFtpErr>, Dropped> {
        if self.status.upload == Upload::Refused {
            return Ok(Err(MavFtpErr::FAIL));
        }
        let received = usize::from(self.status.received);
        let begin = usize::try_from(request.offset).unwrap_or(usize::MAX);
        let end = begin.saturating_add(usize::from(request.size));
        if end <= received {
            return Ok(Ok(false));
        }
        if begin > received {
            return Err(Dropped);
        }
        let Some(to) = self.upload.get_mut(begin..end).filter(|_| self.status.upload == Upload::Running) else {
            self.status.upload = Upload::Refused;
            return Ok(Err(MavFtpErr::FAIL));
        };
        to.fill(0);
        crate::message::zero_extend(request.data, to);
        self.status.received = u16::try_from(end).unwrap_or(u16::MAX);
        let Some([_, _, _, _, low, high]) = self.upload.get(..end).and_then(<[u8]>::first_chunk) else {
            return Ok(Ok(false));
        };
        Ok(Ok(end >= usize::from(u16::from_le_bytes([*low, *high]))))
    }

    /// Sets the uploaded parameters: all or none.
    fn finish_upload<F, P>(&mut self, cx: &mut Cx<'_, F>, client: Peer) -> Outcome
    where
        F: Firmware<Vehicle: Files>,
        P: PackedParams<F>,
    {
        let file = self.upload.get(..usize::from(self.status.received)).unwrap_or_default();
        if P::set_packed(cx, client, file) {
            increment(&mut self.status.counters.uploads);
            self.status.upload = Upload::Done;
            return Ok(0);
        }
        increment(&mut self.status.counters.refused_uploads);
        self.status.upload = Upload::Refused;
        Err(MavFtpErr::FAIL)
    }

    /// Handles a request with a path. Returns `None` if its answer must be computed.
    #[inline(never)]
    fn on_path<F, P>(
        &mut self,
        cx: &mut Cx<'_, F>,
        place: usize,
        request: &Request<'_>,
        digest: u32,
    ) -> Result<Option<Outcome>, Dropped>
    where
        F: Firmware<Vehicle: Files>,
        P: PackedParams<F>,
    {
        let Some(path) = path::of(request.data) else { return Ok(Some(Err(MavFtpErr::FILENOTFOUND))) };
        let change = match request.opcode {
            MavFtpOpcode::LISTDIRECTORY | MavFtpOpcode::LISTDIRECTORYWITHTIME => {
                return Ok(Some(directory::<F, P>(cx, path)));
            }
            MavFtpOpcode::OPENFILERO | MavFtpOpcode::OPENFILEWO | MavFtpOpcode::CREATEFILE => {
                return self.open::<F, P>(cx, place, request.opcode, path, digest);
            }
            MavFtpOpcode::CALCFILECRC => {
                if !matches!(self.status.work, Work::Nothing) {
                    return Err(Dropped);
                }
                let (open, _) = match open::<F, P>(cx, path, FileAccess::Read, false) {
                    Ok(opened) => opened,
                    Err(error) => return Ok(Some(Err(error))),
                };
                self.status.work = Work::Checksum { session: short(place), open, offset: 0, crc: Crc32::ZERO };
                return Ok(None);
            }
            MavFtpOpcode::REMOVEFILE
            | MavFtpOpcode::TRUNCATEFILE
            | MavFtpOpcode::CREATEDIRECTORY
            | MavFtpOpcode::REMOVEDIRECTORY
            | MavFtpOpcode::RENAME
                if !F::Vehicle::WRITES =>
            {
                return Ok(Some(Err(MavFtpErr::FILEPROTECTED)));
            }
            MavFtpOpcode::REMOVEFILE => FileChange::Remove(path),
            MavFtpOpcode::TRUNCATEFILE => FileChange::Truncate { path, size: request.offset },
            MavFtpOpcode::CREATEDIRECTORY => FileChange::CreateDirectory(path),
            MavFtpOpcode::REMOVEDIRECTORY => FileChange::RemoveDirectory(path),
            MavFtpOpcode::RENAME => {
                let second = request.data.iter().position(|byte| *byte == 0).and_then(|end| request.data.get(end..));
                match second.and_then(|rest| path::of(rest.get(1..)?)) {
                    Some(to) if !is_virtual(to) && !to.is_empty() => FileChange::Rename { from: path, to },
                    _ => return Ok(Some(Err(MavFtpErr::FAIL))),
                }
            }
            _ => return Ok(Some(Err(MavFtpErr::UNKNOWNCOMMAND))),
        };
        let is_own = is_virtual(path) || F::Vehicle::FILES.iter().any(|file| file.path.as_bytes() == path);
        if is_own {
            return Ok(Some(Err(MavFtpErr::FILEPROTECTED)));
        }
        let (vehicle, mut context) = cx.hook();
        Ok(Some(vehicle.change(&mut context, change).map(|()| 0)))
    }

    /// Opens a file in a session (F-6).
    fn open<F, P>(
        &mut self,
        cx: &mut Cx<'_, F>,
        place: usize,
        opcode: MavFtpOpcode,
        path: &[u8],
        digest: u32,
    ) -> Result<Option<Outcome>, Dropped>
    where
        F: Firmware<Vehicle: Files>,
        P: PackedParams<F>,
    {
        let now = cx.now;
        // A client that opens another file does not close the one before, or its request to do so was lost.
        self.close(cx, place);
        let open_count =
            self.sessions.iter().fold(0u8, |count, session| count.saturating_add(u8::from(session.is_open())));
        let mut victim = None;
        if open_count >= self.status.open_limit {
            victim = session::victim(self.sessions, now);
            if victim.is_none() {
                increment(&mut self.status.counters.no_session);
                return Ok(Some(Err(MavFtpErr::NOSESSIONSAVAILABLE)));
            }
        }
        let access = match opcode {
            MavFtpOpcode::OPENFILERO => FileAccess::Read,
            MavFtpOpcode::OPENFILEWO => FileAccess::Write,
            _ => FileAccess::Create,
        };
        let uploading = self.sessions.iter().position(|session| matches!(session.open, Open::Upload));
        let may_upload = !self.upload.is_empty() && uploading.is_none_or(|place| Some(place) == victim);
        let (opened, size) = match open::<F, P>(cx, path, access, may_upload) {
            Ok(opened) => opened,
            Err(error) => return Ok(Some(Err(error))),
        };
        let mut size = Some(size);
        if let Open::Params(pack) = opened {
            if !matches!(self.status.work, Work::Nothing) {
                return Err(Dropped);
            }
            self.status.work = Work::Measure { session: short(place), pack };
            size = None;
        }
        if let Some(victim) = victim {
            increment(&mut self.status.counters.taken_over);
            self.close(cx, victim);
        }
        if matches!(opened, Open::Upload) {
            (self.status.received, self.status.upload) = (0, Upload::Running);
        }
        increment(&mut self.status.counters.opened);
        if let Some(session) = self.sessions.get_mut(place) {
            (session.open, session.opened_by, session.size) = (opened, digest, size.unwrap_or(0));
            session.forget_answers();
        }
        Ok(size.map(Ok))
    }

    /// Does a step of what takes more than one call.
    #[inline(never)]
    fn work<F, P>(&mut self, cx: &mut Cx<'_, F>)
    where
        F: Firmware<Vehicle: Files>,
        P: PackedParams<F>,
    {
        let (session, outcome) = match &mut self.status.work {
            Work::Nothing => return,
            Work::Upload { session, client } => {
                let (session, client) = (*session, *client);
                (session, self.finish_upload::<F, P>(cx, client))
            }
            Work::Measure { session, pack } => match P::measure_packed(cx, pack) {
                None => return,
                Some(size) => (*session, Ok(size)),
            },
            Work::Checksum { session, open, offset, crc } => {
                let Some(outcome) = add_to_checksum::<F, P>(cx, open, offset, crc) else { return };
                close(cx, open);
                (*session, outcome)
            }
        };
        self.status.work = Work::Nothing;
        let Some(session) = self.sessions.get_mut(usize::from(session)) else { return };
        // Its client may have gone meanwhile.
        let Some(answer) = session.working() else { return };
        answer.state = State::Pending;
        match outcome {
            Ok(value) => answer.value = value,
            Err(error) => answer.error = error,
        }
        if answer.opcode == MavFtpOpcode::OPENFILERO {
            session.size = answer.value;
        }
    }

    /// Sends an answer with or without data. Data is sent by the link's sessions by turns, what was read or listed before the
    /// packets of bursts.
    #[inline(never)]
    fn send<F, P>(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, link: &mut FileLink, has_data: bool) -> bool
    where
        F: Firmware<Vehicle: Files>,
        P: PackedParams<F>,
    {
        let is_it = |session: &Session| session.client.link == port.id && session.is_due(has_data);
        // From the one behind the last one on, then from the beginning.
        let mut chosen = None;
        let mut place = 0u8;
        for session in self.sessions.iter() {
            if is_it(session) && (chosen.is_none() || (place >= link.first && chosen < Some(link.first))) {
                chosen = Some(place);
            }
            place = place.wrapping_add(1);
        }
        let Some(place) = chosen else { return false };
        let Some(session) = self.sessions.get_mut(usize::from(place)) else { return false };
        let is_sent = send::<F, P>(cx, &mut port.outbox, session, has_data);
        if is_sent && has_data {
            link.first = place.wrapping_add(1);
            let len = u32::try_from(port.outbox.len()).unwrap_or(0);
            link.share.spend_all(cx.now, len.saturating_mul(COST_OF_BYTE), port.config.bytes_per_second);
        }
        is_sent
    }
}

/// The request is dropped without effect, and the client sends it again.
struct Dropped;

/// Sends the oldest pending answer of a session, or the next packet of its burst (F-8).
#[inline(never)]
fn send<F, P>(cx: &mut Cx<'_, F>, outbox: &mut Outbox, session: &mut Session, has_data: bool) -> bool
where
    F: Firmware<Vehicle: Files>,
    P: PackedParams<F>,
{
    let place = session.pending(has_data);
    let Answer { opcode, size, offset, value, error, seq, .. } = session.next_answer(place);
    // A burst that takes too long is cut off.
    let mut is_last = cx.now >= session.burst.until;
    let mut sent = 0;
    let (to, open) = (session.client.address, &mut session.open);
    let head = Head { to, seq, session: session.number, opcode, offset };
    let is_sent = outbox.compose(const { &FileTransferProtocol::INFO }, |payload| {
        let data = packet::data(payload);
        let body = match opcode {
            _ if error != MavFtpErr::NONE => Body::Refused(error),
            MavFtpOpcode::READFILE | MavFtpOpcode::BURSTREADFILE => {
                read::<F, P>(cx, open, offset, data.get_mut(..usize::from(size)).unwrap_or_default())
            }
            _ if session::is_data(opcode) => {
                list::<F, P>(cx, value, offset, opcode == MavFtpOpcode::LISTDIRECTORYWITHTIME, data)
            }
            MavFtpOpcode::OPENFILERO
            | MavFtpOpcode::OPENFILEWO
            | MavFtpOpcode::CREATEFILE
            | MavFtpOpcode::CALCFILECRC => Body::Data(crate::message::zero_extend(&value.to_le_bytes(), data)),
            _ => Body::Data(0),
        };
        let mut ends = is_last;
        match body {
            Body::Data(len) => {
                // A short packet is the last one. The end of the file is said once more behind it.
                ends |= len < usize::from(size);
                sent = u32::try_from(len).unwrap_or(0);
            }
            _ => (is_last, ends) = (true, true),
        }
        packet::complete(payload, &head, &body, ends && opcode == MavFtpOpcode::BURSTREADFILE)
    });
    if !is_sent {
        return false;
    }
    if let Some(answer) = place.and_then(|place| session.answers.get_mut(place)) {
        answer.state = State::Sent;
    } else {
        session.burst.seq = seq.wrapping_add(1);
        session.burst.offset = offset.saturating_add(sent);
        session.burst.is_active = !is_last;
        session.touched = cx.now;
    }
    true
}

/// Adds the next part of a file to its checksum. Returns the checksum at its end. Not inlined: the part needs a buffer.
#[inline(never)]
fn add_to_checksum<F, P>(cx: &mut Cx<'_, F>, open: &mut Open, offset: &mut u32, crc: &mut Crc32) -> Option<Outcome>
where
    F: Firmware<Vehicle: Files>,
    P: PackedParams<F>,
{
    let mut bytes = [0; CHECKED_AT_A_TIME];
    for _ in 0..TIMES {
        match read::<F, P>(cx, open, *offset, &mut bytes) {
            Body::Later => return None,
            Body::Refused(MavFtpErr::EOF) => return Some(Ok(!crc.sum())),
            Body::Refused(error) => return Some(Err(error)),
            Body::Data(len) => {
                crc.add(bytes.get(..len).unwrap_or_default());
                *offset = offset.saturating_add(u32::try_from(len).unwrap_or(0));
            }
        }
    }
    None
}

/// Writes to a file of the vehicle. Not inlined: the zeros that MAVLink 2 does not send need a buffer.
#[inline(never)]
fn write_hook<F: Firmware<Vehicle: Files>>(
    cx: &mut Cx<'_, F>,
    number: u16,
    request: &Request<'_>,
) -> Result<(), MavFtpErr> {
    let mut bytes = [0; MAX_DATA];
    crate::message::zero_extend(request.data, &mut bytes);
    let bytes = bytes.get(..usize::from(request.size)).unwrap_or_default();
    let (vehicle, mut context) = cx.hook();
    vehicle.write(&mut context, number, request.offset, bytes)
}

/// Closes a file of the vehicle.
fn close<F: Firmware<Vehicle: Files>>(cx: &mut Cx<'_, F>, open: &Open) {
    if let Open::Hook { number, .. } = *open {
        let (vehicle, mut context) = cx.hook();
        vehicle.close(&mut context, number);
    }
}

/// Whether a path is one of the stack's own.
fn is_virtual(path: &[u8]) -> bool {
    path.first() == Some(&b'@')
}

/// Opens a file: returns it and its size.
#[inline(never)]
fn open<F, P>(cx: &mut Cx<'_, F>, path: &[u8], access: FileAccess, may_upload: bool) -> Result<(Open, u32), MavFtpErr>
where
    F: Firmware<Vehicle: Files>,
    P: PackedParams<F>,
{
    let is_read = access == FileAccess::Read;
    if P::EXISTS
        && let Some(query) = path.strip_prefix(b"@PARAM/param.pck")
        && matches!(query, [] | [b'?', ..])
    {
        if !is_read {
            let may_upload = P::IS_WRITABLE && may_upload && query.is_empty();
            return if may_upload { Ok((Open::Upload, 0)) } else { Err(MavFtpErr::FILEPROTECTED) };
        }
        let count = P::packed_count(cx);
        let pack = Pack::open(query.get(1..).unwrap_or_default(), count);
        return pack.map(|pack| (Open::Params(pack), 0)).ok_or(MavFtpErr::FAIL);
    }
    if path.is_empty() || is_virtual(path) {
        return Err(MavFtpErr::FILENOTFOUND);
    }
    if !is_read && !F::Vehicle::WRITES {
        return Err(MavFtpErr::FILEPROTECTED);
    }
    let found = F::Vehicle::FILES.iter().position(|file| file.path.as_bytes() == path);
    if let Some((index, file)) = found.and_then(|index| Some((index, F::Vehicle::FILES.get(index)?))) {
        if !is_read {
            return Err(MavFtpErr::FILEPROTECTED);
        }
        let size = u32::try_from(file.bytes.len()).unwrap_or(u32::MAX);
        return Ok((Open::Static(u8::try_from(index).unwrap_or(u8::MAX)), size));
    }
    let (vehicle, mut context) = cx.hook();
    let OpenFile { number, size } = vehicle.open(&mut context, path, access)?;
    Ok((Open::Hook { number, is_writable: !is_read }, size))
}

/// Reads from a file.
#[inline(never)]
fn read<F, P>(cx: &mut Cx<'_, F>, open: &mut Open, offset: u32, out: &mut [u8]) -> Body
where
    F: Firmware<Vehicle: Files>,
    P: PackedParams<F>,
{
    let len = match open {
        Open::Hook { number, .. } => match cx.vehicle.read(*number, offset, out) {
            Ok(len) => len.min(out.len()),
            Err(error) => return Body::Refused(error),
        },
        Open::Static(index) => {
            let bytes = F::Vehicle::FILES.get(usize::from(*index)).map(|file| file.bytes).unwrap_or_default();
            let rest = usize::try_from(offset).ok().and_then(|offset| bytes.get(offset..)).unwrap_or_default();
            crate::message::zero_extend(rest, out)
        }
        Open::Params(pack) => match P::read_packed(cx, pack, offset, out) {
            Some(len) => len,
            None => return Body::Later,
        },
        Open::Nothing | Open::Upload => return Body::Refused(MavFtpErr::INVALIDSESSION),
    };
    if len == 0 { Body::Refused(MavFtpErr::EOF) } else { Body::Data(len) }
}

/// Returns the number that stands for a directory: a static file that is in or below it, the length of the path, and the
/// vehicle's number.
#[inline(never)]
fn directory<F, P>(cx: &mut Cx<'_, F>, path: &[u8]) -> Outcome
where
    F: Firmware<Vehicle: Files>,
    P: PackedParams<F>,
{
    let mut place = NO_ENTRIES;
    let mut number = NO_DIRECTORY;
    if P::EXISTS && path == PARAM_DIRECTORY {
        place = PARAM_ENTRIES;
    } else if !is_virtual(path) {
        let found = if path.is_empty() { Some(0) } else { path::directory(F::Vehicle::FILES, path) };
        place = found.and_then(|index| u8::try_from(index).ok()).unwrap_or(NO_ENTRIES);
        number = cx.vehicle.directory(path).unwrap_or(NO_DIRECTORY);
    }
    if place == NO_ENTRIES && number == NO_DIRECTORY {
        return Err(MavFtpErr::FILENOTFOUND);
    }
    let [low, high] = number.to_le_bytes();
    Ok(u32::from_le_bytes([place, u8::try_from(path.len()).unwrap_or(0), low, high]))
}

/// Writes the entries of a directory from an index on: as many as there is room for (F-9).
#[inline(never)]
fn list<F, P>(cx: &mut Cx<'_, F>, directory: u32, first: u32, has_time: bool, out: &mut [u8]) -> Body
where
    F: Firmware<Vehicle: Files>,
    P: PackedParams<F>,
{
    let mut len = 0usize;
    let mut index = first;
    while let Some(entry) = entry_of::<F, P>(cx, directory, index) {
        let Some(written) = write_entry(&entry, has_time, out.get_mut(len..).unwrap_or_default()) else { break };
        len = len.saturating_add(written);
        index = index.saturating_add(1);
    }
    if len == 0 { Body::Refused(MavFtpErr::EOF) } else { Body::Data(len) }
}

/// Returns an entry of a directory.
fn entry_of<'a, F, P>(cx: &'a mut Cx<'_, F>, directory: u32, index: u32) -> Option<FileEntry<'a>>
where
    F: Firmware<Vehicle: Files>,
    P: PackedParams<F>,
{
    let [place, path_len, low, high] = directory.to_le_bytes();
    if place == PARAM_ENTRIES {
        let size = u32::from(P::packed_count(cx)).saturating_mul(12);
        return (index == 0).then_some(FileEntry { name: PARAM_FILE, size: Some(size), time: 0 });
    }
    let mut index = index;
    if place != NO_ENTRIES {
        let files = F::Vehicle::FILES;
        let path = files.get(usize::from(place)).and_then(|file| file.path.as_bytes().get(..usize::from(path_len)));
        match path::entry(files, path.unwrap_or_default(), index) {
            Ok((name, file)) => {
                let size = file.map(|file| u32::try_from(file.bytes.len()).unwrap_or(u32::MAX));
                return Some(FileEntry { name, size, time: 0 });
            }
            Err(count) => index = index.saturating_sub(count),
        }
        if P::EXISTS && path_len == 0 {
            match index.checked_sub(1) {
                None => return Some(FileEntry { name: PARAM_DIRECTORY, size: None, time: 0 }),
                Some(rest) => index = rest,
            }
        }
    }
    let number = u16::from_le_bytes([low, high]);
    if number == NO_DIRECTORY {
        return None;
    }
    cx.vehicle.entry(number, u16::try_from(index).ok()?)
}

/// Writes an entry. Returns its length; `None` if there is no room for it.
#[inline(never)]
fn write_entry(entry: &FileEntry<'_>, has_time: bool, out: &mut [u8]) -> Option<usize> {
    let mut len = 0usize;
    let mut push = |byte: u8| {
        *out.get_mut(len)? = byte;
        len = len.saturating_add(1);
        Some(())
    };
    if entry.name.len() > 200 {
        // It is skipped.
        push(b'S')?;
        push(0)?;
        return Some(len);
    }
    push(if entry.size.is_some() { b'F' } else { b'D' })?;
    for byte in entry.name {
        push(*byte)?;
    }
    let numbers = [entry.size.or(has_time.then_some(0)), has_time.then_some(entry.time)];
    for number in numbers.into_iter().flatten() {
        push(b'\t')?;
        let mut divisor = 1_000_000_000u32;
        while divisor > 0 {
            let digits = number.checked_div(divisor).unwrap_or(0);
            if digits > 0 || divisor == 1 {
                push(b'0'.wrapping_add(u8::try_from(digits.checked_rem(10).unwrap_or(0)).unwrap_or(0)))?;
            }
            divisor = divisor.checked_div(10).unwrap_or(0);
        }
    }
    push(0)?;
    Some(len)
}
