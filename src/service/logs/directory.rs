//! `@MAV_LOG`: the virtual directory of the logs, for clients that download them by FTP (LOG-15). QGroundControl and
//! PX4's logloader look there first.

use core::task::Poll;

use super::{LogInfo, LogRead, LogServer, Logs, may_read};
use crate::dialect::MavFtpErr;
use crate::message::Text;
use crate::service::Cx;
use crate::service::files::{FileAccess, HasFiles, VirtualEntry, VirtualFile};
use crate::time::{Duration, Instant};
use crate::types::Firmware;

/// The prefix of file names. The number of the log, a dot and [`Logs::LOG_EXTENSION`] follow.
const PREFIX: &str = "log_";

/// If a client has not read a log for this time, it counts as no longer reading, and the logs may be erased (LOG-7). It
/// is the time after which another client takes over its session.
const IDLE: Duration = Duration::from_secs(3);

impl HasFiles for LogServer {
    type File = LogFile;
}

/// An open log. It ends when its number may belong to another log (LOG-16): after a flight or an erasure, or if its
/// time differs.
#[derive(Clone, Copy, Debug)]
pub struct LogFile {
    id: u16,
    /// `Shared::log_numbering` when it was opened.
    numbering: u16,
    info: LogInfo,
}

impl LogFile {
    /// Whether the log may be read, and its number still belongs to it.
    fn is_valid<F: Firmware<Vehicle: Logs>>(&self, cx: &Cx<'_, F>) -> bool {
        may_read(cx)
            && cx.shared.log_numbering == self.numbering
            && cx.vehicle.log_info(self.id).is_some_and(|info| info.time_utc == self.info.time_utc)
    }
}

impl<F: Firmware<Vehicle: Logs>> VirtualFile<F> for LogFile {
    fn name(_: u16) -> &'static [u8] {
        b"@MAV_LOG"
    }

    fn open(cx: &mut Cx<'_, F>, _: u16, path: &[u8], _: FileAccess) -> Result<Self, MavFtpErr> {
        let info =
            number(path, F::Vehicle::LOG_EXTENSION.as_bytes()).and_then(|id| Some((id, cx.vehicle.log_info(id)?)));
        match info {
            None => Err(MavFtpErr::FILENOTFOUND),
            Some(_) if !may_read(cx) => Err(MavFtpErr::FAIL),
            Some((id, info)) => Ok(Self { id, numbering: cx.shared.log_numbering, info }),
        }
    }

    fn size(&self, _: &Cx<'_, F>) -> u32 {
        self.info.size
    }

    fn read(&mut self, cx: &mut Cx<'_, F>, offset: u32, out: &mut [u8]) -> Poll<Result<usize, MavFtpErr>> {
        if !self.is_valid(cx) {
            return Poll::Ready(Err(MavFtpErr::FAIL));
        }
        let rest = usize::try_from(self.info.size.saturating_sub(offset)).unwrap_or(usize::MAX);
        let len = out.len().min(rest);
        let out = out.get_mut(..len).unwrap_or_default();
        if out.is_empty() {
            // At its end.
            cx.shared.logs_read_until = Instant::ZERO;
            return Poll::Ready(Ok(0));
        }
        cx.shared.logs_read_until = cx.now + IDLE;
        match cx.vehicle.read_log(self.id, offset, out) {
            LogRead::Done => Poll::Ready(Ok(len)),
            LogRead::Later => Poll::Pending,
            LogRead::Failed => Poll::Ready(Err(MavFtpErr::FAIL)),
        }
    }

    /// In flight, the directory is empty.
    fn entry(cx: &mut Cx<'_, F>, _: u16, index: u16) -> Option<VirtualEntry> {
        const { assert!(F::Vehicle::LOG_EXTENSION.len() <= 22, "the extension of a log's file is too long") };
        let info = cx.vehicle.log_info(index).filter(|_| may_read(cx))?;
        let mut name = Text::new(PREFIX);
        name.push_number(index.into());
        name.push_str(".");
        name.push_str(F::Vehicle::LOG_EXTENSION);
        Some(VirtualEntry { name, size: info.size, time: info.time_utc })
    }
}

/// Returns the number of a log in the name of its file, which has no zeros in front: a file has one name (F-32).
fn number(name: &[u8], extension: &[u8]) -> Option<u16> {
    let digits = name.strip_prefix(PREFIX.as_bytes())?.strip_suffix(extension)?.strip_suffix(b".")?;
    let mut number = match digits {
        [] | [b'0', _, ..] => return None,
        _ => 0u16,
    };
    for digit in digits {
        let digit = digit.checked_sub(b'0').filter(|digit| *digit < 10)?;
        number = number.checked_mul(10)?.checked_add(digit.into())?;
    }
    Some(number)
}
