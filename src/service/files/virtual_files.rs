//! Virtual directories: their files are not stored, but made by a service of the stack while they are read (F-10).
//!
//! A virtual directory is in the root, and its name begins with `@`. It is one type: that of its open files, which implements
//! [`VirtualFile`]. The service names this type by [`HasFiles`], and is a line in the list of `type Files` in `stack/declare.rs`.
//! From this list [`OneOf`] makes the type of a file of any directory, and [`NoFile`] ends it.
//!
//! A service that is not declared is [`Absent`], whose file is [`NoFile`]: a type without values, so the compiler leaves out
//! all that would handle one.

use core::fmt::Debug;

use super::list::Entries;
use super::packet::Body;
use crate::dialect::MavFtpErr;
use crate::service::{Absent, Cx};
use crate::types::{Firmware, Peer};

/// A service that may have a virtual directory.
pub trait HasFiles {
    /// An open file of it.
    type File;
}

impl HasFiles for Absent {
    type File = NoFile;
}

/// An open file of a virtual directory. It is small: each session has one.
pub trait VirtualFile<F: Firmware>: Copy + Debug {
    /// The name of the directory, with `@`; empty if there is none.
    const DIRECTORY: &'static [u8];
    /// Whether files are uploaded to it. The code for it is left out if not.
    const UPLOADS: bool = false;

