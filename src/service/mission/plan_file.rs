//! `@MISSION`: the plans as files, down and up (F-20 to F-26).
//!
//! The format is ArduPilot's (`AP_Filesystem_Mission`), which MAVProxy reads and writes.
//!
//! ```text
//!   header   magic 0x763D, MAV_MISSION_TYPE, options, number of the first item, number of items: each u16
//!   item     the 38 bytes of a MISSION_ITEM_INT's payload
//! ```
//!
//! Left out: options, and parts of a plan, which are refused.
//!
//! A file is made from the live plan while it is read, so any part of it can be read again. It ends when another plan
//! goes live, because a client must not mix two plans.
//!
//! An upload stages its items as they arrive. The plan service lends the staging area in its poll, as to the client of
//! a MISSION_COUNT, and makes the plan live, or stores it first. The file and the service share a `FileUpload`:
//!
//! ```text
//!              open             poll                 last part              poll
//!   Nothing ──────────▶ Asked ──────────▶ Permitted ───────────▶ Complete ─────────▶ Accepted, or Writing first
//!                         │                  │                       │                  │
//!                         └──────────────────┴── a refusal ──────────┴──────────────────┴─▶ Refused
//! ```

use core::num::Saturating;
use core::task::Poll;

use super::check::stage_item;
use super::engine::Missions;
use super::problem::Problem;
use super::replies::{Client, Replies};
use super::transfer::{Change, Transfer, Upload};
use super::vehicle::Plans;
use super::without_plans::WithoutPlans;
use crate::dialect::{MavFtpErr, MavMissionResult, MissionItemInt};
use crate::message::{Address, Item, Message, Text, zero_extend};
use crate::service::Cx;
use crate::service::command::Commands;
use crate::service::files::{FileAccess, HasFiles, NoFile, Part, VirtualEntry, VirtualFile};
use crate::types::{Firmware, NO_ITEM, Peer, PlanMemory, PlanType, PlanView, PlansMut, Trust, UploadStep};

const MAGIC: u16 = 0x763D;

const HEADER_LEN: usize = 10;
const ITEM_LEN: usize = MissionItemInt::MAX_LEN;

/// A packet's data, and the beginning of an item before it.
const UPLOAD_ROOM: usize = 239 + ITEM_LEN - 1;

impl HasFiles for Missions {
    type File = PlanFile;
}

impl HasFiles for WithoutPlans {
    type File = NoFile;
}

/// The file of a plan. The plan's id when it was opened: another id is another plan.
#[derive(Clone, Copy, Debug)]
pub struct PlanFile {
    plan: PlanType,
    id: u32,
}

impl PlanFile {
    const fn name_of(plan: PlanType) -> &'static str {
        match plan {
            PlanType::Mission => "mission.dat",
            PlanType::Fence => "fence.dat",
            PlanType::Rally => "rally.dat",
        }
    }

    /// Returns the live plan; `None` if it is not that of the file any more (F-22).
    fn live<'a>(&self, plans: &'a PlansMut<'_>) -> Option<PlanView<'a>> {
        Some(plans.live(self.plan)).filter(|live| live.id() == self.id)
    }
}

/// Returns the length of the file of so many items.
fn len(count: usize) -> u32 {
    let len = Saturating(count) * Saturating(ITEM_LEN) + Saturating(HEADER_LEN);
    u32::try_from(len.0).unwrap_or(u32::MAX)
}

impl<F: Firmware<Vehicle: Plans + Commands>> VirtualFile<F> for PlanFile {
    const UPLOAD_ROOM: usize = UPLOAD_ROOM;

