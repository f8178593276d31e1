//! Sending: answers, and the packets of bursts (F-8, F-15, D-4).

use core::task::Poll;

use super::directory::{self, List};
use super::packet;
use super::server::Server;
use super::session::{self, Content, LONGEST_BURST, Session, State, ticks};
use super::vehicle::Files;
use super::virtual_files::VirtualFile;
use crate::dialect::{FileTransferProtocol, MavFtpOpcode};
use crate::link::Port;
use crate::message::Message;
use crate::service::Cx;
use crate::service::rate_limit::RETRY;
use crate::time::Instant;
use crate::types::Firmware;

/// A frame that the service sends, by the index of the session.
#[derive(Clone, Copy, Debug)]
pub enum FileReply {
    /// An answer without data.
    Answer(usize),
    /// Data of a file or a directory. If the file has none yet, another session sends.
    Data(usize),
}

/// The state of the service on a link.
#[derive(Debug)]
pub struct FileLink {
    /// The session that is asked first.
    pub(super) first: usize,
    /// When to retry files that had no data yet.
    pub(super) retry_at: Instant,
}

impl<F: Firmware<Vehicle: Files>, V: VirtualFile<F>, const N: usize> Server<'_, '_, F, V, N> {
    /// Sends an answer with or without data. The link's sessions take turns to send data; reads and listings come
    /// before the packets of bursts. A session whose file has no data yet leaves its turn to the next one (LOG-9).
    pub(super) fn send(&mut self, port: &mut Port, link: &mut FileLink, reply: FileReply) -> bool {
        let first = match reply {
            FileReply::Data(index) => index,
            FileReply::Answer(index) => {
                let session = self.sessions.get_mut(index);
                return session.is_some_and(|session| send_answer(self.cx, port, session, State::Pending));
            }
        };
        let mut index = first;
        for _ in 0..N {
            let Some(session) = self.sessions.get_mut(index) else { break };
            link.first = index.saturating_add(1);
            if send_answer(self.cx, port, session, State::PendingData) {
                return true;
            }
            if V::DIRECTORIES == 0 {
                // Only virtual files have data later.
                return false;
            }
            match session::next(self.sessions, port.id, link.first, State::PendingData) {
                Some(next) if next != first => index = next,
                _ => break,
            }
        }
        link.retry_at = self.cx.now + RETRY;
        false
    }
}

/// Sends the oldest answer of a session in a state, or the next packet of its burst (F-8).
fn send_answer<F: Firmware<Vehicle: Files>, V: VirtualFile<F>>(
    cx: &mut Cx<'_, F>,
    port: &mut Port,
    session: &mut Session<V>,
    state: State,
) -> bool {
    let Session { id: Some(id), file, lease, answers, touched, burst_began, .. } = session else { return false };
    let Some(answer) = answers.iter_mut().find(|answer| answer.state == state) else { return false };
    let head = answer.head;
    let is_burst = head.opcode == MavFtpOpcode::BURSTREADFILE;
    let now = ticks(cx.now);
    // A burst that takes too long is cut off.
    let (mut is_last, mut end) = (now - *burst_began >= LONGEST_BURST, head.offset);
    let is_sent = port.outbox.compose(const { &FileTransferProtocol::INFO }, |payload| {
        let data = packet::data(payload);
        let result = match answer.content {
            Content::Empty => Ok(0),
            Content::Number(bytes) => {
                data.iter_mut().zip(bytes).for_each(|(to, byte)| *to = byte);
                Ok(bytes.len())
            }
            Content::Refused(error) => Err(error),
            Content::FilePart => {
                let out = data.get_mut(..usize::from(head.size)).unwrap_or_default();
                match file.read(cx, head.offset, out) {
                    Poll::Ready(result) => result,
                    Poll::Pending => return false,
                }
            }
            Content::Entries(directory) => {
                let mut list = List::new(&head, data);
                directory.list::<F, V>(cx, &mut list);
                list.result()
            }
            Content::VirtualEntries(number) => {
                let mut list = List::new(&head, data);
                directory::list_virtual::<F, V>(cx, number, &mut list);
                list.result()
            }
        };
        let result = result.map(|len| u8::try_from(len).unwrap_or(0));
        let sent = result.unwrap_or(0);
        // A short packet, or one up to the end of the file, is marked as the last one (F-30); an EOF answer follows it.
        is_last |= result.is_err();
        end = head.offset.saturating_add(sent.into());
        let is_marked = is_burst && (is_last || sent < head.size || end >= file.end());
        packet::answer(payload, *id, &head, result, is_marked);
        true
    });
    if is_sent {
        answer.state = State::Sent;
        lease.bytes += end.saturating_sub(head.offset);
        if is_burst {
            answer.head.seq += 1;
            answer.head.offset = end;
            answer.state = if is_last { State::Empty } else { State::PendingData };
            *touched = now;
        }
    }
    is_sent
}
