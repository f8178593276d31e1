//! The list of the services. Frames and commands are offered to them in this order. [`Turn`](crate::service::Turn) has
//! the order in which they send.

use super::Declares;
use super::bulk::{due, next};
use crate::dialect::MavProtocolCapability;
use crate::link::{Pace, Port, Transport};
use crate::message::{ComponentId, SystemId};
use crate::service::command::CommandService;
#[cfg(test)]
use crate::service::example::Tunes;
use crate::service::heartbeat::Heartbeats;
use crate::service::identity::Identification;
use crate::service::statustext::Texts;
#[cfg(feature = "defmt")]
use crate::service::sum;
use crate::service::{Cx, Handled, Received, Request, Service, Share, Shared, Turn, Verdict, View, turns};
use crate::time::{Duration, Instant};
#[cfg(feature = "defmt")]
use crate::types::LinkId;
use crate::types::{Config, Peer};

/// Whether a service gets a frame or a command for this component, or for all. Always true in a firmware of one component.
fn is_addressed<D: Declares, S: Service<D>>(component: ComponentId) -> bool {
    D::COMPONENTS.is_empty() || component.0 == 0 || S::is_part_of(component)
}

/// Whether a service is left out, because the firmware runs without its other components (K-10).
pub(super) fn is_left_out<D: Declares, S: Service<D>>(_: &S, shared: &Shared) -> bool {
    S::IS_OF_COMPONENTS && shared.leaves_out_components::<D>()
}

/// Defines the services, and what each call does for each of them, in the order of the list.
macro_rules! define {
    ($($name:ident: $service:ty,)*) => {
        /// All services of a firmware, in the order of the list: the large queues of forwarding are last, so that the other
        /// services are near the start of the stack, where it takes less code to reach them.
        #[derive(Debug)]
        #[repr(C)]
        pub(crate) struct Services<D: Declares> {
            $(pub(crate) $name: $service,)*
        }

        /// The states of all services on one link.
        #[derive(Debug)]
        pub(crate) struct States<D: Declares> {
            /// The share of the link for bulk data.
            pub(crate) bulk: Share,
            /// The place of the service that sent bulk data last.
            pub(crate) bulk_turn: u8,
            $(pub(crate) $name: <$service as Service<D>>::Link,)*
        }

        impl<D: Declares> States<D> {
            pub(crate) const VACANT: Self = Self { bulk: Share::NEW, bulk_turn: 0, $($name: <$service as Service<D>>::VACANT,)* };
        }

        impl<D: Declares> Services<D> {
            pub(crate) const NEW: Self = Self { $($name: <$service as Service<D>>::NEW,)* };

            /// The capabilities of all services, for AUTOPILOT_VERSION.
            pub(crate) const CAPABILITIES: MavProtocolCapability =
                MavProtocolCapability::EMPTY$(.with(<$service as Service<D>>::CAPABILITIES))*;

            /// Those of the services that are left out with the other components.
            pub(crate) const COMPONENT_CAPABILITIES: MavProtocolCapability =
                MavProtocolCapability::EMPTY$(.with(match <$service as Service<D>>::IS_OF_COMPONENTS {
                    true => <$service as Service<D>>::CAPABILITIES,
                    false => MavProtocolCapability::EMPTY,
                }))*;

            pub(crate) fn begin(&mut self, config: &Config) {
                $(Service::<D>::begin(&mut self.$name, config);)*
            }

            pub(crate) fn poll(&mut self, cx: &mut Cx<'_, D>, states: &mut [States<D>]) {
                $(if !is_left_out::<D, _>(&self.$name, cx.shared) {
                    self.$name.poll(cx, states.iter_mut().map(|state| &mut state.$name));
                })*
            }

            pub(crate) fn deadline(&self) -> Instant {
                Instant::NEVER$(.min(Service::<D>::deadline(&self.$name)))*
            }

            pub(crate) fn storage_deadline(&self) -> Instant {
                Instant::NEVER$(.min(Service::<D>::storage_deadline(&self.$name)))*
            }

            pub(crate) fn handles_for(component: ComponentId, id: u32) -> bool {
                false$(|| <$service as Service<D>>::handles_for(component, id))*
            }

            pub(crate) fn command_in(port: &Port, received: &Received<'_>) -> Option<Request> {
                $(
                    let request = <$service as Service<D>>::command_in(port, received);
                    if request.is_some() {
                        return request;
                    }
                )*
                None
            }

            pub(crate) fn on_frame(
                &mut self,
                cx: &mut Cx<'_, D>,
                port: &mut Port,
                state: &mut States<D>,
                received: &Received<'_>,
            ) -> Handled {
                let component = received.target.component;
                $(if is_addressed::<D, $service>(component) && !is_left_out::<D, _>(&self.$name, cx.shared) {
                    let handled = self.$name.on_frame(cx, port, &mut state.$name, received);
                    if handled != Handled::No {
                        return handled;
                    }
                })*
                Handled::No
            }

            #[inline(never)]
            pub(crate) fn on_command(
                &mut self,
                cx: &mut Cx<'_, D>,
                port: &mut Port,
                state: &mut States<D>,
                request: &Request,
            ) -> Option<Verdict> {
                let component = request.command.component;
                // A scope for each: they share one place on the stack.
                $(if is_addressed::<D, $service>(component) && !is_left_out::<D, _>(&self.$name, cx.shared) {
                    let verdict = self.$name.on_command(cx, port, &mut state.$name, request);
                    if verdict.is_some() {
                        if let Some(component) = <$service as Service<D>>::COMPONENT {
                            cx.shared.answerer = component;
                        }
                        return verdict;
                    }
                })*
                None
            }

            /// Offers a command of the firmware itself to the services that are one of its other components.
            #[inline(never)]
            pub(crate) fn on_own_command(
                &mut self,
                cx: &mut Cx<'_, D>,
                port: &mut Port,
                state: &mut States<D>,
                request: &Request,
            ) -> Option<Verdict> {
                $(if <$service as Service<D>>::COMPONENT == Some(request.command.component) {
                    let verdict = self.$name.on_command(cx, port, &mut state.$name, request);
                    if verdict.is_some() {
                        return verdict;
                    }
                })*
                None
            }

            pub(crate) fn on_heard(&mut self, now: Instant, from: Peer) {
                $(Service::<D>::on_heard(&mut self.$name, now, from);)*
            }

            pub(crate) fn on_owner(&mut self, own: SystemId, owner: SystemId) {
                $(Service::<D>::on_owner(&mut self.$name, own, owner);)*
            }

            pub(crate) fn on_clock_step(&mut self, lead: Duration) {
                $(Service::<D>::on_clock_step(&mut self.$name, lead);)*
            }

            pub(crate) fn on_sent(&mut self, port: &Port) {
                $(Service::<D>::on_sent(&mut self.$name, port);)*
            }

            #[cfg(feature = "defmt")]
            pub(crate) fn drops(&self) -> u32 {
                sum([$(Service::<D>::drops(&self.$name)),*])
            }

            #[cfg(feature = "defmt")]
            pub(crate) fn drops_on(&self, link: LinkId) -> u32 {
                sum([$(Service::<D>::drops_on(&self.$name, link)),*])
            }

            #[cfg(feature = "defmt")]
            pub(crate) fn log_drops(&self) {
                $(Service::<D>::log_drops(&self.$name);)*
            }

            #[cfg(feature = "defmt")]
            pub(crate) fn log_drops_on(&self, link: LinkId) {
                $(Service::<D>::log_drops_on(&self.$name, link);)*
            }

            pub(crate) fn restart(&mut self, port: &Port, state: &mut States<D>) {
                $(Service::<D>::restart(&mut self.$name, port, &mut state.$name);)*
            }
        }
    };
}

