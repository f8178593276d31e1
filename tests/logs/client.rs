//! Models of the clients that download logs.

use crate::support::{Gcs, millis};
use mavstack::dialect::{LogData, LogEntry, LogRequestData, LogRequestList};
use mavstack::{Address, Duration, Instant};
use std::collections::BTreeMap;

/// The bytes of a LOG_DATA.
const BLOCK: u32 = 90;
/// The part of a log that MAVSDK and QGroundControl request at a time.
const CHUNK: u32 = 512 * BLOCK;

/// How a client requests what is missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// In chunks. The first gap when the last block of the chunk is there, and after half a second of silence. It takes a LOG_DATA
    /// without bytes for a block that it has received.
    Mavsdk,
    /// In chunks, past the end of the log. The first gap when it gets to blocks that it has already, and after half a second.
    Qgc,
    /// All at once. All gaps, up to 20, after 0.7 s of silence. The end is a LOG_DATA with fewer bytes, or with none.
    MavProxy,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    List,
    Data,
    Done,
}

/// A client that lists the logs and downloads one: a state machine that is polled.
#[derive(Debug)]
pub struct LogClient {
    kind: Kind,
    pub address: Address,
    id: u16,
    phase: Phase,
    entries: BTreeMap<u16, LogEntry>,
    blocks: Vec<Option<Vec<u8>>>,
    /// MAVProxy has received the end.
    has_end: bool,
    chunk: u32,
    due: Instant,
    seen: usize,
    pub requests: u32,
}

impl LogClient {
    pub fn new(kind: Kind, address: Address, id: u16) -> Self {
        Self {
            kind,
            address,
            id,
            phase: Phase::List,
            entries: BTreeMap::new(),
            blocks: Vec::new(),
            has_end: false,
            chunk: 0,
            due: Instant::ZERO,
            seen: 0,
            requests: 0,
        }
    }

    /// Returns the downloaded log.
    pub fn content(&self) -> Vec<u8> {
        self.blocks.iter().flat_map(|block| block.clone().expect("no gap")).collect()
    }

    pub fn entries(&self) -> Vec<LogEntry> {
        self.entries.values().copied().collect()
    }

    pub fn is_done(&self) -> bool {
        self.phase == Phase::Done
    }

    const fn timeout(&self) -> Duration {
        if matches!(self.kind, Kind::MavProxy) { millis(700) } else { millis(500) }
    }

    fn request(&mut self, now: Instant, gcs: &mut Gcs, ofs: u32, count: u32) {
        self.requests += 1;
        self.due = now + self.timeout();
        let id = self.id;
        gcs.send_from(self.address, &LogRequestData { ofs, count, id, target_system: 1, target_component: 1 });
    }

    /// The blocks of the chunk.
    fn blocks_of_chunk(&self) -> core::ops::Range<usize> {
        let first = (self.chunk * CHUNK / BLOCK) as usize;
        first..(first + (CHUNK / BLOCK) as usize).min(self.blocks.len())
    }

    fn request_chunk(&mut self, now: Instant, gcs: &mut Gcs) {
        let blocks = self.blocks_of_chunk();
        let size = self.entries[&self.id].size;
        let ofs = blocks.start as u32 * BLOCK;
        let count = match self.kind {
            Kind::Mavsdk => (size - ofs).min(CHUNK),
            Kind::Qgc => blocks.len() as u32 * BLOCK,
            Kind::MavProxy => u32::MAX,
        };
        self.request(now, gcs, ofs, count);
    }

