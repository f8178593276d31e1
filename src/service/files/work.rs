//! Operations that take more than one call: checksums, and uploads to virtual directories (P-22).

use super::open::{close, open, read};
use super::packet::{MAX_DATA, Request};
use super::requests::Stop;
use super::session::{LONGEST_CHECKSUM, Open, Session, State};
use super::virtual_files::{Part, VirtualFiles};
use super::{FileAccess, Files, Outcome, Server, short};
use crate::crc32::Crc32;
use crate::dialect::MavFtpErr;
use crate::service::rate_limit::RETRY;
use crate::service::{Cx, increment};
use crate::types::{Firmware, Peer};

/// The part of a file that a poll adds to its checksum: the number of bytes in a read, and the number of reads.
const CHECKED_AT_A_TIME: usize = 32;
const TIMES: u8 = 8;

/// The state of the upload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Upload {
    Running,
    /// It is complete, and later polls apply it.
    Complete,
    /// It is refused, or not permitted yet.
    Refused,
}

/// An operation that takes more than one call: one at a time. `Nothing` is all zero bits, as in [`Open`].
#[derive(Clone, Copy, Debug)]
#[repr(u8)]
pub(super) enum Work<V> {
    Nothing,
    /// The checksum of a file, that of its path, when it began, and the size of the file.
    Checksum {
        session: u8,
        open: Open<V>,
        path: u32,
        began: u32,
        size: u32,
        offset: u32,
        crc: Crc32,
    },
    /// An upload begins.
    Begin {
        session: u8,
        client: Peer,
        file: V,
    },
    /// An upload is complete.
    Upload {
        session: u8,
        client: Peer,
        file: V,
    },
}

impl<V> Work<V> {
    pub(super) const fn is_running(&self) -> bool {
        !matches!(self, Self::Nothing)
    }

    const fn is_checksum(&self) -> bool {
        matches!(self, Self::Checksum { .. })
    }
}

impl<F: Firmware<Vehicle: Files>, V: VirtualFiles<F>, const N: usize> Server<'_, '_, F, V, N> {
    /// Begins a checksum. A client that asks for the same one again, as another request, gets the answer to that one:
    /// MAVSDK repeats with new numbers, and takes only the last one's answer.
    pub(super) fn begin_checksum(&mut self, place: usize, path: &[u8], from: Peer) -> Outcome {
        let mut sum = Crc32::new();
        sum.add(path);
        let sum = sum.sum();
        if let (Work::Checksum { session, path, .. }, Some(own)) = (&mut *self.work, self.sessions.get_mut(place))
            && usize::from(*session) == place
        {
            // It reads nothing while it waits for a checksum.
            own.drop_data();
            if *path == sum {
                return Err(Stop::LATER);
            }
            self.end_checksum();
        }
        if self.work.is_running() {
            return Err(Stop::DROPPED);
        }
        let (open, size) = open(self.cx, path, FileAccess::Read, from, false)?;
        let began = self.cx.now.coarse();
        *self.work =
            Work::Checksum { session: short(place), open, path: sum, began, size, offset: 0, crc: Crc32::ZERO };
        Err(Stop::LATER)
    }

    /// Ends a checksum, without an answer.
    pub(super) fn end_checksum(&mut self) {
        if let Work::Checksum { open, .. } = self.work {
            close(self.cx, open);
            *self.work = Work::Nothing;
        }
    }

    /// Makes way for an operation: a checksum fails, because what a client waits for to open a file is worth more.
    /// Returns whether another operation can begin.
    pub(super) fn make_way(&mut self) -> bool {
        if let Work::Checksum { session, .. } = self.work {
            let session = *session;
            self.end_checksum();
            self.answer(session, Err(MavFtpErr::FAIL.into()));
        }
        !self.work.is_running()
    }

    /// Answers the request that began an operation.
    fn answer(&mut self, session: u8, outcome: Outcome) {
        let Some(session) = self.sessions.get_mut(usize::from(session)) else { return };
        // Its client may have gone meanwhile.
        let found = session.oldest(State::Working);
        let Some(answer) = found.and_then(|place| session.answers.get_mut(place)) else { return };
        answer.state = State::Pending;
        (answer.is_refused, answer.value) = match outcome {
            Ok(value) => (false, value),
            Err(Stop(error)) => (true, error),
        };
    }

    /// Writes to a file.
    pub(super) fn write(&mut self, place: usize, request: &Request<'_>) -> Outcome {
        let Some(session) = self.sessions.get(place) else { return Err(Stop::DROPPED) };
        match session.open {
            Open::Nothing => return Err(MavFtpErr::INVALIDSESSION.into()),
            Open::Hook { number, is_writable: true } if F::Vehicle::WRITES => {
                write_hook(self.cx, number, request, session.key.client())?;
            }
            Open::Upload(file) if V::UPLOADS => {
                // Nothing is taken that could not be finished.
                if self.work.is_running() && !self.work.is_checksum() {
                    return Err(Stop::DROPPED);
                }
                if self.take_upload(&file, request)? {
                    return self.complete_upload(place);
                }
            }
            _ => return Err(MavFtpErr::FILEPROTECTED.into()),
        }
        Ok(0)
    }

    /// Begins to apply the upload of a session.
    fn complete_upload(&mut self, place: usize) -> Outcome {
        self.make_way();
        if let Some(Session { open: Open::Upload(file), key, .. }) = self.sessions.get(place) {
            self.status.upload = Upload::Complete;
            *self.work = Work::Upload { session: short(place), client: key.client(), file: *file };
        }
        Err(Stop::LATER)
    }

