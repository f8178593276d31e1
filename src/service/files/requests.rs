//! Executes requests when they are received (F-1 to F-7, F-13).

use super::list::directory;
use super::open::{close, is_virtual, open};
use super::packet::{MAX_DATA, Request};
use super::session::{self, Answer, BURST, IDLE, Key, Open, REPEAT, STALLED, Session, State, TAKEOVER};
use super::virtual_files::VirtualFiles;
use super::work::{Upload, Work};
use super::{FileAccess, FileChange, Files, OTHERS, Outcome, Server, path, short};
use crate::dialect::{MavFtpErr, MavFtpOpcode, MavSeverity};
use crate::service::{Handled, Received, increment};
use crate::time::{Duration, Instant};
use crate::types::{Firmware, LinkMask, Peer};

/// The reason for no value: an error, or one of two others. One word, so that a `Result` of it fits into registers.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) struct Stop(pub(super) u32);

impl Stop {
    /// It takes more than this call.
    pub(super) const LATER: Self = Self(256);
    /// The request is not carried out, and the client sends it again.
    pub(super) const DROPPED: Self = Self(257);

    /// Returns the error, if it is one.
    pub(super) fn error(self) -> Option<MavFtpErr> {
        u8::try_from(self.0).ok().map(MavFtpErr)
    }
}

impl From<MavFtpErr> for Stop {
    fn from(error: MavFtpErr) -> Self {
        Self(u32::from(error.0))
    }
}

/// Sets of operations, a bit for each: the least code to tell them apart.
const OPENS: u32 = set(&[MavFtpOpcode::OPENFILERO, MavFtpOpcode::OPENFILEWO, MavFtpOpcode::CREATEFILE]);
const BURSTS: u32 = set(&[MavFtpOpcode::BURSTREADFILE]);
/// Executed again when they are repeated.
const READS: u32 = set(&[MavFtpOpcode::READFILE, MavFtpOpcode::LISTDIRECTORY, MavFtpOpcode::LISTDIRECTORYWITHTIME]);
/// Executed again too: one that is running continues.
const CHECKSUMS: u32 = set(&[MavFtpOpcode::CALCFILECRC]);
const WRITES: u32 = set(&[MavFtpOpcode::WRITEFILE]);
const ENDS: u32 = set(&[MavFtpOpcode::TERMINATESESSION]);
const RESETS: u32 = set(&[MavFtpOpcode::RESETSESSION]);
/// A client awaits the answer to a change before it sends another request, so only its last request can be a repeat.
const CHANGES: u32 = set(&[
    MavFtpOpcode::REMOVEFILE,
    MavFtpOpcode::TRUNCATEFILE,
    MavFtpOpcode::CREATEDIRECTORY,
    MavFtpOpcode::REMOVEDIRECTORY,
    MavFtpOpcode::RENAME,
]);

#[allow(clippy::as_conversions, reason = "lossless: `u32::from` is not const")]
const fn set(mut opcodes: &[MavFtpOpcode]) -> u32 {
    let mut set = 0;
    while let [opcode, rest @ ..] = opcodes {
        set |= 1u32.wrapping_shl(opcode.0 as u32);
        opcodes = rest;
    }
    set
}

impl<F: Firmware<Vehicle: Files>, V: VirtualFiles<F>, const N: usize> Server<'_, '_, F, V, N> {
    /// Ends the sessions of silent clients, and the upload if it has stalled (F-26). If a session is given, closes all
    /// files of its client.
    pub(super) fn end(&mut self, of: Option<Key>) {
        let now = self.cx.now.coarse();
        let mut left = u32::MAX;
        for place in 0..self.sessions.len() {
            let Some(session) = self.sessions.get(place) else { break };
            let idle_for = session.idle_for(now);
            let has_ended = idle_for >= IDLE;
            if has_ended {
                if session.is_open() && !session.is_gone() {
                    increment(&mut self.status.counters.timed_out);
                }
            } else {
                left = left.min(IDLE.wrapping_sub(idle_for));
                let mut closes = of.is_some_and(|key| session.key.has_client_of(key));
                if V::UPLOADS && session.is_uploading() {
                    match STALLED.checked_sub(now.wrapping_sub(self.status.grown)) {
                        Some(rest @ 1..) => left = left.min(rest),
                        _ => {
                            increment(&mut self.status.counters.timed_out);
                            closes = true;
                        }
                    }
                }
                if !closes {
                    continue;
                }
            }
            self.close(place);
            if let Some(session) = self.sessions.get_mut(place).filter(|_| has_ended) {
                session.begin(Key::FREE);
            }
        }
        self.status.is_used = left != u32::MAX;
        // Without a session, in fifty days.
        self.status.wake = self.cx.now + Duration::from_micros(u64::from(left).wrapping_shl(10));
    }

