//! Plan transfers as real clients do them.
//!
//! By default, transfers follow MAVSDK's `MavlinkMissionTransferClient`:
//!
//! - Upload: sends COUNT, then an ITEM_INT for each REQUEST_INT, until the ACK. COUNT is repeated after 0.5 s. An item is sent only
//!   on request, and a limited number of times. A request beyond the next item is ignored.
//! - Download: sends LIST, then a REQUEST_INT for each item, and an ACK at the end. Requests are repeated after 0.5 s.
//! - Every message is sent at most five times, unless the test sets another limit.
//! - MISSION_REQUEST is answered with UNSUPPORTED (M-47).
//!
//! An upload like QGroundControl's `PlanManager` sends COUNT up to seven times, 1.5 s apart. It answers every request for an item.
//! It aborts after 1.5 s without a request for the next item or the ACK (M-42). It ignores MISSION_REQUEST (M-47).
//!
//! An upload like dronekit 2.9 sends COUNT once, then a MISSION_ITEM for each MISSION_REQUEST, without a timeout. It does not know
//! MISSION_REQUEST_INT.
//!
//! An upload like mavez 3.10 does the same with MISSION_ITEM_INT. It aborts after 5 s without a MISSION_REQUEST or the ACK.

use super::Gcs;
use mavstack::dialect::{
    MavCmd, MavFrame, MavMissionResult, MavMissionType, MissionAck, MissionClearAll, MissionCount, MissionItem,
    MissionItemInt, MissionRequest, MissionRequestInt, MissionRequestList,
};
use mavstack::{Address, Duration, Instant};

/// Why a transfer failed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TransferError {
    /// The vehicle refused it.
    Refused(MavMissionResult),
    /// The vehicle did not answer in time.
    Timeout,
}

/// The common state of transfers: the addresses, the frames seen so far, and the time of the next retry.
#[derive(Clone, Debug)]
struct Session {
    from: Address,
    vehicle: Address,
    plan: MavMissionType,
    /// The number of frames of [`Gcs::received`] that were processed.
    seen: usize,
    timeout: Duration,
    /// Maximum number of tries before the client aborts.
    patience: u32,
    tries: u32,
    /// The number of repeated messages.
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

    /// Returns the next frame from the vehicle, as an index in [`Gcs::received`].
    fn next_frame(&mut self, gcs: &Gcs) -> Option<usize> {
        while self.seen < gcs.received.len() {
            self.seen += 1;
            if gcs.received[self.seen - 1].header.source == self.vehicle {
                return Some(self.seen - 1);
            }
        }
        None
    }

    fn is_for_us(&self, system: u8, component: u8, plan: MavMissionType) -> bool {
        Address::new(system, component) == self.from && plan == self.plan
    }

    fn refresh(&mut self, now: Instant) {
        self.due = Some(now + self.timeout);
    }

    /// Whether it is time to send; true on the first call.
    fn is_due(&mut self, now: Instant) -> bool {
        let due = self.due.is_none_or(|due| now >= due);
        if due {
            self.refresh(now);
        }
        due
    }
}

/// An upload in progress. Call [`poll`](Self::poll) after every step.
#[derive(Clone, Debug)]
pub struct Upload {
    session: Session,
    items: Vec<MissionItemInt>,
    next: usize,
    is_asked: bool,
    is_qgroundcontrol: bool,
    /// It knows only MISSION_REQUEST.
    is_old: bool,
    /// It sends MISSION_ITEM.
    sends_floats: bool,
    result: Option<Result<MissionAck, TransferError>>,
}

impl Upload {
    /// Creates an upload from the ground station to its vehicle. The type of the plan is the items' type.
    pub fn new(gcs: &Gcs, items: &[MissionItemInt]) -> Self {
        let plan = items.first().map_or(MavMissionType::MISSION, |item| item.mission_type);
        Self {
            session: Session::new(gcs, plan),
            items: items.to_vec(),
            next: 0,
            is_asked: false,
            is_qgroundcontrol: false,
            is_old: false,
            sends_floats: false,
            result: None,
        }
    }

