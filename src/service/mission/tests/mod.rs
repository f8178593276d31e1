//! Tests of the engine without the stack: encoded frames in, decoded frames out, simulated time, two links.

mod collision;
mod commit;
mod delayed_duplicate;
mod download;
mod edges;
mod links;
mod model;
mod random;
mod table;
mod upload;

use std::vec::Vec;

use super::*;
use crate::dialect::{MavCmd, MavFrame, MavResult, MissionCurrent, MissionState, rules};
use crate::frame::{MAX_FRAME_LEN, Version, encode};
use crate::link::Link;
use crate::message::{Address, CommandRule, Item};
use crate::service::param::NoParams;
use crate::service::rest::{Rest, offer, sent_texts, take, with_frame};
use crate::time::Duration;
use crate::types::{Command, Context, Durability, LinkId, Outcome, Peer, StatusTexts, TextEntry, Trust};

type Memory = crate::plan_memory!(mission: 5, fence: 3, rally: 0);

const VEHICLE: Address = Address::new(1, 1);
const A: Peer = Peer { address: Address::new(255, 190), link: LinkId(0) };
const B: Peer = Peer { address: Address::new(254, 190), link: LinkId(1) };
/// A again, on the other link (M-11).
const A_MOVED: Peer = Peer { link: LinkId(1), ..A };

const MISSION: MavMissionType = MavMissionType::MISSION;
const FENCE: MavMissionType = MavMissionType::FENCE;

const ACCEPTED: MavMissionResult = MavMissionResult::ACCEPTED;
const DENIED: MavMissionResult = MavMissionResult::DENIED;
const ERROR: MavMissionResult = MavMissionResult::ERROR;
const CANCELLED: MavMissionResult = MavMissionResult::OPERATION_CANCELLED;
const UNSUPPORTED: MavMissionResult = MavMissionResult::UNSUPPORTED;

/// A frame that the engine sent, without its destination and plan type.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Out {
    Ask(u16),
    AskLegacy(u16),
    Ack(MavMissionResult, u32),
    Count(u16, u32),
    /// MISSION_ITEM_INT: sequence number, `current`, item.
    Part(u16, u8, Item),
    /// MISSION_ITEM: sequence number, x and y.
    FloatPart(u16, f32, f32),
}
use Out::*;

/// Destination, plan type and content of a sent frame.
type Sent = (Address, MavMissionType, Out);

fn to_a(out: Out) -> Sent {
    (A.address, MISSION, out)
}

fn to_b(out: Out) -> Sent {
    (B.address, MISSION, out)
}

#[derive(Clone, Debug)]
struct Vehicle {
    may_change: Result<(), MavMissionResult>,
    bad_item: Option<(u16, MavMissionResult)>,
    verdict: Result<(), MavMissionResult>,
    may_persist: bool,
    progress: Progress,
    /// The plans of all calls of `may_change`.
    asked: Vec<PlanType>,
    changes: Vec<(PlanType, Vec<Item>, u16)>,
}

impl crate::Vehicle for Vehicle {
    fn state(&self) -> Option<crate::VehicleState> {
        None
    }

    fn may_persist(&self) -> bool {
        self.may_persist
    }
}

impl Commands for Vehicle {
    fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
        MavResult::UNSUPPORTED.into()
    }
}

impl Plans for Vehicle {
    const MISSION_COMMANDS: &'static [CommandRule] = &[rules::NAV_WAYPOINT, CommandRule::any(MavCmd::DO_JUMP)];

    fn may_change(&mut self, _: &mut Context<'_>, plan: PlanType, _: Peer) -> Result<(), MavMissionResult> {
        self.asked.push(plan);
        self.may_change
    }

    fn check_item(&mut self, _: &mut Context<'_>, _: PlanType, seq: u16, _: &Item) -> Result<(), MavMissionResult> {
        match self.bad_item {
            Some((bad, result)) if bad == seq => Err(result),
            _ => Ok(()),
        }
    }

    fn check_plan(&mut self, _: &mut Context<'_>, _: PlanType, _: &[Item]) -> Result<(), PlanFault> {
        Ok(self.verdict?)
    }

