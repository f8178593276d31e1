//! Virtual directories: a service of the stack generates their files while they are read (F-10).
//!
//! A virtual directory is in the root, and its name begins with `@`. One type represents it: that of its open files,
//! which implements [`VirtualFile`]. The service names this type by [`HasFiles`], and is in the list of files in
//! `crates/macros/src/entries.rs`. From this list [`OneOf`] makes the type of a file of any directory; [`NoFile`] ends
//! the list.
//!
//! A service that is not declared is [`Absent`], whose file is [`NoFile`]: a type without values, so the compiler
//! removes all code that would handle one.

use core::fmt::Debug;
use core::task::Poll;

use super::vehicle::FileAccess;
use crate::dialect::MavFtpErr;
use crate::message::Text;
use crate::service::{Absent, Cx};
use crate::types::{Firmware, Peer};

/// A service that may have a virtual directory.
pub trait HasFiles {
    /// An open file of the directory.
    type File;
}

impl HasFiles for Absent {
    type File = NoFile;
}

/// An open file of a virtual directory, or of a list of them. It is small: each session has one.
///
/// A method that returns [`Poll::Pending`] takes more than one call, and is called again.
pub trait VirtualFile<F: Firmware>: Copy + Debug {
    /// The number of directories. They are numbered from 0.
    const DIRECTORIES: u16 = 1;
    /// The room that an upload needs: `upload` in [`#[stack]`](macro@crate::Stack). If it is 0, no file can be uploaded, and the
    /// code for uploads is not linked.
    const UPLOAD_ROOM: usize = 0;
    /// Whether files can be uploaded.
    const UPLOADS: bool = Self::UPLOAD_ROOM > 0;

    /// Returns the name of a directory, with `@`.
    fn name(directory: u16) -> &'static [u8];

    /// Opens a file: for an upload, if the access is not [`FileAccess::Read`]. `path` is its path in the directory.
    ///
    /// # Errors
    ///
    /// [`MavFtpErr::FILENOTFOUND`], [`MavFtpErr::FILEPROTECTED`] for a file that cannot be uploaded, or [`MavFtpErr::FAIL`].
    fn open(cx: &mut Cx<'_, F>, directory: u16, path: &[u8], access: FileAccess) -> Result<Self, MavFtpErr>;

    /// Returns its size (bytes): that of its [`entry`](Self::entry), and the sum of reads of any length (F-30). Called
    /// after [`open`](Self::open).
    fn size(&self, cx: &Cx<'_, F>) -> u32;

    /// Called before a client reads, with the length of the data in its packets.
    fn begin_to_read(&mut self, packet: u8) {
        let _ = packet;
    }

    /// Reads as much as `out` takes, at most 239 bytes, and returns the number of bytes; 0 after the end of the file.
    fn read(&mut self, cx: &mut Cx<'_, F>, offset: u32, out: &mut [u8]) -> Poll<Result<usize, MavFtpErr>>;

    /// Returns a file of a directory; `None` after the last one.
    fn entry(cx: &mut Cx<'_, F>, directory: u16, index: u16) -> Option<VirtualEntry>;

    /// Begins an upload, after [`open`](Self::open). After a refusal the file is closed.
    fn begin(&self, cx: &mut Cx<'_, F>, from: Peer) -> Poll<Result<(), MavFtpErr>> {
        let _ = (cx, from);
        Poll::Ready(Ok(()))
    }

    /// Takes the next part of an upload. `content` is all that has arrived and is still needed: this part is its end.
    fn take(&self, cx: &mut Cx<'_, F>, content: &[u8]) -> Result<Part, MavFtpErr> {
        let _ = (cx, content);
        Ok(Part::Last)
    }

    /// Applies a complete upload, as a whole or not at all. It continues even if the client is gone.
    fn finish(&mut self, cx: &mut Cx<'_, F>, from: Peer, content: &[u8]) -> Poll<Result<(), MavFtpErr>> {
        let _ = (cx, from, content);
        Poll::Ready(Err(MavFtpErr::FILEPROTECTED))
    }

    /// Called when an upload is closed, complete or not.
    fn close(&self, cx: &mut Cx<'_, F>) {
        let _ = cx;
    }
}

/// A file in a virtual directory.
#[derive(Clone, Copy, Debug)]
pub struct VirtualEntry {
    /// The name, without a path.
    pub name: Text<32>,
    /// The size (bytes).
    pub size: u32,
    /// The time of the last change (s since 1970, UTC); 0 if unknown.
    pub time: u32,
}

/// A part of an upload that was taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// More parts follow.
    More {
        /// The number of bytes at the front of the content that are no longer needed.
        used: usize,
    },
    /// It was the last part: [`VirtualFile::finish`] is next.
    Last,
}

/// Returns the number of the directory with this name.
pub(super) fn find<F: Firmware, V: VirtualFile<F>>(name: &[u8]) -> Option<u16> {
    (0..V::DIRECTORIES).find(|directory| V::name(*directory) == name)
}

/// Returns the names of all directories, in order.
pub(super) fn names<F: Firmware, V: VirtualFile<F>>() -> impl Iterator<Item = &'static [u8]> {
    (0..V::DIRECTORIES).map(V::name)
}

/// Opens a file in any directory.
pub(super) fn open<F: Firmware, V: VirtualFile<F>>(
    cx: &mut Cx<'_, F>,
    path: &[u8],
    access: FileAccess,
) -> Result<V, MavFtpErr> {
    for directory in 0..V::DIRECTORIES {
        if let Some([b'/', file @ ..]) = path.strip_prefix(V::name(directory)) {
            return V::open(cx, directory, file, access);
        }
    }
    Err(MavFtpErr::FILENOTFOUND)
}

/// No file: that of a service without a virtual directory, and the end of a list.
#[derive(Clone, Copy, Debug)]
pub enum NoFile {}

impl<F: Firmware> VirtualFile<F> for NoFile {
    const DIRECTORIES: u16 = 0;

    fn name(_: u16) -> &'static [u8] {
        b""
    }

    fn open(_: &mut Cx<'_, F>, _: u16, _: &[u8], _: FileAccess) -> Result<Self, MavFtpErr> {
        Err(MavFtpErr::FILENOTFOUND)
    }

    fn size(&self, _: &Cx<'_, F>) -> u32 {
        match *self {}
    }

    fn read(&mut self, _: &mut Cx<'_, F>, _: u32, _: &mut [u8]) -> Poll<Result<usize, MavFtpErr>> {
        match *self {}
    }

    fn entry(_: &mut Cx<'_, F>, _: u16, _: u16) -> Option<VirtualEntry> {
        None
    }
}

/// An open file of a list of virtual directories: of the first ones, or of the rest. `UPLOADS`: whether the stack has room for an
/// upload.
#[derive(Clone, Copy, Debug)]
pub enum OneOf<const UPLOADS: bool, A, B> {
    /// A file of the first directories.
    First(A),
    /// A file of one of the others.
    Rest(B),
}

/// Calls a method of either file.
macro_rules! either {
    ($either:ident, $file:ident => $call:expr) => {
        match $either {
            Self::First($file) => $call,
            Self::Rest($file) => $call,
        }
    };
}

impl<F: Firmware, const UPLOADS: bool, A: VirtualFile<F>, B: VirtualFile<F>> VirtualFile<F> for OneOf<UPLOADS, A, B> {
    const DIRECTORIES: u16 = A::DIRECTORIES.saturating_add(B::DIRECTORIES);
    const UPLOAD_ROOM: usize = match UPLOADS {
        true if A::UPLOAD_ROOM > B::UPLOAD_ROOM => A::UPLOAD_ROOM,
        true => B::UPLOAD_ROOM,
        false => 0,
    };

