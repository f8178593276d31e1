//! Reads of one parameter.

use super::{Parameter, is_from_target, name_of, parameter_of, request_by_name};
use crate::{Client, Dialogue, Due, Failure, Io, Received, Retry};
use mavstack::Duration;
use mavstack::dialect::{MavParamError, ParamError, ParamValue};

/// Reads a parameter by its name.
#[derive(Clone, Debug)]
pub struct Read {
    name: String,
    retry: Option<Retry>,
    result: Option<Result<Parameter, MavParamError>>,
    /// What a client that ignores PARAM_ERROR was told.
    ignored: Option<MavParamError>,
}

impl Read {
    /// Creates the dialogue.
    pub fn new(name: &str) -> Self {
        Self { name: name.to_string(), retry: None, result: None, ignored: None }
    }

    fn timer(client: Client) -> Retry {
        match client {
            Client::QGroundControl => Retry::new(Duration::from_secs(1), 3),
            Client::Mavsdk => Retry::new(Duration::from_millis(500), 6),
            Client::MavProxy | Client::Pymavlink => Retry::new(client.patience(), 1),
        }
    }

    fn refused(&self, error: MavParamError) -> Failure {
        Failure::Param { name: self.name.clone(), error: Some(error), text: None }
    }
}

impl Dialogue for Read {
    type Output = Parameter;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Parameter, Failure>> {
        if let Some(result) = self.result.take() {
            return Some(result.map_err(|error| self.refused(error)));
        }
        let retry = self.retry.get_or_insert_with(|| Self::timer(io.client()));
        match retry.due(io.now()) {
            Due::Wait => None,
            Due::Send => {
                request_by_name(io, &self.name);
                None
            }
            Due::GiveUp => {
                let timeout = Failure::timeout(format!("the read of parameter {}", self.name), retry.tries());
                Some(Err(self.ignored.map_or(timeout, |error| self.refused(error))))
            }
        }
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        if !is_from_target(io, frame) {
            return;
        }
        if let Some(message) = frame.decode::<ParamValue>()
            && name_of(&message.param_id) == self.name
        {
            self.result = Some(Ok(parameter_of(io, &message)));
        }
        if let Some(message) = frame.decode::<ParamError>()
            && name_of(&message.param_id) == self.name
        {
            match io.client() {
                Client::QGroundControl | Client::Mavsdk => self.result = Some(Err(message.error)),
                Client::MavProxy | Client::Pymavlink => self.ignored = Some(message.error),
            }
        }
    }
}