    /// Closes the file of a session, and drops its pending data and its pending checksum. Returns false if it was an upload that
    /// is not whole: it is refused (F-31).
    pub(super) fn close(&mut self, place: usize) -> bool {
        let Some(session) = self.sessions.get_mut(place) else { return true };
        session.drop_data();
        session.opened_by = 0;
        let open = core::mem::replace(&mut session.open, Open::Nothing);
        let link = session.key.client().link;
        close(self.cx, &open);
        // A client whose upload was refused before knows it.
        let is_whole = !(V::UPLOADS && matches!(open, Open::Upload(_))) || self.status.upload != Upload::Running;
        if !is_whole {
            self.status.upload = Upload::Refused;
            increment(&mut self.status.counters.refused_uploads);
            if cfg!(feature = "plan-texts") {
                let text = b"Upload ended early: nothing was changed";
                self.cx.texts.push(self.cx.now, LinkMask::of(link), MavSeverity::WARNING, text);
            }
        }
        if let Work::Checksum { session, .. } = self.work
            && usize::from(*session) == place
        {
            self.end_checksum();
        }
        is_whole
    }

    /// Handles a packet.
    pub(super) fn on_packet(&mut self, received: &Received<'_>) -> Handled {
        let request = Request::of(received.frame.payload());
        let Request { head, digest, .. } = request;
        let opcode = head.opcode;
        if opcode.0 >= MavFtpOpcode::ACK.0 {
            // It is an answer, which has none.
            return Handled::Yes;
        }
        let key = Key::of(received.from, request.session);
        let now = self.cx.now.coarse();
        let found = session::find(self.sessions, key, now);
        let Some((place, session)) = found.and_then(|place| Some((place, self.sessions.get_mut(place)?))) else {
            return Handled::NoRoom;
        };
        if now.wrapping_sub(session.touched) >= REPEAT {
            session.opened_by = 0;
            session.forget_sent(true, true);
        }
        session.touched = now;
        (self.status.is_used, self.status.wake) = (true, Instant::ZERO);
        let bit = 1u32.checked_shl(opcode.0.into()).unwrap_or(0);
        let is = |set: u32| bit & set != 0;
        let (opens, is_burst, is_data) = (is(OPENS), is(BURSTS), is(READS | BURSTS));
        // An open whose file was closed since is executed again.
        let is_executed_again = is(READS | CHECKSUMS | RESETS) || (opens && session.opened_by != digest);
        let is_last = F::Vehicle::WRITES && is(CHANGES);
        if !is_executed_again && session.is_repeated(digest, is_last) {
            return Handled::Yes;
        }
        if is(ENDS | RESETS) {
            session.drop_data();
        } else if is(READS | BURSTS | WRITES) {
            // Until this session is used, a late repeat of the end of the one before does not end it.
            session.forget_sent(true, false);
        }
        let is_too_long = usize::from(head.size) > MAX_DATA;
        let mut room = session.room();
        if is_burst {
            session.burst_began = now;
            room = Some(BURST);
        }
        let Some(room) = room else { return Handled::NoRoom };
        let outcome = match opcode {
            // Its answer was forgotten.
            _ if opens && session.opened_by == digest => Ok(session.size),
            _ if is_too_long => Err(MavFtpErr::INVALIDDATASIZE.into()),
            MavFtpOpcode::NONE => Ok(0),
            MavFtpOpcode::TERMINATESESSION => {
                // The client must not take its upload for stored.
                if self.close(place) { Ok(0) } else { Err(MavFtpErr::FAIL.into()) }
            }
            MavFtpOpcode::RESETSESSION => {
                self.end(Some(key));
                Ok(0)
            }
            MavFtpOpcode::READFILE | MavFtpOpcode::BURSTREADFILE => match &mut session.open {
                Open::Virtual(file) => {
                    file.begin_to_read(head.wanted());
                    Ok(0)
                }
                Open::Hook { .. } | Open::Static(_) => Ok(0),
                Open::Upload(_) => Err(MavFtpErr::FAIL.into()),
                Open::Nothing => Err(MavFtpErr::INVALIDSESSION.into()),
            },
            MavFtpOpcode::WRITEFILE => self.write(place, &request),
            // Not by `on_path`, whose frame would be on the call stack too.
            _ if opens => self.open(place, &request, received.from),
            _ => self.on_path(place, &request, received.from),
        };
        let (is_refused, value) = match outcome {
            Ok(value) => (false, value),
            Err(Stop(why)) => (true, why),
        };
        let mut answer = Answer { state: State::Pending, is_refused, head, value, digest };
        if is_refused {
            match Stop(value) {
                Stop::DROPPED => return Handled::NoRoom,
                Stop::LATER => (answer.state, answer.is_refused) = (State::Working, false),
                _ => event!("files: request {=u8} of {} refused: {=u32}", opcode.0, received.from, value),
            }
        } else if is_data {
            answer.state = State::Data;
        }
        answer.head.size = head.wanted();
        if let Some(session) = self.sessions.get_mut(place) {
            session.put(room, answer);
        }
        Handled::Yes
    }

