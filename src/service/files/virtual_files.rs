//! Virtual directories: a service of the stack generates their files while they are read (F-10).
//!
//! A virtual directory is in the root, and its name begins with `@`. One type represents it: that of its open files,
//! which implements [`VirtualFile`]. The service names this type by [`HasFiles`], and has a line in the list of `type
//! Files` in `stack/declare.rs`. From this list [`OneOf`] makes the type of a file of any directory; [`NoFile`] ends
//! the list.
//!
//! A service that is not declared is [`Absent`], whose file is [`NoFile`]: a type without values, so the compiler
//! removes all code that would handle one.

use core::fmt::Debug;

use super::list::Entries;
use super::packet::Body;
use crate::dialect::MavFtpErr;
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

/// An open file of a virtual directory. It is small: each session has one.
pub trait VirtualFile<F: Firmware>: Copy + Debug {
    /// The name of the directory, with `@`; empty if there is none.
    const DIRECTORY: &'static [u8];
    /// Whether files can be uploaded to it. If not, the code for uploads is not linked.
    const UPLOADS: bool = false;

    /// Opens a file for an upload or for reading. `path` is its path in the directory.
    ///
    /// # Errors
    ///
    /// [`MavFtpErr::FILENOTFOUND`], [`MavFtpErr::FILEPROTECTED`] for a file that cannot be uploaded, or [`MavFtpErr::FAIL`].
    fn open(cx: &mut Cx<'_, F>, path: &[u8], is_upload: bool) -> Result<Self, MavFtpErr>;

    /// Returns its size (bytes): that of its [`entry`](Self::entry), and what reads of any length deliver (F-30). Called after
    /// [`open`](Self::open).
    fn size(&self, cx: &Cx<'_, F>) -> u32;

    /// Called before a client reads, with the length of the data in its packets.
    fn begin_to_read(&mut self, packet: u8) {
        let _ = packet;
    }

    /// Reads as much as `out` takes, at most 239 bytes; nothing after the end of the file. [`Body::Later`] if the read
    /// takes another call.
    fn read(&mut self, cx: &mut Cx<'_, F>, offset: u32, out: &mut [u8]) -> Body;

    /// Writes the name of a file of the directory. Returns its size (bytes), and the time of its last change (s since
    /// 1970, UTC; 0 if unknown). `None` after the last file.
    fn entry(cx: &mut Cx<'_, F>, index: u16, name: &mut Entries<'_>) -> Option<(u32, u32)>;

    /// The room that an upload needs: `upload` in [`#[stack]`](macro@crate::Stack).
    const UPLOAD_ROOM: usize = 1;

    /// Begins an upload, after [`open`](Self::open). `None` if that takes another call. After a refusal the file is closed.
    fn begin(&self, cx: &mut Cx<'_, F>, from: Peer) -> Option<Result<(), MavFtpErr>> {
        let _ = (cx, from);
        Some(Ok(()))
    }

    /// Takes the next part of an upload. `content` is all that has arrived and is still needed: this part is its end.
    fn take(&self, cx: &mut Cx<'_, F>, content: &[u8]) -> Part {
        let _ = (cx, content);
        Part::Last
    }

    /// Applies a complete upload, as a whole or not at all. `None` if that takes another call. It continues even if the
    /// client is gone.
    fn finish(&mut self, cx: &mut Cx<'_, F>, from: Peer, content: &[u8]) -> Option<Result<(), MavFtpErr>> {
        let _ = (cx, from, content);
        Some(Err(MavFtpErr::FILEPROTECTED))
    }

    /// Called when an upload is closed, complete or not.
    fn close(&self, cx: &mut Cx<'_, F>) {
        let _ = cx;
    }
}

/// The result of a part of an upload.
#[derive(Debug)]
pub enum Part {
    /// More parts follow. This number of bytes of the content is no longer needed.
    Taken(usize),
    /// This was the last part: [`VirtualFile::finish`] is next.
    Last,
    /// The upload is refused.
    Refused(MavFtpErr),
}

/// An open file of any virtual directory. The directories have numbers.
pub trait VirtualFiles<F: Firmware>: Copy + Debug {
    /// The number of directories.
    const COUNT: u16;
    /// Whether any directory has uploads, and the stack room for one.
    const UPLOADS: bool;
    /// The room that an upload to any of them needs.
    const UPLOAD_ROOM: usize;

    /// Returns the name of a directory; empty if there is none with this number.
    fn name(directory: u16) -> &'static [u8];

    /// As [`VirtualFile::open`], with the whole path.
    fn open(cx: &mut Cx<'_, F>, path: &[u8], is_upload: bool) -> Result<Self, MavFtpErr>;

    /// As [`VirtualFile::size`].
    fn size(&self, cx: &Cx<'_, F>) -> u32;

    /// As [`VirtualFile::begin_to_read`].
    fn begin_to_read(&mut self, packet: u8);

    /// As [`VirtualFile::read`].
    fn read(&mut self, cx: &mut Cx<'_, F>, offset: u32, out: &mut [u8]) -> Body;

    /// As [`VirtualFile::entry`].
    fn entry(cx: &mut Cx<'_, F>, directory: u16, index: u16, name: &mut Entries<'_>) -> Option<(u32, u32)>;

    /// As [`VirtualFile::begin`].
    fn begin(&self, cx: &mut Cx<'_, F>, from: Peer) -> Option<Result<(), MavFtpErr>>;

    /// As [`VirtualFile::take`].
    fn take(&self, cx: &mut Cx<'_, F>, content: &[u8]) -> Part;

    /// As [`VirtualFile::finish`].
    fn finish(&mut self, cx: &mut Cx<'_, F>, from: Peer, content: &[u8]) -> Option<Result<(), MavFtpErr>>;

    /// As [`VirtualFile::close`].
    fn close(&self, cx: &mut Cx<'_, F>);
}

/// No file: that of a service without a virtual directory, and the end of a list.
#[derive(Clone, Copy, Debug)]
pub enum NoFile {}

impl<F: Firmware> VirtualFile<F> for NoFile {
    const DIRECTORY: &'static [u8] = b"";

    fn open(_: &mut Cx<'_, F>, _: &[u8], _: bool) -> Result<Self, MavFtpErr> {
        Err(MavFtpErr::FILENOTFOUND)
    }

    fn size(&self, _: &Cx<'_, F>) -> u32 {
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
    const UPLOAD_ROOM: usize = 0;

    fn name(_: u16) -> &'static [u8] {
        b""
    }

    fn open(cx: &mut Cx<'_, F>, path: &[u8], is_upload: bool) -> Result<Self, MavFtpErr> {
        VirtualFile::open(cx, path, is_upload)
    }

    fn size(&self, _: &Cx<'_, F>) -> u32 {
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

    fn begin(&self, _: &mut Cx<'_, F>, _: Peer) -> Option<Result<(), MavFtpErr>> {
        match *self {}
    }

    fn take(&self, _: &mut Cx<'_, F>, _: &[u8]) -> Part {
        match *self {}
    }

    fn finish(&mut self, _: &mut Cx<'_, F>, _: Peer, _: &[u8]) -> Option<Result<(), MavFtpErr>> {
        match *self {}
    }

    fn close(&self, _: &mut Cx<'_, F>) {
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

/// Returns the number of a directory among those after the first one; `None` if it is the first one. A service that is
/// not declared has none.
const fn number_in_rest(directory: u16, first: &[u8]) -> Option<u16> {
    if first.is_empty() { Some(directory) } else { directory.checked_sub(1) }
}

impl<F: Firmware, const UPLOADS: bool, A: VirtualFile<F>, B: VirtualFiles<F>> VirtualFiles<F> for OneOf<UPLOADS, A, B> {
    const COUNT: u16 = B::COUNT.saturating_add(if A::DIRECTORY.is_empty() { 0 } else { 1 });
    const UPLOADS: bool = UPLOADS && (A::UPLOADS || B::UPLOADS);
    const UPLOAD_ROOM: usize = {
        let first = if A::UPLOADS { A::UPLOAD_ROOM } else { 0 };
        if first > B::UPLOAD_ROOM { first } else { B::UPLOAD_ROOM }
    };

    fn name(directory: u16) -> &'static [u8] {
        number_in_rest(directory, A::DIRECTORY).map_or(A::DIRECTORY, B::name)
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

    fn size(&self, cx: &Cx<'_, F>) -> u32 {
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
        match number_in_rest(directory, A::DIRECTORY) {
            None => A::entry(cx, index, name),
            Some(rest) => B::entry(cx, rest, index, name),
        }
    }

    fn begin(&self, cx: &mut Cx<'_, F>, from: Peer) -> Option<Result<(), MavFtpErr>> {
        match self {
            Self::First(file) => file.begin(cx, from),
            Self::Rest(file) => file.begin(cx, from),
        }
    }

    fn take(&self, cx: &mut Cx<'_, F>, content: &[u8]) -> Part {
        match self {
            Self::First(file) => file.take(cx, content),
            Self::Rest(file) => file.take(cx, content),
        }
    }

    fn finish(&mut self, cx: &mut Cx<'_, F>, from: Peer, content: &[u8]) -> Option<Result<(), MavFtpErr>> {
        match self {
            Self::First(file) => file.finish(cx, from, content),
            Self::Rest(file) => file.finish(cx, from, content),
        }
    }

    fn close(&self, cx: &mut Cx<'_, F>) {
        match self {
            Self::First(file) => file.close(cx),
            Self::Rest(file) => file.close(cx),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::string::String;
    use std::vec::Vec;

    use super::super::list::{directory, list};
    use super::super::open::{open, read};
    use super::super::requests::Stop;
    use super::super::session::Open;
    use super::super::{FileAccess, Files};
    use super::*;
    use crate::message::Address;
    use crate::service::param::NoParams;
    use crate::service::rest::Rest;
    use crate::time::Instant;
    use crate::types::{LinkId, NoPlans};

    /// A firmware whose vehicle has no files.
    struct Shelf;

    impl Files for Shelf {}

    impl Firmware for Shelf {
        type Vehicle = Self;
        type Plans = NoPlans;
        type Parameters = NoParams;
    }

    /// `@NOTES/0` to `@NOTES/2`: its number, repeated. A read takes two calls.
    #[derive(Clone, Copy, Debug)]
    struct Note {
        number: u8,
        is_ready: bool,
    }

    impl VirtualFile<Shelf> for Note {
        const DIRECTORY: &'static [u8] = b"@NOTES";

        fn open(_: &mut Cx<'_, Shelf>, path: &[u8], _: bool) -> Result<Self, MavFtpErr> {
            match path {
                [number @ b'0'..=b'2'] => Ok(Self { number: *number, is_ready: false }),
                _ => Err(MavFtpErr::FILENOTFOUND),
            }
        }

        fn size(&self, _: &Cx<'_, Shelf>) -> u32 {
            3
        }

        fn read(&mut self, _: &mut Cx<'_, Shelf>, offset: u32, out: &mut [u8]) -> Body {
            if !core::mem::replace(&mut self.is_ready, true) {
                return Body::Later;
            }
            let rest = 3usize.saturating_sub(offset as usize).min(out.len());
            out[..rest].fill(self.number);
            Body::Data(rest)
        }

        fn entry(_: &mut Cx<'_, Shelf>, index: u16, name: &mut Entries<'_>) -> Option<(u32, u32)> {
            name.decimal(index.into());
            (index < 3).then_some((3, 1_700_000_000 + u32::from(index)))
        }
    }

    /// `@BIN/drop`: it is only uploaded, four bytes that are not zero.
    #[derive(Clone, Copy, Debug)]
    struct Bin;

    impl VirtualFile<Shelf> for Bin {
        const DIRECTORY: &'static [u8] = b"@BIN";
        const UPLOADS: bool = true;

        fn open(_: &mut Cx<'_, Shelf>, path: &[u8], is_upload: bool) -> Result<Self, MavFtpErr> {
            if path == b"drop" && is_upload { Ok(Self) } else { Err(MavFtpErr::FAIL) }
        }

        fn size(&self, _: &Cx<'_, Shelf>) -> u32 {
            0
        }

        fn read(&mut self, _: &mut Cx<'_, Shelf>, _: u32, _: &mut [u8]) -> Body {
            Body::Refused(MavFtpErr::FAIL)
        }

        fn entry(_: &mut Cx<'_, Shelf>, _: u16, _: &mut Entries<'_>) -> Option<(u32, u32)> {
            None
        }

        fn take(&self, _: &mut Cx<'_, Shelf>, content: &[u8]) -> Part {
            if content.len() == 4 { Part::Last } else { Part::Taken(0) }
        }

        fn finish(&mut self, _: &mut Cx<'_, Shelf>, _: Peer, content: &[u8]) -> Option<Result<(), MavFtpErr>> {
            Some(if content.contains(&0) { Err(MavFtpErr::FAIL) } else { Ok(()) })
        }
    }

    type With<const UPLOADS: bool> = OneOf<UPLOADS, Note, OneOf<UPLOADS, NoFile, OneOf<UPLOADS, Bin, NoFile>>>;
    type All = With<true>;

    const CLIENT: Peer = Peer { address: Address::new(255, 190), link: LinkId(0) };

    /// Calls with a context.
    fn with<R>(call: impl FnOnce(&mut Cx<'_, Shelf>) -> R) -> R {
        let (mut rest, mut parameters, mut vehicle) = (Rest::new(), NoParams, Shelf);
        call(&mut rest.cx(Instant::ZERO, &mut parameters, &mut vehicle))
    }

    fn opened<V: VirtualFiles<Shelf>>(path: &str, access: FileAccess) -> Result<Open<V>, MavFtpErr> {
        with(|cx| open(cx, path.as_bytes(), access, CLIENT, V::UPLOADS)).map(|(open, _)| open)
    }

    fn listed(path: &str, first: u32, has_time: bool) -> Result<String, MavFtpErr> {
        let mut out = [0; 40];
        let listed = with(|cx| {
            let directory = directory::<Shelf, All>(cx, path.as_bytes())?;
            list::<Shelf, All>(cx, directory, first, has_time, &mut out)
        });
        let entries = |len: u32| out[..len as usize].iter().map(|byte| char::from(*byte)).collect();
        listed.map(entries).map_err(|stop| stop.error().expect("an error"))
    }

    /// F-9: the root has the directories of the services that are declared, and each of these its files.
    #[test]
    fn directories_are_listed() {
        assert_eq!(listed("", 0, false).as_deref(), Ok("D@NOTES\0D@BIN\0"));
        assert_eq!(listed("", 1, true).as_deref(), Ok("D@BIN\t0\t0\0"));
        assert_eq!(listed("", 2, false), Err(MavFtpErr::EOF));
        assert_eq!(listed("@NOTES", 0, false).as_deref(), Ok("F0\t3\0F1\t3\0F2\t3\0"));
        // As many whole entries as there is room for.
        assert_eq!(listed("@NOTES", 0, true).as_deref(), Ok("F0\t3\t1700000000\0F1\t3\t1700000001\0"));
        assert_eq!(listed("@NOTES", 2, true).as_deref(), Ok("F2\t3\t1700000002\0"));
        assert_eq!(listed("@BIN", 0, false), Err(MavFtpErr::EOF));
        for path in ["@", "@NOTE", "@NOTES/0", "@OTHER"] {
            assert_eq!(listed(path, 0, false), Err(MavFtpErr::FILENOTFOUND), "{path}");
        }
    }

    /// F-3, F-8: a file of any directory is opened and read, also if that takes several calls.
    #[test]
    fn files_are_read() {
        let mut open = opened::<All>("@NOTES/1", FileAccess::Read).expect("it exists");
        let mut parts = Vec::new();
        let mut out = [0; 2];
        for offset in [0, 0, 2, 3] {
            parts.push(with(|cx| read(cx, &mut open, 3, offset, &mut out)).map_err(Stop::error));
        }
        assert_eq!(parts, [Err(None), Ok(2), Ok(1), Err(Some(MavFtpErr::EOF))]);
        // F-30: not beyond the end that the client knows.
        assert_eq!(with(|cx| read(cx, &mut open, 1, 0, &mut out)).map_err(Stop::error), Ok(1));
        assert_eq!(out, *b"11");
        let Open::Virtual(file) = &mut open else { panic!("{open:?}") };
        assert_eq!(with(|cx| file.size(cx)), 3);
        for path in ["@NOTES/3", "@NOTES", "@NOTES/", "@OTHER/0", "@"] {
            let error = opened::<All>(path, FileAccess::Read).expect_err(path);
            assert_eq!(error, MavFtpErr::FILENOTFOUND, "{path}");
        }
    }

    /// F-5: only what can be uploaded is opened to be written, and only if the stack has room for it.
    #[test]
    fn uploads_need_a_directory_and_room() {
        let Ok(Open::Upload(mut file)) = opened::<All>("@BIN/drop", FileAccess::Create) else { panic!("no upload") };
        let take = |content| with(|cx| file.take(cx, content));
        assert!(matches!((take(b"123"), take(b"1234")), (Part::Taken(0), Part::Last)));
        let from = Peer { address: Address::new(255, 190), link: LinkId(0) };
        assert_eq!(with(|cx| file.finish(cx, from, b"1234")), Some(Ok(())));
        assert_eq!(with(|cx| file.finish(cx, from, b"\x0012")), Some(Err(MavFtpErr::FAIL)));
        assert_eq!(opened::<All>("@NOTES/1", FileAccess::Write).expect_err("read-only"), MavFtpErr::FILEPROTECTED);
        let error = opened::<With<false>>("@BIN/drop", FileAccess::Create).expect_err("no room");
        assert_eq!(error, MavFtpErr::FILEPROTECTED);
        let busy = with(|cx| open::<Shelf, All>(cx, b"@BIN/drop", FileAccess::Create, CLIENT, false).map(|_| ()));
        assert_eq!(busy, Err(MavFtpErr::FILEPROTECTED), "another upload is running");
    }
}
