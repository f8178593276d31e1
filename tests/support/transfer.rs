//! Plan transfers as a client does them: MAVSDK's rules, of its `MavlinkMissionTransferClient`.
//!
//! Upload: COUNT, then an ITEM_INT for each REQUEST_INT, until the ACK. COUNT is repeated after half a second; an item is
//! only sent when it is asked for, and not for ever; a request for a later one than is due is ignored. Download: LIST,
//! then a REQUEST_INT for each item, repeated after half a second, in the end an ACK. Everything five times at most,
//! unless the test has more patience.
//!
//! Or an upload as QGroundControl does it, in its `PlanManager`: COUNT up to seven times, a second and a half apart; any
//! item as often as it is asked for; but a second and a half without a request for the next one, or without the ACK, and
//! it gives up (M-42).
//!
//! Or an upload as dronekit does it: COUNT once, then a MISSION_ITEM for each MISSION_REQUEST, without a timeout; it does
//! not know MISSION_REQUEST_INT. MAVSDK answers MISSION_REQUEST with UNSUPPORTED, and QGroundControl ignores it (M-47).

use super::Gcs;
use mavstack::dialect::{
    MavCmd, MavFrame, MavMissionResult, MavMissionType, MissionAck, MissionClearAll, MissionCount, MissionItem,
    MissionItemInt, MissionRequest, MissionRequestInt, MissionRequestList,
};
use mavstack::{Address, Duration, Instant, Message};

/// How a transfer failed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TransferError {
    /// The vehicle said so.
    Refused(MavMissionResult),
    /// The vehicle said too little.
    Timeout,
}

/// What the transfers share: who talks to whom, what was heard so far, when to repeat.
#[derive(Clone, Debug)]
struct Session {
    from: Address,
    vehicle: Address,
    plan: MavMissionType,
    /// Frames of [`Gcs::received`] that were looked at.
    seen: usize,
    timeout: Duration,
    /// How often something is sent, or waited for, before the client gives up.
    patience: u32,
    tries: u32,
    /// What was sent more than once.
    repeats: u32,
    due: Option<Instant>,
}

impl Session {
    fn new(gcs: &Gcs, plan: MavMissionType) -> Self {
        Self {
            from: gcs.address,
            vehicle: gcs.vehicle,
            plan,
            seen: gcs.received.len(),
            timeout: Duration::from_millis(500),
            patience: 5,
            tries: 0,
            repeats: 0,
            due: None,
        }
    }

    /// The next frame from the vehicle, as its place in [`Gcs::received`].
    fn next_frame(&mut self, gcs: &Gcs) -> Option<usize> {
        while self.seen < gcs.received.len() {
            self.seen += 1;
            if gcs.received[self.seen - 1].header.source == self.vehicle {
                return Some(self.seen - 1);
            }
        }
        None
    }

    fn is_for_us(&self, system: u8, component: u8) -> bool {
        Address::new(system, component) == self.from
    }

    fn refresh(&mut self, now: Instant) {
        self.due = Some(now.after(self.timeout));
    }

    /// Whether it is time to send again; the first call is.
    fn is_due(&mut self, now: Instant) -> bool {
        let due = self.due.is_none_or(|due| now >= due);
        if due {
            self.refresh(now);
        }
        due
    }
}

/// An upload in progress. Make it, [`poll`](Self::poll) it after every step.
#[derive(Clone, Debug)]
pub struct Upload {
    session: Session,
    items: Vec<MissionItemInt>,
    next: usize,
    is_asked: bool,
    is_qgroundcontrol: bool,
    is_dronekit: bool,
    result: Option<Result<MissionAck, TransferError>>,
}

impl Upload {
    /// From the ground station's own address to the vehicle it talks to; the plan is the items' own type.
    pub fn new(gcs: &Gcs, items: &[MissionItemInt]) -> Self {
        let plan = items.first().map_or(MavMissionType::MISSION, |item| item.mission_type);
        Self {
            session: Session::new(gcs, plan),
            items: items.to_vec(),
            next: 0,
            is_asked: false,
            is_qgroundcontrol: false,
            is_dronekit: false,
            result: None,
        }
    }