    fn plan_changed(&mut self, _: &mut Context<'_>, change: PlanChange<'_>) {
        self.changes.push((change.plan, change.items.to_vec(), change.first));
    }

    fn progress(&self) -> Progress {
        self.progress
    }
}

/// The firmware of this vehicle.
struct Board;

impl Firmware for Board {
    type Vehicle = Vehicle;
    type Plans = Memory;
    type Parameters = NoParams;
    type Credits = [crate::types::Credits; 0];
}

/// The items and the id of a plan.
type OwnedPlan = (Vec<Item>, u32);

#[derive(Clone)]
struct Bench {
    missions: Missions,
    memory: Memory,
    float_form: bool,
    second_ack: bool,
    vehicle: Vehicle,
    texts: StatusTexts<[TextEntry; 8]>,
    /// What proves the senders of received frames.
    trust: Trust,
    now: Instant,
    /// The sequence number of received frames: constant, unless a test sets it.
    number: u8,
    replies: [Replies; 2],
    ports: [Port; 2],
}

impl Bench {
    fn new() -> Self {
        Self::of(false, Version::V2)
    }

    fn of(float_form: bool, version: Version) -> Self {
        Self {
            missions: Missions::INITIAL,
            memory: Memory::new(),
            float_form,
            second_ack: false,
            vehicle: Vehicle {
                may_change: Ok(()),
                bad_item: None,
                verdict: Ok(()),
                may_persist: true,
                progress: Progress { current: 0, state: MissionState::NOT_STARTED, in_mission_mode: false },
                asked: Vec::new(),
                changes: Vec::new(),
            },
            texts: StatusTexts::new(),
            trust: Trust::Open,
            now: Instant::from_millis(60_000),
            number: 0,
            replies: [const { Replies::new() }; 2],
            ports: [0, 1].map(|link| port(LinkId(link), version)),
        }
    }

    /// Receives a frame.
    fn send<M: Message>(&mut self, from: Peer, message: &M) {
        self.send_as(Version::V2, from, message);
    }

    fn send_as<M: Message>(&mut self, version: Version, from: Peer, message: &M) {
        let mut bytes = [0; MAX_FRAME_LEN];
        let len = encode(message, version, from.address, self.number, &mut bytes).expect("fits");
        with_frame(&bytes[..len], |frame| {
            assert!(is_handled(frame.id()));
            let received =
                Received { frame, from, trust: self.trust, counts: true, may_change: true, target: VEHICLE, age: None };
            self.with_link(usize::from(from.link.0), |missions, cx, port, replies| {
                missions.receive(cx, port, replies, &received);
            });
        });
    }

    /// Receives a frame. Returns everything that is sent then.
    fn ask<M: Message>(&mut self, from: Peer, message: &M) -> Vec<Sent> {
        self.send(from, message);
        self.drain()
    }

