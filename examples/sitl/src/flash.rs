//! Simulates flash with a file. Writes are not buffered, so the contents survive a kill
//! of this program.
//!
//! A file with other content is never overwritten: a mistyped path must not destroy data.

use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::Path;

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};

/// A file that behaves like NOR flash: writing only clears bits.
pub struct FileFlash {
    file: File,
    bytes: Vec<u8>,
}

/// The start of each page: its magic and the version of the format (`src/storage/format.md`).
const MAGIC: &[u8] = b"ML\x01";
/// The length of a page, in bytes.
const PAGE: usize = 256;
/// The starts of pages of other versions of this program.
const OTHER_VERSIONS: [&[u8]; 2] = [b"MVSR", b"ML\x02"];

/// The value of an erased byte.
const ERASED: u8 = 0xFF;

/// Whether one of the pages in these bytes starts like this.
fn has_page(bytes: &[u8], start: &[u8]) -> bool {
    bytes.chunks(PAGE).any(|page| page.starts_with(start))
}

impl FileFlash {
    /// Refuses an existing file that this program did not create. Changes nothing.
    pub fn check(path: &Path, len: u32) -> Result<(), String> {
        let failed = |error: std::io::Error| format!("{}: {error}", path.display());
        let metadata = match path.metadata() {
            Ok(metadata) => metadata,
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
            Err(error) => return Err(failed(error)),
        };
        let what_to_do = "give --storage another name, or move the file";
        let refused =
            |why: String| Err(format!("{} is not a storage file of this vehicle: {why}; {what_to_do}", path.display()));
        if !metadata.is_file() {
            return refused("it is not a regular file".into());
        }
        let size = metadata.len();
        let mut bytes = Vec::new();
        // No more than needed of a file that may be large.
        let file = File::open(path).map_err(failed)?;
        file.take(2 * u64::from(len)).read_to_end(&mut bytes).map_err(failed)?;
        let is_ours = has_page(&bytes, MAGIC);
        let is_of_another_version = OTHER_VERSIONS.iter().any(|start| has_page(&bytes, start));
        if (is_ours && size != u64::from(len)) || (!is_ours && is_of_another_version) {
            return Err(format!(
                "{} is a storage file of {size} bytes, which another version of this program created (this one uses {len} \
                 bytes): run that version, {what_to_do}",
                path.display()
            ));
        }
        if size > u64::from(len) {
            return refused(format!("it has {size} bytes instead of {len}"));
        }
        // An empty or incompletely created file has no data to lose. A damaged one may still have valid pages.
        if is_ours || bytes.iter().all(|&byte| byte == ERASED) {
            return Ok(());
        }
        refused("it contains other data".into())
    }

    /// Opens a storage file, or creates an erased one. Only its owner can read it, because it contains the signing key.
    pub fn open(path: &Path, len: u32) -> Result<Self, String> {
        let failed = |error: std::io::Error| format!("{}: {error}", path.display());
        Self::check(path, len)?;
        let mut options = OpenOptions::new();
        options.read(true).write(true).create(true).truncate(false);
        #[cfg(unix)]
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
        let mut file = options.open(path).map_err(failed)?;
        // Also restricts a file that an older version of this program created.
        #[cfg(unix)]
        file.set_permissions(std::os::unix::fs::PermissionsExt::from_mode(0o600)).map_err(failed)?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).map_err(failed)?;
        let expected = usize::try_from(len).map_err(|error| error.to_string())?;
        if bytes.len() < expected {
            bytes.resize(expected, ERASED);
            file.rewind().and_then(|()| file.write_all(&bytes)).map_err(failed)?;
        }
        Ok(Self { file, bytes })
    }

    fn write_back(&mut self, from: usize, to: usize) -> Result<(), NorFlashErrorKind> {
        let write = |file: &mut File, bytes: &[u8]| {
            file.seek(SeekFrom::Start(from as u64))?;
            file.write_all(bytes)
        };
        write(&mut self.file, &self.bytes[from..to]).map_err(|_| NorFlashErrorKind::Other)
    }
}

