//! What a request does, when it is received (F-1 to F-7, F-13).

use super::list::directory;
use super::open::{close, is_virtual, open};
use super::packet::{MAX_DATA, Request};
use super::session::{self, Answer, Open, State};
use super::virtual_files::VirtualFiles;
use super::work::{Upload, Work};
use super::{FileAccess, FileChange, Files, Outcome, Server, path, short};
use crate::crc32::Crc32;
use crate::dialect::{MavFtpErr, MavFtpOpcode};
use crate::service::{Handled, Received, increment};
use crate::types::{Firmware, Peer};

/// Why a request is not answered with a value.
pub(super) enum Stop {
    /// It is refused.
    Refused(MavFtpErr),
    /// The answer takes more than this call.
    Working,
    /// It is dropped without effect, and the client sends it again.
    Dropped,
}

impl From<MavFtpErr> for Stop {
    fn from(error: MavFtpErr) -> Self {
        Self::Refused(error)
    }
}

impl<F: Firmware<Vehicle: Files>, V: VirtualFiles<F>> Server<'_, '_, F, V> {
    /// Ends the sessions of silent clients.
    #[inline(never)]
    pub(super) fn end_idle(&mut self) {
        self.status.is_used = self.sessions.iter().any(|session| session.is_used) || self.work.is_running();
        for place in 0..self.sessions.len() {
            let Some(session) = self.sessions.get(place) else { return };
            if self.cx.now < session.ends_at() {
                continue;
            }
            if session.is_open() && !session.is_gone {
                increment(&mut self.status.counters.timed_out);
            }
            self.close(place);
            if let Some(session) = self.sessions.get_mut(place) {
                session.free();
            }
        }
    }

    /// Closes what a session has open, and drops its data that is pending.
    #[inline(never)]
    fn close(&mut self, place: usize) {
        let Some(session) = self.sessions.get_mut(place) else { return };
        session.drop_data();
        session.opened_by = 0;
        let open = core::mem::replace(&mut session.open, Open::Nothing);
        close(self.cx, &open);
    }

