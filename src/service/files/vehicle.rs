//! The file service's interface to the vehicle.

use crate::dialect::MavFtpErr;
use crate::types::{Context, Peer};

/// The hooks of a vehicle with files, for a vehicle that declares `files` in [`#[stack]`](macro@crate::Stack).
///
/// Files that never change need no hook: the stack serves those in [`FILES`](Self::FILES). The parameters need no hook
/// either: they are `@PARAM/param.pck`.
///
/// ```
/// use mavstack::files::StaticFile;
/// use mavstack::Files;
/// # use mavstack::prelude::*;
/// # use mavstack::dialect;
///
/// struct Rover;
///
/// impl Files for Rover {
///     const FILES: &'static [StaticFile] = &[
///         StaticFile::new("general.json", br#"{"version":1,"metadataTypes":[]}"#),
///         StaticFile::new("docs/licence.txt", b"MIT"),
///     ];
/// }
/// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
/// # impl Commands for Rover {
/// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { dialect::MavResult::UNSUPPORTED.into() }
/// # }
///
/// #[derive(mavstack::Stack)]
/// #[stack(vehicle: Rover, links: 1, files: { sessions: 2 })]
/// struct Mavlink;
/// ```
///
/// Other files have numbers, which the vehicle chooses. [`open`](Self::open) turns a path into the number of an open
/// file, and [`directory`](Self::directory) into the number of a directory. Hooks get only numbers that the vehicle has
/// returned. The stack opens at most one file per session at a time, plus one while it computes a checksum. A file that is
/// open twice may have the same number twice; each is closed.
///
/// # Paths
///
/// A path is a byte string, such as `b"logs/1.bin"`, without a slash at its ends. The root is the empty path. A path has one
/// spelling (F-10, F-32): all bytes are printable ASCII except `\` and `:`, and no part is empty, `.` or `..`. The stack refuses all
/// other paths. Paths that begin with `@` belong to the stack.
///
/// # Cost
///
/// No hook may block. A sent packet calls [`read`](Self::read) once; a checksum calls it up to eight times in each poll.
/// A list calls [`entry`](Self::entry) for each of its entries. Read a slow medium, such as an SD card, ahead in another
/// task. A hook that has no data yet cannot make the client wait: it
/// returns [`MavFtpErr::FAIL`].
#[diagnostic::on_unimplemented(
    message = "`{Self}` does not implement `Files`",
    note = "`files` in `#[stack]` needs `impl Files for {Self}`: write it, or leave `files` out"
)]
pub trait Files {
    /// Files that never change: at most 250, with different paths. They come before those of the hooks.
    const FILES: &'static [StaticFile] = &[];

    /// Whether clients may write or change files. If not, the code for it is not linked.
    const WRITES: bool = false;

    /// Returns the number of a directory, at most 65,534; `None` if there is none. The root is the empty path. The stack lists the files
    /// of [`FILES`](Self::FILES) and the directories that begin with `@` by itself: a vehicle whose other files are in
    /// the root returns a number for it too.
    fn directory(&mut self, path: &[u8]) -> Option<u16> {
        let _ = path;
        None
    }

    /// Returns an entry of a directory; `None` after the last one. Indices count the vehicle's own entries, from 0. While a
    /// client lists a directory, the order should not change.
    fn entry(&mut self, directory: u16, index: u16) -> Option<FileEntry<'_>> {
        let _ = (directory, index);
        None
    }

    /// Opens a file for the client `from`. It is opened for writing only if the vehicle [`WRITES`](Self::WRITES) files.
    /// By default there are no files.
    ///
    /// Systems that are not in [control](crate::operator_control::OperatorControl) cannot open files for writing; for
    /// them, [`write`](Self::write) and [`change`](Self::change) are not called.
    ///
    /// # Errors
    ///
    /// [`MavFtpErr::FILENOTFOUND`], [`MavFtpErr::FILEPROTECTED`] for a file that this client may not write or read,
    /// [`MavFtpErr::FILEEXISTS`], or [`MavFtpErr::FAIL`].
    fn open(
        &mut self,
        cx: &mut Context<'_>,
        path: &[u8],
        access: FileAccess,
        from: Peer,
    ) -> Result<OpenFile, MavFtpErr> {
        let _ = (cx, path, from);
        Err(if access == FileAccess::Read { MavFtpErr::FILENOTFOUND } else { MavFtpErr::FILEPROTECTED })
    }

    /// Reads from an open file: fills `out`, or its front if the file ends first, and returns the number of bytes, at
    /// most 239. Returns 0 at and after the end of the file.
    ///
    /// # Errors
    ///
    /// [`MavFtpErr::FAIL`].
    fn read(&mut self, file: u16, offset: u32, out: &mut [u8]) -> Result<usize, MavFtpErr> {
        let _ = (file, offset, out);
        Err(MavFtpErr::FAIL)
    }

    /// Writes all of `bytes`, at most 239, to a file that the client `from` has opened for writing. Called only if the
    /// vehicle [`WRITES`](Self::WRITES) files. A client may write parts in any order, and repeatedly.
    ///
    /// # Errors
    ///
    /// [`MavFtpErr::FAIL`], or [`MavFtpErr::FILEPROTECTED`] if this client may no longer write.
    fn write(
        &mut self,
        cx: &mut Context<'_>,
        file: u16,
        offset: u32,
        bytes: &[u8],
        from: Peer,
    ) -> Result<(), MavFtpErr> {
        let _ = (cx, file, offset, bytes, from);
        Err(MavFtpErr::FILEPROTECTED)
    }

    /// Closes a file. Called once for each [open](Self::open) file: when its client closes it or is silent for ten
    /// seconds, when another client takes its session over, when its link is opened again, or when the checksum for which
    /// it was opened ends. The session opens its next file after this.
    fn close(&mut self, cx: &mut Context<'_>, file: u16) {
        let _ = (cx, file);
    }

    /// Removes, renames or truncates a file, or makes or removes a directory, for the client `from`. Called
    /// only if the vehicle [`WRITES`](Self::WRITES) files. Not called again if the client repeats the request within two
    /// seconds and before another one.
    ///
    /// # Errors
    ///
    /// [`MavFtpErr::FILEPROTECTED`], which is the default, and the errors of [`open`](Self::open).
    fn change(&mut self, cx: &mut Context<'_>, change: FileChange<'_>, from: Peer) -> Result<(), MavFtpErr> {
        let _ = (cx, change, from);
        Err(MavFtpErr::FILEPROTECTED)
    }
}