    /// Calls `act` with the engine and everything it needs.
    fn with<R>(
        &mut self,
        act: impl FnOnce(&mut Missions, &mut Cx<'_, Board>, &mut [Port; 2], &mut [Replies; 2]) -> R,
    ) -> R {
        let mut rest = Rest::new();
        rest.shared.config.float_mission_items = self.float_form;
        rest.shared.config.second_mission_ack = self.second_ack;
        let mut cx = Cx {
            now: self.now,
            shared: &mut rest.shared,
            peers: rest.peers.as_mut_view(),
            texts: &mut self.texts,
            requests: &mut rest.requests,
            events: &mut rest.events,
            plans: self.memory.view(),
            parameters: &mut NoParams,
            credits: (),
            vehicle: &mut self.vehicle,
        };
        act(&mut self.missions, &mut cx, &mut self.ports, &mut self.replies)
    }

    /// The same for one link.
    fn with_link<R>(
        &mut self,
        link: usize,
        act: impl FnOnce(&mut Missions, &mut Cx<'_, Board>, &mut Port, &mut Replies) -> R,
    ) -> R {
        self.with(|missions, cx, ports, replies| act(missions, cx, &mut ports[link], &mut replies[link]))
    }

    /// The same for an event that is not a frame, but may have an answer.
    fn with_answer(&mut self, act: impl FnOnce(&mut Missions, &mut Cx<'_, Board>) -> Option<FinalAnswer>) {
        self.with(|missions, cx, _, replies| {
            if let Some(FinalAnswer { link, reply }) = act(missions, cx) {
                replies[usize::from(link.0)].set_result(reply);
            }
        });
    }

    fn poll(&mut self) {
        self.with_answer(Missions::run_timers);
    }

    /// When the engine's next timer is due.
    fn deadline(&self) -> Instant {
        Service::<Board>::deadline(&self.missions)
    }

    /// Returns the content to write: the job number, and each plan with its id.
    fn unsaved(&mut self) -> Option<(u16, [OwnedPlan; 3])> {
        let plans = self.memory.view();
        // Whatever the pause, up to which nothing is written.
        let job = self.missions.pending_write(Instant::NEVER)?;
        Some((job, self.missions.content(&plans).map(|plan| (plan.items().to_vec(), plan.id()))))
    }

    /// Reports that storage holds the content.
    fn saved(&mut self) {
        self.with_answer(Missions::on_saved);
    }

    /// Reports that storage failed.
    fn not_saved(&mut self) {
        self.with_answer(Missions::on_save_failed);
    }

    /// Advances the time by `millis` ms in steps of 10 ms. Returns the frames that are sent meanwhile, and after how
    /// many ms.
    fn wait(&mut self, millis: u64) -> Vec<(u64, Sent)> {
        let mut sent = Vec::new();
        for step in 1..=millis / 10 {
            self.now += Duration::from_millis(10);
            self.poll();
            sent.extend(self.drain().into_iter().map(|out| (step * 10, out)));
        }
        sent
    }

    /// Returns everything that link 0 sends, then everything that link 1 sends.
    fn drain(&mut self) -> Vec<Sent> {
        (0..2).flat_map(|link| self.drain_link(link)).collect()
    }

    fn drain_link(&mut self, link: usize) -> Vec<Sent> {
        core::iter::from_fn(|| self.next(link)).collect()
    }

    /// Makes a link send the frame that is pending in a turn. Returns false if none is.
    fn offer(&mut self, link: usize, turn: Turn) -> bool {
        self.with_link(link, |missions, cx, port, replies| {
            let is_pending = Service::<Board>::pending(missions, &cx.view(), port, replies, turn).is_some();
            let is_sent = offer(missions, cx, port, replies, turn);
            assert_eq!(is_pending, is_sent, "a pending frame is sent");
            is_sent
        })
    }

    /// Returns the next frame that a link sends, except MISSION_CURRENT.
    fn next(&mut self, link: usize) -> Option<Sent> {
        if !self.offer(link, Turn::MissionAck) && !self.offer(link, Turn::MissionTransfer) {
            return None;
        }
        let tx = &mut self.ports[link].outbox;
        Some(with_frame(&take(tx), |frame| {
            let (system, component, mission_type, out) = if let Some(m) = frame.decode::<MissionRequestInt>() {
                (m.target_system, m.target_component, m.mission_type, Ask(m.seq))
            } else if let Some(m) = frame.decode::<MissionRequest>() {
                (m.target_system, m.target_component, m.mission_type, AskLegacy(m.seq))
            } else if let Some(m) = frame.decode::<MissionAck>() {
                (m.target_system, m.target_component, m.mission_type, Ack(m.r#type, m.opaque_id))
            } else if let Some(m) = frame.decode::<MissionCount>() {
                (m.target_system, m.target_component, m.mission_type, Count(m.count, m.opaque_id))
            } else if let Some(m) = frame.decode::<MissionItemInt>() {
                let part = Part(m.seq, m.current, Item::from_int(&m));
                (m.target_system, m.target_component, m.mission_type, part)
            } else if let Some(m) = frame.decode::<MissionItem>() {
                (m.target_system, m.target_component, m.mission_type, FloatPart(m.seq, m.x, m.y))
            } else {
                panic!("message {}", frame.id())
            };
            (Address::new(system, component), mission_type, out)
        }))
    }

    /// Returns the MISSION_CURRENT that a link sends next.
    fn next_current(&mut self, link: usize) -> Option<MissionCurrent> {
        let is_sent = self.offer(link, Turn::MissionProgress);
        let tx = &mut self.ports[link].outbox;
        is_sent.then(|| with_frame(&take(tx), |frame| frame.decode().expect("MISSION_CURRENT")))
    }

    /// Returns the texts that are sent.
    fn texts(&mut self) -> Vec<std::string::String> {
        sent_texts(&mut self.texts, &mut self.ports[0].outbox)
    }

    /// Returns the number of items in the staging area.
    fn staged(&mut self) -> u16 {
        self.memory.view().staged()
    }

    fn live(&self, plan: PlanType) -> (&[Item], u32) {
        let live = self.memory.live(plan);
        (live.items(), live.id())
    }

    /// Uploads a plan. Returns the final answer.
    fn upload(&mut self, from: Peer, plan: MavMissionType, items: &[Item]) -> Out {
        let mut out = self.ask(from, &count(plan, items.len()));
        for (seq, item) in items.iter().enumerate() {
            assert_eq!(out, [(from.address, plan, Ask(seq as u16))]);
            out = self.ask(from, &int(plan, seq, item));
        }
        match out[..] {
            [(to, mission_type, ack)] if (to, mission_type) == (from.address, plan) => ack,
            _ => panic!("{out:?}"),
        }
    }
}

fn port(link: LinkId, version: Version) -> Port {
    let mut port = Link::VACANT.port;
    port.id = link;
    port.outbox.configure(link, VEHICLE, version);
    port
}

fn both_links() -> LinkMask {
    LinkMask::of(LinkId(0)).with(LinkMask::of(LinkId(1)))
}

/// An item that is unique for its `tag` and `seq`.
fn item(tag: u16, seq: u16) -> Item {
    Item {
        frame: MavFrame::GLOBAL_RELATIVE_ALT,
        command: MavCmd::NAV_WAYPOINT,
        autocontinue: 1,
        params: [tag.into(), 0.0, 0.0, f32::NAN],
        x: 473_977_432 + i32::from(seq),
        y: 85_455_942,
        z: 20.0,
    }
}

fn plan(tag: u16, len: u16) -> Vec<Item> {
    (0..len).map(|seq| item(tag, seq)).collect()
}

/// Circles that are unique for their `tag` and position.
fn fence(tag: u16, len: u16) -> Vec<Item> {
    plan(tag, len).into_iter().map(|item| Item { command: MavCmd::NAV_FENCE_CIRCLE_EXCLUSION, ..item }).collect()
}

/// The id of a plan (M-5), computed by a library.
fn id_of(items: &[Item]) -> u32 {
    let mut crc = crc_any::CRCu32::crc32();
    items.iter().for_each(|item| crc.digest(&item.to_bytes()));
    if items.is_empty() { 0 } else { crc.get_crc().max(1) }
}

fn count(mission_type: MavMissionType, count: usize) -> MissionCount {
    MissionCount { count: count as u16, target_system: 1, target_component: 1, mission_type, opaque_id: 0 }
}

fn int(mission_type: MavMissionType, seq: usize, item: &Item) -> MissionItemInt {
    item.to_int(VEHICLE, mission_type, seq as u16, false)
}

fn ack(mission_type: MavMissionType, result: MavMissionResult) -> MissionAck {
    MissionAck { r#type: result, mission_type, ..Default::default() }
}

fn clear(mission_type: MavMissionType) -> MissionClearAll {
    MissionClearAll { mission_type, ..Default::default() }
}

fn list(mission_type: MavMissionType) -> MissionRequestList {
    MissionRequestList { mission_type, ..Default::default() }
}

fn request(mission_type: MavMissionType, seq: u16) -> MissionRequestInt {
    MissionRequestInt { seq, mission_type, ..Default::default() }
}

/// Receives a frame with this sequence number. Returns everything that is sent then.
fn ask_numbered<M: Message>(bench: &mut Bench, number: u8, from: Peer, message: &M) -> Vec<Sent> {
    bench.number = number;
    bench.ask(from, message)
}

/// Returns the live mission and its id.
fn seen(bench: &Bench) -> (Vec<Item>, u32) {
    let (items, id) = bench.live(PlanType::Mission);
    (items.to_vec(), id)
}
