//! A client that downloads a log, with its user.

use crate::support::secs;
use mavstack::Duration;
use mavstack_station::logs::{Download, Listing, Log};
use mavstack_station::{Dialogue, Failure, Io, Received};

/// Lists the logs and downloads one. When the client has given up, or shows an empty list, its user presses the button again.
#[derive(Debug)]
pub struct Fetch {
    id: u16,
    patience: Duration,
    pub logs: Vec<Log>,
    step: Step,
}

#[derive(Debug)]
enum Step {
    List(Listing),
    Data(Download),
}

impl Fetch {
    pub fn new(id: u16) -> Self {
        Self { id, patience: secs(20), logs: Vec::new(), step: Step::List(Listing::new()) }
    }

    /// Waits longer for data.
    pub fn with_patience(mut self, patience: Duration) -> Self {
        self.patience = patience;
        self
    }

    /// Returns the download of the log, if it is listed. Only MAVProxy reads empty logs.
    fn download(&self) -> Option<Step> {
        let log = self.logs.iter().find(|log| log.id == self.id)?;
        Some(Step::Data(Download::new(*log).with_patience(self.patience)))
    }
}

impl Dialogue for Fetch {
    type Output = Vec<u8>;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Vec<u8>, Failure>> {
        match &mut self.step {
            Step::List(listing) => {
                self.logs = listing.poll(io)?.unwrap_or_default();
                self.step = self.download().unwrap_or_else(|| Step::List(Listing::new()));
            }
            Step::Data(download) => match download.poll(io)? {
                Err(Failure::Timeout { .. }) => self.step = self.download()?,
                // The client has told the user that the log is empty.
                Err(Failure::Protocol(_)) => return Some(Ok(Vec::new())),
                result => return Some(result),
            },
        }
        None
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        match &mut self.step {
            Step::List(listing) => listing.receive(io, frame),
            Step::Data(download) => download.receive(io, frame),
        }
    }
}
