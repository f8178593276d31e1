//! Plans, or parameters, in a file: what a flight controller has in flash. The file is written at once, so that they survive
//! also the end of this program by force.

use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::Path;

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};

/// A file that behaves as NOR flash does: writing only clears bits.
pub struct FileFlash {
    file: File,
    bytes: Vec<u8>,
}

impl FileFlash {
    /// Opens the file, or makes one that is erased.
    pub fn open(path: &Path, len: u32) -> Result<Self, String> {
        let failed = |error: std::io::Error| format!("{}: {error}", path.display());
        let mut file =
            OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path).map_err(failed)?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).map_err(failed)?;
        let expected = usize::try_from(len).map_err(|error| error.to_string())?;
        if bytes.len() > expected {
            return Err(format!("{} is not a file of this program: it has {} bytes", path.display(), bytes.len()));
        }
        // A new file, or one that was not made to its end.
        if bytes.len() < expected {
            bytes.resize(expected, 0xFF);
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
        self.bytes[from..to].fill(0xFF);
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
