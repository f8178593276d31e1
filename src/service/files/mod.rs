//! A server of the MAVLink file transfer protocol: files of the vehicle, and virtual directories.
//!
//! Implements the server's side of <https://mavlink.io/en/services/ftp.html>, rules F-1 to F-32.
//! Left out: the error FailErrno, and the swap of files that MAVLink defines without a user.
//!
//! A request is executed when it is received. The client's session keeps the answer without its data, which is read
//! when the link has room. A repeated request is answered again; only reads, lists and checksums are executed again. A
//! session belongs to a client, a link and the number that the client has chosen.
//!
//! ```text
//!                open                     close, or 10 s without a request, a burst or a checksum
//!   nothing ───────────────▶ open ──────────────────────────────────────────────▶ nothing
//!                             │ ▲ burst                 another client opens after 3 s
//!                             └─┘
//! ```
//!
//! `requests.rs` executes requests, `work.rs` runs operations that take more than one call, and `send.rs` sends.
//! `open.rs` opens and reads files, and `list.rs` lists them. `virtual_files.rs` is the interface of virtual
//! directories, such as `@PARAM`. Other services implement it; this one knows none of them.

mod list;
mod open;
mod packet;
mod path;
mod requests;
mod send;
mod session;
mod vehicle;
mod virtual_files;
mod work;

pub use list::Entries;
pub use packet::{Body, changes};
pub use session::Session;
pub use vehicle::{FileAccess, FileChange, FileEntry, Files, OpenFile, StaticFile};
pub use virtual_files::{HasFiles, NoFile, OneOf, Part, VirtualFile, VirtualFiles};

use self::requests::Stop;
use self::session::State;
use self::work::{Upload, Work};
use super::{About, Cx, Handled, Received, Service, ShowCounters, StackEvent, Turn, View};
use crate::dialect::{FileTransferProtocol, MavProtocolCapability};
use crate::link::Port;
use crate::message::Message;
use crate::time::Instant;
use crate::types::Firmware;

/// The number of sessions, besides the open ones, that hold answers to clients without an open session.
const OTHERS: usize = 2;

counters! {
    /// Counters of the file service. They wrap.
    FileCounters {
        /// Files that were opened.
        count opened,
        /// Completed uploads: of parameters, for example.
        count uploads,
        /// Uploads that were refused as a whole.
        drop refused_uploads,
        /// Files that were not opened because all sessions were in use.
        drop no_session,
        /// Sessions that ended because their client was silent for ten seconds, and uploads that received no part for eight.
        drop timed_out,
        /// Sessions that another client took over after three seconds.
        drop taken_over,
    }
}

/// The file service: declared by `files` in [`#[stack]`](macro@crate::Stack), and read through
/// [`Stack::files`](crate::Stack::files).
#[derive(Debug)]
pub struct FileStatus {
    /// Whether any session is used: otherwise there is nothing to send.
    is_used: bool,
    /// When a session may end.
    wake: Instant,
    /// When to retry an operation that waits for data or for storage.
    work_at: Instant,
    counters: FileCounters,
    /// The upload: the bytes received, when the last ones arrived, how many are kept, and the state.
    received: u32,
    grown: u32,
    kept: u16,
    upload: Upload,
}

impl FileStatus {
    /// Returns the counters.
    pub const fn counters(&self) -> FileCounters {
        self.counters
    }
}

/// Serves files: `OPEN` sessions at a time, `N` sessions in all with those that only hold answers, uploads of up to
/// `UPLOAD` bytes, and the files `V` of virtual directories.
#[derive(Debug)]
pub struct FileServer<const OPEN: usize, const N: usize, const UPLOAD: usize, V> {
    pub(crate) status: FileStatus,
    work: Work<V>,
    sessions: [Session<V>; N],
    upload: [u8; UPLOAD],
}

/// What the service sends, by the number of the session.
#[derive(Clone, Copy, Debug)]
pub enum FileReply {
    /// An answer without data.
    Answer(usize),
    /// Data of a file or a directory. If the file has none yet, another session sends.
    Data(usize),
}

/// The state of the service on a link.
#[derive(Debug)]
pub struct FileLink {
    /// The session that is asked first.
    first: usize,
    /// When to retry files that had no data yet.
    retry_at: Instant,
}

/// The service at work. A firmware has one, so its code is compiled once: with the number of sessions as a constant it
/// is 300 bytes smaller than with a slice of them.
struct Server<'a, 'c, F: Firmware, V, const N: usize> {
    cx: &'a mut Cx<'c, F>,
    status: &'a mut FileStatus,
    work: &'a mut Work<V>,
    sessions: &'a mut [Session<V>; N],
    upload: &'a mut [u8],
}

