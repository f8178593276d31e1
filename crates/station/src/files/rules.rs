//! What the clients do differently.

use crate::Client;
use crate::files::MAX_DATA;
use mavstack::{Duration, Instant};
use std::collections::BTreeMap;

/// A request that is repeated without an end.
const ALWAYS: u32 = u32::MAX;

/// The kinds of requests that clients treat differently.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Step {
    /// OpenFileRO.
    Open,
    /// CreateFile.
    Create,
    /// ListDirectory. The older operation follows if ListDirectoryWithTime is not answered.
    Page,
    /// ListDirectoryWithTime.
    PageWithTime,
    /// BurstReadFile.
    Burst,
    /// ReadFile.
    Read,
    /// WriteFile.
    Write,
    /// An operation of one request.
    Operation,
    /// The end of a session.
    Close,
}

/// How long an answer is awaited, and how often a request is sent.
#[derive(Clone, Copy, Debug)]
pub(super) struct Patience {
    pub(super) timeout: Timeout,
    pub(super) sends: u32,
}

/// How long an answer is awaited.
#[derive(Clone, Copy, Debug)]
pub(super) enum Timeout {
    Fixed(Duration),
    /// By the measured round trip, and at least this long.
    Measured(Duration),
}

/// Which number a repetition has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Repeat {
    SameNumber,
    NewNumber,
}

/// How a session ends after a success.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Closing {
    /// ResetSessions; any answer, or none, will do.
    Reset,
    /// TerminateSession; its refusal is a failure.
    Terminate,
    /// TerminateSession; any answer, or none, will do.
    TerminateLoosely,
    /// TerminateSession, without waiting for its answer.
    TerminateAndForget,
}

/// When TerminateSession is sent after a failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Abort {
    Never,
    AfterRefusal,
    /// After a failed read or write of a file.
    OfFile,
    Always,
}

/// When the gaps of a burst are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Filling {
    During,
    After,
    /// Afterwards, and not more often than this.
    Paced(Duration),
}

impl Client {
    pub(super) fn ftp_patience(self, step: Step) -> Patience {
        let fixed = |millis, sends| Patience { timeout: Timeout::Fixed(Duration::from_millis(millis)), sends };
        let measured = |millis, sends| Patience { timeout: Timeout::Measured(Duration::from_millis(millis)), sends };
        match (self, step) {
            (Self::QGroundControl, Step::Open | Step::Create | Step::Close) => fixed(1_000, 1),
            (Self::QGroundControl, _) => fixed(1_000, 4),
            (Self::Mavsdk, _) => fixed(500, 10),
            (Self::MavProxy, Step::PageWithTime) => measured(3_000, 4),
            (Self::MavProxy, Step::Burst | Step::Read | Step::Write) => measured(500, ALWAYS),
            (Self::MavProxy, _) => measured(500, 11),
            (Self::Pymavlink, Step::Open) => fixed(1_000, 3),
            (Self::Pymavlink, Step::Burst | Step::Read) => fixed(500, ALWAYS),
            (Self::Pymavlink, Step::Write) => fixed(1_000, ALWAYS),
            // It stops when it has sent nothing for this long.
            (Self::Pymavlink, _) => fixed(3_700, 1),
        }
    }

    /// Bytes of data in a packet.
    pub(super) fn ftp_block(self) -> u8 {
        if self == Self::Pymavlink { 80 } else { MAX_DATA }
    }

    /// Requests that may wait for their answers at once.
    pub(super) fn ftp_window(self) -> usize {
        match self {
            Self::QGroundControl | Self::Mavsdk => 1,
            Self::MavProxy | Self::Pymavlink => 5,
        }
    }

    pub(super) fn ftp_repeat(self, step: Step) -> Repeat {
        match (self, step) {
            (Self::QGroundControl, Step::Operation) | (Self::MavProxy, Step::Read | Step::Write) => Repeat::NewNumber,
            _ => Repeat::SameNumber,
        }
    }

    pub(super) fn ftp_filling(self) -> Filling {
        match self {
            Self::QGroundControl | Self::Mavsdk => Filling::After,
            Self::MavProxy => Filling::During,
            Self::Pymavlink => Filling::Paced(Duration::from_millis(50)),
        }
    }

    pub(super) fn ftp_closing(self) -> Closing {
        match self {
            Self::QGroundControl => Closing::Reset,
            Self::Mavsdk => Closing::Terminate,
            Self::MavProxy => Closing::TerminateAndForget,
            Self::Pymavlink => Closing::TerminateLoosely,
        }
    }

    pub(super) fn ftp_abort(self) -> Abort {
        match self {
            Self::QGroundControl => Abort::Never,
            Self::Mavsdk => Abort::AfterRefusal,
            Self::MavProxy => Abort::Always,
            Self::Pymavlink => Abort::OfFile,
        }
    }

    /// Returns a path as the client sends it: MAVSDK sends the NUL at its end too.
    pub(super) fn ftp_path(self, path: &str) -> Vec<u8> {
        let end: &[u8] = if self == Self::Mavsdk { &[0] } else { &[] };
        [path.as_bytes(), end].concat()
    }
}

/// The measured round trip, smoothed as in RFC 6298. MAVProxy uses it.
#[derive(Clone, Debug, Default)]
pub(super) struct RoundTrip {
    sent: BTreeMap<u16, Instant>,
    /// The mean and its deviation (µs).
    measured: Option<(u64, u64)>,
}

impl RoundTrip {
    /// Notes that a request was sent for the first time.
    pub(super) fn sent(&mut self, number: u16, now: Instant) {
        self.sent.insert(number, now);
    }

    /// Notes that a request was sent again: its answer measures nothing (Karn's algorithm).
    pub(super) fn repeated(&mut self, number: u16) {
        self.sent.remove(&number);
    }

    pub(super) fn answered(&mut self, number: u16, now: Instant) {
        let Some(sent) = self.sent.remove(&number) else { return };
        let sample = (now - sent).as_micros();
        self.measured = Some(match self.measured {
            None => (sample, sample / 2),
            Some((mean, deviation)) => ((7 * mean + sample) / 8, (3 * deviation + mean.abs_diff(sample)) / 4),
        });
    }

    /// Returns how long the next answer is awaited.
    pub(super) fn timeout(&self, timeout: Timeout) -> Duration {
        let (unmeasured, longest) = (Duration::from_secs(1), Duration::from_secs(10));
        match (timeout, self.measured) {
            (Timeout::Fixed(fixed), _) => fixed,
            (Timeout::Measured(least), None) => least.max(unmeasured),
            (Timeout::Measured(least), Some((mean, deviation))) => {
                Duration::from_micros(mean + 4 * deviation).min(longest).max(least)
            }
        }
    }
}