    fn name(_: u16) -> &'static [u8] {
        b"@MISSION"
    }

    fn open(cx: &mut Cx<'_, F>, _: u16, path: &[u8], _: FileAccess) -> Result<Self, MavFtpErr> {
        let is_it = |plan: &PlanType| Self::name_of(*plan).as_bytes() == path && cx.plans.capacity(*plan) > 0;
        let plan = PlanType::ALL.into_iter().find(is_it).ok_or(MavFtpErr::FILENOTFOUND)?;
        Ok(Self { plan, id: cx.plans.live(plan).id() })
    }

    fn size(&self, cx: &Cx<'_, F>) -> u32 {
        len(self.live(&cx.plans).map_or(0, |live| live.items().len()))
    }

    fn read(&mut self, cx: &mut Cx<'_, F>, offset: u32, out: &mut [u8]) -> Poll<Result<usize, MavFtpErr>> {
        let live = self.live(&cx.plans).ok_or(MavFtpErr::FAIL)?;
        let current = if self.plan == PlanType::Mission { cx.vehicle.progress().current } else { NO_ITEM };
        Poll::Ready(Ok(read(self.plan, live.items(), current, offset, out)))
    }

    fn entry(cx: &mut Cx<'_, F>, _: u16, index: u16) -> Option<VirtualEntry> {
        let mut served = PlanType::ALL.into_iter().filter(|plan| cx.plans.capacity(*plan) > 0);
        let plan = served.nth(usize::from(index))?;
        let size = len(cx.plans.live(plan).items().len());
        Some(VirtualEntry { name: Text::new(Self::name_of(plan)), size, time: 0 })
    }

    fn begin(&self, cx: &mut Cx<'_, F>, from: Peer) -> Poll<Result<(), MavFtpErr>> {
        let Some(upload) = cx.plans.upload_mut() else { return Poll::Pending };
        match upload.step {
            UploadStep::Nothing => {
                (upload.step, upload.plan, upload.client) = (UploadStep::Asked, self.plan, from);
                (upload.count, upload.first) = (NO_ITEM, NO_ITEM);
                Poll::Pending
            }
            UploadStep::Asked => Poll::Pending,
            UploadStep::Permitted => Poll::Ready(Ok(())),
            _ => Poll::Ready(Err(MavFtpErr::FAIL)),
        }
    }

    fn take(&self, cx: &mut Cx<'_, F>, content: &[u8]) -> Result<Part, MavFtpErr> {
        let mut rest = content;
        loop {
            match take(cx, self.plan, rest) {
                Ok(Taken::Record(others)) => rest = others,
                Ok(Taken::Nothing) => return Ok(Part::More { used: content.len().saturating_sub(rest.len()) }),
                Ok(Taken::Last) => return Ok(Part::Last),
                Err(problem) => {
                    problem.report(cx);
                    if let Some(upload) = cx.plans.upload_mut() {
                        (upload.step, upload.result) = (UploadStep::Refused, problem.fault().result);
                    }
                    return Err(MavFtpErr::FAIL);
                }
            }
        }
    }

    fn finish(&mut self, cx: &mut Cx<'_, F>, _: Peer, _: &[u8]) -> Poll<Result<(), MavFtpErr>> {
        let Some(upload) = cx.plans.upload_mut() else { return Poll::Pending };
        let result = match upload.step {
            UploadStep::Complete | UploadStep::Writing => return Poll::Pending,
            UploadStep::Accepted => Ok(()),
            _ => Err(MavFtpErr::FAIL),
        };
        upload.step = UploadStep::Nothing;
        Poll::Ready(result)
    }

    fn close(&self, cx: &mut Cx<'_, F>) {
        let Some(upload) = cx.plans.upload_mut() else { return };
        if !matches!(upload.step, UploadStep::Complete | UploadStep::Writing) {
            upload.step = UploadStep::Nothing;
            // The next poll frees the staging area.
            cx.shared.has_acted = true;
        }
    }
}

