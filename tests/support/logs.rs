//! Flight logs in memory.

use super::TestVehicle;
use mavstack::dialect::MavResult;
use mavstack::logs::{LogInfo, LogRead};
use mavstack::{Address, Context, LogStreaming, Logs, Peer};

/// Flight logs.
#[derive(Clone, Debug, Default)]
pub struct MemoryLogs {
    /// The content of each log, the oldest first. Its time is its number times 100, plus 1,000. So many were evicted before.
    pub content: Vec<Vec<u8>>,
    pub evicted: u32,
    /// The only sender that may erase; `None` permits every sender.
    pub owner: Option<Address>,
    /// Whether logs may be read while armed.
    pub is_read_in_flight: bool,
    /// So many reads have no data yet.
    pub later: usize,
    /// Whether every read fails.
    pub is_broken: bool,
    /// The number of reads.
    pub reads: usize,
    /// The running log: its definitions, and the data that was not streamed yet.
    pub definitions: Vec<u8>,
    pub data: Vec<u8>,
    /// Whether it refuses to stream.
    pub refuses_stream: bool,
    /// The clients of streams that were started, and the number of those that have ended.
    pub streams: Vec<Peer>,
    pub ended: usize,
}

impl Logs for TestVehicle {
    fn log_count(&self) -> u16 {
        self.logs.content.len() as u16
    }

    fn log_info(&self, id: u16) -> Option<LogInfo> {
        let log = self.logs.content.get(usize::from(id))?;
        Some(LogInfo { size: log.len() as u32, time_utc: 1_000 + 100 * (self.logs.evicted + u32::from(id)) })
    }

    fn read_log(&mut self, id: u16, offset: u32, out: &mut [u8]) -> LogRead {
        let logs = &mut self.logs;
        logs.reads += 1;
        assert!((1..=239).contains(&out.len()));
        let bytes = &logs.content[usize::from(id)][offset as usize..][..out.len()];
        if logs.is_broken {
            return LogRead::Failed;
        }
        if logs.later > 0 {
            logs.later -= 1;
            return LogRead::Later;
        }
        out.copy_from_slice(bytes);
        LogRead::Done
    }

    fn erase_logs(&mut self, _: &mut Context<'_>, from: Peer) -> bool {
        let may = self.logs.owner.is_none_or(|owner| owner == from.address);
        if may {
            self.logs.content.clear();
        }
        may
    }

    fn may_read_logs(&self, is_armed: bool) -> bool {
        !is_armed || self.logs.is_read_in_flight
    }
}

impl LogStreaming for TestVehicle {
    fn start_log_stream(&mut self, _: &mut Context<'_>, from: Peer) -> MavResult {
        if self.logs.refuses_stream {
            return MavResult::FAILED;
        }
        assert_eq!(self.logs.streams.len(), self.logs.ended, "the one before has ended");
        self.logs.streams.push(from);
        MavResult::ACCEPTED
    }

    fn stop_log_stream(&mut self, _: &mut Context<'_>) {
        self.logs.ended += 1;
        assert_eq!(self.logs.streams.len(), self.logs.ended, "once each");
    }

    fn read_log_definitions(&mut self, offset: u32, out: &mut [u8]) -> usize {
        assert!((1..=249).contains(&out.len()));
        let rest = &self.logs.definitions[offset as usize..];
        let len = rest.len().min(out.len());
        out[..len].copy_from_slice(&rest[..len]);
        len
    }

    fn log_data_len(&self) -> usize {
        self.logs.data.len()
    }

    fn take_log_data(&mut self, out: &mut [u8]) -> usize {
        assert_eq!(out.len(), 249);
        let len = self.logs.data.len().min(out.len());
        for (to, from) in out.iter_mut().zip(self.logs.data.drain(..len)) {
            *to = from;
        }
        len
    }
}
