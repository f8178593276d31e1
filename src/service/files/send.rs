//! Sending: answers, and the packets of bursts (F-8, F-15, D-4).

use super::list::list;
use super::open::read;
use super::packet::{self, Body, Head};
use super::session::{self, Answer, Session, State};
use super::virtual_files::VirtualFiles;
use super::{COST_OF_BYTE, FileLink, Files, Server};
use crate::dialect::{FileTransferProtocol, MavFtpErr, MavFtpOpcode};
use crate::link::{Outbox, Port};
use crate::message::Message;
use crate::service::Cx;
use crate::types::Firmware;

impl<F: Firmware<Vehicle: Files>, V: VirtualFiles<F>> Server<'_, '_, F, V> {
    /// Sends an answer with or without data. Data is sent by the link's sessions by turns, what was read or listed before the
    /// packets of bursts.
    #[inline(never)]
    pub(super) fn send(&mut self, port: &mut Port, link: &mut FileLink, has_data: bool) -> bool {
        let is_it = |session: &Session<V>| session.client.link == port.id && session.is_due(has_data);
        // From the one behind the last one on, then from the beginning.
        let mut chosen = None;
        let mut place = 0u8;
        for session in self.sessions.iter() {
            if is_it(session) && (chosen.is_none() || (place >= link.first && chosen < Some(link.first))) {
                chosen = Some(place);
            }
            place = place.wrapping_add(1);
        }
        let Some(place) = chosen else { return false };
        let Some(session) = self.sessions.get_mut(usize::from(place)) else { return false };
        let is_sent = send(self.cx, &mut port.outbox, session, has_data);
        if is_sent && has_data {
            link.first = place.wrapping_add(1);
            let len = u32::try_from(port.outbox.len()).unwrap_or(0);
            link.share.spend_all(self.cx.now, len.saturating_mul(COST_OF_BYTE), port.config.bytes_per_second);
        }
        is_sent
    }
}

/// Sends the oldest pending answer of a session, or the next packet of its burst (F-8).
#[inline(never)]
fn send<F: Firmware<Vehicle: Files>, V: VirtualFiles<F>>(
    cx: &mut Cx<'_, F>,
    outbox: &mut Outbox,
    session: &mut Session<V>,
    has_data: bool,
) -> bool {
    let place = session.pending(has_data);
    let Answer { opcode, size, offset, value, error, seq, .. } = session.next_answer(place);
    // A burst that takes too long is cut off.
    let mut is_last = cx.now >= session.burst.until;
    let mut sent = 0;
    let (to, open) = (session.client.address, &mut session.open);
    let head = Head { to, seq, session: session.number, opcode, offset };
    let is_sent = outbox.compose(const { &FileTransferProtocol::INFO }, |payload| {
        let data = packet::data(payload);
        let body = match opcode {
            _ if error != MavFtpErr::NONE => Body::Refused(error),
            MavFtpOpcode::READFILE | MavFtpOpcode::BURSTREADFILE => {
                read(cx, open, offset, data.get_mut(..usize::from(size)).unwrap_or_default())
            }
            _ if session::is_data(opcode) => {
                list::<F, V>(cx, value, offset, opcode == MavFtpOpcode::LISTDIRECTORYWITHTIME, data)
            }
            MavFtpOpcode::OPENFILERO
            | MavFtpOpcode::OPENFILEWO
            | MavFtpOpcode::CREATEFILE
            | MavFtpOpcode::CALCFILECRC => Body::Data(crate::message::zero_extend(&value.to_le_bytes(), data)),
            _ => Body::Data(0),
        };
        let mut ends = is_last;
        match body {
            Body::Data(len) => {
                // A short packet is the last one. The end of the file is said once more behind it.
                ends |= len < usize::from(size);
                sent = u32::try_from(len).unwrap_or(0);
            }
            _ => (is_last, ends) = (true, true),
        }
        packet::complete(payload, &head, &body, ends && opcode == MavFtpOpcode::BURSTREADFILE)
    });
    if !is_sent {
        return false;
    }
    if let Some(answer) = place.and_then(|place| session.answers.get_mut(place)) {
        answer.state = State::Sent;
    } else {
        session.burst.seq = seq.wrapping_add(1);
        session.burst.offset = offset.saturating_add(sent);
        session.burst.is_active = !is_last;
        session.touched = cx.now;
    }
    true
}
