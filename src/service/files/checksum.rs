//! The checksum of a file, which takes more than one call.

use core::task::Poll;

use super::file::File;
use super::session::{Ticks, seconds};
use super::vehicle::Files;
use super::virtual_files::VirtualFile;
use crate::crc32::Crc32;
use crate::dialect::MavFtpErr;
use crate::service::Cx;
use crate::types::Firmware;

/// A checksum that takes longer than two minutes ends with its client's session: MAVProxy waits for as long.
pub(super) const LONGEST_CHECKSUM: Ticks = seconds(120);

/// The part of a file that a poll adds to its checksum: the number of bytes in a read, and the number of reads.
const READ_LEN: usize = 32;
const READS: u8 = 8;

/// A checksum under computation.
#[derive(Clone, Copy, Debug)]
pub(super) struct Checksum<V> {
    /// The index of its client's session.
    pub(super) session: usize,
    /// The CRC-32 of the file's path.
    pub(super) path_crc: u32,
    pub(super) began: Ticks,
    pub(super) file: File<V>,
    /// The number of bytes so far.
    pub(super) offset: u32,
    crc: Crc32,
}

impl<V> Checksum<V> {
    pub(super) const fn new(session: usize, path_crc: u32, began: Ticks, file: File<V>) -> Self {
        Self { session, path_crc, began, file, offset: 0, crc: Crc32::ZERO }
    }

    /// Adds the next part of the file. Returns the checksum after the last one.
    pub(super) fn add_part<F: Firmware<Vehicle: Files>>(&mut self, cx: &mut Cx<'_, F>) -> Poll<Result<u32, MavFtpErr>>
    where
        V: VirtualFile<F>,
    {
        let mut bytes = [0; READ_LEN];
        for _ in 0..READS {
            match self.file.read(cx, self.offset, &mut bytes) {
                Poll::Ready(Ok(len)) => {
                    self.offset = self.offset.saturating_add(u32::try_from(len).unwrap_or(0));
                    self.crc.add(bytes.get(..len).unwrap_or_default());
                }
                Poll::Ready(Err(MavFtpErr::EOF)) => return Poll::Ready(Ok(!self.crc.sum())),
                Poll::Ready(Err(error)) => return Poll::Ready(Err(error)),
                Poll::Pending => break,
            }
        }
        Poll::Pending
    }
}
