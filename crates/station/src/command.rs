//! Commands: COMMAND_LONG and COMMAND_INT, their results and their progress.

use crate::names::Named;
use crate::{Dialogue, Due, Failure, Io, Received, Retry};
use mavstack::Duration;
use mavstack::dialect::{CommandAck, CommandLong, MavCmd, MavResult};

/// Sends a command and waits for its result.
#[derive(Clone, Debug)]
pub struct Send {
    message: CommandLong,
    retry: Retry,
    result: Option<CommandAck>,
}

/// A command that was accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Accepted {
    /// The `result_param2` of the answer.
    pub param: i32,
}

impl Send {
    /// Creates a command in the form COMMAND_LONG, with parameters 1 to 7.
    pub fn long(command: MavCmd, params: [f32; 7]) -> Self {
        let [param1, param2, param3, param4, param5, param6, param7] = params;
        let message = CommandLong {
            command,
            param1,
            param2,
            param3,
            param4,
            param5,
            param6,
            param7,
            target_system: 0,
            target_component: 0,
            confirmation: 0,
        };
        Self { message, retry: Retry::new(Duration::from_millis(500), 4), result: None }
    }
}

impl Dialogue for Send {
    type Output = Accepted;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Accepted, Failure>> {
        let command = self.message.command;
        if let Some(ack) = self.result {
            return Some(match ack.result {
                MavResult::ACCEPTED => Ok(Accepted { param: ack.result_param2 }),
                result => Err(Failure::Command { command, result, text: None }),
            });
        }
        match self.retry.due(io.now()) {
            Due::Wait => None,
            Due::Send => {
                let target = io.target();
                self.message.target_system = target.system.wire();
                self.message.target_component = target.component.wire();
                io.send(&self.message);
                None
            }
            Due::GiveUp => Some(Err(Failure::timeout(command.named(), self.retry.tries()))),
        }
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        let Some(ack) = frame.decode::<CommandAck>().filter(|ack| ack.command == self.message.command) else { return };
        if ack.result == MavResult::IN_PROGRESS {
            self.retry.extend(io.now(), Duration::from_secs(3));
        } else if io.is_for_us(ack.target_system, ack.target_component) {
            self.result = Some(ack);
        }
    }
}
