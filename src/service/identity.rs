//! AUTOPILOT_VERSION and PROTOCOL_VERSION: the vehicle's versions and capabilities (Q-2, V-4, V-6).

use super::{About, Cx, Request, Service, Turn, Verdict, View};
use crate::dialect::{AutopilotVersion, MavCmd, MavProtocolCapability, MavResult, ProtocolVersion};
use crate::frame::Version;
use crate::link::Port;
use crate::message::Message;
use crate::num;
use crate::time::Instant;
use crate::types::Firmware;

/// The answers that are pending on a link. Each is a flag, so no request is refused for lack of room.
#[derive(Clone, Copy, Debug)]
pub struct IdentityLink {
    autopilot_version: bool,
    protocol_version: bool,
}

/// An answer that is pending.
#[derive(Clone, Copy, Debug)]
pub enum IdentityReply {
    AutopilotVersion,
    ProtocolVersion,
}

/// Answers requests for the vehicle's identity.
#[derive(Debug)]
pub struct Identification;

impl<F: Firmware> Service<F> for Identification {
    const NEW: Self = Self;
    type Link = IdentityLink;
    const VACANT: IdentityLink = IdentityLink { autopilot_version: false, protocol_version: false };
    type Reply = IdentityReply;
    const ABOUT: About =
        About { turns: &[Turn::Identity], capabilities: MavProtocolCapability::MAVLINK2, ..About::AUTOPILOT };

    /// Handles MAV_CMD_REQUEST_MESSAGE for one of the two, and the commands that it replaced.
    fn on_command(
        &mut self,
        _: &mut Cx<'_, F>,
        port: &mut Port,
        link: &mut IdentityLink,
        request: &Request,
    ) -> Option<Verdict> {
        let command = &request.command;
        let [first, ..] = command.params;
        let (message, is_valid) = match command.id {
            MavCmd::REQUEST_MESSAGE => (num::integer(first)?, command.has_response_target()),
            // The commands that REQUEST_MESSAGE replaced: parameter 1 must be 1.
            MavCmd::REQUEST_AUTOPILOT_CAPABILITIES => (AutopilotVersion::ID, first == 1.0),
            MavCmd::REQUEST_PROTOCOL_VERSION => (ProtocolVersion::ID, first == 1.0),
            _ => return None,
        };
        let is_pending = match message {
            AutopilotVersion::ID => &mut link.autopilot_version,
            ProtocolVersion::ID => &mut link.protocol_version,
            _ => return None,
        };
        if !is_valid || port.config.class.is_high_latency() {
            return Some(Verdict::done(MavResult::DENIED));
        }
        *is_pending = true;
        Some(Verdict::done(MavResult::ACCEPTED))
    }

    #[inline(always)]
    fn pending(&self, view: &View<'_>, _: &Port, link: &IdentityLink, _: Turn) -> Option<(Instant, IdentityReply)> {
        let reply = match *link {
            IdentityLink { autopilot_version: true, .. } => IdentityReply::AutopilotVersion,
            IdentityLink { protocol_version: true, .. } => IdentityReply::ProtocolVersion,
            _ => return None,
        };
        Some((view.now, reply))
    }

    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, link: &mut IdentityLink, reply: IdentityReply) -> bool {
        match reply {
            IdentityReply::AutopilotVersion => {
                link.autopilot_version = false;
                let identity = &cx.shared.config.identity;
                port.outbox.send(&AutopilotVersion {
                    capabilities: identity.capabilities,
                    flight_sw_version: identity.flight_sw_version,
                    middleware_sw_version: identity.middleware_sw_version,
                    os_sw_version: identity.os_sw_version,
                    board_version: identity.board_version,
                    flight_custom_version: identity.flight_custom_version,
                    vendor_id: identity.vendor_id,
                    product_id: identity.product_id,
                    uid: identity.uid,
                    uid2: identity.uid2,
                    ..Default::default()
                })
            }
            IdentityReply::ProtocolVersion => {
                link.protocol_version = false;
                let message =
                    ProtocolVersion { version: 200, min_version: 100, max_version: 200, ..Default::default() };
                // Always MAVLink 2: its arrival is the answer (V-6).
                port.outbox.send_as(Version::V2, &message)
            }
        }
    }
}