    /// Uploads like QGroundControl.
    #[must_use]
    pub fn like_qgroundcontrol(mut self) -> Self {
        self.is_qgroundcontrol = true;
        self.session.timeout = Duration::from_millis(1_500);
        self.session.patience = 7;
        self
    }

    /// Uploads like dronekit.
    #[must_use]
    pub fn like_dronekit(mut self) -> Self {
        self.is_old = true;
        self.sends_floats = true;
        self.session.timeout = Duration::from_secs(60);
        self.session.patience = 1;
        self
    }

    /// Uploads like mavez.
    #[must_use]
    pub fn like_mavez(mut self) -> Self {
        self.is_old = true;
        self.session.timeout = Duration::from_secs(5);
        self.session.patience = 1;
        self
    }

    /// Returns the result; `None` while the transfer is in progress.
    pub fn result(&self) -> Option<Result<MissionAck, TransferError>> {
        self.result
    }

    /// Returns the vehicle's final answer.
    pub fn answer(&self) -> MavMissionResult {
        match self.result {
            Some(Ok(ack)) => ack.r#type,
            Some(Err(TransferError::Refused(result))) => result,
            other => panic!("{other:?}"),
        }
    }

    /// Returns the number of repeated messages, by timeout or on request.
    pub fn repeats(&self) -> u32 {
        self.session.repeats
    }

    /// Returns the number of items sent, without repetitions.
    pub fn items_sent(&self) -> usize {
        self.next
    }

    /// Processes received frames and sends what is due.
    pub fn poll(&mut self, now: Instant, gcs: &mut Gcs) -> Option<Result<MissionAck, TransferError>> {
        while self.result.is_none()
            && let Some(index) = self.session.next_frame(gcs)
        {
            let frame = gcs.received[index].clone();
            if let Some(request) = frame.decode::<MissionRequestInt>()
                && self.session.is_for_us(request.target_system, request.target_component, request.mission_type)
            {
                if !self.is_old {
                    self.on_request(now, usize::from(request.seq), gcs);
                }
            } else if let Some(request) = frame.decode::<MissionRequest>()
                && self.session.is_for_us(request.target_system, request.target_component, request.mission_type)
            {
                self.on_old_request(now, usize::from(request.seq), gcs);
            } else if let Some(ack) = frame.decode::<MissionAck>()
                && self.session.is_for_us(ack.target_system, ack.target_component, ack.mission_type)
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
                        target_system: self.session.vehicle.system.wire(),
                        target_component: self.session.vehicle.component.wire(),
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
        let (target_system, target_component) = (system.wire(), component.wire());
        let mission_type = self.session.plan;
        if self.is_old {
            let Some(item) = self.items.get(seq) else { return };
            self.next = self.next.max(seq + 1);
            self.session.refresh(now);
            if !self.sends_floats {
                let item = MissionItemInt { target_system, target_component, seq: seq as u16, ..*item };
                return gcs.send_from(self.session.from, &item);
            }
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
            target_system: self.session.vehicle.system.wire(),
            target_component: self.session.vehicle.component.wire(),
            seq: seq as u16,
            ..*item
        };
        gcs.send_from(self.session.from, &item);
    }
}

/// A download in progress. Call [`poll`](Self::poll) after every step.
#[derive(Clone, Debug)]
pub struct Download {
    session: Session,
    count: Option<u16>,
    items: Vec<MissionItemInt>,
    result: Option<Result<Vec<MissionItemInt>, TransferError>>,
}

impl Download {
    /// Creates a download from the ground station's vehicle.
    pub fn new(gcs: &Gcs, plan: MavMissionType) -> Self {
        Self { session: Session::new(gcs, plan), count: None, items: Vec::new(), result: None }
    }

