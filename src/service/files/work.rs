//! What takes more than one call: checksums, the size of a virtual file, and uploads to virtual directories (P-22).

use super::open::{close, read};
use super::packet::{Body, MAX_DATA, Request};
use super::requests::Stop;
use super::session::{Open, State};
use super::virtual_files::VirtualFiles;
use super::{Files, Outcome, Server, short};
use crate::crc32::Crc32;
use crate::dialect::{MavFtpErr, MavFtpOpcode};
use crate::service::{Cx, increment};
use crate::types::{Firmware, Peer};

/// How much of a file a poll adds to its checksum: so many bytes, so many times.
const CHECKED_AT_A_TIME: usize = 32;
const TIMES: u8 = 8;

/// The state of the upload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Upload {
    Running,
    /// It is complete, and later polls take it up.
    Complete,
    Refused,
}

/// What takes more than one call: one at a time. `Nothing` is all zero bits, as in [`Open`].
#[derive(Clone, Copy, Debug)]
#[repr(u8)]
pub(super) enum Work<V> {
    Nothing,
    /// The checksum of a file.
    Checksum {
        session: u8,
        open: Open<V>,
        offset: u32,
        crc: Crc32,
    },
    /// An upload is complete.
    Upload {
        session: u8,
        client: Peer,
        file: V,
    },
    /// The size of a virtual file.
    Measure {
        session: u8,
        file: V,
    },
}

impl<V> Work<V> {
    pub(super) const fn is_running(&self) -> bool {
        !matches!(self, Self::Nothing)
    }
}

impl<F: Firmware<Vehicle: Files>, V: VirtualFiles<F>> Server<'_, '_, F, V> {
    /// Writes to a file.
    #[inline(never)]
    pub(super) fn write(&mut self, place: usize, request: &Request<'_>) -> Outcome {
        let Some(session) = self.sessions.get(place) else { return Err(Stop::Dropped) };
        match session.open {
            Open::Nothing => return Err(MavFtpErr::INVALIDSESSION.into()),
            Open::Hook { number, is_writable: true } if F::Vehicle::WRITES => write_hook(self.cx, number, request)?,
            Open::Upload(file) if V::UPLOADS => {
                let client = session.client;
                // Nothing is taken that could not be finished.
                if self.work.is_running() {
                    return Err(Stop::Dropped);
                }
                if self.take_upload(&file, request)? {
                    self.status.upload = Upload::Complete;
                    *self.work = Work::Upload { session: short(place), client, file };
                    return Err(Stop::Working);
                }
            }
            _ => return Err(MavFtpErr::FILEPROTECTED.into()),
        }
        Ok(0)
    }

    /// Takes a part of an upload, in order: a later one is dropped, and the client sends it again. Returns whether the file is
    /// complete.
    fn take_upload(&mut self, file: &V, request: &Request<'_>) -> Result<bool, Stop> {
        if self.status.upload == Upload::Refused {
            return Err(MavFtpErr::FAIL.into());
        }
        let received = usize::from(self.status.received);
        let begin = usize::try_from(request.offset).unwrap_or(usize::MAX);
        let end = begin.saturating_add(usize::from(request.size));
        if end <= received {
            return Ok(false);
        }
        if begin > received {
            return Err(Stop::Dropped);
        }
        let Some(to) = self.upload.get_mut(begin..end).filter(|_| self.status.upload == Upload::Running) else {
            self.status.upload = Upload::Refused;
            return Err(MavFtpErr::FAIL.into());
        };
        to.fill(0);
        crate::message::zero_extend(request.data, to);
        self.status.received = u16::try_from(end).unwrap_or(u16::MAX);
        Ok(file.is_complete(self.upload.get(..end).unwrap_or_default()))
    }

    /// Does a step of what takes more than one call.
    #[inline(never)]
    pub(super) fn work(&mut self) {
        let (session, outcome) = match self.work {
            Work::Upload { session, client, file } if V::UPLOADS => {
                let content = self.upload.get(..usize::from(self.status.received)).unwrap_or_default();
                let Some(finished) = file.finish(self.cx, *client, content) else { return };
                match finished {
                    Ok(()) => increment(&mut self.status.counters.uploads),
                    Err(_) => {
                        increment(&mut self.status.counters.refused_uploads);
                        self.status.upload = Upload::Refused;
                    }
                }
                (*session, finished.map(|()| 0))
            }
            Work::Nothing | Work::Upload { .. } => return,
            Work::Measure { session, file } => match file.size(self.cx) {
                None => return,
                Some(size) => (*session, Ok(size)),
            },
            Work::Checksum { session, open, offset, crc } => {
                let Some(outcome) = add_to_checksum(self.cx, open, offset, crc) else { return };
                close(self.cx, open);
                (*session, outcome)
            }
        };
        *self.work = Work::Nothing;
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
}

/// Adds the next part of a file to its checksum. Returns the checksum at its end. Not inlined: the part needs a buffer.
#[inline(never)]
fn add_to_checksum<F: Firmware<Vehicle: Files>, V: VirtualFiles<F>>(
    cx: &mut Cx<'_, F>,
    open: &mut Open<V>,
    offset: &mut u32,
    crc: &mut Crc32,
) -> Option<Result<u32, MavFtpErr>> {
    let mut bytes = [0; CHECKED_AT_A_TIME];
    for _ in 0..TIMES {
        match read(cx, open, *offset, &mut bytes) {
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