impl ErrorType for FileFlash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for FileFlash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        check_read(self, offset, bytes.len())?;
        let from = offset as usize;
        bytes.copy_from_slice(&self.bytes[from..from + bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl NorFlash for FileFlash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = 4096;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        check_erase(self, from, to)?;
        let (from, to) = (from as usize, to as usize);
        self.bytes[from..to].fill(ERASED);
        self.write_back(from, to)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        check_write(self, offset, bytes.len())?;
        let from = offset as usize;
        for (cell, byte) in self.bytes[from..].iter_mut().zip(bytes) {
            *cell &= byte;
        }
        self.write_back(from, from + bytes.len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use std::path::PathBuf;

    const LEN: u32 = 8_192;

    /// A temporary folder of one test, removed when dropped.
    struct Folder(PathBuf);

    impl Folder {
        fn new(name: &str) -> Self {
            let path = std::env::temp_dir().join(format!("mavstack-sitl-{name}-{}", std::process::id()));
            fs::create_dir_all(&path).unwrap();
            Self(path)
        }

        fn file(&self, name: &str, bytes: &[u8]) -> PathBuf {
            let path = self.0.join(name);
            fs::write(&path, bytes).unwrap();
            path
        }
    }

    impl Drop for Folder {
        fn drop(&mut self) {
            let _ = fs::remove_dir_all(&self.0);
        }
    }

    /// Returns a file that is erased except for two pages with this content.
    fn pages(first: &[u8], second: &[u8]) -> Vec<u8> {
        let mut bytes = vec![ERASED; LEN as usize];
        bytes[..first.len()].copy_from_slice(first);
        bytes[LEN as usize / 2 + PAGE..][..second.len()].copy_from_slice(second);
        bytes
    }

    /// A mistyped `--storage` destroys no file: files with other content are refused and stay unchanged.
    #[test]
    fn a_file_with_other_content_is_refused_and_unchanged() {
        let folder = Folder::new("others");
        for (name, bytes) in [
            ("short", b"The only copy of my notes.".to_vec()),
            ("long", vec![b'x'; LEN as usize + 1]),
            ("same-size", vec![b'x'; LEN as usize]),
            ("zeros", vec![0; LEN as usize]),
            ("half-erased", pages(b"", b"nope")),
            ("between-pages", pages(b"", b"xML\x01")),
        ] {
            let path = folder.file(name, &bytes);
            let error = FileFlash::open(&path, LEN).err().expect(name);
            assert!(error.contains(name) && error.contains("give --storage another name"), "{error}");
            assert!(fs::read(&path).unwrap() == bytes, "{name}");
        }
        let error = FileFlash::open(&folder.0, LEN).err().expect("a folder");
        assert!(error.contains("not a regular file"), "{error}");
    }

    /// A storage file of another version has another length or other pages. The refusal says so, and the file stays unchanged.
    #[test]
    fn a_file_of_another_version_is_refused_and_unchanged() {
        let folder = Folder::new("versions");
        let ours = pages(b"ML\x01\x01", b"ML\x01\x02");
        let second = pages(b"", b"ML\x01\x02");
        for (name, bytes, len) in [
            ("larger", &ours, LEN / 2),
            ("smaller", &ours, 2 * LEN),
            ("second-page-larger", &second, LEN / 2),
            ("second-page-smaller", &second, 2 * LEN),
            ("slots", &pages(b"MVSR\x01", b""), LEN),
            ("slots-larger", &pages(b"MVSR\x01", b""), LEN / 2),
            ("newer", &pages(b"ML\x02\x01", b""), LEN),
        ] {
            let path = folder.file(name, bytes);
            let error = FileFlash::check(&path, len).expect_err(name);
            let parts = ["another version", "8192 bytes", &len.to_string(), "give --storage another name"];
            assert!(parts.iter().all(|part| error.contains(part)), "{error}");
            assert!(!error.contains("not a storage file"), "{error}");
            assert!(FileFlash::open(&path, len).is_err() && fs::read(&path).unwrap() == *bytes, "{name}");
        }
    }

    /// A storage file is opened even if damaged. An empty or incomplete file is completed, and a new one is erased.
    #[test]
    fn a_storage_file_is_opened() {
        let folder = Folder::new("ours");
        for (name, bytes) in [
            ("first", pages(b"ML\x01\x01", b"")),
            ("second", pages(b"", b"ML\x01\x01")),
            ("damaged", pages(b"ML\x01\x01", b"torn")),
            ("damaged-first", pages(b"torn", b"ML\x01\x01")),
            ("erased", pages(b"", b"")),
        ] {
            let path = folder.file(name, &bytes);
            let flash = FileFlash::open(&path, LEN).expect(name);
            assert!(flash.bytes == bytes && fs::read(&path).unwrap() == bytes, "{name}");
        }
        for (name, bytes) in [("empty", &[][..]), ("unfinished", &[ERASED; 100])] {
            let path = folder.file(name, bytes);
            FileFlash::open(&path, LEN).expect(name);
            assert!(fs::read(&path).unwrap() == pages(b"", b""), "{name}");
        }
        let path = folder.0.join("new");
        FileFlash::check(&path, LEN).expect("no file is valid");
        assert!(!path.exists(), "the check creates no file");
        FileFlash::open(&path, LEN).expect("created");
        assert!(fs::read(&path).unwrap() == pages(b"", b""));
    }

    /// SEC-15: only the owner can read the signing key, even if the file was readable by everyone before.
    #[cfg(unix)]
    #[test]
    fn the_file_is_readable_by_its_owner_only() {
        use std::os::unix::fs::PermissionsExt as _;

        let folder = Folder::new("key");
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
        let path = folder.0.join("new");
        FileFlash::open(&path, LEN).expect("created");
        assert_eq!(mode(&path), 0o600);
        let path = folder.file("readable", &pages(b"ML\x01\x01", b""));
        fs::set_permissions(&path, fs::Permissions::from_mode(0o644)).unwrap();
        FileFlash::open(&path, LEN).expect("opened");
        assert_eq!(mode(&path), 0o600);
    }
}
