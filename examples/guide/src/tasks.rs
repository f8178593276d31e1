//! Flight in a task of its own: `docs/tasks.md`.

use heapless::spsc::{Consumer, Producer, Queue};
use mavstack::dialect::MissionState;
use mavstack::dialect::commands::ComponentArmDisarm;
use mavstack::dialect::rules::NAV_WAYPOINT;
use mavstack::message::LatLon;
use mavstack::prelude::*;
use mavstack_snapshot::{Reader, Snapshot, Writer};
use static_cell::ConstStaticCell;

/// Published by flight in each pass.
#[derive(Clone, Copy)]
struct State {
    armed: bool,
    is_flying: bool,
    /// The id of the mission that it flies, and the item.
    mission: u32,
    item: u16,
}

/// A request to flight.
enum Decision {
    Arm(bool),
}

static STATE: ConstStaticCell<Snapshot<State>> = ConstStaticCell::new(Snapshot::new(State::START));
static DECISIONS: ConstStaticCell<Queue<Decision, 8>> = ConstStaticCell::new(Queue::new());
static PULSE: Pulse = Pulse::new();

/// Flight, in its interrupt or task.
struct Flight {
    state: State,
    writer: Writer<'static, State>,
    decisions: Consumer<'static, Decision>,
    guidance: Guide,
}

impl Flight {
    fn pass(&mut self, now: Instant) {
        // At most one in each pass, so that a pass is bounded.
        match self.decisions.dequeue() {
            // Flight has the last word: its state may have changed meanwhile.
            Some(Decision::Arm(arm)) if arm || !self.state.is_flying => self.state.armed = arm,
            _ => {}
        }
        let target = self.guidance.target(now, &mut self.state);
        // … sensors; control towards `target`, inside `self.guidance.fence`: hold, return or land if it is `None`; motors
        let _ = target;
        self.writer.write(self.state);
        PULSE.tick();
    }
}

/// The vehicle that the stack sees.
struct Copter {
    /// As read at the start of the pass: all hooks of a pass see the same state.
    state: State,
    reader: Reader<'static, State>,
    decisions: Producer<'static, Decision>,
}

impl Vehicle for Copter {
    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState::new(self.state.armed))
    }
}

impl Commands for Copter {
    fn command(&mut self, _: &mut Context<'_>, command: &Command) -> Outcome {
        let result = match command.decode() {
            Err(result) => result,
            Ok(ComponentArmDisarm { arm: false, .. }) if self.state.is_flying => MavResult::DENIED,
            Ok(_) if command.is_broadcast => MavResult::DENIED,
            Ok(ComponentArmDisarm { arm, .. }) => match self.decisions.enqueue(Decision::Arm(arm)) {
                Ok(()) => MavResult::ACCEPTED,
                Err(_) => MavResult::TEMPORARILY_REJECTED,
            },
        };
        result.into()
    }
}

/// The MAVLink task.
fn pass(now: Instant, stack: &mut StackOf<Mavlink>, copter: &mut Copter, orders: &mut Publisher) {
    copter.state = copter.reader.read();
    stack.poll(now, copter);
    // … `poll_link` for each link, `persist`
    orders.publish(now, stack, &copter.state);
}

/// At startup.
fn split() -> (Flight, Copter, Publisher) {
    let (writer, reader) = STATE.take().split();
    let (producer, consumer) = DECISIONS.take().split();
    let (publisher, guidance) = orders();
    let flight = Flight { state: State::START, writer, decisions: consumer, guidance };
    (flight, Copter { state: State::START, reader, decisions: producer }, publisher)
}

/// What flight needs of the stack, published in each pass of the MAVLink task.
#[derive(Clone, Copy)]
struct Orders {
    /// By the clock of both tasks: its age shows whether the MAVLink task runs.
    written: Instant,
    has_station: bool,
    /// The id of the mission, and two of its items: the second one bridges a late pass.
    mission: u32,
    first: u16,
    items: [Option<Item>; 2],
    /// The id of the fence.
    fence: u32,
}

/// The corners of the fence, which change rarely.
#[derive(Clone, Copy)]
struct Fence {
    corners: [LatLon; 32],
    len: usize,
}

static ORDERS: ConstStaticCell<Snapshot<Orders>> = ConstStaticCell::new(Snapshot::new(Orders::NONE));
static FENCE: ConstStaticCell<Snapshot<Fence>> = ConstStaticCell::new(Snapshot::new(Fence::NONE));

/// In the MAVLink task.
struct Publisher {
    orders: Writer<'static, Orders>,
    fence: Writer<'static, Fence>,
    fence_id: u32,
}

impl Publisher {
    fn publish(&mut self, now: Instant, stack: &StackOf<Mavlink>, flight: &State) {
        let (mission, fence) = (stack.mission(), stack.fence());
        if fence.id() != self.fence_id {
            self.fence.write(Fence::of(fence.items())); // before the orders that name it
            self.fence_id = fence.id();
        }
        let first = if flight.mission == mission.id() { flight.item } else { 0 };
        self.orders.write(Orders {
            written: now,
            has_station: stack.has_ground_station(now),
            mission: mission.id(),
            first,
            items: [0, 1].map(|next| mission.items().get(usize::from(first) + next).copied()),
            fence: fence.id(),
        });
    }
}