    /// The same, as QGroundControl does it.
    #[must_use]
    pub fn like_qgroundcontrol(mut self) -> Self {
        self.is_qgroundcontrol = true;
        self.session.timeout = Duration::from_millis(1_500);
        self.session.patience = 7;
        self
    }

    /// Uploads as dronekit does.
    #[must_use]
    pub fn like_dronekit(mut self) -> Self {
        self.is_dronekit = true;
        self.session.timeout = Duration::from_secs(60);
        self.session.patience = 1;
        self
    }

    /// The same from another address.
    #[must_use]
    pub fn by(mut self, from: Address) -> Self {
        self.session.from = from;
        self
    }

    /// The same, that tries everything so often, and not five times.
    #[must_use]
    pub fn with_patience(mut self, patience: u32) -> Self {
        self.session.patience = patience;
        self
    }

    /// How it ended; `None` while it goes on.
    pub fn result(&self) -> Option<Result<MissionAck, TransferError>> {
        self.result
    }

    /// When it does something though nothing comes.
    pub fn due(&self) -> Instant {
        self.session.due.unwrap_or(Instant::ZERO)
    }

    /// What it sent again, because no answer came or because it was asked to.
    pub fn repeats(&self) -> u32 {
        self.session.repeats
    }

    /// Items that were sent, each counted once.
    pub fn items_sent(&self) -> usize {
        self.next
    }

    /// Takes in what came and sends what is due.
    pub fn poll(&mut self, now: Instant, gcs: &mut Gcs) -> Option<Result<MissionAck, TransferError>> {
        while self.result.is_none()
            && let Some(index) = self.session.next_frame(gcs)
        {
            let frame = gcs.received[index].clone();
            if let Some(request) = frame.decode::<MissionRequestInt>()
                && self.session.is_for_us(request.target_system, request.target_component)
                && request.mission_type == self.session.plan
            {
                if !self.is_dronekit {
                    self.on_request(now, usize::from(request.seq), gcs);
                }
            } else if let Some(request) = frame.decode::<MissionRequest>()
                && self.session.is_for_us(request.target_system, request.target_component)
                && request.mission_type == self.session.plan
            {
                self.on_old_request(now, usize::from(request.seq), gcs);
            } else if let Some(ack) = frame.decode::<MissionAck>()
                && self.session.is_for_us(ack.target_system, ack.target_component)
                && ack.mission_type == self.session.plan
            {
                let is_complete = self.next == self.items.len();
                self.result = Some(match ack.r#type {
                    MavMissionResult::ACCEPTED if is_complete => Ok(ack),
                    result => Err(TransferError::Refused(result)),
                });
            }
        }
        if self.result.is_none() && self.session.is_due(now) {
            let gives_up = self.is_qgroundcontrol && self.is_asked;
            if gives_up || self.session.tries >= self.session.patience {
                self.result = Some(Err(TransferError::Timeout));
            } else {
                self.session.tries += 1;
                if !self.is_asked {
                    self.session.repeats += u32::from(self.session.tries > 1);
                    let count = MissionCount {
                        target_system: self.session.vehicle.system.0,
                        target_component: self.session.vehicle.component.0,
                        count: self.items.len() as u16,
                        mission_type: self.session.plan,
                        opaque_id: 0,
                    };
                    gcs.send_from(self.session.from, &count);
                }
            }
        }
        self.result
    }

    fn on_old_request(&mut self, now: Instant, seq: usize, gcs: &mut Gcs) {
        let Address { system, component } = self.session.vehicle;
        let (target_system, target_component) = (system.0, component.0);
        let mission_type = self.session.plan;
        if self.is_dronekit {
            let Some(item) = self.items.get(seq) else { return };
            self.next = self.next.max(seq + 1);
            self.session.refresh(now);
            let degrees = |scaled: i32| (f64::from(scaled) / 1e7) as f32;
            let MissionItemInt { frame, command, current, autocontinue, param1, param2, param3, param4, z, .. } = *item;
            let (seq, x, y) = (seq as u16, degrees(item.x), degrees(item.y));
            gcs.send_from(
                self.session.from,
                &MissionItem {
                    target_system,
                    target_component,
                    seq,
                    frame,
                    command,
                    current,
                    autocontinue,
                    param1,
                    param2,
                    param3,
                    param4,
                    x,
                    y,
                    z,
                    mission_type,
                },
            );
        } else if !self.is_qgroundcontrol {
            let r#type = MavMissionResult::UNSUPPORTED;
            let nack = MissionAck { target_system, target_component, r#type, mission_type, opaque_id: 0 };
            gcs.send_from(self.session.from, &nack);
        }
    }

    fn on_request(&mut self, now: Instant, seq: usize, gcs: &mut Gcs) {
        self.is_asked = true;
        let Some(item) = self.items.get(seq) else { return };
        if self.is_qgroundcontrol {
            assert!(seq <= self.next, "the vehicle asks in order");
        } else if seq > self.next {
            return;
        } else if seq == self.next {
            self.session.tries = 0;
        } else if self.session.tries >= self.session.patience {
            self.result = Some(Err(TransferError::Timeout));
            return;
        }
        self.session.refresh(now);
        self.session.tries += 1;
        self.session.repeats += u32::from(seq < self.next);
        self.next = if self.is_qgroundcontrol { self.next.max(seq + 1) } else { seq + 1 };
        let item = MissionItemInt {
            target_system: self.session.vehicle.system.0,
            target_component: self.session.vehicle.component.0,
            seq: seq as u16,
            ..*item
        };
        gcs.send_from(self.session.from, &item);
    }
}

