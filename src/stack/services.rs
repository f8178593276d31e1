//! The list of the services. [`Turn`](crate::service::Turn) has the order in which they send.

use super::Declares;
use crate::dialect::MavProtocolCapability;
use crate::service::command::CommandService;
use crate::service::heartbeat::Heartbeats;
use crate::service::identity::Identification;
use crate::service::statustext::Texts;
use crate::service::{About, Look, LookAll, RateLimit, Service, ServiceList, Turn, Visit, VisitAll};

/// Returns the turns of these services, a bit each.
const fn turns_of(services: &[About]) -> u64 {
    let (mut turns, mut services) = (0, services);
    while let [about, rest @ ..] = services {
        turns |= Turn::bits(about.turns);
        services = rest;
    }
    turns
}

/// Whether peers of one of these services hold what others wait for.
const fn holds(services: &[About]) -> bool {
    let (mut holds, mut services) = (false, services);
    while let [about, rest @ ..] = services {
        holds |= about.holds;
        services = rest;
    }
    holds
}

/// Defines the list of services, and how each is visited.
macro_rules! define {
    ($($name:ident: $service:ty,)*) => {
        /// All services of a firmware: the large queues of forwarding are last, so that the other services are near the start of
        /// the stack, where it takes less code to reach them.
        #[derive(Debug)]
        #[repr(C)]
        pub(crate) struct Services<D: Declares> {
            /// The fields of the declaration's struct.
            pub(crate) own: D::Services,
            $(pub(crate) $name: $service,)*
        }

        /// The states of all services on one link.
        #[derive(Debug)]
        pub(crate) struct States<D: Declares> {
            /// The share of the link for bulk data.
            pub(super) bulk: RateLimit,
            /// The number of the service that sent bulk data last.
            pub(super) last_bulk: u8,
            $(pub(crate) $name: <$service as Service<D>>::Link,)*
            pub(crate) own: <D::Services as ServiceList<D>>::Links,
        }

        impl<D: Declares> States<D> {
            pub(crate) const VACANT: Self = Self { bulk: RateLimit::NEW, last_bulk: 0, $($name: <$service as Service<D>>::VACANT,)* own: <D::Services as ServiceList<D>>::VACANT };
        }

        impl<D: Declares> Services<D> {
            pub(crate) const NEW: Self = Self { own: <D::Services as ServiceList<D>>::NEW, $($name: <$service as Service<D>>::NEW,)* };

            /// The turns of all services.
            const TURNS: u64 = turns_of(<D::Services as ServiceList<D>>::ABOUT) | turns_of(&[$(<$service as Service<D>>::ABOUT),*]);

            /// Whether a service sends bulk data.
            pub(super) const HAS_BULK: bool = Self::TURNS & Turn::Bulk.bit() != 0;

            /// Whether a service sends streams or forwards frames.
            pub(super) const HAS_STREAMS: bool = Self::TURNS & Turn::STREAMS != 0;

            /// Whether peers of a service hold what others wait for.
            pub(super) const HOLDS: bool = holds(<D::Services as ServiceList<D>>::ABOUT) || holds(&[$(<$service as Service<D>>::ABOUT),*]);

            /// The capabilities of all services, for AUTOPILOT_VERSION.
            pub(crate) const CAPABILITIES: MavProtocolCapability = Self::capabilities(false);

            /// Those of the services that are left out with the other components.
            pub(crate) const COMPONENT_CAPABILITIES: MavProtocolCapability = Self::capabilities(true);

            const fn capabilities(of_components: bool) -> MavProtocolCapability {
                let library = About::capabilities(&[$(<$service as Service<D>>::ABOUT),*], of_components);
                library.with(About::capabilities(<D::Services as ServiceList<D>>::ABOUT, of_components))
            }

            /// Visits the services until one ends it. Returns whether one did.
            #[cfg(not(test))]
            #[inline(always)]
            pub(super) fn visit(&mut self, states: &mut States<D>, visit: &mut impl Visit<D>) -> bool {
                false $(|| visit.visit(&mut self.$name, &mut states.$name))* || self.own.visit(&mut states.own, visit)
            }

            #[inline(always)]
            pub(super) fn look(&self, states: &States<D>, look: &mut impl Look<D>) {
                $(look.look(&self.$name, &states.$name);)*
                self.own.look(&states.own, look);
            }

            #[cfg(not(test))]
            #[inline(always)]
            pub(super) fn visit_all(&mut self, states: &mut [States<D>], visit: &mut impl VisitAll<D>) {
                $(visit.visit(&mut self.$name, states.iter_mut().map(|state| &mut state.$name));)*
                self.own.visit_all(states, |state| &mut state.own, visit);
            }

            /// The same in an order that a test chooses: it carries nothing.
            #[cfg(test)]
            pub(super) fn visit(&mut self, states: &mut States<D>, visit: &mut impl Visit<D>) -> bool {
                for place in super::permuted::order() {
                    let mut number = 0;
                    $(
                        if number == place && visit.visit(&mut self.$name, &mut states.$name) {
                            return true;
                        }
                        number += 1;
                    )*
                    let nth = place.wrapping_sub(number);
                    if self.own.visit(&mut states.own, &mut super::permuted::Nth { nth, visit }) {
                        return true;
                    }
                }
                false
            }

            #[cfg(test)]
            pub(super) fn visit_all(&mut self, states: &mut [States<D>], visit: &mut impl VisitAll<D>) {
                for place in super::permuted::order() {
                    let mut number = 0;
                    $(
                        if number == place {
                            visit.visit(&mut self.$name, states.iter_mut().map(|state| &mut state.$name));
                        }
                        number += 1;
                    )*
                    let nth = place.wrapping_sub(number);
                    self.own.visit_all(states, |state| &mut state.own, &mut super::permuted::Nth { nth, visit });
                }
            }

            #[inline(always)]
            pub(super) fn look_all(&self, look: &mut impl LookAll<D>) {
                $(look.look(&self.$name);)*
                self.own.look_all(look);
            }
        }
    };
}

