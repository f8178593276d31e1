//! Flight logs in memory.

use super::TestVehicle;
use mavstack::logs::{LogInfo, LogRead};
use mavstack::{Address, Context, Logs, Peer};

/// Flight logs.
#[derive(Clone, Debug, Default)]
pub struct MemoryLogs {
    /// The content of each log, the oldest first. Its time is its number times 100, plus 1,000.
    pub content: Vec<Vec<u8>>,
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
}

impl Logs for TestVehicle {
    fn log_count(&self) -> u16 {
        self.logs.content.len() as u16
    }

    fn log_info(&self, id: u16) -> Option<LogInfo> {
        let log = self.logs.content.get(usize::from(id))?;
        Some(LogInfo { size: log.len() as u32, time_utc: 1_000 + 100 * u32::from(id) })
    }

    fn read_log(&mut self, id: u16, offset: u32, out: &mut [u8]) -> LogRead {
        let logs = &mut self.logs;
        logs.reads += 1;
        assert!((1..=90).contains(&out.len()));
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
