//! Downloads.

use super::items::{from_float_message, from_message};
use super::{Timing, ack_of, refused, send_ack, target};
use crate::failure::plan_name;
use crate::{Client, Dialogue, Due, Failure, Io, Received, Retry};
use mavstack::dialect::{
    MavMissionResult, MissionCount, MissionItem, MissionItemInt, MissionRequest, MissionRequestInt, MissionRequestList,
};
use mavstack::{Duration, Instant, Item, PlanType};
use std::collections::BTreeMap;

/// The number of items that MAVProxy asks for at a time.
const MAVPROXY_BATCH: u16 = 5;
/// When MAVProxy asks for an item again.
const MAVPROXY_AGAIN: Duration = Duration::from_secs(2);
/// How long without an item MAVProxy, which never gives up, is waited for.
const MAVPROXY_NO_PROGRESS: Duration = Duration::from_secs(20);

/// A plan that was downloaded.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Plan {
    /// Its items, in order.
    pub items: Vec<Item>,
    /// The vehicle's id of it (`opaque_id`); 0 if there is none.
    pub id: u32,
}

/// Downloads a plan.
#[derive(Clone, Debug)]
pub struct Download {
    plan: PlanType,
    retry: Option<Retry>,
    count: Option<u16>,
    id: u32,
    items: BTreeMap<u16, Item>,
    /// When MAVProxy asked for each item.
    asked: BTreeMap<u16, Instant>,
    end: Option<Result<(), Failure>>,
}

impl Download {
    /// Creates the dialogue.
    pub fn new(plan: PlanType) -> Self {
        Self { plan, retry: None, count: None, id: 0, items: BTreeMap::new(), asked: BTreeMap::new(), end: None }
    }

    fn item_timer(client: Client) -> Retry {
        match client {
            Client::QGroundControl => Retry::new(Duration::from_millis(250), 7),
            Client::Mavsdk => Retry::new(Duration::from_millis(500), 5),
            Client::MavProxy => Retry::new(MAVPROXY_NO_PROGRESS, 1),
            Client::Pymavlink => Retry::new(client.patience(), 1),
        }
    }

    fn request_list(&self, io: &mut Io<'_>) {
        let (target_system, target_component) = target(io);
        io.send(&MissionRequestList { target_system, target_component, mission_type: self.plan.mission_type() });
    }

    /// Returns the first item that is missing.
    fn next(&self) -> Option<u16> {
        (0..self.count?).find(|seq| !self.items.contains_key(seq))
    }

    fn request_item(&self, io: &mut Io<'_>, seq: u16) {
        let (target_system, target_component) = target(io);
        let mission_type = self.plan.mission_type();
        match io.client() {
            Client::Pymavlink => io.send(&MissionRequest { seq, target_system, target_component, mission_type }),
            _ => io.send(&MissionRequestInt { seq, target_system, target_component, mission_type }),
        }
    }

    /// Asks for the next items that MAVProxy has not asked for lately.
    fn request_batch(&mut self, io: &mut Io<'_>) {
        let Some((next, count)) = self.next().zip(self.count) else { return };
        for seq in next..count.min(next.saturating_add(MAVPROXY_BATCH)) {
            let is_pending = self.asked.get(&seq).is_some_and(|&at| io.now() - at < MAVPROXY_AGAIN);
            if !is_pending && !self.items.contains_key(&seq) {
                self.asked.insert(seq, io.now());
                self.request_item(io, seq);
            }
        }
    }

    fn take_count(&mut self, io: &mut Io<'_>, count: &MissionCount) {
        (self.count, self.id) = (Some(count.count), count.opaque_id);
        self.retry = Some(Self::item_timer(io.client()));
    }

    fn take_item(&mut self, io: &mut Io<'_>, seq: u16, item: Item) {
        // All but MAVProxy ask one by one, and drop what they did not ask for.
        let is_expected = match io.client() {
            Client::MavProxy => self.count.is_some_and(|count| seq < count),
            _ => self.next() == Some(seq),
        };
        if is_expected && self.items.insert(seq, item).is_none() {
            self.retry = Some(Self::item_timer(io.client()));
        }
    }

    /// Asks for the list until it is answered. Returns the failure if it is not.
    fn poll_list(&mut self, io: &mut Io<'_>) -> Option<Failure> {
        let timing = Timing::of(io.client());
        let retry = self.retry.get_or_insert(Retry::new(timing.wait, timing.tries));
        let (due, tries) = (retry.due(io.now()), retry.tries());
        if due == Due::Send {
            self.request_list(io);
        }
        let request = || format!("MISSION_REQUEST_LIST of the {}", plan_name(self.plan));
        (due == Due::GiveUp).then(|| Failure::timeout(request(), tries))
    }

    /// Asks for the next item, or several. Returns the failure if it does not come.
    fn poll_item(&mut self, io: &mut Io<'_>, next: u16) -> Option<Failure> {
        let retry = self.retry.as_mut()?;
        let (due, tries) = (retry.due(io.now()), retry.tries());
        match due {
            Due::GiveUp => {
                let request = format!("the request of item {next} of the {}", plan_name(self.plan));
                return Some(Failure::timeout(request, tries));
            }
            _ if io.client() == Client::MavProxy => self.request_batch(io),
            Due::Send => self.request_item(io, next),
            Due::Wait => {}
        }
        None
    }

    fn finish(&mut self, io: &mut Io<'_>) -> Plan {
        if matches!(io.client(), Client::QGroundControl | Client::Mavsdk) {
            send_ack(io, self.plan, MavMissionResult::ACCEPTED);
        }
        Plan { items: std::mem::take(&mut self.items).into_values().collect(), id: self.id }
    }

    fn item_of(&self, frame: &Received) -> Option<(u16, Item)> {
        let mission_type = self.plan.mission_type();
        if let Some(message) = frame.decode::<MissionItemInt>() {
            return (message.mission_type == mission_type).then(|| (message.seq, from_message(&message)));
        }
        let message = frame.decode::<MissionItem>()?;
        (message.mission_type == mission_type).then(|| (message.seq, from_float_message(&message)))
    }
}

impl Dialogue for Download {
    type Output = Plan;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Plan, Failure>> {
        if let Some(Err(failure)) = self.end.take() {
            return Some(Err(failure));
        }
        match (self.count, self.next()) {
            (None, _) => self.poll_list(io).map(Err),
            (Some(_), Some(next)) => self.poll_item(io, next).map(Err),
            (Some(_), None) => Some(Ok(self.finish(io))),
        }
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        if self.retry.is_none() || frame.source() != io.target() {
            return;
        }
        if let Some(count) = frame.decode::<MissionCount>()
            && count.mission_type == self.plan.mission_type()
        {
            // QGroundControl ignores a COUNT that it does not wait for. MAVSDK and MAVProxy begin again.
            if self.count.is_none() || matches!(io.client(), Client::Mavsdk | Client::MavProxy) {
                self.items.clear();
                self.asked.clear();
                self.take_count(io, &count);
            }
        } else if let Some((seq, item)) = self.item_of(frame) {
            self.take_item(io, seq, item);
        } else if let Some(ack) = ack_of(io, frame, self.plan)
            && ack.r#type != MavMissionResult::ACCEPTED
            // MAVSDK ignores it, and runs into its timeout.
            && io.client() != Client::Mavsdk
        {
            self.end = Some(Err(refused(self.plan, None, ack.r#type)));
        }
    }
}
