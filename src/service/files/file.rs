//! Open files of any origin: static files, those of the hooks, and those of virtual directories (F-3, F-5).

use core::task::Poll;

use super::path;
use super::vehicle::{FileAccess, Files, OpenFile};
use super::virtual_files::{self, VirtualFile};
use crate::dialect::MavFtpErr;
use crate::message::zero_extend;
use crate::service::Cx;
use crate::types::{Firmware, Peer};

/// A file that may be open. A closed one is all zero bits.
#[derive(Clone, Copy, Debug)]
pub(super) struct File<V> {
    pub(super) origin: Origin<V>,
    /// The size that the client knows.
    pub(super) size: u32,
}

/// The origin of an open file. With this representation no field has the discriminant in its niche.
#[derive(Clone, Copy, Debug)]
#[repr(u8)]
pub(super) enum Origin<V> {
    /// No file is open.
    Closed,
    /// A file of the vehicle's hooks, by number.
    Hook { is_writable: bool, number: u16 },
    /// A file that never changes, by its index.
    Static { index: u8 },
    /// A file of a virtual directory, to be read.
    Virtual(V),
    /// A file of a virtual directory, to be uploaded: one at a time.
    Upload(V),
}

impl<V> File<V> {
    pub(super) const CLOSED: Self = Self { origin: Origin::Closed, size: 0 };

    /// Opens a file.
    pub(super) fn open<F: Firmware<Vehicle: Files>>(
        cx: &mut Cx<'_, F>,
        path: &[u8],
        access: FileAccess,
        from: Peer,
        may_upload: bool,
    ) -> Result<Self, MavFtpErr>
    where
        V: VirtualFile<F>,
    {
        let is_read = access == FileAccess::Read;
        if path::is_virtual(path) {
            let file = virtual_files::open::<F, V>(cx, path, access)?;
            return match is_read {
                true => Ok(Self { origin: Origin::Virtual(file), size: file.size(cx) }),
                false if may_upload => Ok(Self { origin: Origin::Upload(file), size: 0 }),
                false => Err(MavFtpErr::FILEPROTECTED),
            };
        }
        if path.is_empty() {
            return Err(MavFtpErr::FILENOTFOUND);
        }
        if !is_read && !F::Vehicle::WRITES {
            return Err(MavFtpErr::FILEPROTECTED);
        }
        for (index, file) in (0..).zip(F::Vehicle::FILES) {
            if file.path.as_bytes() == path {
                let opened = Self { origin: Origin::Static { index }, size: file.size() };
                return if is_read { Ok(opened) } else { Err(MavFtpErr::FILEPROTECTED) };
            }
        }
        let (vehicle, mut context) = cx.hook();
        let OpenFile { number, size } = vehicle.open(&mut context, path, access, from)?;
        Ok(Self { origin: Origin::Hook { number, is_writable: !is_read }, size })
    }

    /// Returns where reading ends: at the size that the client knows, so that it gets exactly so many bytes (F-30). A file that the
    /// client writes ends where the vehicle says.
    pub(super) const fn end(&self) -> u32 {
        if matches!(self.origin, Origin::Hook { is_writable: true, .. }) { u32::MAX } else { self.size }
    }

    /// Reads up to the end. Returns the number of bytes, and [`MavFtpErr::EOF`] instead of 0; pending if it takes another call.
    pub(super) fn read<F: Firmware<Vehicle: Files>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        offset: u32,
        out: &mut [u8],
    ) -> Poll<Result<usize, MavFtpErr>>
    where
        V: VirtualFile<F>,
    {
        let left = usize::try_from(self.end().saturating_sub(offset)).unwrap_or(usize::MAX).min(out.len());
        let out = out.get_mut(..left).unwrap_or_default();
        let len = match &mut self.origin {
            Origin::Hook { .. } if out.is_empty() => 0,
            Origin::Hook { number, .. } => cx.vehicle.read(*number, offset, out)?.min(out.len()),
            Origin::Static { index } => {
                let bytes = F::Vehicle::FILES.get(usize::from(*index)).map(|file| file.bytes).unwrap_or_default();
                let rest = usize::try_from(offset).ok().and_then(|offset| bytes.get(offset..));
                zero_extend(rest.unwrap_or_default(), out)
            }
            Origin::Virtual(file) => match file.read(cx, offset, out)? {
                Poll::Ready(len) => len,
                Poll::Pending => return Poll::Pending,
            },
            Origin::Closed | Origin::Upload(_) => return Poll::Ready(Err(MavFtpErr::INVALIDSESSION)),
        };
        Poll::Ready(if len == 0 { Err(MavFtpErr::EOF) } else { Ok(len) })
    }

    /// Closes a file of the vehicle, or an upload (F-26).
    pub(super) fn close<F: Firmware<Vehicle: Files>>(&mut self, cx: &mut Cx<'_, F>)
    where
        V: VirtualFile<F>,
    {
        match core::mem::replace(&mut self.origin, Origin::Closed) {
            Origin::Hook { number, .. } => {
                let (vehicle, mut context) = cx.hook();
                vehicle.close(&mut context, number);
            }
            Origin::Upload(file) if V::UPLOADS => file.close(cx),
            _ => {}
        }
    }
}