/// Reads from the file of a plan. Returns the number of bytes.
fn read(plan: PlanType, items: &[Item], current: u16, offset: u32, out: &mut [u8]) -> usize {
    let offset = usize::try_from(offset).unwrap_or(usize::MAX);
    let mut len = 0usize;
    let mut put = |from: &[u8], at: usize| {
        let to = out.get_mut(len..).unwrap_or_default();
        len = len.saturating_add(zero_extend(from.get(at..).unwrap_or_default(), to));
        len == out.len()
    };
    let count = u16::try_from(items.len()).unwrap_or(NO_ITEM);
    let mission_type = plan.mission_type();
    let ([a, b], [c, d]) = (MAGIC.to_le_bytes(), count.to_le_bytes());
    if put(&[a, b, mission_type.0, 0, 0, 0, 0, 0, c, d], offset) {
        return len;
    }
    let after_header = offset.saturating_sub(HEADER_LEN);
    let (first, mut at) = (after_header / ITEM_LEN, after_header % ITEM_LEN);
    for (seq, item) in (0..items.len()).zip(items).skip(first) {
        let mut record = [0; ITEM_LEN];
        let seq = u16::try_from(seq).unwrap_or(NO_ITEM);
        let message = item.to_int(Address::new(0, 0), mission_type, seq, seq == current);
        let _ = message.encode(&mut record);
        if put(&record, core::mem::take(&mut at)) {
            break;
        }
    }
    len
}

/// The part of an uploaded file that was taken.
enum Taken<'a> {
    /// The header or an item. These bytes follow.
    Record(&'a [u8]),
    /// Too few bytes.
    Nothing,
    /// The last item, or the header of a file without items.
    Last,
}

/// Takes the header or an item of an upload.
fn take<'a, F: Firmware<Vehicle: Plans>>(
    cx: &mut Cx<'_, F>,
    plan: PlanType,
    bytes: &'a [u8],
) -> Result<Taken<'a>, Problem> {
    let refused = |result: MavMissionResult| Problem::Refused(plan, result.into());
    let (seq, capacity) = (cx.plans.staged(), cx.plans.capacity(plan));
    let upload = cx.plans.upload_mut().filter(|upload| upload.step == UploadStep::Permitted);
    let upload = upload.ok_or(refused(MavMissionResult::DENIED))?;
    let count = upload.count;
    let rest = if count == NO_ITEM {
        let Some((header, rest)) = bytes.split_first_chunk::<HEADER_LEN>() else { return Ok(Taken::Nothing) };
        let [a, b, c, d, options @ .., e, f] = header;
        let (magic, of) = (u16::from_le_bytes([*a, *b]), u16::from_le_bytes([*c, *d]));
        // F-25: neither options nor a first item.
        if (magic, of) != (MAGIC, plan.mission_type().0.into()) || *options != [0; 4] {
            return Err(refused(MavMissionResult::INVALID));
        }
        upload.count = u16::from_le_bytes([*e, *f]);
        if upload.count > capacity {
            return Err(refused(MavMissionResult::NO_SPACE));
        }
        rest
    } else {
        let Some((item, rest)) = bytes.split_first_chunk::<ITEM_LEN>() else { return Ok(Taken::Nothing) };
        let message = MissionItemInt::decode(item);
        if seq >= count || message.mission_type != plan.mission_type() || message.current > 1 {
            return Err(refused(MavMissionResult::INVALID));
        }
        if message.current == 1 && upload.first == NO_ITEM {
            upload.first = seq;
        }
        stage_item(cx, plan, Item::from_int(&message))?;
        rest
    };
    let staged = cx.plans.staged();
    if let Some(upload) = cx.plans.upload_mut().filter(|upload| upload.count == staged) {
        upload.step = UploadStep::Complete;
        return if rest.is_empty() { Ok(Taken::Last) } else { Err(refused(MavMissionResult::INVALID)) };
    }
    Ok(Taken::Record(rest))
}

/// Whether the plan that is being stored was uploaded as a file.
pub(super) fn is_writing_file<F: Firmware>(cx: &Cx<'_, F>) -> bool {
    F::Plans::TAKES_FILES && cx.plans.upload().is_some_and(|upload| upload.step == UploadStep::Writing)
}

impl Missions {
    /// Ends the upload as a file: its plan was accepted, or refused.
    pub(super) fn end_file(&mut self, plans: &mut PlansMut<'_>, is_accepted: bool) {
        // Its client does not repeat an item, and gets no message.
        (self.finished, self.second_answer) = (None, None);
        if let Some(upload) = plans.upload_mut() {
            upload.step = if is_accepted { UploadStep::Accepted } else { UploadStep::Refused };
        }
    }