/// The last line is the example's, which only unit tests compile.
macro_rules! services {
    ($($name:ident: $service:ty,)* #[cfg(test)] $($example:tt)*) => {
        #[cfg(not(test))]
        define! { $($name: $service,)* }
        #[cfg(test)]
        define! { $($name: $service,)* $($example)* }
    };
}

services! {
    command: CommandService<D::Commands>,
    high_latency: D::HighLatency,
    mission: D::Mission,
    // Before the parameters, whose poll takes up what it sets.
    files: D::Files,
    param: D::Param,
    ext_parameters: D::ExtParameters,
    logs: D::Logs,
    log_streaming: D::LogStreaming,
    heartbeat: Heartbeats,
    // Before the two that refuse requests for messages that they do not know.
    camera: D::Camera,
    // Before the components and the streams, which refuse the intervals of all other messages.
    gimbal_manager: D::GimbalManager,
    gimbal_device: D::GimbalDevice,
    components: D::Components,
    stream: D::Stream,
    messages: D::Messages,
    time: D::Time,
    signing: D::Signing,
    manual_control: D::ManualControl,
    setpoints: D::Setpoints,
    operator_control: D::OperatorControl,
    // Before the vehicle, which would have to carry out the checks.
    events: D::Events,
    mode: D::Mode,
    identity: Identification,
    statustext: Texts,
    forwarding: D::Forwarding,
    records: D::Records,
    // Polled last, after the hooks that send commands.
    client: D::Client,
    #[cfg(test)]
    example: Tunes,
}

