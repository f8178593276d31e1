//! Tests of virtual directories, without the rest of the service.

use core::num::{NonZeroU32, Wrapping};
use core::task::Poll;
use std::string::String;
use std::vec::Vec;

use super::directory::{self, Directory, List};
use super::file::{File, Origin};
use super::packet::{Head, Request, SessionId};
use super::session::{self, Session};
use super::virtual_files::{self, NoFile, OneOf, Part, VirtualEntry, VirtualFile};
use super::{FileAccess, Files};
use crate::dialect::{MavFtpErr, MavFtpOpcode};
use crate::message::{Address, Text};
use crate::service::Cx;
use crate::service::param::NoParams;
use crate::service::rest::Rest;
use crate::time::Instant;
use crate::types::{Firmware, LinkId, NoPlans, Peer, Trust};

/// A firmware whose vehicle has no files.
struct Shelf;

impl Files for Shelf {}

impl Firmware for Shelf {
    type Vehicle = Self;
    type Plans = NoPlans;
    type Parameters = NoParams;
    type Credits = [crate::types::Credits; 0];
}

/// `@NOTES/0` to `@NOTES/2`: its number, repeated. A read takes two calls.
#[derive(Clone, Copy, Debug)]
struct Note {
    number: u8,
    is_ready: bool,
}

impl VirtualFile<Shelf> for Note {
    fn name(_: u16) -> &'static [u8] {
        b"@NOTES"
    }

    fn open(_: &mut Cx<'_, Shelf>, _: u16, path: &[u8], _: FileAccess) -> Result<Self, MavFtpErr> {
        match path {
            [number @ b'0'..=b'2'] => Ok(Self { number: *number, is_ready: false }),
            _ => Err(MavFtpErr::FILENOTFOUND),
        }
    }

    fn size(&self, _: &Cx<'_, Shelf>) -> u32 {
        3
    }

    fn read(&mut self, _: &mut Cx<'_, Shelf>, offset: u32, out: &mut [u8]) -> Poll<Result<usize, MavFtpErr>> {
        if !core::mem::replace(&mut self.is_ready, true) {
            return Poll::Pending;
        }
        let rest = 3usize.saturating_sub(offset as usize).min(out.len());
        out[..rest].fill(self.number);
        Poll::Ready(Ok(rest))
    }

    fn entry(_: &mut Cx<'_, Shelf>, _: u16, index: u16) -> Option<VirtualEntry> {
        let mut name = Text::EMPTY;
        name.push_number(index.into());
        (index < 3).then_some(VirtualEntry { name, size: 3, time: 1_700_000_000 + u32::from(index) })
    }
}

/// `@BIN/drop`: it is only uploaded, four bytes that are not zero.
#[derive(Clone, Copy, Debug)]
struct Bin;

impl VirtualFile<Shelf> for Bin {
    const UPLOAD_ROOM: usize = 4;

