//! A server of the MAVLink file transfer protocol: files of the vehicle, and all parameters in one file.
//!
//! Implements the server's side of <https://mavlink.io/en/services/ftp.html>, rules F-1 to F-15, and `@PARAM/param.pck` (P-22).
//! Left out: the error FailErrno, and the swap of files that MAVLink defines without a user.
//!
//! A request is executed when it is received. Its answer is kept without data, in the client's session: the data is read when
//! the link has room. A repeated request is answered again, and not executed again. A session belongs to a client, a link and
//! the number that the client has chosen.
//!
//! ```text
//!                open                     close, or 10 s without a request and a packet of a burst
//!   nothing ───────────────▶ open ──────────────────────────────────────────────▶ nothing
//!                             │ ▲ burst                 another client opens after 3 s
//!                             └─┘
//! ```
//!
//! `requests.rs` has what a request does, `work.rs` what takes more than one call, and `send.rs` what is sent. Files are opened and
//! read in `open.rs`, and listed in `list.rs`.

mod list;
mod open;
mod packet;
mod path;
mod requests;
mod send;
mod session;
mod vehicle;
mod work;

pub use session::Session;
pub use vehicle::{FileAccess, FileChange, FileEntry, Files, OpenFile, StaticFile};

use core::marker::PhantomData;

use self::work::{Upload, Work};
use super::param::PackedParams;
use super::share::Share;
use super::{Cx, Handled, Received, Service, Turn, View};
use crate::dialect::{FileTransferProtocol, MavFtpErr, MavProtocolCapability};
use crate::link::Port;
use crate::message::Message;
use crate::time::{Duration, Instant};
use crate::types::{Firmware, Peer};

/// The cost of a byte for a share of 30 % of the link (D-4).
const COST_OF_BYTE: u32 = 3_333_333;
/// Data that has waited this long is sent before streams and forwarded frames, which would starve it otherwise.
const MAX_LATENESS: Duration = Duration::from_millis(20);

counters! {
    /// Counters of the file service. They wrap.
    FileCounters {
        /// Files that were opened.
        count opened,
        /// Uploads of parameters that were carried out.
        count uploads,
        /// Uploads of parameters that were refused as a whole.
        drop refused_uploads,
        /// Files that were not opened, because all sessions were in use.
        drop no_session,
        /// Sessions that ended because their client was silent for ten seconds.
        drop timed_out,
        /// Sessions that another client took over after three seconds.
        drop taken_over,
    }
}

/// The file service: declared by `files` in [`stack!`](crate::stack), and read through
/// [`Stack::files`](crate::Stack::files).
#[derive(Debug)]
pub struct FileStatus {
    /// The number of sessions that can be open at a time.
    open_limit: u8,
    /// Whether any session is used: otherwise there is nothing to do.
    is_used: bool,
    counters: FileCounters,
    work: Work,
    /// The upload of parameters: the bytes received, and what became of it.
    received: u16,
    upload: Upload,
}

impl FileStatus {
    /// Whether a poll has something to compute.
    #[cfg(test)]
    pub(crate) const fn is_working(&self) -> bool {
        !matches!(self.work, Work::Nothing)
    }

    /// Returns the counters.
    pub const fn counters(&self) -> FileCounters {
        self.counters
    }
}

/// Serves files: `OPEN` sessions at a time, `N` of them and of answers to others, uploads of parameters of up to `UPLOAD` bytes,
/// and the parameters of the service `P`.
#[derive(Debug)]
pub struct FileServer<const OPEN: usize, const N: usize, const UPLOAD: usize, P> {
    pub(crate) status: FileStatus,
    sessions: [Session; N],
    upload: [u8; UPLOAD],
    params: PhantomData<fn() -> P>,
}

/// The state of the service on a link.
#[derive(Debug)]
pub struct FileLink {
    share: Share,
    /// The session that is asked first for data.
    first: u8,
}

/// The service without the types of its size.
struct Server<'a> {
    status: &'a mut FileStatus,
    sessions: &'a mut [Session],
    upload: &'a mut [u8],
}