define! {
    command: CommandService<D::Commands>,
    mission: D::Mission,
    files: D::Files,
    param: D::Param,
    logs: D::Logs,
    heartbeat: Heartbeats,
    components: D::Components,
    stream: D::Stream,
    messages: D::Messages,
    signing: D::Signing,
    manual_control: D::ManualControl,
    operator_control: D::OperatorControl,
    events: D::Events,
    mode: D::Mode,
    identity: Identification,
    statustext: Texts,
    forwarding: D::Forwarding,
    records: D::Records,
    client: D::Client,
}

#[cfg(test)]
mod tests {
    use crate::dialect::{MavResult, NamedValueInt, PlayTune};
    use crate::frame::{Version, encode};
    use crate::message::{Address, Message};
    use crate::service::example::Tunes;
    use crate::time::{Duration, Instant};
    use crate::{
        Command, Commands, Config, Context, LinkConfig, LinkId, Outcome, Pulse, StackOf, Vehicle, VehicleState,
    };

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

    #[derive(crate::Stack)]
    #[stack(vehicle: Rover, links: 2)]
    struct Mavlink {
        tunes: Tunes,
    }

    /// The recipe in CONTRIBUTING.md: the example's files work together.
    #[test]
    fn a_listed_service_gets_its_frames_and_sends_in_its_turn() {
        static PULSE: Pulse = Pulse::new();
        let config = Config::new(Address::new(1, 1), &PULSE);
        let mut stack = StackOf::<Mavlink>::new(config, [LinkConfig::unlimited(); 2]);
        let mut now = Instant::from_millis(1_000);
        stack.poll(now, &mut Rover);
        for wait in [500, 0] {
            for link in [LinkId(0), LinkId(1)] {
                assert_eq!(stack.transmit(now, link, &mut Rover), [0_u8; 0], "no heartbeat comes");
            }
            now += Duration::from_millis(wait);
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
        assert_eq!(stack.tunes.received(), 3);
        assert_eq!(stack.next_deadline(now), now, "an answer is pending");

        now += Duration::from_millis(7);
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