    /// Handles a packet.
    #[inline(never)]
    pub(super) fn on_packet(&mut self, received: &Received<'_>) -> Handled {
        self.status.is_used = true;
        let request = Request::of(received.frame.payload());
        if request.opcode.0 >= MavFtpOpcode::ACK.0 {
            // It is an answer, which has none.
            return Handled::Yes;
        }
        let Some(place) = session::find(self.sessions, received.from, request.session) else { return Handled::NoRoom };
        let digest = request.digest();
        let now = self.cx.now;
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
            if let Open::Virtual(file) = &mut session.open {
                file.begin_to_read(request.wanted());
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
        let outcome = match request.opcode {
            // Its answer was forgotten.
            _ if opens && session.opened_by == digest => Ok(session.size),
            _ if usize::from(request.size) > MAX_DATA => Err(MavFtpErr::INVALIDDATASIZE.into()),
            MavFtpOpcode::NONE => Ok(0),
            MavFtpOpcode::TERMINATESESSION => {
                self.close(place);
                Ok(0)
            }
            MavFtpOpcode::RESETSESSION => {
                self.close_all(received.from);
                Ok(0)
            }
            MavFtpOpcode::READFILE => self.start_read(place, &request),
            MavFtpOpcode::WRITEFILE => self.write(place, &request),
            MavFtpOpcode::BURSTREADFILE => Err(MavFtpErr::INVALIDSESSION.into()),
            _ => self.on_path(place, &request, digest),
        };
        let (state, value, error) = match outcome {
            Ok(value) => (State::Pending, value, MavFtpErr::NONE),
            Err(Stop::Refused(error)) => (State::Pending, 0, error),
            Err(Stop::Working) => (State::Working, 0, MavFtpErr::NONE),
            Err(Stop::Dropped) => return Handled::NoRoom,
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

    /// Closes all files of a client on its link.
    fn close_all(&mut self, client: Peer) {
        for place in 0..self.sessions.len() {
            if self.sessions.get(place).is_some_and(|session| session.is_used && session.client == client) {
                self.close(place);
            }
        }
    }

    /// Checks a request to read.
    fn start_read(&mut self, place: usize, request: &Request<'_>) -> Outcome {
        match self.sessions.get_mut(place).map(|session| &mut session.open) {
            Some(Open::Virtual(file)) => file.begin_to_read(request.wanted()),
            Some(Open::Hook { .. } | Open::Static(_)) => {}
            Some(Open::Upload(_)) => return Err(MavFtpErr::FAIL.into()),
            Some(Open::Nothing) | None => return Err(MavFtpErr::INVALIDSESSION.into()),
        }
        Ok(0)
    }

    /// Handles a request with a path.
    #[inline(never)]
    fn on_path(&mut self, place: usize, request: &Request<'_>, digest: u32) -> Outcome {
        let Some(path) = path::of(request.data) else { return Err(MavFtpErr::FILENOTFOUND.into()) };
        let change = match request.opcode {
            MavFtpOpcode::LISTDIRECTORY | MavFtpOpcode::LISTDIRECTORYWITHTIME => {
                return directory::<F, V>(self.cx, path);
            }
            MavFtpOpcode::OPENFILERO => return self.open(place, FileAccess::Read, path, digest),
            MavFtpOpcode::OPENFILEWO => return self.open(place, FileAccess::Write, path, digest),
            MavFtpOpcode::CREATEFILE => return self.open(place, FileAccess::Create, path, digest),
            MavFtpOpcode::CALCFILECRC => {
                if self.work.is_running() {
                    return Err(Stop::Dropped);
                }
                let (open, _) = open(self.cx, path, FileAccess::Read, false)?;
                *self.work = Work::Checksum { session: short(place), open, offset: 0, crc: Crc32::ZERO };
                return Err(Stop::Working);
            }
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
            MavFtpOpcode::TRUNCATEFILE => FileChange::Truncate { path, size: request.offset },
            MavFtpOpcode::CREATEDIRECTORY => FileChange::CreateDirectory(path),
            MavFtpOpcode::REMOVEDIRECTORY => FileChange::RemoveDirectory(path),
            MavFtpOpcode::RENAME => {
                let second = request.data.iter().position(|byte| *byte == 0).and_then(|end| request.data.get(end..));
                match second.and_then(|rest| path::of(rest.get(1..)?)) {
                    Some(to) if !is_virtual(to) && !to.is_empty() => FileChange::Rename { from: path, to },
                    _ => return Err(MavFtpErr::FAIL.into()),
                }
            }
            _ => return Err(MavFtpErr::UNKNOWNCOMMAND.into()),
        };
        let is_own = is_virtual(path) || F::Vehicle::FILES.iter().any(|file| file.path.as_bytes() == path);
        if is_own {
            return Err(MavFtpErr::FILEPROTECTED.into());
        }
        let (vehicle, mut context) = self.cx.hook();
        vehicle.change(&mut context, change)?;
        Ok(0)
    }

    /// Opens a file in a session (F-6).
    #[inline(never)]
    fn open(&mut self, place: usize, access: FileAccess, path: &[u8], digest: u32) -> Outcome {
        // A client that opens another file does not close the one before, or its request to do so was lost.
        self.close(place);
        let open_count =
            self.sessions.iter().fold(0u8, |count, session| count.saturating_add(u8::from(session.is_open())));
        let mut victim = None;
        if open_count >= self.status.open_limit {
            victim = session::victim(self.sessions, self.cx.now);
            if victim.is_none() {
                increment(&mut self.status.counters.no_session);
                return Err(MavFtpErr::NOSESSIONSAVAILABLE.into());
            }
        }
        let uploading = self.sessions.iter().position(|session| matches!(session.open, Open::Upload(_)));
        let may_upload = V::UPLOADS && uploading.is_none_or(|place| Some(place) == victim);
        let (opened, size) = open(self.cx, path, access, may_upload)?;
        // The size takes work, and an upload could not be finished.
        if matches!(opened, Open::Virtual(_) | Open::Upload(_)) && self.work.is_running() {
            return Err(Stop::Dropped);
        }
        if let Some(victim) = victim {
            increment(&mut self.status.counters.taken_over);
            self.close(victim);
        }
        if V::UPLOADS && matches!(opened, Open::Upload(_)) {
            (self.status.received, self.status.upload) = (0, Upload::Running);
        }
        increment(&mut self.status.counters.opened);
        if let Some(session) = self.sessions.get_mut(place) {
            (session.open, session.opened_by, session.size) = (opened, digest, size);
            session.forget_answers();
        }
        if let Open::Virtual(file) = opened {
            *self.work = Work::Measure { session: short(place), file };
            return Err(Stop::Working);
        }
        Ok(size)
    }
}
