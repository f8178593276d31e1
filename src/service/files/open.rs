//! Opens and reads files of any origin: static files, those of the hooks, and those of virtual directories (F-3, F-5).

use super::packet::Body;
use super::requests::Stop;
use super::session::Open;
use super::virtual_files::VirtualFiles;
use super::{FileAccess, Files, OpenFile, Outcome};
use crate::dialect::MavFtpErr;
use crate::service::Cx;
use crate::types::{Firmware, Peer};

/// Closes a file of the vehicle, or an upload (F-26).
pub(super) fn close<F: Firmware<Vehicle: Files>, V: VirtualFiles<F>>(cx: &mut Cx<'_, F>, open: &Open<V>) {
    match open {
        Open::Hook { number, .. } => {
            let (vehicle, mut context) = cx.hook();
            vehicle.close(&mut context, *number);
        }
        Open::Upload(file) if V::UPLOADS => file.close(cx),
        _ => {}
    }
}

/// Whether a path is one of the stack's own.
pub(super) fn is_virtual(path: &[u8]) -> bool {
    path.first() == Some(&b'@')
}

/// Opens a file: returns it and its size.
pub(super) fn open<F: Firmware<Vehicle: Files>, V: VirtualFiles<F>>(
    cx: &mut Cx<'_, F>,
    path: &[u8],
    access: FileAccess,
    from: Peer,
    may_upload: bool,
) -> Result<(Open<V>, u32), MavFtpErr> {
    let is_read = access == FileAccess::Read;
    if is_virtual(path) {
        if V::UPLOADS && !is_read {
            let file = V::open(cx, path, true)?;
            return if may_upload { Ok((Open::Upload(file), 0)) } else { Err(MavFtpErr::FILEPROTECTED) };
        }
        let file = V::open(cx, path, !is_read)?;
        let size = file.size(cx);
        return Ok((Open::Virtual(file), size));
    }
    if path.is_empty() {
        return Err(MavFtpErr::FILENOTFOUND);
    }
    if !is_read && !F::Vehicle::WRITES {
        return Err(MavFtpErr::FILEPROTECTED);
    }
    let found = F::Vehicle::FILES.iter().position(|file| file.path.as_bytes() == path);
    if let Some((index, file)) = found.and_then(|index| Some((index, F::Vehicle::FILES.get(index)?))) {
        if !is_read {
            return Err(MavFtpErr::FILEPROTECTED);
        }
        let size = u32::try_from(file.bytes.len()).unwrap_or(u32::MAX);
        return Ok((Open::Static(u8::try_from(index).unwrap_or(u8::MAX)), size));
    }
    let (vehicle, mut context) = cx.hook();
    let OpenFile { number, size } = vehicle.open(&mut context, path, access, from)?;
    Ok((Open::Hook { number, is_writable: !is_read }, size))
}

/// Returns where reading a file ends: at the size that its client knows, so that it gets exactly so many bytes (F-30). A file
/// that the client writes ends where the vehicle says.
pub(super) const fn end<V>(open: &Open<V>, size: u32) -> u32 {
    if matches!(open, Open::Hook { is_writable: true, .. }) { u32::MAX } else { size }
}

/// Reads from a file up to its `end`. Returns the number of bytes.
pub(super) fn read<F: Firmware<Vehicle: Files>, V: VirtualFiles<F>>(
    cx: &mut Cx<'_, F>,
    open: &mut Open<V>,
    end: u32,
    offset: u32,
    out: &mut [u8],
) -> Outcome {
    let left = usize::try_from(end.saturating_sub(offset)).unwrap_or(usize::MAX).min(out.len());
    let out = out.get_mut(..left).unwrap_or_default();
    let len = match open {
        Open::Hook { .. } if out.is_empty() => 0,
        Open::Hook { number, .. } => cx.vehicle.read(*number, offset, out)?.min(out.len()),
        Open::Static(index) => {
            let bytes = F::Vehicle::FILES.get(usize::from(*index)).map(|file| file.bytes).unwrap_or_default();
            let rest = usize::try_from(offset).ok().and_then(|offset| bytes.get(offset..)).unwrap_or_default();
            crate::message::zero_extend(rest, out)
        }
        Open::Virtual(file) => match file.read(cx, offset, out) {
            Body::Data(len) => len,
            Body::Later => return Err(Stop::LATER),
            Body::Refused(error) => return Err(error.into()),
        },
        Open::Nothing | Open::Upload(_) => return Err(MavFtpErr::INVALIDSESSION.into()),
    };
    data(len)
}

/// Returns a number of bytes of data: 0 is the end.
pub(super) fn data(len: usize) -> Outcome {
    if len == 0 { Err(MavFtpErr::EOF.into()) } else { Ok(u32::try_from(len).unwrap_or(0)) }
}