/// A file that never changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StaticFile {
    pub(super) path: &'static str,
    pub(super) bytes: &'static [u8],
}

impl StaticFile {
    /// Returns a file with this path and content: `StaticFile::new("general.json", include_bytes!("general.json"))`.
    pub const fn new(path: &'static str, bytes: &'static [u8]) -> Self {
        Self { path, bytes }
    }

    /// Returns the path.
    pub const fn path(&self) -> &'static str {
        self.path
    }

    /// Returns the content.
    pub const fn bytes(&self) -> &'static [u8] {
        self.bytes
    }

    /// Returns the size (bytes).
    pub(super) fn size(&self) -> u32 {
        u32::try_from(self.bytes.len()).unwrap_or(u32::MAX)
    }

    /// Fails to compile if a client could not open a file of the table.
    #[doc(hidden)]
    #[allow(
        clippy::indexing_slicing,
        clippy::arithmetic_side_effects,
        reason = "const-evaluated: a failure is a compile error"
    )]
    pub const fn check(files: &[Self]) {
        assert!(
            files.len() <= 250,
            "a vehicle has at most 250 static files: serve more of them by the hooks of `Files`"
        );
        let mut i = 0;
        while i < files.len() {
            let path = files[i].path.as_bytes();
            assert!(
                !path.is_empty()
                    && path.len() <= 200
                    && path[0] != b'/'
                    && path[0] != b'@'
                    && (path.len() > 1 || path[0] != b'.')
                    && path[path.len() - 1] != b'/',
                "the path of a static file has 1 to 200 bytes, and does not begin with `/` or `@`"
            );
            // The number of dots at the beginning of a component; more than two if there is anything else.
            let (mut k, mut dots) = (0, 0);
            while k < path.len() {
                assert!(
                    path[k] >= b' ' && path[k] <= b'~' && path[k] != b'\\' && path[k] != b':',
                    "the path of a static file is printable ASCII without backslashes and colons"
                );
                dots = match path[k] {
                    b'/' => 0,
                    b'.' => dots + 1,
                    _ => 3,
                };
                let ends = k + 1 == path.len() || path[k + 1] == b'/';
                assert!(!ends || dots > 2, "no part of the path of a static file is `..`, `.` or empty");
                k += 1;
            }
            i += 1;
        }
    }
}

/// An entry of a directory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FileEntry<'a> {
    /// The name, without a path. A name of more than 200 bytes, or one that no path may contain, is skipped.
    pub name: &'a [u8],
    /// The size of a file (bytes), the same as of the open file; `None` for a directory.
    pub size: Option<u32>,
    /// The time of the last change (s since 1970, UTC); 0 if unknown.
    pub time: u32,
}

/// An open file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OpenFile {
    /// The vehicle's number for it.
    pub number: u16,
    /// Its size (bytes). A file that was opened for reading is read up to here, also if it grows (F-30).
    pub size: u32,
}

/// The access with which a file is opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FileAccess {
    /// Read only.
    Read,
    /// Write: OpenFileWO. Keeps the content of an existing file. The vehicle decides whether it creates a missing one.
    Write,
    /// Write from the beginning: CreateFile. Replaces an old file of that name.
    Create,
}

/// A change of files and directories.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileChange<'a> {
    /// Removes a file.
    Remove(&'a [u8]),
    /// Truncates a file, or extends it with zeros.
    Truncate {
        /// The file.
        path: &'a [u8],
        /// The new size (bytes).
        size: u32,
    },
    /// Renames a file or a directory.
    Rename {
        /// The old path.
        from: &'a [u8],
        /// The new path.
        to: &'a [u8],
    },
    /// Creates a directory.
    CreateDirectory(&'a [u8]),
    /// Removes an empty directory.
    RemoveDirectory(&'a [u8]),
}
