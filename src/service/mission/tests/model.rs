//! A model check of the upload and clear protocol. It runs the engine itself, not a model of it, against a model of MAVSDK's
//! client, over a link that loses, duplicates and reorders frames. It visits every reachable state, within these bounds:
//!
//! - One client has one or two tasks: an upload of a unique plan of one to three items, or a clear. It repeats COUNT and
//!   CLEAR_ALL every half second, three times in all (MAVSDK: five). It sends an item on request: item 0 first, then the next
//!   item or the last one again, each at most three times. It refuses MISSION_REQUEST with UNSUPPORTED.
//! - Two or three faults of any kind happen at any time. A frame is lost; or delayed by up to 0.9 s, so that others overtake
//!   it; or duplicated, and the duplicate is delayed; or storage fails. All other frames arrive at once and in order.
//! - Time advances from one timer of the engine or the client to the next, while only delayed frames are in transit. A write to
//!   storage takes any time up to the engine's timeout.
//! - The engine's pending messages are sent at once. Stalled links are tested elsewhere.
//! - The client increments its sequence number (M-22), except in one check.
//!
//! These properties hold in every state:
//!
//! - The live plan is complete (M-1): the initial one, or the outcome of a task that was begun.
//! - A plan that was reported as accepted is live (M-39). With durable storage, the live plan is stored (M-44).
//! - Without further faults, client, upload, storage and staging area become idle (M-41).
//!
//! MAVLink transfers carry no transaction id: a frame of a client's last transfer looks like one of its next. So the properties
//! depend on when a client begins the next transfer. They hold for a [`Patient`](Manners::Patient) client, and for one that
//! waits for the [`Result`](Manners::Result). For other clients the check finds truncated and mixed plans. Each of these
//! limits has a test, which fails when the limit is gone.
//!
//! About 390,000 states in all: less than a minute on one core in a debug build.

mod client;
mod state;

use self::client::{Client, Manners, Phase};
use self::state::{InTransit, Msg, State};
use super::*;
use core::fmt::Write;
use core::hash::{Hash, Hasher};
use stateright::{Checker, Model, Path, Property};
use std::collections::HashSet;
use std::string::String;
use std::sync::Mutex;

/// Maximum delay of a frame: less than the time in which the engine expects a delayed duplicate (M-22).
const LIFETIME: Duration = Duration::from_millis(900);

type Tasks = &'static [Op];

/// A task of the client.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Op {
    /// Upload a unique plan of this many items.
    Upload(u16),
    Clear,
}

/// Returns the tag of the items that this task uploads.
fn tag(op: usize) -> u16 {
    1 + op as u16
}

/// Returns the live plan after a task.
fn outcome(op: usize, task: Op) -> Vec<Item> {
    match task {
        Op::Upload(len) => plan(tag(op), len),
        Op::Clear => Vec::new(),
    }
}

