//! The upload and clear protocol, model-checked: the engine itself, not a model of it, and a ground station as MAVSDK has
//! it, over a line that loses, doubles and reorders frames. Every state that they can reach is visited, up to these bounds:
//!
//! - One client, with one or two tasks: to upload a plan of one to three items, unlike any other, or to clear. It repeats
//!   COUNT and CLEAR_ALL each half second, three times in all (MAVSDK: five); sends an item when it is asked for it, first
//!   item 0, then one more each time or the last again, each at most three times; refuses MISSION_REQUEST with UNSUPPORTED.
//! - Two or three faults in all, of any kind, at any moment: a frame is lost; late, by up to 0.9 s, so that any others
//!   overtake it; or doubled, and the copy is late; or storage fails. Any frame that is not late arrives at once, in order.
//! - Time goes by from one moment at which the engine or the client does something on its own to the next, while no frame
//!   is on the line but late ones. Writing to storage takes any time up to the engine's patience.
//! - What the engine owes goes on the line at once: that a link is stuck is checked elsewhere.
//! - The client numbers its frames (M-22), but for one check.
//!
//! What holds in every state:
//!
//! - The live plan is a whole one (M-1): the one from before, or the outcome of a task that was begun.
//! - What the client was told is accepted is live (M-39), and where that is the policy, what is live is stored (M-44).
//! - Without further faults all comes to rest: client, upload, storage, staging area (M-41).
//!
//! MAVLink gives a transfer no number: a frame of a client's last transfer looks like one of its next. So this depends on
//! when a client begins the next one. It holds for a [`Patient`](Manners::Patient) one, and for one that was
//! [`Told`](Manners::Told). For others the check finds how plans are cut short and mixed. These limits have a test each, so
//! that it shows when one is gone.
//!
//! Some 390,000 states in all: less than a minute of one core for a debug build.

mod client;
mod state;

use self::client::{Client, Manners, Phase};
use self::state::{Flying, Msg, State};
use super::*;
use core::fmt::Write;
use core::hash::{Hash, Hasher};
use stateright::{Checker, Model, Path, Property};
use std::collections::HashSet;
use std::string::String;
use std::sync::Mutex;

/// A frame is late by at most so much. Less than what the engine takes for a late copy (M-22).
const LIFETIME: Duration = Duration::from_millis(900);

type Tasks = &'static [Op];

/// What the client is to do.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Op {
    /// Upload a plan of so many items, unlike any other.
    Upload(u16),
    Clear,
}

/// What the items of the upload that is this task bear.
fn tag(op: usize) -> u16 {
    1 + op as u16
}

/// The plan that a task leaves.
fn outcome(op: usize, task: Op) -> Vec<Item> {
    match task {
        Op::Upload(len) => plan(tag(op), len),
        Op::Clear => Vec::new(),
    }
}

