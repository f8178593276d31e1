//! The vehicle's requests to other components, by token.

use mavstack::{CommandClient, CommandReply, Context, OutgoingCommand, ParamAnswer, Text};

use super::Quadrotor;
use super::authorise::AUTHORISE;
use super::payload::{CAMERA_MODE, GIMBAL_INFORMATION};
use mavstack::dialect::GimbalDeviceInformation;

impl CommandClient for Quadrotor {
    const READS_PARAMS: bool = true;

    fn command_for(&mut self, token: u16) -> Option<OutgoingCommand> {
        match token {
            AUTHORISE.. => self.authorisation_request(token),
            GIMBAL_INFORMATION => Some(OutgoingCommand::request_message::<GimbalDeviceInformation>(0)),
            _ => None,
        }
    }

    fn command_answered(&mut self, cx: &mut Context<'_>, token: u16, reply: CommandReply) {
        if token >= AUTHORISE {
            self.on_authorisation(cx, token, reply);
        }
    }

    fn param_for(&mut self, token: u16) -> Option<Text<16>> {
        (token == CAMERA_MODE).then(|| Text::new("CAM_MODE"))
    }

    fn param_answered(&mut self, cx: &mut Context<'_>, _token: u16, answer: ParamAnswer<'_>) {
        self.on_camera_mode(cx, answer);
    }
}
