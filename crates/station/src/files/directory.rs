//! Listing a directory.

use super::packet::Packet;
use super::requests::Requests;
use super::rules::Step;
use crate::{Client, Dialogue, Failure, Io, Received};
use mavstack::dialect::{MavFtpErr, MavFtpOpcode};

/// An entry of a directory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Its name.
    pub name: String,
    /// What it is.
    pub kind: EntryKind,
}

/// What an entry of a directory is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EntryKind {
    /// A directory.
    Directory,
    /// A file.
    File {
        /// Its size (bytes).
        size: u32,
        /// When it was changed (s since 1970, UTC), if that was asked for and is known. MAVProxy asks.
        time: Option<u64>,
    },
}

/// Lists a directory. Ends with its entries, in the vehicle's order. Entries that the vehicle does not show are left out.
#[derive(Debug)]
pub struct Listing {
    path: String,
    state: Option<State>,
}

impl Listing {
    /// Lists the directory `path`; `/` is the root.
    pub fn new(path: impl Into<String>) -> Self {
        Self { path: path.into(), state: None }
    }
}

impl Dialogue for Listing {
    type Output = Vec<Entry>;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Vec<Entry>, Failure>> {
        self.state.get_or_insert_with(|| State::begin(io, &self.path)).poll(io)
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        if let (Some(state), Some(packet)) = (&mut self.state, Packet::of(io, frame)) {
            state.take(io, &packet);
        }
    }
}

#[derive(Debug)]
struct State {
    requests: Requests,
    path: Vec<u8>,
    /// [`Step::Page`] or [`Step::PageWithTime`].
    step: Step,
    entries: Vec<Entry>,
    /// The index of the next entry; those that are not shown count.
    index: u32,
    result: Option<Result<(), Failure>>,
}

impl State {
    fn begin(io: &mut Io<'_>, path: &str) -> Self {
        let step = if io.client() == Client::MavProxy { Step::PageWithTime } else { Step::Page };
        let mut state = Self {
            requests: Requests::begin(io, path),
            path: io.client().ftp_path(path),
            step,
            entries: Vec::new(),
            index: 0,
            result: None,
        };
        state.request(io);
        state
    }

    fn request(&mut self, io: &mut Io<'_>) {
        let opcode = match self.step {
            Step::PageWithTime => MavFtpOpcode::LISTDIRECTORYWITHTIME,
            _ => MavFtpOpcode::LISTDIRECTORY,
        };
        self.requests.send(io, self.step, Packet::request(opcode, self.index, &self.path));
    }

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Vec<Entry>, Failure>> {
        if self.result.is_none()
            && let Err(gone) = self.requests.repeat_overdue(io)
        {
            if gone.step == Step::PageWithTime && self.index == 0 {
                self.request_without_time(io);
            } else {
                self.result = Some(Err(self.requests.timed_out(gone)));
            }
        }
        match self.result.take()? {
            Ok(()) => {
                if matches!(io.client(), Client::Mavsdk | Client::MavProxy) {
                    let terminate = Packet::request(MavFtpOpcode::TERMINATESESSION, 0, &[]);
                    self.requests.send_and_forget(io, terminate);
                }
                Some(Ok(std::mem::take(&mut self.entries)))
            }
            Err(failure) => Some(Err(self.requests.abort(io, failure))),
        }
    }

    /// Many vehicles do not know the operation with times, and some do not answer it.
    fn request_without_time(&mut self, io: &mut Io<'_>) {
        self.requests.clear();
        self.step = Step::Page;
        self.request(io);
    }

    fn take(&mut self, io: &mut Io<'_>, packet: &Packet) {
        if self.result.is_some() || self.requests.answer(io, packet).is_none() {
            return;
        }
        let is_first = self.index == 0;
        match packet.error() {
            None if packet.data.is_empty() => self.result = Some(Ok(())),
            None => {
                self.read(&packet.data);
                self.request(io);
            }
            Some(MavFtpErr::EOF) => self.result = Some(Ok(())),
            Some(MavFtpErr::FAIL | MavFtpErr::UNKNOWNCOMMAND) if self.step == Step::PageWithTime && is_first => {
                self.request_without_time(io);
            }
            Some(error) => self.result = Some(Err(self.requests.refusal(error))),
        }
    }

    /// Reads a page: entries that end with a NUL each.
    fn read(&mut self, data: &[u8]) {
        for entry in data.split(|byte| *byte == 0).filter(|entry| !entry.is_empty()) {
            self.index += 1;
            let text = String::from_utf8_lossy(&entry[1..]);
            let mut fields = text.split('\t');
            let name = fields.next().unwrap_or_default().to_owned();
            let kind = match entry[0] {
                b'D' => EntryKind::Directory,
                b'F' => EntryKind::File {
                    size: fields.next().and_then(|size| size.parse().ok()).unwrap_or(0),
                    time: fields.next().and_then(|time| time.parse().ok()).filter(|time| *time > 0),
                },
                _ => continue,
            };
            self.entries.push(Entry { name, kind });
        }
    }
}