    fn name(_: u16) -> &'static [u8] {
        b"@BIN"
    }

    fn open(_: &mut Cx<'_, Shelf>, _: u16, path: &[u8], access: FileAccess) -> Result<Self, MavFtpErr> {
        if path == b"drop" && access != FileAccess::Read { Ok(Self) } else { Err(MavFtpErr::FAIL) }
    }

    fn size(&self, _: &Cx<'_, Shelf>) -> u32 {
        0
    }

    fn read(&mut self, _: &mut Cx<'_, Shelf>, _: u32, _: &mut [u8]) -> Poll<Result<usize, MavFtpErr>> {
        Poll::Ready(Err(MavFtpErr::FAIL))
    }

    fn entry(_: &mut Cx<'_, Shelf>, _: u16, _: u16) -> Option<VirtualEntry> {
        None
    }

    fn take(&self, _: &mut Cx<'_, Shelf>, content: &[u8]) -> Result<Part, MavFtpErr> {
        Ok(if content.len() == 4 { Part::Last } else { Part::More { used: 0 } })
    }

    fn finish(&mut self, _: &mut Cx<'_, Shelf>, _: Peer, content: &[u8]) -> Poll<Result<(), MavFtpErr>> {
        Poll::Ready(if content.contains(&0) { Err(MavFtpErr::FAIL) } else { Ok(()) })
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

fn opened<V: VirtualFile<Shelf>>(path: &str, access: FileAccess) -> Result<File<V>, MavFtpErr> {
    with(|cx| File::open(cx, path.as_bytes(), access, CLIENT, V::UPLOADS))
}

fn listed(path: &str, first: u32, has_times: bool) -> Result<String, MavFtpErr> {
    let mut out = [0; 40];
    let opcode = if has_times { MavFtpOpcode::LISTDIRECTORYWITHTIME } else { MavFtpOpcode::LISTDIRECTORY };
    let mut list = List::new(&Head { opcode, offset: first, ..Head::EMPTY }, &mut out);
    let len = with(|cx| {
        match virtual_files::find::<Shelf, All>(path.as_bytes()) {
            Some(number) => directory::list_virtual::<Shelf, All>(cx, number, &mut list),
            None if path.is_empty() => Directory::find(cx, b"").expect("the root").list::<Shelf, All>(cx, &mut list),
            None => return Err(MavFtpErr::FILENOTFOUND),
        }
        list.result()
    });
    len.map(|len| out[..len].iter().map(|byte| char::from(*byte)).collect())
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
    let mut file = opened::<All>("@NOTES/1", FileAccess::Read).expect("it exists");
    assert_eq!(file.size, 3);
    let mut out = [0; 2];
    let parts: Vec<_> = [0, 0, 2, 3].into_iter().map(|offset| with(|cx| file.read(cx, offset, &mut out))).collect();
    assert_eq!(parts, [Poll::Pending, Poll::Ready(Ok(2)), Poll::Ready(Ok(1)), Poll::Ready(Err(MavFtpErr::EOF))]);
    // F-30: not beyond the end that the client knows.
    file.size = 1;
    assert_eq!(with(|cx| file.read(cx, 0, &mut out)), Poll::Ready(Ok(1)));
    assert_eq!(out, *b"11");
    for path in ["@NOTES/3", "@NOTES", "@NOTES/", "@OTHER/0", "@"] {
        let error = opened::<All>(path, FileAccess::Read).expect_err(path);
        assert_eq!(error, MavFtpErr::FILENOTFOUND, "{path}");
    }
}

/// F-5: only files that can be uploaded are opened to be written, and only if the stack has room for it.
#[test]
fn uploads_need_a_directory_and_room() {
    let opened_to_write = opened::<All>("@BIN/drop", FileAccess::Create).expect("it can be uploaded");
    let Origin::Upload(mut file) = opened_to_write.origin else { panic!("no upload") };
    let take = |content| with(|cx| file.take(cx, content));
    assert_eq!((take(b"123"), take(b"1234")), (Ok(Part::More { used: 0 }), Ok(Part::Last)));
    assert_eq!(with(|cx| file.finish(cx, CLIENT, b"1234")), Poll::Ready(Ok(())));
    assert_eq!(with(|cx| file.finish(cx, CLIENT, b"\x0012")), Poll::Ready(Err(MavFtpErr::FAIL)));
    assert_eq!(opened::<All>("@NOTES/1", FileAccess::Write).expect_err("read-only"), MavFtpErr::FILEPROTECTED);
    let error = opened::<With<false>>("@BIN/drop", FileAccess::Create).expect_err("no room");
    assert_eq!(error, MavFtpErr::FILEPROTECTED);
    let busy = with(|cx| File::<All>::open(cx, b"@BIN/drop", FileAccess::Create, CLIENT, false).map(|_| ()));
    assert_eq!(busy, Err(MavFtpErr::FILEPROTECTED), "another upload is running");
}

/// a session belongs to a client with its proof. A frame in its name with less proof, or with more, has another session.
#[test]
fn sessions_belong_to_proofs() {
    let mut sessions = [Session::<NoFile>::FREE; 4];
    let mut session_of = |trust| {
        let request = Request {
            session: SessionId { client: CLIENT, number: 1 },
            trust,
            rate: 0,
            head: Head::EMPTY,
            data: &[],
            digest: NonZeroU32::MIN,
        };
        session::find_or_begin(&mut sessions, &request, false, Wrapping(0)).map(|(index, _)| index)
    };
    let signed = session_of(Trust::Signed);
    assert_ne!(session_of(Trust::Open), signed);
    assert_eq!(session_of(Trust::Signed), signed);
    assert!(sessions.iter().filter(|session| session.is_of(CLIENT, Trust::Signed)).count() == 1);
}