    /// Lends the staging area to an upload as a file, makes its plan live, and takes the area back (F-23, F-26).
    pub(super) fn poll_file<F: Firmware<Vehicle: Plans>>(&mut self, cx: &mut Cx<'_, F>) {
        let Some(upload) = cx.plans.upload().copied() else { return };
        let is_lent = matches!(&self.transfer, Transfer::Upload(upload) if upload.is_of_file());
        // The same checks as of a client of messages. The answer is for the file.
        let mut replies = Replies::new();
        let mission_type = upload.plan.mission_type();
        let mut client =
            Client { peer: upload.client, trust: Trust::Signed, rate: 0, mission_type, replies: &mut replies };
        let step = match upload.step {
            UploadStep::Accepted | UploadStep::Writing => return,
            UploadStep::Nothing | UploadStep::Refused if !is_lent => return,
            UploadStep::Permitted if is_lent => return,
            UploadStep::Permitted => UploadStep::Refused,
            UploadStep::Nothing => {
                self.abandon_upload(&mut cx.plans);
                self.heard_at = cx.now;
                UploadStep::Nothing
            }
            UploadStep::Refused => {
                let seq = cx.plans.staged();
                self.refuse_upload(cx, &mut client, seq, upload.result);
                self.finished = None;
                self.heard_at = cx.now;
                UploadStep::Refused
            }
            UploadStep::Asked => {
                if is_lent {
                    self.heard_at = cx.now;
                    self.abandon_upload(&mut cx.plans);
                }
                if self.admit_file(cx, upload.plan, upload.client) {
                    self.begin_time(cx.now, upload.client.address);
                    self.abandon_upload(&mut cx.plans);
                    self.finished = None;
                    event!("{} upload as a file by {}: started", upload.plan, upload.client);
                    self.transfer = Transfer::Upload(Upload::of_file(upload.plan));
                    UploadStep::Permitted
                } else {
                    UploadStep::Refused
                }
            }
            UploadStep::Complete => {
                self.complete_file(cx, &mut client, upload.plan, upload.first);
                if self.committing().is_none() {
                    return self.end_file(&mut cx.plans, replies.is_accepted());
                }
                UploadStep::Writing
            }
        };
        if let Some(upload) = cx.plans.upload_mut() {
            upload.step = step;
        }
    }

    /// Returns whether an upload as a file may begin. A refusal is reported.
    fn admit_file<F: Firmware<Vehicle: Plans>>(&mut self, cx: &mut Cx<'_, F>, plan: PlanType, client: Peer) -> bool {
        let is_free =
            self.committing().is_none() && !self.is_loading() && (!self.is_receiving() || self.oust(cx, client));
        is_free && self.ask_permission(cx, plan, client).is_ok() && self.check_write_rate(cx, plan, client, 0).is_ok()
    }

    /// Completes an upload as a file, as the last item completes one by messages.
    fn complete_file<F: Firmware<Vehicle: Plans>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        client: &mut Client<'_>,
        plan: PlanType,
        first: u16,
    ) {
        let count = cx.plans.staged();
        let last_seq = count.saturating_sub(1);
        // For items, the vehicle was asked when the upload began.
        let needs_permission = count == 0 && !self.is_already_clear(&cx.plans, Some(plan));
        let is_permitted = !needs_permission || self.ask_permission(cx, plan, client.peer).is_ok();
        if !is_permitted || self.check_write_rate(cx, plan, client.peer, count).is_err() {
            return self.refuse_upload(cx, client, last_seq, MavMissionResult::DENIED);
        }
        if count == 0 {
            self.transfer = Transfer::Idle;
            return self.start_change(cx, client, Change::Clear(Some(plan)));
        }
        if let Transfer::Upload(upload) = &mut self.transfer {
            cx.plans.staged_items().iter().for_each(|item| upload.digest.add(item));
            upload.first = (first != NO_ITEM).then_some(first);
        }
        self.complete(cx, client, last_seq);
    }
}
