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
//!                             │ ▲ burst                 it gives way to another client
//!                             └─┘
//! ```
//!
//! An open file is a lease (X-3). If none is free, it gives way to a client that opens another: when it was idle for 3 s, when it
//! was used at less than a twentieth of its link's rate over 10 s, when its client has several and the other has none, when
//! its client has held files for 30 s and the other has none, and at once when only the other is in control. Of several that may, the one that was idle for the longest does.
//!
//! `server.rs` executes requests and runs operations that take more than one call, and `send.rs` sends. They work on
//! sessions (`session.rs`), open files (`file.rs`), directories, the checksum and the upload, which do not know them.
//! `virtual_files.rs` is the interface of virtual directories, such as `@PARAM`. Other services implement it; this one
//! knows none of them.

mod checksum;
mod directory;
mod file;
mod packet;
mod path;
mod send;
mod server;
mod session;
#[cfg(test)]
mod tests;
mod upload;
mod vehicle;
mod virtual_files;

use core::num::Wrapping;

pub use send::{FileLink, FileReply};
pub use server::{FileCounters, FileStatus, sessions};
pub use session::Session;
pub use vehicle::{FileAccess, FileChange, FileEntry, Files, OpenFile, StaticFile};
pub use virtual_files::{HasFiles, NoFile, OneOf, Part, VirtualEntry, VirtualFile};

use self::server::{Operation, Server};
use self::session::State;
use self::upload::{Upload, UploadState};
use super::{About, Cx, Handled, Received, Service, ShowCounters, StackEvent, Turn, View};
use crate::dialect::{FileTransferProtocol, MavProtocolCapability};
use crate::link::Port;
use crate::message::Message;
use crate::time::Instant;
use crate::types::Firmware;

/// Serves files: `N` [`sessions`] in all, uploads of up to `UPLOAD` bytes, and the files `V` of virtual directories.
#[derive(Debug)]
pub struct FileServer<const N: usize, const UPLOAD: usize, V> {
    pub(crate) status: FileStatus,
    operation: Operation<V>,
    sessions: [Session<V>; N],
    upload: Upload,
    content: heapless::Vec<u8, UPLOAD>,
}

impl<F, V, const N: usize, const UPLOAD: usize> Service<F> for FileServer<N, UPLOAD, V>
where
    F: Firmware<Vehicle: Files>,
    V: VirtualFile<F>,
{
    type Link = FileLink;
    const VACANT: FileLink = FileLink { first: 0, retry_at: Instant::ZERO };
    type Reply = FileReply;
    const ABOUT: About = About {
        turns: &[Turn::FileAnswer, Turn::LateBulk, Turn::Bulk],
        capabilities: MavProtocolCapability::FTP,
        holds: true,
        ..About::AUTOPILOT
    };
    const NEW: Self = {
        assert!(UPLOAD < 65_536, "an upload has less than 65,536 bytes");
        assert!(UPLOAD >= V::UPLOAD_ROOM, "plans as files need `upload: 276` or more");
        StaticFile::check(F::Vehicle::FILES);
        Self {
            status: FileStatus::NEW,
            operation: Operation::Nothing,
            sessions: [const { Session::FREE }; N],
            upload: Upload { state: UploadState::Opening, received: 0, grown: Wrapping(0) },
            content: heapless::Vec::new(),
        }
    };

    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut FileLink>) {
        if cx.now >= self.status.wake {
            self.server(cx).end_silent_sessions();
        }
        if self.operation.is_running() && cx.now >= self.status.retry_at {
            self.server(cx).run_operation();
        }
    }

    fn deadline(&self) -> Instant {
        let FileStatus { wake, retry_at, .. } = self.status;
        if self.operation.is_running() { wake.min(retry_at) } else { wake }
    }

    fn on_frame(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, _: &mut FileLink, received: &Received<'_>) -> Handled {
        if received.frame.id() != FileTransferProtocol::ID {
            return Handled::No;
        }
        if received.target.system.is_all() {
            return Handled::OutOfPlace;
        }
        if port.is_stalled() {
            return Handled::NoRoom;
        }
        let handled = self.server(cx).on_packet(received, port.config.bytes_per_second);
        self.slow_streams::<F>(cx.now, port);
        handled
    }

    #[inline(always)]
    fn pending(&self, view: &View<'_>, port: &Port, link: &FileLink, turn: Turn) -> Option<(Instant, FileReply)> {
        if self.status.wake == Instant::NEVER {
            // There is no client.
            return None;
        }
        let next = |state| session::next(&self.sessions, port.id, link.first, state);
        match turn {
            Turn::FileAnswer => next(State::Pending).map(|index| (view.now, FileReply::Answer(index))),
            _ => next(State::PendingData).map(|index| (link.retry_at, FileReply::Data(index))),
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
        match event {
            // The clients are gone, or get no answers. The next poll closes their files.
            StackEvent::Opened(port, _) | StackEvent::Stalled(port, _) => {
                self.status.wake = Instant::ZERO;
                for session in &mut self.sessions {
                    session.id = session.id.filter(|id| id.client.link != port.id);
                }
            }
            // The next poll ends the uploads of those that are not in control any more (X-5).
            StackEvent::NewOwner { .. } => self.status.wake = Instant::ZERO,
            _ => {}
        }
    }
}

impl<const N: usize, const UPLOAD: usize, V> FileServer<N, UPLOAD, V> {
    /// Has streams slowed on a link while a client transfers a file there (F-11).
    fn slow_streams<F: Firmware>(&self, now: Instant, port: &mut Port) {
        if F::SLOWS_STREAMS {
            port.facts.transferring_until = session::transferring_until(&self.sessions, port.id, now);
        }
    }

    fn server<'a, 'c, F: Firmware>(&'a mut self, cx: &'a mut Cx<'c, F>) -> Server<'a, 'c, F, V, N> {
        let Self { status, operation, sessions, upload, content } = self;
        Server { cx, status, operation, sessions, upload, content }
    }

    /// Whether a poll has something to compute.
    #[cfg(test)]
    pub(crate) const fn is_working(&self) -> bool {
        self.operation.is_running()
    }
}