macro_rules! send {
    ($($turn:ident $service:ident $pace:ident $class:ident $messages:literal $when:literal;)*) => {
        impl<D: Declares> Services<D> {
            /// Puts the next frame into the link's empty outbox: the first turn with something to send sends it (D-4).
            pub(crate) fn send(&mut self, cx: &mut Cx<'_, D>, port: &mut Port, state: &mut States<D>) -> bool {
                let class = port.config.class;
                let pace = if port.is_held() { Pace::Stalled } else { port.bucket.pace() };
                false $(|| (
                    Turn::$turn.is_on(class)
                        && Turn::$turn.pace() <= pace
                        && next!($service, D, self, cx, port, state, Turn::$turn)
                ))*
            }

            /// Returns when the link has something to send, as far as its transport accepts bytes.
            pub(crate) fn due(&self, view: &View<'_>, port: &Port, state: &States<D>) -> Instant {
                // Only the HEARTBEAT, which frames wait for (H-17).
                let is_held = view.shared.holds(port);
                let has_frame = !port.outbox.is_empty();
                let is_stalled = match port.transport {
                    // The rest of a frame waits for the next poll's budget, or for a transport that has failed.
                    Transport::Ready if has_frame => return view.now.max(port.retry_at),
                    // The transport must become ready first, which the stack cannot observe.
                    Transport::Full | Transport::Unknown if has_frame => return Instant::NEVER,
                    transport => transport == Transport::Full,
                };
                let (class, ready_at, idle_at) = (port.config.class, port.bucket.ready_at(), port.bucket.idle_at());
                let mut due = match is_held {
                    true => port.held_until(),
                    // It was cut off, and is sent again.
                    false if port.outbox.has_frame() => view.now,
                    false => Instant::NEVER,
                };
                $(if Turn::$turn.is_on(class) && (!(is_stalled || is_held) || Turn::$turn.pace() == Pace::Stalled) {
                    let at = due!($service, D, self, view, port, state, Turn::$turn);
                    due = due.min(at.max(match Turn::$turn.pace() {
                        Pace::Stalled | Pace::AtOnce => Instant::ZERO,
                        Pace::Room => ready_at,
                        Pace::Idle => idle_at,
                    }));
                })*
                // What is due already waits for the transport.
                if is_stalled && due <= view.now { Instant::NEVER } else { due.max(port.retry_at) }
            }
        }
    };
}

turns!(send);

#[cfg(test)]
mod tests {
    use crate::dialect::{MavResult, NamedValueInt, PlayTune};
    use crate::frame::{Version, encode};
    use crate::message::{Address, Message};
    use crate::time::{Duration, Instant};
    use crate::{Command, Commands, Config, Context, LinkConfig, LinkId, Outcome, Pulse, Vehicle, VehicleState};

    /// A vehicle in a fault, so that nothing but the example sends.
    struct Rover;

    impl Vehicle for Rover {
        fn state(&self) -> Option<VehicleState> {
            None
        }
    }

    impl Commands for Rover {
        fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
            MavResult::UNSUPPORTED.into()
        }
    }

    crate::stack! {
        struct Mavlink for Rover { links: 2 }
    }

    /// The recipe in CONTRIBUTING.md: the example's files work together.
    #[test]
    fn a_listed_service_gets_its_frames_and_sends_in_its_turn() {
        static PULSE: Pulse = Pulse::new();
        let config = Config::new(Address::new(1, 1), &PULSE);
        let mut stack = Mavlink::new(config, [LinkConfig::unlimited(); 2]);
        let mut now = Instant::from_millis(1_000);
        stack.poll(now, &mut Rover);
        for wait in [500, 0] {
            for link in [LinkId(0), LinkId(1)] {
                assert_eq!(stack.transmit(now, link, &mut Rover), [0_u8; 0], "no heartbeat comes");
            }
            now = now.after(Duration::from_millis(wait));
        }
        stack.poll(now, &mut Rover);
        assert!(stack.next_deadline(now) > now, "nothing is pending");

        let mut tune = [0; 280];
        let station = Address::new(255, 190);
        for (sender, seq) in [(station, 0), (station, 1), (Address::new(254, 190), 0)] {
            let len = encode(&PlayTune::default(), Version::V2, sender, seq, &mut tune).unwrap();
            assert_eq!(stack.receive(now, LinkId(1), &tune[..len], &mut Rover), len);
        }
        let other = encode(&NamedValueInt::default(), Version::V2, station, 2, &mut tune).unwrap();
        stack.receive(now, LinkId(1), &tune[..other], &mut Rover);
        let tunes: &crate::Tunes = &stack.services.example;
        assert_eq!(tunes.received(), 3);
        assert_eq!(stack.next_deadline(now), now, "an answer is pending");

        now = now.after(Duration::from_millis(7));
        stack.poll(now, &mut Rover);
        assert_eq!(stack.transmit(now, LinkId(0), &mut Rover), [0_u8; 0], "nothing is pending on the other link");
        let answer = stack.transmit(now, LinkId(1), &mut Rover);
        let [0xFD, len, 0, 0, _, 1, 1, id, 0, 0, payload @ .., _, _] = answer else { panic!("{answer:?}") };
        assert_eq!((u32::from(*id), usize::from(*len)), (NamedValueInt::ID, payload.len()));
        let answer = NamedValueInt::decode(payload);
        assert_eq!((answer.time_boot_ms, answer.name.as_str(), answer.value), (1_507, Some("TUNES"), 3));
        let len = payload.len() + 12;
        stack.transmitted(LinkId(1), len);
        assert_eq!(stack.transmit(now, LinkId(1), &mut Rover), [0_u8; 0], "one answer for all three");
        assert!(stack.next_deadline(now) > now, "nothing is pending");
    }
}
