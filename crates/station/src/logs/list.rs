//! The list of the logs.

use super::Log;
use crate::{Client, Dialogue, Failure, Io, Received};
use mavstack::dialect::{LogEntry, LogErase, LogRequestList};
use mavstack::{Duration, Instant};

/// How long the first entry is awaited, and with other clients than QGroundControl the next one too.
const PATIENCE: Duration = Duration::from_secs(5);
/// After which time without an entry QGroundControl requests a missing one.
const GAP: Duration = Duration::from_millis(500);
/// How often QGroundControl requests missing entries.
const GAP_REQUESTS: u32 = 3;

/// Lists the logs. Ends with them, in the order of their numbers.
///
/// On a link that loses frames only QGroundControl gets along: see [`Again`](crate::Again).
#[derive(Debug, Default)]
pub struct Listing {
    /// One entry for each log; `None` until it is received.
    logs: Option<Vec<Option<Log>>>,
    due: Option<Instant>,
    /// Requests for missing entries since the last entry.
    requests: u32,
}

impl Listing {
    /// Creates a list that is requested when it is polled.
    pub fn new() -> Self {
        Self::default()
    }

    fn request(&mut self, io: &mut Io<'_>, start: u16, end: u16) {
        let target = io.target();
        io.send(&LogRequestList {
            start,
            end,
            target_system: target.system.wire(),
            target_component: target.component.wire(),
        });
        self.due = Some(io.now() + PATIENCE);
    }

    /// The first entries that are missing: the numbers of the first and of the last one.
    fn gap(&self) -> Option<(u16, u16)> {
        let logs = self.logs.as_ref()?;
        let first = logs.iter().position(Option::is_none)?;
        let len = logs[first..].iter().take_while(|log| log.is_none()).count();
        Some((first as u16, (first + len - 1) as u16))
    }

    fn is_complete(&self) -> bool {
        self.logs.is_some() && self.gap().is_none()
    }

    /// Nothing has come for a while.
    fn time_out(&mut self, io: &mut Io<'_>) -> Option<Result<Vec<Log>, Failure>> {
        let failure = || Err(Failure::timeout("LOG_REQUEST_LIST", 1));
        match self.gap() {
            _ if io.client() != Client::QGroundControl => Some(failure()),
            // It shows an empty list.
            None => Some(Ok(Vec::new())),
            Some(_) if self.requests == GAP_REQUESTS => Some(failure()),
            Some((first, last)) => {
                self.requests += 1;
                self.request(io, first, last);
                None
            }
        }
    }
}

impl Dialogue for Listing {
    type Output = Vec<Log>;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Vec<Log>, Failure>> {
        if self.is_complete() {
            return Some(Ok(self.logs.take()?.into_iter().flatten().collect()));
        }
        match self.due {
            None => self.request(io, 0, u16::MAX),
            Some(due) if io.now() >= due => return self.time_out(io),
            Some(_) => {}
        }
        None
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        let Some(entry) = frame.decode::<LogEntry>().filter(|_| frame.source() == io.target()) else { return };
        let logs = self.logs.get_or_insert_with(|| vec![None; usize::from(entry.num_logs)]);
        if let Some(log) = logs.get_mut(usize::from(entry.id)) {
            *log = Some(Log { id: entry.id, size: entry.size, time_utc: entry.time_utc });
        }
        self.requests = 0;
        let wait = if io.client() == Client::QGroundControl { GAP } else { PATIENCE };
        self.due = Some(io.now() + wait);
    }
}

/// Erases all logs. LOG_ERASE has no answer, so it ends with the list of those that are left: QGroundControl lists them then.
#[derive(Debug, Default)]
pub struct Erasure {
    list: Option<Listing>,
}

impl Erasure {
    /// Creates an erasure that is sent when it is polled.
    pub fn new() -> Self {
        Self::default()
    }
}

impl Dialogue for Erasure {
    type Output = Vec<Log>;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Vec<Log>, Failure>> {
        let list = self.list.get_or_insert_with(|| {
            let target = io.target();
            io.send(&LogErase { target_system: target.system.wire(), target_component: target.component.wire() });
            Listing::new()
        });
        list.poll(io)
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        if let Some(list) = &mut self.list {
            list.receive(io, frame);
        }
    }
}