    fn name(directory: u16) -> &'static [u8] {
        match directory.checked_sub(A::DIRECTORIES) {
            None => A::name(directory),
            Some(rest) => B::name(rest),
        }
    }

    fn open(cx: &mut Cx<'_, F>, directory: u16, path: &[u8], access: FileAccess) -> Result<Self, MavFtpErr> {
        match directory.checked_sub(A::DIRECTORIES) {
            None if access != FileAccess::Read && !(UPLOADS && A::UPLOADS) => Err(MavFtpErr::FILEPROTECTED),
            None => A::open(cx, directory, path, access).map(Self::First),
            Some(rest) => B::open(cx, rest, path, access).map(Self::Rest),
        }
    }

    fn size(&self, cx: &Cx<'_, F>) -> u32 {
        either!(self, file => file.size(cx))
    }

    fn begin_to_read(&mut self, packet: u8) {
        either!(self, file => file.begin_to_read(packet));
    }

    fn read(&mut self, cx: &mut Cx<'_, F>, offset: u32, out: &mut [u8]) -> Poll<Result<usize, MavFtpErr>> {
        either!(self, file => file.read(cx, offset, out))
    }

    fn entry(cx: &mut Cx<'_, F>, directory: u16, index: u16) -> Option<VirtualEntry> {
        match directory.checked_sub(A::DIRECTORIES) {
            None => A::entry(cx, directory, index),
            Some(rest) => B::entry(cx, rest, index),
        }
    }

    fn begin(&self, cx: &mut Cx<'_, F>, from: Peer) -> Poll<Result<(), MavFtpErr>> {
        either!(self, file => file.begin(cx, from))
    }

    fn take(&self, cx: &mut Cx<'_, F>, content: &[u8]) -> Result<Part, MavFtpErr> {
        either!(self, file => file.take(cx, content))
    }

    fn finish(&mut self, cx: &mut Cx<'_, F>, from: Peer, content: &[u8]) -> Poll<Result<(), MavFtpErr>> {
        either!(self, file => file.finish(cx, from, content))
    }

    fn close(&self, cx: &mut Cx<'_, F>) {
        either!(self, file => file.close(cx));
    }
}