    /// Returns the result; `None` while the transfer is in progress.
    pub fn result(&self) -> Option<Result<Vec<MissionItemInt>, TransferError>> {
        self.result.clone()
    }

    /// Returns the number of repeated messages.
    pub fn repeats(&self) -> u32 {
        self.session.repeats
    }

    /// Processes received frames and sends what is due. A refusal ends the download, as in QGroundControl and unlike MAVSDK.
    pub fn poll(&mut self, now: Instant, gcs: &mut Gcs) -> Option<Result<Vec<MissionItemInt>, TransferError>> {
        while self.result.is_none()
            && let Some(index) = self.session.next_frame(gcs)
        {
            let frame = gcs.received[index].clone();
            if let Some(count) = frame.decode::<MissionCount>()
                && self.session.is_for_us(count.target_system, count.target_component, count.mission_type)
                && self.count.is_none()
            {
                self.count = Some(count.count);
                self.go_on(now, gcs);
            } else if let Some(item) = frame.decode::<MissionItemInt>()
                && self.session.is_for_us(item.target_system, item.target_component, item.mission_type)
                && usize::from(item.seq) == self.items.len()
                && self.count.is_some()
            {
                self.items.push(item);
                self.go_on(now, gcs);
            } else if let Some(ack) = frame.decode::<MissionAck>()
                && self.session.is_for_us(ack.target_system, ack.target_component, ack.mission_type)
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

    /// Requests the next item, or ends the download.
    fn go_on(&mut self, now: Instant, gcs: &mut Gcs) {
        self.session.tries = 0;
        self.session.refresh(now);
        if self.count.is_some_and(|count| self.items.len() < usize::from(count)) {
            self.ask(gcs);
            return;
        }
        let ack = MissionAck {
            target_system: self.session.vehicle.system.wire(),
            target_component: self.session.vehicle.component.wire(),
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
        let (target_system, target_component) = (system.wire(), component.wire());
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

macro_rules! options {
    ($Transfer:ty) => {
        impl $Transfer {
            /// Uses another source address.
            #[must_use]
            pub fn by(mut self, from: Address) -> Self {
                self.session.from = from;
                self
            }

            /// Sets the maximum number of tries, instead of five.
            #[must_use]
            pub fn with_patience(mut self, patience: u32) -> Self {
                self.session.patience = patience;
                self
            }

            /// Returns the time of the next retry or timeout.
            pub fn due(&self) -> Instant {
                self.session.due.unwrap_or(Instant::ZERO)
            }
        }
    };
}
options!(Upload);
options!(Download);

/// A clear in progress. Call [`poll`](Self::poll) after every step.
#[derive(Clone, Debug)]
pub struct Clear {
    session: Session,
    result: Option<Result<MissionAck, TransferError>>,
}

impl Clear {
    /// Creates a clear of a plan of the ground station's vehicle.
    pub fn new(gcs: &Gcs, plan: MavMissionType) -> Self {
        Self { session: Session::new(gcs, plan), result: None }
    }

    /// Returns the result; `None` while the transfer is in progress.
    pub fn result(&self) -> Option<Result<MissionAck, TransferError>> {
        self.result
    }

    /// Processes received frames and sends what is due.
    pub fn poll(&mut self, now: Instant, gcs: &mut Gcs) -> Option<Result<MissionAck, TransferError>> {
        while self.result.is_none()
            && let Some(index) = self.session.next_frame(gcs)
        {
            if let Some(ack) = gcs.received[index].decode::<MissionAck>()
                && self.session.is_for_us(ack.target_system, ack.target_component, ack.mission_type)
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
                    target_system: self.session.vehicle.system.wire(),
                    target_component: self.session.vehicle.component.wire(),
                    mission_type: self.session.plan,
                };
                gcs.send_from(self.session.from, &clear);
            }
        }
        self.result
    }
}

/// Returns a mission of `len` different waypoints. Another `variant` gives a different mission of the same length.
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