/// A download in progress. Make it, [`poll`](Self::poll) it after every step.
#[derive(Clone, Debug)]
pub struct Download {
    session: Session,
    count: Option<u16>,
    items: Vec<MissionItemInt>,
    result: Option<Result<Vec<MissionItemInt>, TransferError>>,
}

impl Download {
    /// By the ground station's own address from the vehicle it talks to.
    pub fn new(gcs: &Gcs, plan: MavMissionType) -> Self {
        Self { session: Session::new(gcs, plan), count: None, items: Vec::new(), result: None }
    }

    /// The same by another address.
    #[must_use]
    pub fn by(mut self, from: Address) -> Self {
        self.session.from = from;
        self
    }

    /// The same, that tries everything so often, and not five times.
    #[must_use]
    pub fn with_patience(mut self, patience: u32) -> Self {
        self.session.patience = patience;
        self
    }

    /// How it ended; `None` while it goes on.
    pub fn result(&self) -> Option<Result<Vec<MissionItemInt>, TransferError>> {
        self.result.clone()
    }

    /// When it does something though nothing comes.
    pub fn due(&self) -> Instant {
        self.session.due.unwrap_or(Instant::ZERO)
    }

    /// What it sent again, because no answer came.
    pub fn repeats(&self) -> u32 {
        self.session.repeats
    }

