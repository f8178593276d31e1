//! Several components in one firmware: an autopilot that is also a gimbal, a camera or another payload.
//!
//! Each component has an address of its own in the vehicle's system, its own HEARTBEAT, sequence numbers, commands and
//! streams (K-10). All share the links, the peer table and the stack's memory:
//!
//! ```text
//!                      ┌─▶ autopilot (1): plans, parameters, modes, commands ...
//!   frame ─▶ address ──┼─▶ gimbal (154):  the service that is this component, or `Components::component_command`
//!                      └─▶ camera (100)
//! ```
//!
//! A service may be such a component: [`Service::COMPONENT`]. Messages and commands that no service handles go to the
//! vehicle's hook. A command of the firmware's own [client](crate::CommandClient) to one of them is carried out in
//! [`Stack::poll`](crate::Stack::poll), and leaves the firmware on no link.

use super::{About, Cx, Part, Request, Service, Turn, Verdict, View};
use crate::dialect::{Heartbeat, MavAutopilot, MavCmd, MavModeFlag, MavResult, MavState};
use crate::link::Port;
use crate::message::{ComponentId, Message};
use crate::num;
use crate::time::Instant;
use crate::types::{Command, Component, Context, Firmware, Outcome};

/// The version of the definitions in HEARTBEAT (V-5).
const MAVLINK_VERSION: u8 = 3;

/// The other components of the firmware, and their commands. For a vehicle that declares `components` in
/// [`#[stack]`](macro@crate::Stack).
///
/// ```
/// use mavstack::dialect::{MavCmd, MavResult, MavState, MavType};
/// use mavstack::message::ComponentId;
/// use mavstack::prelude::*;
///
/// /// MAV_COMP_ID_PERIPHERAL.
/// const WINCH: ComponentId = ComponentId::new(158);
///
/// # struct Copter { length: f32, is_stuck: bool }
/// # impl Vehicle for Copter { fn state(&self) -> Option<VehicleState> { None } }
/// # impl Commands for Copter {
/// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { MavResult::UNSUPPORTED.into() }
/// # }
/// impl Components for Copter {
///     const COMPONENTS: &'static [Component] = &[Component::new(WINCH, MavType::WINCH)];
///
///     fn component_state(&self, _: ComponentId) -> Option<MavState> {
///         Some(if self.is_stuck { MavState::CRITICAL } else { MavState::ACTIVE })
///     }
///
///     fn component_command(&mut self, _: &mut Context<'_>, _: ComponentId, command: &Command) -> Outcome {
///         let [_, action, length, _] = command.params;
///         if command.id != MavCmd::DO_WINCH || action != 1.0 {
///             return MavResult::UNSUPPORTED.into();
///         }
///         self.length = length;
///         MavResult::ACCEPTED.into()
///     }
/// }
///
/// #[derive(Stack)]
/// #[stack(vehicle: Copter, links: 2, components)]
/// struct Mavlink;
/// ```
#[diagnostic::on_unimplemented(
    message = "`{Self}` does not implement `Components`",
    note = "`components` in `#[stack]` needs `impl Components for {Self}`: write it, or leave `components` out"
)]
pub trait Components {
    /// The components besides the autopilot, at most three. None has the component id of [`Config`](crate::Config).
    const COMPONENTS: &'static [Component];

    /// Whether the firmware may run without these components: [`Stack::leave_out_components`](crate::Stack::leave_out_components).
    /// Each of its streams must then be the autopilot's.
    const OPTIONAL: bool = false;

    /// Returns HEARTBEAT.system_status of a component; `None` while it is in a fault, which stops its heartbeats. They stop with
    /// those of the autopilot too (H-5).
    fn component_state(&self, component: ComponentId) -> Option<MavState> {
        let _ = component;
        Some(MavState::ACTIVE)
    }

    /// Carries out a command that is addressed to one of the components, and that no service handles. The vehicle's
    /// [`POLICIES`](crate::Commands::POLICIES) apply to it. The answer comes from that component.
    fn component_command(&mut self, cx: &mut Context<'_>, component: ComponentId, command: &Command) -> Outcome {
        let _ = (cx, component, command);
        MavResult::UNSUPPORTED.into()
    }
}

/// The heartbeats of a link that are pending.
#[derive(Debug)]
pub struct ComponentLink {
    /// The number of the autopilot's heartbeat after which the components last sent.
    period: u8,
    /// The number of components, from the end of the list, that are still to send.
    left: u8,
}

impl ComponentLink {
    /// Whether components are still to send: each does after the autopilot's scheduled heartbeat.
    const fn is_pending(&self, port: &Port) -> bool {
        self.period != port.facts.periods || self.left != 0
    }
}

/// Sends the heartbeats of the components.
#[derive(Debug)]
pub struct ComponentService;

impl<F: Firmware<Vehicle: Components>> Service<F> for ComponentService {
    const NEW: Self = Self;
    const ABOUT: About =
        About { turns: &[Turn::ComponentHeartbeat], part: Part::Every, is_of_components: true, ..About::AUTOPILOT };
    type Link = ComponentLink;
    const VACANT: ComponentLink = ComponentLink { period: 0, left: 0 };
    type Reply = ();

    /// Handles a request for a component's HEARTBEAT.
    fn on_command(
        &mut self,
        cx: &mut Cx<'_, F>,
        port: &mut Port,
        link: &mut ComponentLink,
        request: &Request,
    ) -> Option<Verdict> {
        let command = &request.command;
        let [id, ..] = command.params;
        if !F::is_component(command.component)
            || command.id != MavCmd::REQUEST_MESSAGE
            || num::integer(id) != Some(Heartbeat::ID)
        {
            return None;
        }
        let is_alive = cx.vehicle.component_state(command.component).is_some() && cx.shared.is_beating(cx.now);
        if !is_alive || !command.has_response_target() || port.config.class.is_high_latency() {
            return Some(Verdict::done(MavResult::DENIED));
        }
        // All components send: it is simpler, and each heartbeat is current.
        link.left = count::<F>();
        Some(Verdict::done(MavResult::ACCEPTED))
    }

    #[inline(always)]
    fn pending(&self, view: &View<'_>, port: &Port, link: &ComponentLink, _: Turn) -> Option<(Instant, ())> {
        link.is_pending(port).then_some((view.now, ()))
    }

    /// Sends the heartbeat of the next component that is not in a fault.
    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, link: &mut ComponentLink, (): ()) -> bool {
        if link.period != port.facts.periods {
            (link.period, link.left) = (port.facts.periods, count::<F>());
        }
        while let Some(left) = link.left.checked_sub(1) {
            link.left = left;
            let Some(component) = F::COMPONENTS.iter().nth_back(left.into()) else { continue };
            let Some(system_status) = cx.vehicle.component_state(component.id) else { continue };
            return port.outbox.send_from::<F, _>(
                Some(component.id),
                &Heartbeat {
                    custom_mode: 0,
                    r#type: component.r#type,
                    autopilot: MavAutopilot::INVALID,
                    base_mode: MavModeFlag::EMPTY,
                    system_status,
                    mavlink_version: MAVLINK_VERSION,
                },
            );
        }
        false
    }
}

/// Returns the number of components.
fn count<F: Firmware>() -> u8 {
    u8::try_from(F::COMPONENTS.len()).unwrap_or(0)
}
