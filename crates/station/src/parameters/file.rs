//! The whole list of parameters, by file.

use super::{Parameter, decode_packed};
use crate::files::Download;
use crate::{Dialogue, Failure, Io, Received};

/// The file, with the query that MAVProxy and QGroundControl add.
const PATH: &str = "@PARAM/param.pck?withdefaults=1";

/// Downloads all parameters in one file, as MAVProxy does from every vehicle, and QGroundControl from ArduPilot.
#[derive(Debug)]
pub struct FileList {
    download: Download,
}

impl FileList {
    /// Creates the dialogue.
    pub fn new() -> Self {
        Self { download: Download::new(PATH) }
    }
}

impl Default for FileList {
    fn default() -> Self {
        Self::new()
    }
}

impl Dialogue for FileList {
    type Output = Vec<Parameter>;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Vec<Parameter>, Failure>> {
        let file = match self.download.poll(io)? {
            Ok(file) => file,
            Err(failure) => return Some(Err(failure)),
        };
        Some(decode_packed(&file).map_err(|error| Failure::Protocol(error.to_string())))
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        self.download.receive(io, frame);
    }
}
