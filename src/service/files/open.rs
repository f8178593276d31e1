//! Files, wherever they are: the static ones, those of the hooks, and the file of parameters (F-3, F-5).

use super::packet::Body;
use super::session::Open;
use super::{FileAccess, Files, OpenFile};
use crate::dialect::MavFtpErr;
use crate::service::Cx;
use crate::service::param::{Pack, PackedParams};
use crate::types::Firmware;

/// Closes a file of the vehicle.
pub(super) fn close<F: Firmware<Vehicle: Files>>(cx: &mut Cx<'_, F>, open: &Open) {
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
pub(super) fn open<F, P>(
    cx: &mut Cx<'_, F>,
    path: &[u8],
    access: FileAccess,
    may_upload: bool,
) -> Result<(Open, u32), MavFtpErr>
where
    F: Firmware<Vehicle: Files>,
    P: PackedParams<F>,
{
    let is_read = access == FileAccess::Read;
    if P::EXISTS
        && let Some(query) = path.strip_prefix(b"@PARAM/param.pck")
        && matches!(query, [] | [b'?', ..])
    {
        if !is_read {
            let may_upload = P::IS_WRITABLE && may_upload && query.is_empty();
            return if may_upload { Ok((Open::Upload, 0)) } else { Err(MavFtpErr::FILEPROTECTED) };
        }
        let count = P::packed_count(cx);
        let pack = Pack::open(query.get(1..).unwrap_or_default(), count);
        return pack.map(|pack| (Open::Params(pack), 0)).ok_or(MavFtpErr::FAIL);
    }
    if path.is_empty() || is_virtual(path) {
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
pub(super) fn read<F, P>(cx: &mut Cx<'_, F>, open: &mut Open, offset: u32, out: &mut [u8]) -> Body
where
    F: Firmware<Vehicle: Files>,
    P: PackedParams<F>,
{
    let len = match open {
        Open::Hook { number, .. } => match cx.vehicle.read(*number, offset, out) {
            Ok(len) => len.min(out.len()),
            Err(error) => return Body::Refused(error),
        },
        Open::Static(index) => {
            let bytes = F::Vehicle::FILES.get(usize::from(*index)).map(|file| file.bytes).unwrap_or_default();
            let rest = usize::try_from(offset).ok().and_then(|offset| bytes.get(offset..)).unwrap_or_default();
            crate::message::zero_extend(rest, out)
        }
        Open::Params(pack) => match P::read_packed(cx, pack, offset, out) {
            Some(len) => len,
            None => return Body::Later,
        },
        Open::Nothing | Open::Upload => return Body::Refused(MavFtpErr::INVALIDSESSION),
    };
    if len == 0 { Body::Refused(MavFtpErr::EOF) } else { Body::Data(len) }
}