/// What is live at first.
fn initial() -> Vec<Item> {
    plan(100, 2)
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Action {
    /// The client begins the next task.
    Begin,
    Deliver(Flying),
    /// A frame is lost.
    Lose(Flying),
    /// A frame is late: others overtake it, and time goes by.
    Delay(Flying),
    /// There is a copy of a frame, which is late.
    Double(Flying),
    /// Time goes on to what the engine waits for.
    EngineTimer,
    /// Time goes on to what the client waits for.
    ClientTimer,
    Stored,
    NotStored,
}

/// What is checked.
struct Protocol {
    tasks: Tasks,
    manners: Manners,
    /// How often something goes wrong, at most.
    faults: u8,
    durability: Option<Durability>,
    second_ack: bool,
    is_counting: bool,
    /// States from which all comes to rest.
    settled: Mutex<HashSet<u64>>,
}

impl Protocol {
    fn new(manners: Manners, faults: u8, tasks: Tasks) -> Self {
        let settled = Mutex::default();
        Self { tasks, manners, faults, durability: None, second_ack: false, is_counting: true, settled }
    }

    /// With storage, and ACCEPTED when it is written.
    #[cfg(feature = "storage")]
    fn durable(self) -> Self {
        Self { durability: Some(Durability::Durable), ..self }
    }

    /// The task that the client is at, or was at last.
    fn task(&self, state: &State) -> Option<Op> {
        self.tasks.get(state.client.begun.checked_sub(1)?).copied()
    }

    /// Whether it begins nothing while a frame is on the line.
    fn awaits_silence(&self) -> bool {
        matches!(self.manners, Manners::Patient | Manners::Told)
    }

    fn may_begin(&self, state: &State) -> bool {
        let is_resting = match state.client.phase {
            Phase::Resting(until) => state.now() >= until,
            _ => self.manners == Manners::Hasty,
        };
        let is_free = !self.awaits_silence() || state.line.is_empty();
        is_resting && is_free && state.client.begun < self.tasks.len()
    }

    /// What engine and client wait for, where that is what happens next: nothing does while a frame is on the line that is
    /// not late.
    fn timers(&self, state: &State) -> (Option<Instant>, Option<Instant>) {
        let rest = match state.client.phase {
            Phase::Resting(until) if until > state.now() => Some(until),
            _ => None,
        };
        let (engine, client) = (state.engine_due(), state.client.due().or(rest));
        let first = engine.into_iter().chain(client).min();
        let is_next = |at: &Instant| Some(*at) == first && state.line.iter().all(|flying| flying.is_late);
        (engine.filter(is_next), client.filter(is_next))
    }

    /// The initial plan, and the outcomes of the tasks that were begun.
    fn whole_plans(&self, state: &State) -> Vec<Vec<Item>> {
        let tasks = self.tasks.iter().enumerate().take(state.client.begun);
        core::iter::once(initial()).chain(tasks.map(|(op, task)| outcome(op, *task))).collect()
    }

    /// The outcome of the task that the client is at, or was at last.
    fn wanted(&self, state: &State) -> Option<Vec<Item>> {
        Some(outcome(state.client.begun.checked_sub(1)?, self.task(state)?))
    }

    /// Whether without more faults all comes to rest from here.
    fn settles(&self, state: &State) -> bool {
        let mut state = state.clone();
        let mut path = Vec::new();
        let settles = loop {
            if self.settled.lock().unwrap().contains(&state.key) {
                break true;
            }
            path.push(state.key);
            let action = if state.bench.missions.commit.is_some() {
                Action::Stored
            } else if let Some(first) = state.line.first() {
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
                state.fly(msg);
            }
            Action::Deliver(flying) => {
                state.remove(flying);
                state.arrive(flying, task);
            }
            Action::Lose(flying) => {
                state.faults -= 1;
                state.remove(flying);
            }
            Action::Delay(flying) => {
                state.faults -= 1;
                state.remove(flying);
                state.line.push(Flying { is_late: true, ..flying });
            }
            Action::Double(flying) => {
                state.faults -= 1;
                state.line.push(Flying { is_late: true, ..flying });
            }
            Action::EngineTimer => {
                let (due, _) = self.timers(state);
                state.wait_until(due.expect("it waits for something"));
                state.bench.poll();
                state.after();
            }
            Action::ClientTimer => {
                let (_, due) = self.timers(state);
                state.wait_until(due.expect("it waits for something"));
                let now = state.now();
                let msg = task.and_then(|task| state.client.timeout(now, task));
                msg.into_iter().for_each(|msg| state.fly(msg));
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
            // He takes no notice of them, and begins nothing before they are gone.
            state.line.retain(|flying| flying.msg.is_to_vehicle());
        }
        state.note();
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
        bench.now = bench.now.after(Duration::from_secs(60));
        let client = Client::new(bench.now, self.manners);
        let (faults, is_counting) = (self.faults, self.is_counting);
        let (line, stored) = (Vec::new(), initial());
        let mut state = State { bench, client, line, number: 0, is_counting, faults, stored, key: 0 };
        state.note();
        std::vec![state]
    }

    fn actions(&self, state: &State, actions: &mut Vec<Action>) {
        if self.may_begin(state) {
            actions.push(Action::Begin);
        }
        // In order, but for those that are late.
        let next = |to_vehicle| {
            state.line.iter().find(move |flying| !flying.is_late && flying.msg.is_to_vehicle() == to_vehicle)
        };
        for flying in [next(true), next(false)].into_iter().flatten() {
            actions.push(Action::Deliver(*flying));
            if state.faults > 0 {
                actions.extend([Action::Lose(*flying), Action::Delay(*flying), Action::Double(*flying)]);
            }
        }
        let late = state.line.iter().enumerate().filter(|(_, flying)| flying.is_late);
        actions.extend(
            late.filter(|(at, flying)| !state.line[..*at].contains(flying)).map(|(_, flying)| Action::Deliver(*flying)),
        );
        if state.bench.missions.commit.is_some() {
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
                state.client.told != Some(true) || Some(state.live()) == model.wanted(state).as_deref()
            }),
            Property::always(REFUSED_IS_NOT, |model: &Self, state: &State| {
                let is_clean = model.faults == 0;
                !is_clean || state.client.told != Some(false) || Some(state.live()) != model.wanted(state).as_deref()
            }),
            Property::always(STORED, |model: &Self, state: &State| {
                model.durability != Some(Durability::Durable) || state.live() == state.stored
            }),
            Property::always("all comes to rest", Self::settles),
            Property::sometimes(DONE, |model: &Self, state: &State| {
                state.client.begun == model.tasks.len() && state.client.told == Some(true)
            }),
        ]
    }
}

const CUT: &str = "no plan is cut short";
const MIXED: &str = "no plans are mixed";
const ACCEPTED_IS_LIVE: &str = "what is accepted is live";
/// Without faults only: an answer that is overtaken, or lost, may look like another request's.
const REFUSED_IS_NOT: &str = "what is refused is not live";
const STORED: &str = "what is live is stored";
const DONE: &str = "everything is done";