/// Returns the initial plan.
fn initial() -> Vec<Item> {
    plan(100, 2)
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Action {
    /// The client begins the next task.
    Begin,
    Deliver(InTransit),
    /// A frame is lost.
    Lose(InTransit),
    /// A frame is delayed: others overtake it, and time passes.
    Delay(InTransit),
    /// A frame is duplicated, and the duplicate is delayed.
    Duplicate(InTransit),
    /// Time advances to the engine's next timer.
    EngineTimer,
    /// Time advances to the client's next timer.
    ClientTimer,
    Stored,
    NotStored,
}

/// The model to check.
struct Protocol {
    tasks: Tasks,
    manners: Manners,
    /// Maximum number of faults.
    faults: u8,
    durability: Option<Durability>,
    second_ack: bool,
    is_counting: bool,
    /// States from which everything becomes idle.
    settled: Mutex<HashSet<u64>>,
}

impl Protocol {
    fn new(manners: Manners, faults: u8, tasks: Tasks) -> Self {
        let settled = Mutex::default();
        Self { tasks, manners, faults, durability: None, second_ack: false, is_counting: true, settled }
    }

    /// Adds durable storage.
    #[cfg(feature = "storage")]
    fn durable(self) -> Self {
        Self { durability: Some(Durability::Durable), ..self }
    }

    /// Returns the client's current or last task.
    fn task(&self, state: &State) -> Option<Op> {
        self.tasks.get(state.client.begun.checked_sub(1)?).copied()
    }

    /// Whether the client begins no task while a frame is in transit.
    fn awaits_silence(&self) -> bool {
        matches!(self.manners, Manners::Patient | Manners::Result)
    }

    fn may_begin(&self, state: &State) -> bool {
        let is_resting = match state.client.phase {
            Phase::Resting(until) => state.now() >= until,
            _ => self.manners == Manners::Hasty,
        };
        let is_free = !self.awaits_silence() || state.in_transit.is_empty();
        is_resting && is_free && state.client.begun < self.tasks.len()
    }

    /// Returns the next timers of engine and client, if one of them is the next event: while a frame that is not delayed is in
    /// transit, none is.
    fn timers(&self, state: &State) -> (Option<Instant>, Option<Instant>) {
        let rest = match state.client.phase {
            Phase::Resting(until) if until > state.now() => Some(until),
            _ => None,
        };
        let (engine, client) = (state.engine_due(), state.client.due().or(rest));
        let first = engine.into_iter().chain(client).min();
        let is_next = |at: &Instant| Some(*at) == first && state.in_transit.iter().all(|frame| frame.is_delayed);
        (engine.filter(is_next), client.filter(is_next))
    }

    /// Returns the initial plan, and the outcomes of the tasks that were begun.
    fn whole_plans(&self, state: &State) -> Vec<Vec<Item>> {
        let tasks = self.tasks.iter().enumerate().take(state.client.begun);
        core::iter::once(initial()).chain(tasks.map(|(op, task)| outcome(op, *task))).collect()
    }

    /// Returns the outcome of the client's current or last task.
    fn wanted(&self, state: &State) -> Option<Vec<Item>> {
        Some(outcome(state.client.begun.checked_sub(1)?, self.task(state)?))
    }

    /// Whether everything becomes idle from here without more faults.
    fn settles(&self, state: &State) -> bool {
        let mut state = state.clone();
        let mut path = Vec::new();
        let settles = loop {
            if self.settled.lock().unwrap().contains(&state.key) {
                break true;
            }
            path.push(state.key);
            let action = if state.bench.missions.is_committing() {
                Action::Stored
            } else if let Some(first) = state.in_transit.first() {
                Action::Deliver(*first)
            } else {
                match self.timers(&state) {
                    (Some(_), _) => Action::EngineTimer,
                    (None, Some(_)) => Action::ClientTimer,
                    (None, None) => break state.is_idle() && state.client.is_resting() && state.bench.staged() == 0,
                }
            };
            if path.len() > 300 {
                break false;
            }
            self.act(&mut state, action);
        };
        if settles {
            self.settled.lock().unwrap().extend(path);
        }
        settles
    }

    fn act(&self, state: &mut State, action: Action) {
        let task = self.task(state);
        match action {
            Action::Begin => {
                let msg = state.client.begin(state.now(), self.tasks[state.client.begun]);
                state.send(msg);
            }
            Action::Deliver(frame) => {
                state.remove(frame);
                state.deliver(frame, task);
            }
            Action::Lose(frame) => {
                state.faults -= 1;
                state.remove(frame);
            }
            Action::Delay(frame) => {
                state.faults -= 1;
                state.remove(frame);
                state.in_transit.push(InTransit { is_delayed: true, ..frame });
            }
            Action::Duplicate(frame) => {
                state.faults -= 1;
                state.in_transit.push(InTransit { is_delayed: true, ..frame });
            }
            Action::EngineTimer => {
                let (due, _) = self.timers(state);
                state.wait_until(due.expect("a timer is set"));
                state.bench.poll();
                state.after();
            }
            Action::ClientTimer => {
                let (_, due) = self.timers(state);
                state.wait_until(due.expect("a timer is set"));
                let now = state.now();
                let msg = task.and_then(|task| state.client.timeout(now, task));
                msg.into_iter().for_each(|msg| state.send(msg));
            }
            Action::Stored => {
                let (_, [mission, ..]) = state.bench.unsaved().expect("there is something to write");
                state.stored = mission.0;
                state.bench.saved();
                state.after();
            }
            Action::NotStored => {
                state.faults -= 1;
                state.bench.not_saved();
                state.after();
            }
        }
        if self.awaits_silence() && state.client.is_resting() {
            // The client ignores these frames, and begins no task before they are gone.
            state.in_transit.retain(|frame| frame.msg.is_to_vehicle());
        }
        state.rehash();
    }
}

impl Model for Protocol {
    type State = State;
    type Action = Action;

    fn init_states(&self) -> Vec<State> {
        let mut bench = Bench::new();
        bench.upload(B, MISSION, &initial());
        bench.second_ack = self.second_ack;
        if let Some(durability) = self.durability {
            bench.missions.attach_storage(durability);
            bench.saved();
        }
        bench.now += Duration::from_secs(60);
        let client = Client::new(bench.now, self.manners);
        let (faults, is_counting) = (self.faults, self.is_counting);
        let (in_transit, stored) = (Vec::new(), initial());
        let mut state = State { bench, client, in_transit, number: 0, is_counting, faults, stored, key: 0 };
        state.rehash();
        std::vec![state]
    }

    fn actions(&self, state: &State, actions: &mut Vec<Action>) {
        if self.may_begin(state) {
            actions.push(Action::Begin);
        }
        // In order, except for delayed frames.
        let next = |to_vehicle| {
            state.in_transit.iter().find(move |frame| !frame.is_delayed && frame.msg.is_to_vehicle() == to_vehicle)
        };
        for frame in [next(true), next(false)].into_iter().flatten() {
            actions.push(Action::Deliver(*frame));
            if state.faults > 0 {
                actions.extend([Action::Lose(*frame), Action::Delay(*frame), Action::Duplicate(*frame)]);
            }
        }
        let late = state.in_transit.iter().enumerate().filter(|(_, frame)| frame.is_delayed);
        actions.extend(
            late.filter(|(at, frame)| !state.in_transit[..*at].contains(frame))
                .map(|(_, frame)| Action::Deliver(*frame)),
        );
        if state.bench.missions.is_committing() {
            actions.push(Action::Stored);
            if state.faults > 0 {
                actions.push(Action::NotStored);
            }
        }
        let (engine, client) = self.timers(state);
        actions.extend(engine.map(|_| Action::EngineTimer));
        actions.extend(client.map(|_| Action::ClientTimer));
    }

    fn next_state(&self, state: &State, action: Action) -> Option<State> {
        let mut state = state.clone();
        self.act(&mut state, action);
        Some(state)
    }

    fn properties(&self) -> Vec<Property<Self>> {
        std::vec![
            Property::always(CUT, |model: &Self, state: &State| {
                let plans = model.whole_plans(state);
                let live = state.live();
                plans.iter().any(|plan| plan == live) || !plans.iter().any(|plan| plan.starts_with(live))
            }),
            Property::always(MIXED, |model: &Self, state: &State| {
                model.whole_plans(state).iter().any(|plan| plan.starts_with(state.live()))
            }),
            Property::always(ACCEPTED_IS_LIVE, |model: &Self, state: &State| {
                state.client.result != Some(true) || Some(state.live()) == model.wanted(state).as_deref()
            }),
            Property::always(REFUSED_IS_NOT, |model: &Self, state: &State| {
                let is_clean = model.faults == 0;
                !is_clean || state.client.result != Some(false) || Some(state.live()) != model.wanted(state).as_deref()
            }),
            Property::always(STORED, |model: &Self, state: &State| {
                model.durability != Some(Durability::Durable) || state.live() == state.stored
            }),
            Property::always("everything becomes idle", Self::settles),
            Property::sometimes(DONE, |model: &Self, state: &State| {
                state.client.begun == model.tasks.len() && state.client.result == Some(true)
            }),
        ]
    }
}

const CUT: &str = "no plan is truncated";
const MIXED: &str = "no plans are mixed";
const ACCEPTED_IS_LIVE: &str = "the accepted plan is live";
/// Only without faults: a delayed or lost answer may look like the answer to another request.
const REFUSED_IS_NOT: &str = "the refused plan is not live";
const STORED: &str = "the live plan is stored";
const DONE: &str = "everything is done";

/// Returns the violated properties, each with its counterexample.
fn violations(model: Protocol) -> Vec<(&'static str, String)> {
    let what = std::format!("{:?} {:?}, {} faults, {:?}", model.manners, model.tasks, model.faults, model.durability);
    let checker = model.checker().spawn_bfs().join();
    let model = checker.model();
    std::println!("{what}: {} states", checker.unique_state_count());
    let mut paths = checker.discoveries();
    assert!(paths.remove(DONE).is_some(), "{what}: no state completes all tasks");
    let violation = |(name, path): (&'static str, Path<State, Action>)| {
        let condition = model.property(name).condition;
        let mut steps = std::format!("{what}: violated: {name}\n");
        for (state, action) in path.into_vec() {
            writeln!(steps, "{state:?}").expect("a String takes everything");
            if !condition(model, &state) {
                break;
            }
            writeln!(steps, "    {action:?}").expect("a String takes everything");
        }
        (name, steps)
    };
    paths.into_iter().map(violation).collect()
}

fn assert_holds(model: Protocol) {
    let violations = violations(model);
    assert!(violations.is_empty(), "{}", violations[0].1);
}

const LONGER: Tasks = &[Op::Upload(1), Op::Upload(2)];
const SHORTER: Tasks = &[Op::Upload(2), Op::Upload(1)];
const EQUAL: Tasks = &[Op::Upload(2), Op::Upload(2)];
const ONE_AND_ONE: Tasks = &[Op::Upload(1), Op::Upload(1)];
const THREE: Tasks = &[Op::Upload(3)];
const THEN_CLEAR: Tasks = &[Op::Upload(2), Op::Clear];
const CLEAR_FIRST: Tasks = &[Op::Clear, Op::Upload(2)];

/// M-1, M-41: without storage, with up to three faults.
#[test]
fn plans_are_whole_and_answers_true() {
    for tasks in [LONGER, SHORTER, ONE_AND_ONE, THEN_CLEAR, CLEAR_FIRST] {
        assert_holds(Protocol::new(Manners::Patient, 3, tasks));
    }
}

/// The same for the tasks with the most states.
#[test]
fn plans_are_whole_and_answers_true_in_longer_transfers() {
    for tasks in [EQUAL, THREE] {
        assert_holds(Protocol::new(Manners::Patient, 3, tasks));
    }
}

/// M-44: ACCEPTED means durable, with up to two faults, including faults of storage.
#[cfg(feature = "storage")]
#[test]
fn accepted_means_durable() {
    for tasks in [LONGER, SHORTER, EQUAL, ONE_AND_ONE, THREE, THEN_CLEAR, CLEAR_FIRST] {
        assert_holds(Protocol::new(Manners::Patient, 2, tasks).durable());
    }
}

/// M-31: a second final answer is harmless for a client that does not take it for the answer to another request.
#[test]
fn the_second_answer_is_harmless() {
    for tasks in [LONGER, SHORTER, EQUAL, ONE_AND_ONE, THREE, THEN_CLEAR, CLEAR_FIRST] {
        assert_holds(Protocol { second_ack: true, ..Protocol::new(Manners::Patient, 2, tasks) });
    }
}

/// M-22: without sequence numbers, no COUNT can be distinguished from a delayed duplicate.
#[test]
fn sequence_numbers_are_not_needed() {
    for tasks in [EQUAL, ONE_AND_ONE] {
        for manners in [Manners::Patient, Manners::Result] {
            assert_holds(Protocol { is_counting: false, ..Protocol::new(manners, 2, tasks) });
        }
    }
}

/// Over a perfect link, however fast the client continues: it gets the result of each task, in the order of the tasks.
#[test]
fn without_faults_all_answers_are_true() {
    for manners in [Manners::Patient, Manners::Result, Manners::Prompt] {
        for tasks in [LONGER, SHORTER, EQUAL, ONE_AND_ONE, THREE, THEN_CLEAR, CLEAR_FIRST] {
            assert_holds(Protocol::new(manners, 0, tasks));
        }
        #[cfg(feature = "storage")]
        for tasks in [LONGER, SHORTER, EQUAL, ONE_AND_ONE, THREE] {
            assert_holds(Protocol::new(manners, 0, tasks).durable());
        }
    }
}

/// The same, where the clear is repeated because storage takes longer than the client waits.
#[cfg(feature = "storage")]
#[test]
fn a_clear_that_is_being_written_is_not_denied() {
    for manners in [Manners::Patient, Manners::Result] {
        for tasks in [THEN_CLEAR, CLEAR_FIRST] {
            assert_holds(Protocol::new(manners, 0, tasks).durable());
        }
    }
}

/// A client that continues as soon as it has the result of a transfer and no frame is in transit.
#[test]
fn a_client_with_a_result_may_continue() {
    for tasks in [LONGER, SHORTER, EQUAL, ONE_AND_ONE, THREE, THEN_CLEAR, CLEAR_FIRST] {
        assert_holds(Protocol::new(Manners::Result, 2, tasks));
    }
}

/// The same with storage, which may be slow and may fail.
#[cfg(feature = "storage")]
#[test]
fn a_client_with_a_result_of_storage_may_continue() {
    for tasks in [LONGER, SHORTER, EQUAL, ONE_AND_ONE, THREE, THEN_CLEAR, CLEAR_FIRST] {
        assert_holds(Protocol::new(Manners::Result, 1, tasks).durable());
    }
}

/// Asserts that exactly these properties are violated, in alphabetical order. When a limit is gone, update the text at the top.
fn assert_limits(model: Protocol, limits: &[&str]) {
    let violations = violations(model);
    let mut names: Vec<_> = violations.iter().map(|(name, _)| *name).collect();
    names.sort_unstable();
    let steps: String = violations.into_iter().map(|(_, steps)| steps).collect();
    assert_eq!(names, limits, "{steps}");
}

/// A delayed duplicate of the first upload's item 0 is taken for item 0 of the next upload, which has begun meanwhile.
#[test]
fn limit_a_delayed_duplicate_of_an_item() {
    assert_limits(Protocol::new(Manners::Prompt, 1, EQUAL), &[MIXED, ACCEPTED_IS_LIVE]);
}

/// A client gives up an upload and begins another, whose COUNT is lost. The vehicle requests item 0 of the old plan and receives
/// item 0 of the new one. The old plan had one item, so the new plan goes live without its second item.
#[test]
fn limit_another_plan_while_the_first_is_expected() {
    assert_limits(Protocol::new(Manners::Hasty, 1, LONGER), &[CUT, MIXED, ACCEPTED_IS_LIVE]);
}
