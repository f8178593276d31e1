//! Reading a log.

use super::Log;
use crate::{Client, Dialogue, Failure, Io, Received};
use mavstack::dialect::{LogData, LogRequestData};
use mavstack::{Duration, Instant};
use std::ops::Range;

/// The bytes of a log in a LOG_DATA.
const BLOCK: usize = 90;
/// The blocks that QGroundControl and MAVSDK request at once.
const CHUNK: usize = 512;
/// The gaps that MAVProxy requests at once.
const GAPS: usize = 20;
/// After which time without data a download is given up by default: no client does, but its user.
const PATIENCE: Duration = Duration::from_secs(30);

/// Reads a log. Ends with its content.
#[derive(Debug)]
pub struct Download {
    log: Log,
    content: Vec<u8>,
    /// Which blocks are there.
    blocks: Vec<bool>,
    /// The blocks that QGroundControl and MAVSDK read now.
    chunk: Range<usize>,
    /// When gaps are requested.
    due: Option<Instant>,
    /// The time of the last data; at first, of the beginning.
    heard: Instant,
    patience: Duration,
    is_complete: bool,
}

impl Download {
    /// Reads a log of a [`Listing`](super::Listing).
    pub fn new(log: Log) -> Self {
        Self {
            log,
            content: Vec::new(),
            blocks: Vec::new(),
            chunk: 0..0,
            due: None,
            heard: Instant::ZERO,
            patience: PATIENCE,
            is_complete: false,
        }
    }

    /// Fails after this time without data; after 30 s by default.
    #[must_use]
    pub fn with_patience(mut self, patience: Duration) -> Self {
        self.patience = patience;
        self
    }

    fn begin(&mut self, io: &mut Io<'_>) -> Result<(), Failure> {
        self.heard = io.now();
        match io.client() {
            Client::MavProxy | Client::Pymavlink => self.request(io, 0, u32::MAX),
            client if self.log.size == 0 => {
                return Err(Failure::Protocol(format!("log {} is empty: {client} cannot read it", self.log.id)));
            }
            _ => {
                self.blocks = vec![false; (self.log.size as usize).div_ceil(BLOCK)];
                self.begin_chunk(io, 0);
            }
        }
        self.due = Some(io.now() + idle(io.client()));
        Ok(())
    }

    /// Requests the next part of the log.
    fn begin_chunk(&mut self, io: &mut Io<'_>, first: usize) {
        self.chunk = first..(first + CHUNK).min(self.blocks.len());
        let offset = (first * BLOCK) as u32;
        let count = (self.chunk.len() * BLOCK) as u32;
        let count = if io.client() == Client::Mavsdk { count.min(self.log.size - offset) } else { count };
        self.request(io, offset, count);
    }

    fn request(&mut self, io: &mut Io<'_>, ofs: u32, count: u32) {
        let target = io.target();
        io.send(&LogRequestData {
            ofs,
            count,
            id: self.log.id,
            target_system: target.system.wire(),
            target_component: target.component.wire(),
        });
    }

    /// Returns the first gap of `within`, in blocks.
    fn gap(&self, within: Range<usize>) -> Option<Range<usize>> {
        let first = within.clone().find(|block| !self.blocks[*block])?;
        let end = (first..within.end).find(|block| self.blocks[*block]).unwrap_or(within.end);
        Some(first..end)
    }

    fn request_gap(&mut self, io: &mut Io<'_>, gap: &Range<usize>) {
        self.request(io, (gap.start * BLOCK) as u32, (gap.len() * BLOCK) as u32);
    }

    /// No data have come for a while.
    fn request_missing(&mut self, io: &mut Io<'_>) {
        if !matches!(io.client(), Client::MavProxy | Client::Pymavlink) {
            if let Some(gap) = self.gap(self.chunk.clone()) {
                self.request_gap(io, &gap);
            }
            return;
        }
        // It does not know that its first request was lost.
        if self.blocks.is_empty() {
            return;
        }
        let mut from = 0;
        for _ in 0..GAPS {
            let Some(gap) = self.gap(from..self.blocks.len()) else { break };
            self.request_gap(io, &gap);
            from = gap.end;
        }
        if from == 0 {
            self.request(io, (self.blocks.len() * BLOCK) as u32, u32::MAX);
        }
    }

    fn take(&mut self, io: &mut Io<'_>, data: &LogData) {
        let (block, len) = (data.ofs as usize / BLOCK, usize::from(data.count).min(BLOCK));
        let is_known = !matches!(io.client(), Client::MavProxy | Client::Pymavlink);
        if !(data.ofs as usize).is_multiple_of(BLOCK) || is_known && !self.chunk.contains(&block) {
            return;
        }
        (self.heard, self.due) = (io.now(), Some(io.now() + idle(io.client())));
        if len > 0 {
            self.store(block, &data.data[..len]);
        }
        if is_known {
            self.advance(io, block);
        } else {
            let is_whole = self.gap(0..self.blocks.len()).is_none();
            self.is_complete = len == 0 || len < BLOCK && is_whole && block + 1 == self.blocks.len();
            if self.is_complete {
                super::end(io);
            }
        }
    }

    fn store(&mut self, block: usize, bytes: &[u8]) {
        let begin = block * BLOCK;
        self.blocks.resize(self.blocks.len().max(block + 1), false);
        self.blocks[block] = true;
        self.content.resize(self.content.len().max(begin + bytes.len()), 0);
        self.content[begin..][..bytes.len()].copy_from_slice(bytes);
    }

    /// Requests the next chunk, or the next gap, if a block was the last one of a request.
    fn advance(&mut self, io: &mut Io<'_>, block: usize) {
        let Some(gap) = self.gap(self.chunk.clone()) else {
            if self.chunk.end == self.blocks.len() {
                self.is_complete = true;
            } else {
                self.begin_chunk(io, self.chunk.end);
            }
            return;
        };
        let last = self.chunk.end - 1;
        let is_behind_gap = match io.client() {
            Client::Mavsdk => self.blocks[last],
            _ => block < last && self.blocks[block + 1],
        };
        if is_behind_gap {
            self.request_gap(io, &gap);
        }
    }
}

/// How long without data gaps are requested.
fn idle(client: Client) -> Duration {
    match client {
        Client::QGroundControl | Client::Mavsdk => Duration::from_millis(500),
        Client::MavProxy | Client::Pymavlink => Duration::from_millis(700),
    }
}

impl Dialogue for Download {
    type Output = Vec<u8>;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Vec<u8>, Failure>> {
        if self.is_complete {
            return Some(Ok(std::mem::take(&mut self.content)));
        }
        match self.due {
            None => return self.begin(io).err().map(Err),
            Some(_) if io.now() > self.heard + self.patience => {
                return Some(Err(Failure::timeout(format!("LOG_REQUEST_DATA of log {}", self.log.id), 1)));
            }
            Some(due) if io.now() >= due => {
                self.due = Some(io.now() + idle(io.client()));
                self.request_missing(io);
            }
            Some(_) => {}
        }
        None
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        if let Some(data) = frame.decode::<LogData>()
            && frame.source() == io.target()
            && data.id == self.log.id
            && self.due.is_some()
            && !self.is_complete
        {
            self.take(io, &data);
        }
    }
}
