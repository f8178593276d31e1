//! Sending: answers, and the packets of bursts (F-8, F-15, D-4).

use super::list::list;
use super::open::{end, read};
use super::packet;
use super::requests::Stop;
use super::session::{self, LONGEST_BURST, Session, State};
use super::virtual_files::VirtualFiles;
use super::{FileLink, FileReply, Files, Server};
use crate::dialect::{FileTransferProtocol, MavFtpOpcode};
use crate::link::{Outbox, Port};
use crate::message::Message;
use crate::service::Cx;
use crate::service::rate_limit::RETRY;
use crate::types::Firmware;

impl<F: Firmware<Vehicle: Files>, V: VirtualFiles<F>, const N: usize> Server<'_, '_, F, V, N> {
    /// Sends an answer with or without data. The link's sessions take turns to send data; reads and listings come
    /// before the packets of bursts. A session whose file has no data yet leaves its turn to the next one (LOG-9).
    pub(super) fn send(&mut self, port: &mut Port, link: &mut FileLink, reply: FileReply) -> bool {
        let (first, state) = match reply {
            FileReply::Answer(place) => (place, State::Pending),
            FileReply::Data(place) => (place, State::Data),
        };
        let mut place = first;
        // Without virtual directories no file has data later.
        for _ in 0..const { if V::COUNT == 0 { 1 } else { N } } {
            let Some(session) = self.sessions.get_mut(place) else { break };
            let is_sent = send(self.cx, &mut port.outbox, session, state);
            if state == State::Pending {
                return is_sent;
            }
            link.first = place.wrapping_add(1);
            if is_sent {
                return true;
            }
            match session::next(self.sessions, port.id, link.first, state) {
                Some(next) if next != first => place = next,
                Some(_) => break,
                None => return false,
            }
        }
        if V::COUNT > 0 {
            link.retry_at = self.cx.now + RETRY;
        }
        false
    }
}

/// Sends the oldest pending answer of a session, or the next packet of its burst (F-8).
fn send<F: Firmware<Vehicle: Files>, V: VirtualFiles<F>>(
    cx: &mut Cx<'_, F>,
    outbox: &mut Outbox,
    session: &mut Session<V>,
    state: State,
) -> bool {
    let Some(place) = session.oldest(state) else { return false };
    let Session { open, answers, key, touched, burst_began, size, .. } = session;
    let end = end(open, *size);
    let Some(answer) = answers.get_mut(place) else { return false };
    let (head, value) = (answer.head, answer.value);
    let is_burst = head.opcode == MavFtpOpcode::BURSTREADFILE;
    let now = cx.now.coarse();
    let (mut is_last, mut sent) = (false, 0);
    let is_sent = outbox.compose(const { &FileTransferProtocol::INFO }, |payload| {
        let data = packet::data(payload);
        if let Some(first) = data.first_chunk_mut() {
            *first = value.to_le_bytes();
        }
        let content = match head.opcode {
            _ if answer.is_refused => Err(Stop(value)),
            MavFtpOpcode::READFILE | MavFtpOpcode::BURSTREADFILE => {
                read(cx, open, end, head.offset, data.get_mut(..usize::from(head.size)).unwrap_or_default())
            }
            MavFtpOpcode::LISTDIRECTORY => list::<F, V>(cx, value, head.offset, false, data),
            MavFtpOpcode::LISTDIRECTORYWITHTIME => list::<F, V>(cx, value, head.offset, true, data),
            MavFtpOpcode::OPENFILERO
            | MavFtpOpcode::OPENFILEWO
            | MavFtpOpcode::CREATEFILE
            | MavFtpOpcode::CALCFILECRC => Ok(4),
            _ => Ok(0),
        };
        sent = content.unwrap_or(0);
        // A burst that takes too long is cut off. A short packet, or one up to the end of the file, is the last one (F-30). The
        // end of the file is said once more behind it.
        is_last = content.is_err() || now.wrapping_sub(*burst_began) >= LONGEST_BURST;
        let ends = is_last || sent < u32::from(head.size) || head.offset.saturating_add(sent) >= end;
        packet::complete(payload, *key, &head, content, is_burst && ends)
    });
    if is_sent {
        answer.state = State::Sent;
        if is_burst {
            answer.head.seq = head.seq.wrapping_add(1);
            answer.head.offset = head.offset.saturating_add(sent);
            answer.state = if is_last { State::Empty } else { State::Data };
            *touched = now;
        }
    }
    is_sent
}