impl<F, V, const OPEN: usize, const N: usize, const UPLOAD: usize> Service<F> for FileServer<OPEN, N, UPLOAD, V>
where
    F: Firmware<Vehicle: Files>,
    V: VirtualFiles<F>,
{
    type Link = FileLink;
    const VACANT: FileLink = FileLink { first: 0, retry_at: Instant::ZERO };
    type Reply = FileReply;
    const ABOUT: About = About {
        turns: &[Turn::FileAnswer, Turn::LateBulk, Turn::Bulk],
        capabilities: MavProtocolCapability::FTP,
        ..About::AUTOPILOT
    };
    const NEW: Self = {
        assert!(N == OPEN.saturating_add(OTHERS));
        assert!(OPEN > 0 && OPEN < 100, "a client needs a session: `files: {{ sessions: 2 }}`, or leave `files` out");
        assert!(UPLOAD < 65_536, "an upload has less than 65,536 bytes");
        assert!(!V::UPLOADS || UPLOAD >= V::UPLOAD_ROOM, "plans as files need `upload: 276` or more");
        StaticFile::check(F::Vehicle::FILES);
        Self {
            status: FileStatus {
                is_used: false,
                wake: Instant::ZERO,
                work_at: Instant::ZERO,
                counters: FileCounters::ZERO,
                received: 0,
                grown: 0,
                kept: 0,
                upload: Upload::Running,
            },
            work: Work::Nothing,
            sessions: [const { Session::FREE }; N],
            upload: [0; UPLOAD],
        }
    };

    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut FileLink>) {
        if cx.now >= self.status.wake {
            self.server(cx).end(None);
        }
        if self.work.is_running() && (V::COUNT == 0 || cx.now >= self.status.work_at) {
            self.server(cx).work();
        }
    }

    fn deadline(&self) -> Instant {
        let FileStatus { wake, work_at, .. } = self.status;
        match self.work.is_running() {
            // Only files of virtual directories have data later, or are stored.
            true if V::COUNT == 0 => Instant::ZERO,
            true => wake.min(work_at),
            false => wake,
        }
    }

    fn on_frame(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, _: &mut FileLink, received: &Received<'_>) -> Handled {
        if received.frame.id() != FileTransferProtocol::ID {
            return Handled::No;
        }
        if received.target.system.is_all() {
            return Handled::OutOfPlace;
        }
        let handled = self.server(cx).on_packet(received);
        self.slow_streams::<F>(cx.now, port);
        handled
    }

    #[inline(always)]
    fn pending(&self, view: &View<'_>, port: &Port, link: &FileLink, turn: Turn) -> Option<(Instant, FileReply)> {
        if !self.status.is_used {
            return None;
        }
        let next = |state| session::next(&self.sessions, port.id, link.first, state);
        match turn {
            Turn::FileAnswer => next(State::Pending).map(|place| (view.now, FileReply::Answer(place))),
            _ => next(State::Data).map(|place| (link.retry_at, FileReply::Data(place))),
        }
    }

    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, link: &mut FileLink, reply: FileReply) -> bool {
        let is_sent = self.server(cx).send(port, link, reply);
        self.slow_streams::<F>(cx.now, port);
        is_sent
    }

    fn counters(&self, show: &mut impl ShowCounters) {
        show.counters(&self.status.counters);
    }

    fn on_event(&mut self, event: StackEvent<'_, Self::Link>) {
        // The clients are gone. The next poll closes their files.
        if let StackEvent::Opened(port, _) = event {
            self.status.wake = Instant::ZERO;
            self.sessions.iter_mut().for_each(|session| session.leave(port.id));
        }
    }
}

impl<const OPEN: usize, const N: usize, const UPLOAD: usize, V> FileServer<OPEN, N, UPLOAD, V> {
    /// Has streams slowed on a link while a client transfers a file there (F-11).
    fn slow_streams<F: Firmware>(&self, now: Instant, port: &mut Port) {
        if F::SLOWS_STREAMS {
            port.facts.transferring_until = session::transferring_until(&self.sessions, port.id, now);
        }
    }

    fn server<'a, 'c, F: Firmware>(&'a mut self, cx: &'a mut Cx<'c, F>) -> Server<'a, 'c, F, V, N> {
        let Self { status, work, sessions, upload } = self;
        Server { cx, status, work, sessions, upload }
    }

    /// Whether a poll has something to compute.
    #[cfg(test)]
    pub(crate) const fn is_working(&self) -> bool {
        self.work.is_running()
    }
}

/// Returns the number of a session.
fn short(place: usize) -> u8 {
    u8::try_from(place).unwrap_or(u8::MAX)
}

/// The answer to a request: a value, or the reason for none.
type Outcome = Result<u32, Stop>;