    /// Opens a file, which is uploaded or read. `path` is its path in the directory.
    ///
    /// # Errors
    ///
    /// [`MavFtpErr::FILENOTFOUND`], [`MavFtpErr::FILEPROTECTED`] for a file that cannot be uploaded, or [`MavFtpErr::FAIL`].
    fn open(cx: &mut Cx<'_, F>, path: &[u8], is_upload: bool) -> Result<Self, MavFtpErr>;

    /// Returns its size (bytes); `None` if that takes another call.
    fn size(&mut self, cx: &mut Cx<'_, F>) -> Option<u32>;

    /// Called before a client reads by packets with so much data.
    fn begin_to_read(&mut self, packet: u8) {
        let _ = packet;
    }

    /// Reads as much as `out` takes, at most 239 bytes; nothing behind the end of the file. [`Body::Later`] if that takes another
    /// call.
    fn read(&mut self, cx: &mut Cx<'_, F>, offset: u32, out: &mut [u8]) -> Body;

    /// Writes the name of a file of the directory. Returns its size (bytes), and when it was last changed (s since 1970, UTC; 0
    /// if that is unknown). `None` behind the last one.
    fn entry(cx: &mut Cx<'_, F>, index: u16, name: &mut Entries<'_>) -> Option<(u32, u32)>;

    /// Whether an upload is complete: called after each of its parts, with what has arrived.
    fn is_complete(&self, content: &[u8]) -> bool {
        let _ = content;
        true
    }

    /// Takes up an upload that is complete, as a whole or not at all. `None` if that takes another call.
    fn finish(&mut self, cx: &mut Cx<'_, F>, from: Peer, content: &[u8]) -> Option<Result<(), MavFtpErr>> {
        let _ = (cx, from, content);
        Some(Err(MavFtpErr::FILEPROTECTED))
    }
}

/// An open file of any virtual directory. The directories have numbers.
pub trait VirtualFiles<F: Firmware>: Copy + Debug {
    /// The number of directories, those without a name included.
    const COUNT: u16;
    /// Whether any directory has uploads, and the stack room for one.
    const UPLOADS: bool;

    /// Returns the name of a directory; empty if there is none with this number.
    fn name(directory: u16) -> &'static [u8];

    /// As [`VirtualFile::open`], with the whole path.
    fn open(cx: &mut Cx<'_, F>, path: &[u8], is_upload: bool) -> Result<Self, MavFtpErr>;

    /// As [`VirtualFile::size`].
    fn size(&mut self, cx: &mut Cx<'_, F>) -> Option<u32>;

    /// As [`VirtualFile::begin_to_read`].
    fn begin_to_read(&mut self, packet: u8);

    /// As [`VirtualFile::read`].
    fn read(&mut self, cx: &mut Cx<'_, F>, offset: u32, out: &mut [u8]) -> Body;

    /// As [`VirtualFile::entry`].
    fn entry(cx: &mut Cx<'_, F>, directory: u16, index: u16, name: &mut Entries<'_>) -> Option<(u32, u32)>;

    /// As [`VirtualFile::is_complete`].
    fn is_complete(&self, content: &[u8]) -> bool;

    /// As [`VirtualFile::finish`].
    fn finish(&mut self, cx: &mut Cx<'_, F>, from: Peer, content: &[u8]) -> Option<Result<(), MavFtpErr>>;
}

/// No file: that of a service without a virtual directory, and the end of a list.
#[derive(Clone, Copy, Debug)]
pub enum NoFile {}

impl<F: Firmware> VirtualFile<F> for NoFile {
    const DIRECTORY: &'static [u8] = b"";

    fn open(_: &mut Cx<'_, F>, _: &[u8], _: bool) -> Result<Self, MavFtpErr> {
        Err(MavFtpErr::FILENOTFOUND)
    }

    fn size(&mut self, _: &mut Cx<'_, F>) -> Option<u32> {
        match *self {}
    }

    fn read(&mut self, _: &mut Cx<'_, F>, _: u32, _: &mut [u8]) -> Body {
        match *self {}
    }

    fn entry(_: &mut Cx<'_, F>, _: u16, _: &mut Entries<'_>) -> Option<(u32, u32)> {
        None
    }
}

impl<F: Firmware> VirtualFiles<F> for NoFile {
    const COUNT: u16 = 0;
    const UPLOADS: bool = false;

    fn name(_: u16) -> &'static [u8] {
        b""
    }

    fn open(cx: &mut Cx<'_, F>, path: &[u8], is_upload: bool) -> Result<Self, MavFtpErr> {
        VirtualFile::open(cx, path, is_upload)
    }

    fn size(&mut self, _: &mut Cx<'_, F>) -> Option<u32> {
        match *self {}
    }

    fn begin_to_read(&mut self, _: u8) {
        match *self {}
    }

    fn read(&mut self, _: &mut Cx<'_, F>, _: u32, _: &mut [u8]) -> Body {
        match *self {}
    }

    fn entry(_: &mut Cx<'_, F>, _: u16, _: u16, _: &mut Entries<'_>) -> Option<(u32, u32)> {
        None
    }

    fn is_complete(&self, _: &[u8]) -> bool {
        match *self {}
    }

    fn finish(&mut self, _: &mut Cx<'_, F>, _: Peer, _: &[u8]) -> Option<Result<(), MavFtpErr>> {
        match *self {}
    }
}

/// An open file of a list of virtual directories: of the first one, or of one of the rest. `UPLOADS`: whether the stack has room
/// for an upload.
#[derive(Clone, Copy, Debug)]
pub enum OneOf<const UPLOADS: bool, A, B> {
    /// A file of the first directory.
    First(A),
    /// A file of one of the others.
    Rest(B),
}

impl<F: Firmware, const UPLOADS: bool, A: VirtualFile<F>, B: VirtualFiles<F>> VirtualFiles<F> for OneOf<UPLOADS, A, B> {
    const COUNT: u16 = B::COUNT.saturating_add(1);
    const UPLOADS: bool = UPLOADS && (A::UPLOADS || B::UPLOADS);

    fn name(directory: u16) -> &'static [u8] {
        directory.checked_sub(1).map_or(A::DIRECTORY, B::name)
    }

    fn open(cx: &mut Cx<'_, F>, path: &[u8], is_upload: bool) -> Result<Self, MavFtpErr> {
        if !A::DIRECTORY.is_empty()
            && let Some([b'/', file @ ..]) = path.strip_prefix(A::DIRECTORY)
        {
            if is_upload && !(UPLOADS && A::UPLOADS) {
                return Err(MavFtpErr::FILEPROTECTED);
            }
            return A::open(cx, file, is_upload).map(Self::First);
        }
        B::open(cx, path, is_upload).map(Self::Rest)
    }

    fn size(&mut self, cx: &mut Cx<'_, F>) -> Option<u32> {
        match self {
            Self::First(file) => file.size(cx),
            Self::Rest(file) => file.size(cx),
        }
    }

    fn begin_to_read(&mut self, packet: u8) {
        match self {
            Self::First(file) => file.begin_to_read(packet),
            Self::Rest(file) => file.begin_to_read(packet),
        }
    }

    fn read(&mut self, cx: &mut Cx<'_, F>, offset: u32, out: &mut [u8]) -> Body {
        match self {
            Self::First(file) => file.read(cx, offset, out),
            Self::Rest(file) => file.read(cx, offset, out),
        }
    }

    fn entry(cx: &mut Cx<'_, F>, directory: u16, index: u16, name: &mut Entries<'_>) -> Option<(u32, u32)> {
        match directory.checked_sub(1) {
            None => A::entry(cx, index, name),
            Some(rest) => B::entry(cx, rest, index, name),
        }
    }

    fn is_complete(&self, content: &[u8]) -> bool {
        match self {
            Self::First(file) => file.is_complete(content),
            Self::Rest(file) => file.is_complete(content),
        }
    }

    fn finish(&mut self, cx: &mut Cx<'_, F>, from: Peer, content: &[u8]) -> Option<Result<(), MavFtpErr>> {
        match self {
            Self::First(file) => file.finish(cx, from, content),
            Self::Rest(file) => file.finish(cx, from, content),
        }
    }
}
