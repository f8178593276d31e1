//! The upload to a virtual directory (F-23, F-26).

use core::cell::Cell;

use heapless::vec::VecView;

use super::packet::Request;
use super::session::{Ticks, seconds, ticks};
use super::virtual_files::{Part, VirtualFile};
use crate::dialect::MavFtpErr;
use crate::service::Cx;
use crate::types::Firmware;

/// An upload is closed when no new part has arrived for eight seconds (F-26; by messages, M-41): it excludes all other
/// uploads, and other requests of its client would keep its session.
pub(super) const STALLED: Ticks = seconds(8);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum UploadState {
    /// The virtual directory has not permitted it yet.
    Opening,
    Receiving,
    /// The last part was received, and later polls apply the file.
    Complete,
    Refused,
}

/// The state of the upload: one at a time.
#[derive(Debug)]
pub(super) struct Upload {
    pub(super) state: UploadState,
    /// The number of bytes received.
    pub(super) received: u32,
    /// When the last new part was received.
    pub(super) grown: Ticks,
}

/// The result of a part of an upload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Taken {
    /// The part before it is missing. It is dropped, and the client sends it again.
    Dropped,
    More,
    /// The file is complete.
    Last,
}

impl Upload {
    /// Takes a part, in order (F-23). `content`: the bytes of the parts before that the virtual directory still needs.
    pub(super) fn take<F: Firmware, V: VirtualFile<F>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        file: &V,
        content: &mut VecView<u8>,
        request: &Request<'_>,
    ) -> Result<Taken, MavFtpErr> {
        if matches!(self.state, UploadState::Opening | UploadState::Refused) {
            return Err(MavFtpErr::FAIL);
        }
        let Some(known) = self.received.checked_sub(request.head.offset) else { return Ok(Taken::Dropped) };
        let new = u32::from(request.head.size).saturating_sub(known);
        if new == 0 {
            return Ok(Taken::More);
        }
        let data = usize::try_from(known).ok().and_then(|known| request.data.get(known..)).unwrap_or_default();
        let len = content.len().saturating_add(usize::try_from(new).unwrap_or(usize::MAX));
        let has_room = self.state == UploadState::Receiving
            && content.extend_from_slice(data).is_ok()
            && content.resize(len, 0).is_ok();
        let part = if has_room { file.take(cx, content) } else { Err(MavFtpErr::FAIL) };
        let part = part.inspect_err(|_| self.state = UploadState::Refused)?;
        self.received = self.received.saturating_add(new);
        self.grown = ticks(cx.now);
        let Part::More { used } = part else { return Ok(Taken::Last) };
        if used > 0 {
            // A loop, because `copy_within` would link 1.5 kB.
            let bytes = Cell::from_mut(content.as_mut_slice()).as_slice_of_cells();
            let rest = bytes.get(used..).unwrap_or_default();
            bytes.iter().zip(rest).for_each(|(to, from)| to.set(from.get()));
            let left = rest.len();
            content.truncate(left);
        }
        Ok(Taken::More)
    }
}
