//! What a request does, when it is received (F-1 to F-7, F-13).

use super::list::directory;
use super::open::{close, is_virtual, open};
use super::packet::{MAX_DATA, Request};
use super::session::{self, Answer, Open, State};
use super::work::{Upload, Work};
use super::{FileAccess, FileChange, Files, Outcome, Server, path, short};
use crate::crc32::Crc32;
use crate::dialect::{MavFtpErr, MavFtpOpcode};
use crate::service::param::PackedParams;
use crate::service::{Cx, Handled, Received, increment};
use crate::types::{Firmware, Peer};

/// The request is dropped without effect, and the client sends it again.
pub(super) struct Dropped;

impl Server<'_> {
    /// Ends the sessions of silent clients.
    #[inline(never)]
    pub(super) fn end_idle<F: Firmware<Vehicle: Files>>(&mut self, cx: &mut Cx<'_, F>) {
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
    pub(super) fn on_packet<F, P>(&mut self, cx: &mut Cx<'_, F>, received: &Received<'_>) -> Handled
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
}