    /// Requests the first gap, or all of them.
    fn request_gaps(&mut self, now: Instant, gcs: &mut Gcs) {
        let mut range = if self.kind == Kind::MavProxy { 0..self.blocks.len() } else { self.blocks_of_chunk() };
        if self.kind == Kind::MavProxy {
            let Some(highest) = self.blocks.iter().rposition(Option::is_some) else {
                // It only repeats a request after something was received; its user repeats the first one.
                return self.request(now, gcs, 0, u32::MAX);
            };
            if self.blocks[..highest].iter().all(Option::is_some) {
                return self.request(now, gcs, (highest as u32 + 1) * BLOCK, u32::MAX);
            }
            range.end = highest;
        }
        let most = if self.kind == Kind::MavProxy { 20 } else { 1 };
        for _ in 0..most {
            let Some(first) = range.clone().find(|block| self.blocks[*block].is_none()) else { return };
            let end = (first..range.end).find(|block| self.blocks[*block].is_some()).unwrap_or(range.end);
            self.request(now, gcs, first as u32 * BLOCK, (end - first) as u32 * BLOCK);
            range.start = end;
        }
    }

    fn on_entry(&mut self, now: Instant, gcs: &mut Gcs, entry: LogEntry) {
        if self.phase != Phase::List {
            return;
        }
        self.due = now + self.timeout();
        if entry.num_logs == 0 {
            self.phase = Phase::Done;
            return;
        }
        self.entries.insert(entry.id, entry);
        if self.entries.len() < usize::from(entry.num_logs) {
            return;
        }
        let size = self.entries[&self.id].size;
        self.blocks = vec![None; size.div_ceil(BLOCK) as usize];
        self.phase = if self.blocks.is_empty() { Phase::Done } else { Phase::Data };
        if self.phase == Phase::Data {
            self.request_chunk(now, gcs);
        }
    }

    fn on_data(&mut self, now: Instant, gcs: &mut Gcs, data: &LogData) {
        if self.phase != Phase::Data || data.id != self.id {
            return;
        }
        self.due = now + self.timeout();
        assert_eq!(data.ofs % BLOCK, 0, "clients ignore misaligned data");
        let block = (data.ofs / BLOCK) as usize;
        if self.kind == Kind::MavProxy {
            self.has_end |= data.count < 90;
            if data.count > 0 {
                self.blocks[block] = Some(data.data[..usize::from(data.count)].to_vec());
            }
            if self.has_end && self.blocks.iter().all(Option::is_some) {
                self.phase = Phase::Done;
            }
            return;
        }
        let blocks = self.blocks_of_chunk();
        if !blocks.contains(&block) {
            return;
        }
        self.blocks[block] = Some(data.data[..usize::from(data.count)].to_vec());
        if self.blocks[blocks.clone()].iter().all(Option::is_some) {
            if blocks.end == self.blocks.len() {
                self.phase = Phase::Done;
                return;
            }
            self.chunk += 1;
            return self.request_chunk(now, gcs);
        }
        let meets_known = match self.kind {
            Kind::Mavsdk => self.blocks[blocks.end - 1].is_some(),
            _ => block + 1 < blocks.end && self.blocks[block + 1].is_some(),
        };
        if meets_known {
            self.request_gaps(now, gcs);
        }
    }

    /// Returns true when the log is there.
    pub fn poll(&mut self, now: Instant, gcs: &mut Gcs) -> bool {
        while let Some(frame) = gcs.received.get(self.seen).cloned() {
            self.seen += 1;
            if let Some(entry) = frame.decode::<LogEntry>() {
                self.on_entry(now, gcs, entry);
            } else if let Some(data) = frame.decode::<LogData>() {
                self.on_data(now, gcs, &data);
            }
        }
        if now >= self.due {
            match self.phase {
                Phase::List => self.request_list(now, gcs),
                Phase::Data => self.request_gaps(now, gcs),
                Phase::Done => {}
            }
        }
        self.is_done()
    }

    /// Requests the list, or the entries that are missing.
    fn request_list(&mut self, now: Instant, gcs: &mut Gcs) {
        let count = self.entries.values().next().map_or(u16::MAX, |entry| entry.num_logs);
        let start = (0..count).find(|id| !self.entries.contains_key(id)).unwrap_or(0);
        let known = (start..count).find(|id| self.entries.contains_key(id));
        let end = known.unwrap_or(count).saturating_sub(1);
        self.requests += 1;
        self.due = now + self.timeout();
        gcs.send_from(self.address, &LogRequestList { start, end, target_system: 1, target_component: 1 });
    }
}