    /// Handles a request with a path, except those that open a file.
    fn on_path(&mut self, place: usize, request: &Request<'_>, from: Peer) -> Outcome {
        let Some(path) = path::of(request.data) else { return Err(MavFtpErr::FILENOTFOUND.into()) };
        let change = match request.head.opcode {
            MavFtpOpcode::LISTDIRECTORY | MavFtpOpcode::LISTDIRECTORYWITHTIME => {
                return directory::<F, V>(self.cx, path);
            }
            MavFtpOpcode::CALCFILECRC => return self.begin_checksum(place, path, from),
            MavFtpOpcode::REMOVEFILE
            | MavFtpOpcode::TRUNCATEFILE
            | MavFtpOpcode::CREATEDIRECTORY
            | MavFtpOpcode::REMOVEDIRECTORY
            | MavFtpOpcode::RENAME
                if !F::Vehicle::WRITES =>
            {
                return Err(MavFtpErr::FILEPROTECTED.into());
            }
            MavFtpOpcode::REMOVEFILE => FileChange::Remove(path),
            MavFtpOpcode::TRUNCATEFILE => FileChange::Truncate { path, size: request.head.offset },
            MavFtpOpcode::CREATEDIRECTORY => FileChange::CreateDirectory(path),
            MavFtpOpcode::REMOVEDIRECTORY => FileChange::RemoveDirectory(path),
            MavFtpOpcode::RENAME => {
                let second = request.data.iter().position(|byte| *byte == 0).and_then(|end| request.data.get(end..));
                match second.and_then(|rest| path::of(rest.get(1..)?)) {
                    Some(to) if !is_own::<F>(to) => FileChange::Rename { from: path, to },
                    _ => return Err(MavFtpErr::FAIL.into()),
                }
            }
            _ => return Err(MavFtpErr::UNKNOWNCOMMAND.into()),
        };
        if is_own::<F>(path) {
            return Err(MavFtpErr::FILEPROTECTED.into());
        }
        let (vehicle, mut context) = self.cx.hook();
        vehicle.change(&mut context, change, from)?;
        Ok(0)
    }

    /// Opens a file in a session (F-6).
    fn open(&mut self, place: usize, request: &Request<'_>, from: Peer) -> Outcome {
        let Some(path) = path::of(request.data) else { return Err(MavFtpErr::FILENOTFOUND.into()) };
        let access = match request.head.opcode {
            MavFtpOpcode::OPENFILERO => FileAccess::Read,
            MavFtpOpcode::OPENFILEWO => FileAccess::Write,
            _ => FileAccess::Create,
        };
        // A client that opens another file does not close the one before, or its request to do so was lost. If nothing has arrived
        // of an upload, it asks again with another number.
        if self.status.received == 0 && self.sessions.get(place).is_some_and(Session::is_uploading) {
            self.status.upload = Upload::Refused;
        }
        self.close(place);
        let mut not_open = 0usize;
        self.sessions.iter().for_each(|session| not_open = not_open.wrapping_add(usize::from(!session.is_open())));
        if not_open <= OTHERS {
            let now = self.cx.now.coarse();
            let is_idle = |place: &usize| self.sessions.get(*place).is_some_and(|open| open.idle_for(now) >= TAKEOVER);
            let Some(victim) = session::oldest(self.sessions, true, now).filter(is_idle) else {
                increment(&mut self.status.counters.no_session);
                return Err(MavFtpErr::NOSESSIONSAVAILABLE.into());
            };
            // First: the vehicle may have no room for another open file.
            increment(&mut self.status.counters.taken_over);
            self.close(victim);
        }
        let may_upload = V::UPLOADS && !self.sessions.iter().any(Session::is_uploading);
        let (opened, size) = open(self.cx, path, access, from, may_upload)?;
        if V::UPLOADS && matches!(opened, Open::Upload(_)) {
            // It could not be finished either.
            if !self.make_way() {
                return Err(Stop::DROPPED);
            }
            (self.status.received, self.status.kept, self.status.upload) = (0, 0, Upload::Refused);
            self.status.grown = self.cx.now.coarse();
        }
        increment(&mut self.status.counters.opened);
        if let Some(session) = self.sessions.get_mut(place) {
            (session.open, session.opened_by, session.size) = (opened, request.digest, size);
            // For another file, an identical request is a new one.
            session.forget_sent(false, true);
        }
        match opened {
            Open::Upload(file) if V::UPLOADS => {
                *self.work = Work::Begin { session: short(place), client: from, file };
                Err(Stop::LATER)
            }
            _ => Ok(size),
        }
    }
}

/// Whether a path is the root, one of the stack's own, or that of a static file: no client changes it.
fn is_own<F: Firmware<Vehicle: Files>>(path: &[u8]) -> bool {
    path.is_empty() || is_virtual(path) || F::Vehicle::FILES.iter().any(|file| file.path.as_bytes() == path)
}