    /// Takes in what came and sends what is due. Unlike MAVSDK it heeds a refusal, as QGroundControl does.
    pub fn poll(&mut self, now: Instant, gcs: &mut Gcs) -> Option<Result<Vec<MissionItemInt>, TransferError>> {
        while self.result.is_none()
            && let Some(index) = self.session.next_frame(gcs)
        {
            let frame = gcs.received[index].clone();
            if let Some(count) = frame.decode::<MissionCount>()
                && self.session.is_for_us(count.target_system, count.target_component)
                && count.mission_type == self.session.plan
                && self.count.is_none()
            {
                self.count = Some(count.count);
                self.go_on(now, gcs);
            } else if let Some(item) = frame.decode::<MissionItemInt>()
                && self.session.is_for_us(item.target_system, item.target_component)
                && item.mission_type == self.session.plan
                && usize::from(item.seq) == self.items.len()
                && self.count.is_some()
            {
                self.items.push(item);
                self.go_on(now, gcs);
            } else if let Some(ack) = frame.decode::<MissionAck>()
                && self.session.is_for_us(ack.target_system, ack.target_component)
                && ack.mission_type == self.session.plan
                && ack.r#type != MavMissionResult::ACCEPTED
            {
                self.result = Some(Err(TransferError::Refused(ack.r#type)));
            }
        }
        if self.result.is_none() && self.session.is_due(now) {
            if self.session.tries >= self.session.patience {
                self.result = Some(Err(TransferError::Timeout));
            } else {
                self.ask(gcs);
            }
        }
        self.result.clone()
    }

    /// Something new came: asks for the next item at once, or ends.
    fn go_on(&mut self, now: Instant, gcs: &mut Gcs) {
        self.session.tries = 0;
        self.session.refresh(now);
        if self.count.is_some_and(|count| self.items.len() < usize::from(count)) {
            self.ask(gcs);
            return;
        }
        let ack = MissionAck {
            target_system: self.session.vehicle.system.0,
            target_component: self.session.vehicle.component.0,
            r#type: MavMissionResult::ACCEPTED,
            mission_type: self.session.plan,
            opaque_id: 0,
        };
        gcs.send_from(self.session.from, &ack);
        self.result = Some(Ok(std::mem::take(&mut self.items)));
    }

    fn ask(&mut self, gcs: &mut Gcs) {
        self.session.tries += 1;
        self.session.repeats += u32::from(self.session.tries > 1);
        let Address { system, component } = self.session.vehicle;
        let (target_system, target_component) = (system.0, component.0);
        let mission_type = self.session.plan;
        if self.count.is_none() {
            let list = MissionRequestList { target_system, target_component, mission_type };
            gcs.send_from(self.session.from, &list);
        } else {
            let seq = self.items.len() as u16;
            let request = MissionRequestInt { target_system, target_component, seq, mission_type };
            gcs.send_from(self.session.from, &request);
        }
    }
}

/// A plan being cleared. Make it, [`poll`](Self::poll) it after every step.
#[derive(Clone, Debug)]
pub struct Clear {
    session: Session,
    result: Option<Result<MissionAck, TransferError>>,
}

impl Clear {
    /// By the ground station's own address at the vehicle it talks to.
    pub fn new(gcs: &Gcs, plan: MavMissionType) -> Self {
        Self { session: Session::new(gcs, plan), result: None }
    }

    /// How it ended; `None` while it goes on.
    pub fn result(&self) -> Option<Result<MissionAck, TransferError>> {
        self.result
    }

    /// Takes in what came and sends what is due.
    pub fn poll(&mut self, now: Instant, gcs: &mut Gcs) -> Option<Result<MissionAck, TransferError>> {
        while self.result.is_none()
            && let Some(index) = self.session.next_frame(gcs)
        {
            if let Some(ack) = gcs.received[index].decode::<MissionAck>()
                && self.session.is_for_us(ack.target_system, ack.target_component)
                && ack.mission_type == self.session.plan
            {
                self.result = Some(match ack.r#type {
                    MavMissionResult::ACCEPTED => Ok(ack),
                    result => Err(TransferError::Refused(result)),
                });
            }
        }
        if self.result.is_none() && self.session.is_due(now) {
            if self.session.tries >= self.session.patience {
                self.result = Some(Err(TransferError::Timeout));
            } else {
                self.session.tries += 1;
                let clear = MissionClearAll {
                    target_system: self.session.vehicle.system.0,
                    target_component: self.session.vehicle.component.0,
                    mission_type: self.session.plan,
                };
                gcs.send_from(self.session.from, &clear);
            }
        }
        self.result
    }
}

/// A mission of `len` waypoints, no two alike; `variant` makes another one of the same length.
pub fn plan(len: u16, variant: u16) -> Vec<MissionItemInt> {
    let waypoint = |seq: u16| MissionItemInt {
        seq,
        frame: MavFrame::GLOBAL_RELATIVE_ALT,
        command: if seq == 0 { MavCmd::NAV_TAKEOFF } else { MavCmd::NAV_WAYPOINT },
        current: u8::from(seq == 0),
        autocontinue: 1,
        param1: f32::from(seq) * 0.5,
        param2: f32::from(variant),
        param4: f32::NAN,
        x: 473_977_418 + i32::from(seq) * 1_001 + i32::from(variant),
        y: 85_455_939 - i32::from(seq) * 997,
        z: 10.0 + f32::from(seq),
        mission_type: MavMissionType::MISSION,
        ..MissionItemInt::default()
    };
    (0..len).map(waypoint).collect()
}