impl<F, P, const OPEN: usize, const N: usize, const UPLOAD: usize> Service<F> for FileServer<OPEN, N, UPLOAD, P>
where
    F: Firmware<Vehicle: Files>,
    P: PackedParams<F> + core::fmt::Debug,
{
    type Link = FileLink;
    const VACANT: FileLink = FileLink { share: Share::NEW, first: 0 };
    const CAPABILITIES: MavProtocolCapability = MavProtocolCapability::FTP;
    const NEW: Self = {
        assert!(OPEN > 0 && OPEN < 100, "a client needs a session: `files: {{ sessions: 2 }}`, or leave `files` out");
        assert!(UPLOAD < 65_536, "an upload of parameters has less than 65,536 bytes");
        StaticFile::check(F::Vehicle::FILES);
        Self {
            status: FileStatus {
                open_limit: 0,
                is_used: false,
                counters: FileCounters::ZERO,
                work: Work::Nothing,
                received: 0,
                upload: Upload::Running,
            },
            sessions: [Session::FREE; N],
            upload: [0; UPLOAD],
            params: PhantomData,
        }
    };

    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut FileLink>) {
        if !self.status.is_used {
            return;
        }
        let mut server = self.server();
        server.end_idle(cx);
        server.work::<F, P>(cx);
    }

    fn deadline(&self) -> Instant {
        if !matches!(self.status.work, Work::Nothing) {
            return Instant::ZERO;
        }
        self.sessions.iter().fold(Instant::NEVER, |due, session| due.min(session.ends_at()))
    }

    fn on_frame(&mut self, cx: &mut Cx<'_, F>, _: &mut Port, link: &mut FileLink, received: &Received<'_>) -> Handled {
        if received.frame.id() != FileTransferProtocol::ID {
            return Handled::No;
        }
        if received.target.system.0 == 0 {
            return Handled::OutOfPlace;
        }
        if !has_data(&self.sessions, received.from) {
            link.share.begin(cx.now);
        }
        self.server().on_packet::<F, P>(cx, received)
    }

    fn next(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, link: &mut FileLink, turn: Turn) -> bool {
        match turn {
            _ if !self.status.is_used => false,
            Turn::LateFileData if cx.now < link.share.due().after(MAX_LATENESS) => false,
            _ => self.server().send::<F, P>(cx, port, link, turn != Turn::FileAnswer),
        }
    }

    fn due(&self, view: &View<'_>, port: &Port, link: &FileLink, turn: Turn) -> Instant {
        let has_data = turn != Turn::FileAnswer;
        let is_pending = self.status.is_used
            && self.sessions.iter().any(|session| session.client.link == port.id && session.is_due(has_data));
        match turn {
            _ if !is_pending => Instant::NEVER,
            Turn::LateFileData => link.share.due().after(MAX_LATENESS),
            _ => view.now,
        }
    }

    #[cfg(feature = "defmt")]
    fn drops(&self) -> u32 {
        self.status.counters.drops()
    }

    #[cfg(feature = "defmt")]
    fn log_drops(&self) {
        defmt::warn!("files: {}", self.status.counters);
    }

    /// The clients are gone. The next poll closes their files.
    fn restart(&mut self, port: &Port, _: &mut FileLink) {
        for session in self.sessions.iter_mut().filter(|session| session.client.link == port.id) {
            session.is_gone = session.is_used;
            session.drop_data();
            session.forget_all();
        }
    }
}

impl<const OPEN: usize, const N: usize, const UPLOAD: usize, P> FileServer<OPEN, N, UPLOAD, P> {
    fn server(&mut self) -> Server<'_> {
        self.status.open_limit = u8::try_from(OPEN).unwrap_or(u8::MAX);
        Server { status: &mut self.status, sessions: &mut self.sessions, upload: &mut self.upload }
    }
}

/// Whether data is pending on the link of a client.
fn has_data(sessions: &[Session], client: Peer) -> bool {
    sessions.iter().any(|session| session.client.link == client.link && session.is_due(true))
}

/// Returns the number of a session.
fn short(place: usize) -> u8 {
    u8::try_from(place).unwrap_or(u8::MAX)
}

/// What a request that was executed is answered with: a value, or an error.
type Outcome = Result<u32, MavFtpErr>;
