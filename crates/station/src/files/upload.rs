//! Writing a file.

use super::packet::Packet;
use super::requests::{Answered, Gone, Requests};
use super::rules::{Closing, Step};
use crate::{Client, Dialogue, Failure, Io, Received};
use mavstack::dialect::{MavFtpErr, MavFtpOpcode};
use std::collections::VecDeque;

/// Creates or replaces a file.
///
/// MAVProxy and QGroundControl take an upload for stored although the vehicle refuses its end.
#[derive(Debug)]
pub struct Upload {
    path: String,
    content: Vec<u8>,
    transfer: Option<Transfer>,
}

impl Upload {
    /// Writes `content` to the file `path`.
    pub fn new(path: impl Into<String>, content: impl Into<Vec<u8>>) -> Self {
        Self { path: path.into(), content: content.into(), transfer: None }
    }
}

impl Dialogue for Upload {
    type Output = ();

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<(), Failure>> {
        let transfer = self.transfer.get_or_insert_with(|| Transfer::begin(io, &self.path, &self.content));
        transfer.poll(io)
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        if let (Some(transfer), Some(packet)) = (&mut self.transfer, Packet::of(io, frame)) {
            transfer.take(io, &packet);
        }
    }
}

/// A file that is being written.
#[derive(Debug)]
struct Transfer {
    requests: Requests,
    /// The parts that were not sent yet: offset and bytes.
    parts: VecDeque<(u32, Vec<u8>)>,
    result: Option<Result<(), Failure>>,
}

impl Transfer {
    fn begin(io: &mut Io<'_>, path: &str, content: &[u8]) -> Self {
        let mut requests = Requests::begin(io, path);
        let block = usize::from(io.client().ftp_block());
        let parts = content.chunks(block).enumerate().map(|(index, part)| ((index * block) as u32, part.to_vec()));
        requests.send(io, Step::Create, Packet::request(MavFtpOpcode::CREATEFILE, 0, &io.client().ftp_path(path)));
        Self { requests, parts: parts.collect(), result: None }
    }

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<(), Failure>> {
        if self.result.is_none()
            && let Err(gone) = self.requests.repeat_overdue(io)
        {
            self.give_up(io.client(), gone);
        }
        let result = self.result.take()?;
        Some(result.map_err(|failure| self.requests.abort(io, failure)))
    }

    fn give_up(&mut self, client: Client, gone: Gone) {
        let loosely = matches!(client.ftp_closing(), Closing::Reset | Closing::TerminateLoosely);
        self.result = Some(match gone.step {
            Step::Close if loosely => Ok(()),
            _ => Err(self.requests.timed_out(gone)),
        });
    }

    fn take(&mut self, io: &mut Io<'_>, packet: &Packet) {
        if self.result.is_some() {
            return;
        }
        let Some(answered) = self.requests.answer(io, packet) else { return };
        let loosely = io.client().ftp_closing() != Closing::Terminate;
        match packet.error() {
            Some(_) if answered.step == Step::Close && loosely => self.result = Some(Ok(())),
            Some(error) if !is_created(io.client(), error, &answered) => {
                self.result = Some(Err(self.requests.refusal(error)));
            }
            _ if answered.step == Step::Close => self.result = Some(Ok(())),
            _ => self.write(io),
        }
    }

    /// Sends parts, as many at once as the client does; closes the file if all were answered.
    fn write(&mut self, io: &mut Io<'_>) {
        while self.requests.waiting(Step::Write) < io.client().ftp_window()
            && let Some((offset, part)) = self.parts.pop_front()
        {
            self.requests.send(io, Step::Write, Packet::request(MavFtpOpcode::WRITEFILE, offset, &part));
        }
        if self.requests.waiting(Step::Write) > 0 {
            return;
        }
        let terminate = Packet::request(MavFtpOpcode::TERMINATESESSION, 0, &[]);
        match io.client().ftp_closing() {
            Closing::Reset => {
                self.requests.send(io, Step::Close, Packet::request(MavFtpOpcode::RESETSESSION, 0, &[]));
            }
            Closing::Terminate | Closing::TerminateLoosely => self.requests.send(io, Step::Close, terminate),
            Closing::TerminateAndForget => {
                self.requests.send_and_forget(io, terminate);
                self.result = Some(Ok(()));
            }
        }
    }
}

/// Whether a refusal says that the first request was carried out, and the file is open already.
fn is_created(client: Client, error: MavFtpErr, answered: &Answered) -> bool {
    client == Client::MavProxy && answered.step == Step::Create && answered.sends > 1 && error == MavFtpErr::FAIL
}