/// In flight.
struct Guide {
    orders: Reader<'static, Orders>,
    fences: Reader<'static, Fence>,
    fence: Fence,
    fence_id: u32,
}

impl Guide {
    /// Returns the item to fly to; `None` starts the failsafe.
    fn target(&mut self, now: Instant, state: &mut State) -> Option<Item> {
        let orders = self.orders.read();
        if orders.fence != self.fence_id {
            (self.fence, self.fence_id) = (self.fences.read(), orders.fence);
        }
        if orders.mission != state.mission {
            (state.mission, state.item) = (orders.mission, 0); // another mission: from its start
        }
        // A MAVLink task that hangs is a ground station that is lost.
        let is_hung = now - orders.written > Duration::from_millis(500);
        if is_hung || !orders.has_station {
            return None;
        }
        let next = state.item.checked_sub(orders.first)?;
        *orders.items.get(usize::from(next))?
    }
}

#[derive(Stack)]
#[stack(vehicle: Copter, links: 1, plans: { mission: 100, fence: 32 })]
struct Mavlink;

impl State {
    const START: Self = Self { armed: false, is_flying: false, mission: 0, item: 0 };
}

impl Orders {
    const NONE: Self =
        Self { written: Instant::ZERO, has_station: false, mission: 0, first: 0, items: [None; 2], fence: 0 };
}

impl Fence {
    const NONE: Self = Self { corners: [LatLon { latitude: 0, longitude: 0 }; 32], len: 0 };

    /// A fence of one polygon.
    fn of(items: &[Item]) -> Self {
        let mut fence = Self::NONE;
        for (corner, item) in fence.corners.iter_mut().zip(items) {
            *corner = LatLon { latitude: item.x, longitude: item.y };
            fence.len += 1;
        }
        fence
    }
}

impl Plans for Copter {
    const MISSION_COMMANDS: &'static [CommandRule] = &[NAV_WAYPOINT];

    fn plan_changed(&mut self, _: &mut Context<'_>, _: PlanChange<'_>) {}

    fn progress(&self) -> Progress {
        Progress { current: self.state.item, state: MissionState::ACTIVE, in_mission_mode: true }
    }
}

fn orders() -> (Publisher, Guide) {
    let (orders, newest) = ORDERS.take().split();
    let (fence, fences) = FENCE.take().split();
    let guide = Guide { orders: newest, fences, fence: Fence::NONE, fence_id: 0 };
    (Publisher { orders, fence, fence_id: 0 }, guide)
}

#[cfg(test)]
mod tests {
    use super::*;
    use mavstack::dialect::{MavCmd, MavFrame};
    use std::boxed::Box;

    const POLYGON: MavCmd = MavCmd::NAV_FENCE_POLYGON_VERTEX_INCLUSION;

    fn corner(latitude: i32) -> Item {
        let params = [3.0, 0.0, 0.0, 0.0];
        Item {
            command: POLYGON,
            frame: MavFrame::GLOBAL,
            params,
            x: latitude,
            y: latitude * latitude,
            ..Item::default()
        }
    }

    fn waypoint(latitude: i32) -> Item {
        Item { command: MavCmd::NAV_WAYPOINT, x: latitude, ..corner(0) }
    }

    /// One test, because the statics are taken once.
    #[test]
    fn flight_follows_the_plans_and_notices_a_task_that_hangs() {
        let (mut flight, mut copter, mut publisher) = split();
        let config = Config::new(Address::new(1, 1), &PULSE);
        let mut stack = Box::new(StackOf::<Mavlink>::new(config, [LinkConfig::uart(57_600)]));
        let at = Instant::from_millis;
        pass(at(10), &mut stack, &mut copter, &mut publisher);
        assert!(flight.guidance.target(at(10), &mut flight.state).is_none(), "no station, no mission");

        let (mission, fence) = ([waypoint(1), waypoint(2)], [corner(10), corner(20), corner(-30)]);
        stack.load_plan(at(20), PlanType::Mission, mission.iter().copied(), &mut copter).expect("a mission");
        stack.load_plan(at(20), PlanType::Fence, fence.iter().copied(), &mut copter).expect("a fence");
        flight.state.item = 1;
        pass(at(20), &mut stack, &mut copter, &mut publisher);
        flight.pass(at(20));
        assert_eq!(flight.state.item, 0, "another mission begins at its start");
        assert_eq!(flight.guidance.fence.len, 3);
        assert_eq!(flight.guidance.fence.corners[1].latitude, 20);

        // A station, without its frames.
        let orders = Orders { has_station: true, ..flight.guidance.orders.read() };
        publisher.orders.write(orders);
        assert_eq!(flight.guidance.target(at(500), &mut flight.state).map(|item| item.x), Some(1));
        flight.state.item = 1;
        assert_eq!(
            flight.guidance.target(at(500), &mut flight.state).map(|item| item.x),
            Some(2),
            "before the next pass"
        );
        assert!(flight.guidance.target(at(521), &mut flight.state).is_none(), "the MAVLink task hangs");
    }
}