    /// Takes a part of an upload, in order (F-23): a later part is dropped, and the client sends it again. Returns
    /// whether the file is complete.
    fn take_upload(&mut self, file: &V, request: &Request<'_>) -> Result<bool, Stop> {
        if self.status.upload == Upload::Refused {
            return Err(MavFtpErr::FAIL.into());
        }
        let Some(known) = self.status.received.checked_sub(request.head.offset) else { return Err(Stop::DROPPED) };
        let new = match u32::from(request.head.size).checked_sub(known) {
            None | Some(0) => return Ok(false),
            Some(new) => new,
        };
        let kept = usize::from(self.status.kept);
        let end = kept.saturating_add(usize::try_from(new).unwrap_or(usize::MAX));
        let room = self.upload.get_mut(kept..end).filter(|_| self.status.upload == Upload::Running);
        let part = match room {
            Some(to) => {
                to.fill(0);
                let data = request.data.get(usize::try_from(known).unwrap_or(usize::MAX)..);
                crate::message::zero_extend(data.unwrap_or_default(), to);
                file.take(self.cx, self.upload.get(..end).unwrap_or_default())
            }
            None => Part::Refused(MavFtpErr::FAIL),
        };
        let done = match part {
            Part::Taken(done) => done.min(end),
            Part::Last => 0,
            Part::Refused(error) => {
                self.status.upload = Upload::Refused;
                return Err(error.into());
            }
        };
        if done > 0 {
            // The rest moves to the front: a few bytes, for which `copy_within` would link 1.5 kB.
            for (to, from) in (done..end).enumerate() {
                let byte = self.upload.get(from).copied().unwrap_or(0);
                if let Some(to) = self.upload.get_mut(to) {
                    *to = byte;
                }
            }
        }
        self.status.received = self.status.received.saturating_add(new);
        self.status.grown = self.cx.now.coarse();
        self.status.kept = u16::try_from(end.saturating_sub(done)).unwrap_or(u16::MAX);
        Ok(matches!(part, Part::Last))
    }

    /// Runs a step of the operation.
    pub(super) fn work(&mut self) {
        let (session, outcome) = match self.work {
            Work::Upload { session, client, file } if V::UPLOADS => {
                let content = self.upload.get(..usize::from(self.status.kept)).unwrap_or_default();
                let Some(finished) = file.finish(self.cx, *client, content) else {
                    // It waits for storage.
                    self.status.work_at = self.cx.now + RETRY;
                    return;
                };
                match finished {
                    Ok(()) => increment(&mut self.status.counters.uploads),
                    Err(_) => {
                        increment(&mut self.status.counters.refused_uploads);
                        self.status.upload = Upload::Refused;
                    }
                }
                (*session, finished.map(|()| 0).map_err(Stop::from))
            }
            Work::Begin { session, client, file } if V::UPLOADS => {
                let session = *session;
                let open = self.sessions.get(usize::from(session)).map(|session| &session.open);
                // Its client may have closed it meanwhile, and have opened another file.
                let outcome = if let Some(Open::Upload(_)) = open {
                    let Some(begun) = file.begin(self.cx, *client) else { return };
                    match begun {
                        Ok(()) => self.status.upload = Upload::Running,
                        Err(_) => drop(self.close(usize::from(session))),
                    }
                    begun
                } else {
                    Err(MavFtpErr::FAIL)
                };
                (session, outcome.map(|()| 0).map_err(Stop::from))
            }
            Work::Nothing | Work::Begin { .. } | Work::Upload { .. } => return,
            Work::Checksum { session, open, began, size, offset, crc, .. } => {
                let (from, now) = (*offset, self.cx.now.coarse());
                let outcome = add_to_checksum(self.cx, open, *size, offset, crc);
                if !is_later(outcome) {
                    close(self.cx, open);
                } else if V::COUNT > 0 && *offset == from {
                    // The log has no data yet (LOG-9).
                    self.status.work_at = self.cx.now + RETRY;
                } else if now.wrapping_sub(*began) < LONGEST_CHECKSUM
                    && let Some(session) = self.sessions.get_mut(usize::from(*session))
                    && !session.is_open()
                {
                    session.touched = now;
                }
                (*session, outcome)
            }
        };
        if is_later(outcome) {
            return;
        }
        *self.work = Work::Nothing;
        self.answer(session, outcome);
    }
}

/// Whether it takes another call.
fn is_later(outcome: Outcome) -> bool {
    outcome == Err(Stop::LATER)
}

/// Adds the next part of a file to its checksum. Returns the checksum at its end.
fn add_to_checksum<F: Firmware<Vehicle: Files>, V: VirtualFiles<F>>(
    cx: &mut Cx<'_, F>,
    open: &mut Open<V>,
    size: u32,
    offset: &mut u32,
    crc: &mut Crc32,
) -> Outcome {
    let mut bytes = [0; CHECKED_AT_A_TIME];
    for _ in 0..TIMES {
        match read(cx, open, size, *offset, &mut bytes) {
            Err(stop) if stop == MavFtpErr::EOF.into() => return Ok(!crc.sum()),
            Err(stop) => return Err(stop),
            Ok(len) => {
                *offset = offset.saturating_add(len);
                let len = usize::try_from(len).unwrap_or(0);
                crc.add(bytes.get(..len).unwrap_or_default());
            }
        }
    }
    Err(Stop::LATER)
}

/// Writes to a file of the vehicle.
fn write_hook<F: Firmware<Vehicle: Files>>(
    cx: &mut Cx<'_, F>,
    number: u16,
    request: &Request<'_>,
    from: Peer,
) -> Result<(), MavFtpErr> {
    let mut bytes = [0; MAX_DATA];
    crate::message::zero_extend(request.data, &mut bytes);
    let bytes = bytes.get(..usize::from(request.head.size)).unwrap_or_default();
    let (vehicle, mut context) = cx.hook();
    vehicle.write(&mut context, number, request.head.offset, bytes, from)
}
