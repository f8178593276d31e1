//! Files, wherever they are: the static ones, those of the hooks, and those of virtual directories (F-3, F-5).

use super::packet::Body;
use super::session::Open;
use super::virtual_files::VirtualFiles;
use super::{FileAccess, Files, OpenFile};
use crate::dialect::MavFtpErr;
use crate::service::Cx;
use crate::types::Firmware;

/// Closes a file of the vehicle.
pub(super) fn close<F: Firmware<Vehicle: Files>, V>(cx: &mut Cx<'_, F>, open: &Open<V>) {
    if let Open::Hook { number, .. } = *open {
        let (vehicle, mut context) = cx.hook();
        vehicle.close(&mut context, number);
    }
}

/// Whether a path is one of the stack's own.
pub(super) fn is_virtual(path: &[u8]) -> bool {
    path.first() == Some(&b'@')
}

/// Opens a file: returns it and its size.
#[inline(never)]
pub(super) fn open<F: Firmware<Vehicle: Files>, V: VirtualFiles<F>>(
    cx: &mut Cx<'_, F>,
    path: &[u8],
    access: FileAccess,
    may_upload: bool,
) -> Result<(Open<V>, u32), MavFtpErr> {
    let is_read = access == FileAccess::Read;
    if is_virtual(path) {
        if V::UPLOADS && !is_read {
            let file = V::open(cx, path, true)?;
            return if may_upload { Ok((Open::Upload(file), 0)) } else { Err(MavFtpErr::FILEPROTECTED) };
        }
        return V::open(cx, path, !is_read).map(|file| (Open::Virtual(file), 0));
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
    let OpenFile { number, size } = vehicle.open(&mut context, path, access)?;
    Ok((Open::Hook { number, is_writable: !is_read }, size))
}

/// Reads from a file.
#[inline(never)]
pub(super) fn read<F: Firmware<Vehicle: Files>, V: VirtualFiles<F>>(
    cx: &mut Cx<'_, F>,
    open: &mut Open<V>,
    offset: u32,
    out: &mut [u8],
) -> Body {
    let body = match open {
        Open::Hook { number, .. } => match cx.vehicle.read(*number, offset, out) {
            Ok(len) => Body::Data(len.min(out.len())),
            Err(error) => Body::Refused(error),
        },
        Open::Static(index) => {
            let bytes = F::Vehicle::FILES.get(usize::from(*index)).map(|file| file.bytes).unwrap_or_default();
            let rest = usize::try_from(offset).ok().and_then(|offset| bytes.get(offset..)).unwrap_or_default();
            Body::Data(crate::message::zero_extend(rest, out))
        }
        Open::Virtual(file) => file.read(cx, offset, out),
        Open::Nothing | Open::Upload(_) => Body::Refused(MavFtpErr::INVALIDSESSION),
    };
    if matches!(body, Body::Data(0)) { Body::Refused(MavFtpErr::EOF) } else { body }
}