/// The properties that do not hold, each with the way there.
fn violations(model: Protocol) -> Vec<(&'static str, String)> {
    let what = std::format!("{:?} {:?}, {} faults, {:?}", model.manners, model.tasks, model.faults, model.durability);
    let checker = model.checker().spawn_bfs().join();
    let model = checker.model();
    std::println!("{what}: {} states", checker.unique_state_count());
    let mut paths = checker.discoveries();
    assert!(paths.remove(DONE).is_some(), "{what}: nothing is ever done");
    let violation = |(name, path): (&'static str, Path<State, Action>)| {
        let condition = model.property(name).condition;
        let mut steps = std::format!("{what}: not so: {name}\n");
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

/// M-1, M-41, SEC-9: without storage, after any three faults.
#[test]
fn plans_are_whole_and_answers_true() {
    for tasks in [LONGER, SHORTER, ONE_AND_ONE, THEN_CLEAR, CLEAR_FIRST] {
        assert_holds(Protocol::new(Manners::Patient, 3, tasks));
    }
}

/// The same for the scripts that have the most states.
#[test]
fn plans_are_whole_and_answers_true_in_longer_transfers() {
    for tasks in [EQUAL, THREE] {
        assert_holds(Protocol::new(Manners::Patient, 3, tasks));
    }
}

/// M-44: ACCEPTED means durable, after any two faults, of the storage too.
#[cfg(feature = "storage")]
#[test]
fn accepted_means_durable() {
    for tasks in [LONGER, SHORTER, EQUAL, ONE_AND_ONE, THREE, THEN_CLEAR, CLEAR_FIRST] {
        assert_holds(Protocol::new(Manners::Patient, 2, tasks).durable());
    }
}

/// M-31: a second copy of the final answer does no harm to who does not take it for the answer to something else.
#[test]
fn the_second_answer_is_harmless() {
    for tasks in [LONGER, SHORTER, EQUAL, ONE_AND_ONE, THREE, THEN_CLEAR, CLEAR_FIRST] {
        assert_holds(Protocol { second_ack: true, ..Protocol::new(Manners::Patient, 2, tasks) });
    }
}

/// M-22: of a client that sends the same sequence number each time no COUNT can be told from a late copy.
#[test]
fn numbers_are_not_needed() {
    for tasks in [EQUAL, ONE_AND_ONE] {
        for manners in [Manners::Patient, Manners::Told] {
            assert_holds(Protocol { is_counting: false, ..Protocol::new(manners, 2, tasks) });
        }
    }
}

/// Over a perfect line, however fast the client goes on: it is told what becomes of its task, in the order of its tasks.
#[test]
fn without_faults_all_answers_are_true() {
    for manners in [Manners::Patient, Manners::Told, Manners::Prompt] {
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
    for manners in [Manners::Patient, Manners::Told] {
        for tasks in [THEN_CLEAR, CLEAR_FIRST] {
            assert_holds(Protocol::new(manners, 0, tasks).durable());
        }
    }
}

/// A client that goes on as soon as it was told how a transfer ended and the line is silent.
#[test]
fn who_was_told_may_go_on() {
    for tasks in [LONGER, SHORTER, EQUAL, ONE_AND_ONE, THREE, THEN_CLEAR, CLEAR_FIRST] {
        assert_holds(Protocol::new(Manners::Told, 2, tasks));
    }
}

/// The same with storage, which may take its time, and fail.
#[cfg(feature = "storage")]
#[test]
fn who_was_told_that_it_is_stored_may_go_on() {
    for tasks in [LONGER, SHORTER, EQUAL, ONE_AND_ONE, THREE, THEN_CLEAR, CLEAR_FIRST] {
        assert_holds(Protocol::new(Manners::Told, 1, tasks).durable());
    }
}

/// Limits are what is found, in the order of the names. When one is not found any more it is gone: say so at the top.
fn assert_limits(model: Protocol, limits: &[&str]) {
    let violations = violations(model);
    let mut names: Vec<_> = violations.iter().map(|(name, _)| *name).collect();
    names.sort_unstable();
    let steps: String = violations.into_iter().map(|(_, steps)| steps).collect();
    assert_eq!(names, limits, "{steps}");
}

/// A copy of the first upload's item 0 is late, and is taken for the next upload's, which has begun meanwhile.
#[test]
fn limit_a_late_copy_of_an_item() {
    assert_limits(Protocol::new(Manners::Prompt, 1, EQUAL), &[MIXED, ACCEPTED_IS_LIVE]);
}

/// A client gives an upload up and begins another, whose COUNT is lost: what is asked for is the old one's item 0, and what
/// comes is the new one's. One item was all that the old plan had: so the new one is live, without its second.
#[test]
fn limit_another_plan_while_the_first_is_wanted() {
    assert_limits(Protocol::new(Manners::Hasty, 1, LONGER), &[CUT, MIXED, ACCEPTED_IS_LIVE]);
}
