//! What takes more than one call: checksums, the length of the file of parameters, and its upload (P-22, F-14).

use super::open::{close, read};
use super::packet::{Body, MAX_DATA, Request};
use super::requests::Dropped;
use super::session::{Open, State};
use super::{Files, Outcome, Server, short};
use crate::crc32::Crc32;
use crate::dialect::{MavFtpErr, MavFtpOpcode};
use crate::service::param::{Pack, PackedParams};
use crate::service::{Cx, increment};
use crate::types::{Firmware, Peer};

/// How much of a file a poll adds to its checksum: so many bytes, so many times.
const CHECKED_AT_A_TIME: usize = 32;
const TIMES: u8 = 8;

/// The state of the upload of parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Upload {
    Running,
    /// It is complete, and the next poll sets the parameters.
    Complete,
    Done,
    Refused,
}

/// What takes more than one call: one at a time. `Nothing` is all zero bits, as in [`Open`].
#[derive(Clone, Copy, Debug)]
#[repr(u8)]
pub(super) enum Work {
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

impl Server<'_> {
    /// Writes to a file. Returns `None` if the answer must be computed.
    #[inline(never)]
    pub(super) fn write<F, P>(
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

    /// Does a step of what takes more than one call.
    #[inline(never)]
    pub(super) fn work<F, P>(&mut self, cx: &mut Cx<'_, F>)
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
