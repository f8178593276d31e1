//! The memory of the plans: three live plans and one staging area that they share (M-1, M-2, M-83,
//! SEC-11).
//!
//! Only the outermost type, [`PlanBuffers`], has capacities. The logic works on [`PlansMut`] and is compiled once. An
//! upload fills the staging area and never touches a live plan. The live plan changes in one step when the upload is
//! complete.

use heapless::Vec;
use heapless::vec::VecView;

use super::link::{LinkId, Peer};
use crate::dialect::{MavMissionResult, MavMissionType};
use crate::message::{Address, Item};

/// A kind of plan. Each kind has its own live plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum PlanType {
    /// The flight plan.
    Mission,
    /// The geofence.
    Fence,
    /// The rally points.
    Rally,
}

impl PlanType {
    /// Every kind.
    pub const ALL: [Self; 3] = [Self::Mission, Self::Fence, Self::Rally];

    /// Whether plan memory with these capacities, ordered as [`ALL`](Self::ALL), has room for items of this plan.
    pub const fn is_served(self, capacities: &[u16; 3]) -> bool {
        let [mission, fence, rally] = *capacities;
        0 < match self {
            Self::Mission => mission,
            Self::Fence => fence,
            Self::Rally => rally,
        }
    }

    /// Returns the plan type as messages have it.
    pub const fn mission_type(self) -> MavMissionType {
        match self {
            Self::Mission => MavMissionType::MISSION,
            Self::Fence => MavMissionType::FENCE,
            Self::Rally => MavMissionType::RALLY,
        }
    }

    /// Returns the kind of plan that a message names; `None` for ALL and for undefined values.
    pub const fn from_mission_type(mission_type: MavMissionType) -> Option<Self> {
        match mission_type {
            MavMissionType::MISSION => Some(Self::Mission),
            MavMissionType::FENCE => Some(Self::Fence),
            MavMissionType::RALLY => Some(Self::Rally),
            _ => None,
        }
    }
}

/// A live plan.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PlanView<'a> {
    items: &'a [Item],
    id: u32,
}

impl<'a> PlanView<'a> {
    pub(crate) const EMPTY: Self = Self { items: &[], id: 0 };

    /// Returns the items, in order.
    pub const fn items(&self) -> &'a [Item] {
        self.items
    }

    /// Returns the id of the plan. Equal content has an equal id; an empty plan has 0 (M-5).
    pub const fn id(&self) -> u32 {
        self.id
    }
}

/// Memory for three live plans, and for the staging area of `S` items, the largest of the three capacities. Declared by
/// `plans` in [`#[stack]`](macro@crate::Stack). A plan of capacity 0 is not served: it is refused with UNSUPPORTED, and
/// AUTOPILOT_VERSION does not announce it.
///
/// [`plan_memory!`](crate::plan_memory) spells the type. It takes 32 bytes for each item, and at most 256 for the rest.
/// `U` is a `FileUpload` in a stack that takes plans as files.
#[derive(Clone, Debug)]
pub struct PlanBuffers<const M: usize, const F: usize, const R: usize, const S: usize, U = ()> {
    mission: Buffer<M>,
    fence: Buffer<F>,
    rally: Buffer<R>,
    staging: Vec<Item, S>,
    upload: U,
}

/// The state of an upload as a file, or nothing.
pub trait UploadMemory {
    /// Whether there is one.
    const IS_KEPT: bool;
    /// No upload: all zero bits.
    const NEW: Self;

    /// Returns the state.
    fn view(&mut self) -> Option<&mut FileUpload>;
}

impl UploadMemory for () {
    const IS_KEPT: bool = false;
    const NEW: Self = ();

    fn view(&mut self) -> Option<&mut FileUpload> {
        None
    }
}

impl UploadMemory for FileUpload {
    const IS_KEPT: bool = true;
    const NEW: Self = Self {
        step: UploadStep::Nothing,
        plan: PlanType::Mission,
        client: Peer { address: Address::new(0, 0), link: LinkId(0) },
        count: 0,
        first: 0,
        result: MavMissionResult(0),
    };

    fn view(&mut self) -> Option<&mut FileUpload> {
        Some(self)
    }
}

/// The upload of a plan as a file. Its items are staged as the file's parts are received; the plan service lends the
/// staging area, and makes the plan live.
#[derive(Clone, Copy, Debug)]
pub struct FileUpload {
    pub(crate) step: UploadStep,
    pub(crate) plan: PlanType,
    pub(crate) client: Peer,
    /// The number of items; more than [`MAX_ITEMS`] before the file's header is received.
    pub(crate) count: u16,
    /// The first item marked as current; more than [`MAX_ITEMS`] if there is none.
    pub(crate) first: u16,
    /// Why it is refused.
    pub(crate) result: MavMissionResult,
}

/// Instead of a number of items, or of an item: there is none.
pub(crate) const NO_ITEM: u16 = u16::MAX;

/// How far the upload of a plan as a file is. `client`: set by the file; `service`: set by the plan service in its
/// poll.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum UploadStep {
    /// There is none (client).
    Nothing,
    /// The client asks for the staging area (client).
    Asked,
    /// The file may stage items (service).
    Permitted,
    /// All items are staged (client).
    Complete,
    /// The plan is being stored (service).
    Writing,
    /// It is live (service).
    Accepted,
    /// It is refused (both).
    Refused,
}

#[derive(Clone, Debug)]
struct Buffer<const N: usize> {
    items: Vec<Item, N>,
    id: u32,
}

impl<const N: usize> Buffer<N> {
    const EMPTY: Self = Self { items: Vec::new(), id: 0 };

    fn view(&mut self) -> Live<'_> {
        Live { items: self.items.as_mut_view(), id: &mut self.id }
    }

    fn live(&self) -> PlanView<'_> {
        PlanView { items: &self.items, id: self.id }
    }
}

/// The plan memory of a vehicle without plans. The mission engine is not linked, and requests are answered UNSUPPORTED.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct NoPlans;

/// The maximum number of items of a plan: 65,535 means "no mission" on the wire (M-21, M-90).
pub const MAX_ITEMS: usize = 65_534;

/// Returns the largest of three capacities, for [`plan_memory!`](crate::plan_memory).
#[doc(hidden)]
pub const fn largest(mission: usize, fence: usize, rally: usize) -> usize {
    let two = if mission > fence { mission } else { fence };
    if two > rally { two } else { rally }
}

/// The type of a stack's plan memory, from the capacities in items. A plan that is left out is not served.
///
/// ```
/// type Plans = mavstack::plan_memory!(mission: 250, fence: 64, rally: 16);
/// assert!(size_of::<Plans>() <= (250 + 64 + 16 + 250) * 32 + 256);
/// type OnlyMission = mavstack::plan_memory!(mission: 100);
/// ```
#[doc(hidden)]
#[macro_export]
macro_rules! plan_memory {
    (mission: $mission:expr $(,)?) => {
        $crate::plan_memory!(mission: $mission, fence: 0, rally: 0)
    };
    (mission: $mission:expr, fence: $fence:expr $(,)?) => {
        $crate::plan_memory!(mission: $mission, fence: $fence, rally: 0)
    };
    (mission: $mission:expr, fence: $fence:expr, rally: $rally:expr $(,)?) => {
        $crate::__private::PlanBuffers<
            { $mission },
            { $fence },
            { $rally },
            { $crate::__private::largest($mission, $fence, $rally) },
        >
    };
    ($($anything:tt)*) => {
        ::core::compile_error!("write plan_memory!(mission: 100, fence: 64, rally: 16); fence and rally may be left out")
    };
}

/// Plan memory in a stack that takes plans as files, if `UPLOADS` is true.
pub trait PlanMemoryOf<const UPLOADS: bool> {
    /// The memory.
    type Memory;
}

impl<const M: usize, const F: usize, const R: usize, const S: usize> PlanMemoryOf<false> for PlanBuffers<M, F, R, S> {
    type Memory = Self;
}

impl<const M: usize, const F: usize, const R: usize, const S: usize> PlanMemoryOf<true> for PlanBuffers<M, F, R, S> {
    type Memory = PlanBuffers<M, F, R, S, FileUpload>;
}

impl<const M: usize, const F: usize, const R: usize, const S: usize, U: UploadMemory> PlanBuffers<M, F, R, S, U> {
    #[allow(clippy::arithmetic_side_effects, reason = "const-evaluated: an overflow is a compile error")]
    const CHECKED: () = {
        assert!(S == largest(M, F, R), "the staging area is as large as the largest plan: use plan_memory!");
        assert!(S <= MAX_ITEMS, "a plan has at most 65,534 items");
        assert!(S > 0, "plan memory without room for an item: leave `plans` out");
        assert!(size_of::<Self>() <= (M + F + R + S) * size_of::<Item>() + 256);
    };

    /// Three empty plans.
    pub const fn new() -> Self {
        const { Self::CHECKED };
        Self { mission: Buffer::EMPTY, fence: Buffer::EMPTY, rally: Buffer::EMPTY, staging: Vec::new(), upload: U::NEW }
    }
}

impl<const M: usize, const F: usize, const R: usize, const S: usize, U: UploadMemory> Default
    for PlanBuffers<M, F, R, S, U>
{
    fn default() -> Self {
        Self::new()
    }
}

/// The plan memory of a stack: a [`PlanBuffers`] of any capacities, or [`NoPlans`]. Nothing else implements it.
pub trait PlanMemory {
    /// Three empty plans.
    #[doc(hidden)]
    const EMPTY: Self;
    /// The maximum number of items in each plan, ordered as [`PlanType::ALL`]; 0 for a plan that is not served.
    const CAPACITIES: [u16; 3];
    /// Whether the stack takes plans as files.
    #[doc(hidden)]
    const TAKES_FILES: bool = false;

    /// Returns a live plan. Uploaded items are not in it before the upload is complete (M-39).
    fn live(&self, plan: PlanType) -> PlanView<'_>;

    /// Returns the plans without their capacities.
    #[doc(hidden)]
    fn view(&mut self) -> PlansMut<'_>;
}

impl<const M: usize, const F: usize, const R: usize, const S: usize, U: UploadMemory> PlanMemory
    for PlanBuffers<M, F, R, S, U>
{
    const EMPTY: Self = Self::new();
    #[allow(clippy::as_conversions, reason = "const-evaluated; checked by `new` to be at most MAX_ITEMS")]
    const CAPACITIES: [u16; 3] = [M as u16, F as u16, R as u16];
    const TAKES_FILES: bool = U::IS_KEPT;

    fn live(&self, plan: PlanType) -> PlanView<'_> {
        match plan {
            PlanType::Mission => self.mission.live(),
            PlanType::Fence => self.fence.live(),
            PlanType::Rally => self.rally.live(),
        }
    }

    // Out of line: it has several callers.
    #[inline(never)]
    fn view(&mut self) -> PlansMut<'_> {
        PlansMut(Some(Buffers {
            mission: self.mission.view(),
            fence: self.fence.view(),
            rally: self.rally.view(),
            staging: self.staging.as_mut_view(),
            upload: self.upload.view(),
        }))
    }
}

impl PlanMemory for NoPlans {
    const EMPTY: Self = Self;
    const CAPACITIES: [u16; 3] = [0; 3];

    fn live(&self, _: PlanType) -> PlanView<'_> {
        PlanView::EMPTY
    }

    fn view(&mut self) -> PlansMut<'_> {
        PlansMut::none()
    }
}

/// The plans without their capacities, as the logic uses them. A firmware without plans has [none](Self::none): three
/// empty ones of capacity 0.
pub struct PlansMut<'a>(Option<Buffers<'a>>);

struct Buffers<'a> {
    mission: Live<'a>,
    fence: Live<'a>,
    rally: Live<'a>,
    /// The items of the upload that is running.
    staging: &'a mut VecView<Item>,
    /// The upload as a file, in a stack that takes plans as files.
    upload: Option<&'a mut FileUpload>,
}

/// A live plan that can be replaced.
struct Live<'a> {
    items: &'a mut VecView<Item>,
    id: &'a mut u32,
}

impl PlansMut<'_> {
    /// Returns the plans of a firmware without plans.
    pub(crate) const fn none() -> Self {
        Self(None)
    }

    /// Returns a live plan, if there are plans.
    // Out of line: it has several callers.
    #[inline(never)]
    fn of(&self, plan: PlanType) -> Option<&Live<'_>> {
        let Buffers { mission, fence, rally, .. } = self.0.as_ref()?;
        Some(match plan {
            PlanType::Mission => mission,
            PlanType::Fence => fence,
            PlanType::Rally => rally,
        })
    }

    /// A live plan.
    pub(crate) fn live(&self, plan: PlanType) -> PlanView<'_> {
        self.of(plan).map_or(PlanView::EMPTY, |live| PlanView { items: live.items.as_slice(), id: *live.id })
    }

    /// Returns the number of items of a live plan.
    pub(crate) fn count(&self, plan: PlanType) -> u16 {
        self.of(plan).map_or(0, |live| clamped(live.items.len()))
    }

    /// Returns the maximum number of items of a plan; 0 if it is not served.
    pub(crate) fn capacity(&self, plan: PlanType) -> u16 {
        self.of(plan).map_or(0, |live| clamped(live.items.capacity()))
    }

    /// Returns the items of the running upload that were received.
    pub(crate) fn staged_items(&self) -> &[Item] {
        self.0.as_ref().map_or(&[], |buffers| buffers.staging.as_slice())
    }

    /// Returns how many they are.
    pub(crate) fn staged(&self) -> u16 {
        clamped(self.staged_items().len())
    }

    /// Returns the staged items as a plan with this id.
    pub(crate) fn staged_as(&self, id: u32) -> PlanView<'_> {
        PlanView { items: self.staged_items(), id }
    }

    /// Adds an item to the staging area, if it has room for one.
    pub(crate) fn stage(&mut self, item: Item) {
        if let Some(buffers) = &mut self.0 {
            let _ = buffers.staging.push(item);
        }
    }

    /// Empties the staging area.
    pub(crate) fn clear_staging(&mut self) {
        if let Some(buffers) = &mut self.0 {
            buffers.staging.clear();
        }
    }

    /// Returns the upload as a file, in a stack that takes plans as files.
    pub(crate) fn upload(&self) -> Option<&FileUpload> {
        self.0.as_ref()?.upload.as_deref()
    }

    /// The same, mutably.
    pub(crate) fn upload_mut(&mut self) -> Option<&mut FileUpload> {
        self.0.as_mut()?.upload.as_deref_mut()
    }

    /// Whether the staged plan, which has this id, equals the live one byte for byte. Equal ids alone prove nothing
    /// (M-39).
    pub(crate) fn is_live(&self, plan: PlanType, id: u32) -> bool {
        let live = self.live(plan);
        live.id == id && live.items == self.staged_items()
    }

    /// Replaces the live plan by the staged one, in one step. The id of an empty plan is 0.
    pub(crate) fn go_live(&mut self, plan: PlanType, id: u32) {
        let Some(Buffers { mission, fence, rally, staging, .. }) = &mut self.0 else { return };
        let Live { items, id: live_id } = match plan {
            PlanType::Mission => mission,
            PlanType::Fence => fence,
            PlanType::Rally => rally,
        };
        items.clear();
        // The count was checked against the capacity before the first item (M-21).
        let _ = items.extend_from_slice(staging);
        **live_id = id;
        staging.clear();
    }
}

/// Converts a number of items. Capacities are at most [`MAX_ITEMS`], so nothing is lost.
fn clamped(len: usize) -> u16 {
    u16::try_from(len).unwrap_or(u16::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// M-2: the RAM that the documentation states.
    #[test]
    fn memory_is_as_documented() {
        assert!(size_of::<plan_memory!(mission: 250, fence: 64, rally: 16)>() <= (250 + 64 + 16 + 250) * 32 + 256);
        assert!(size_of::<plan_memory!(mission: 3, fence: 64, rally: 16)>() <= (3 + 64 + 16 + 64) * 32 + 256);
        assert_eq!(size_of::<NoPlans>(), 0);
    }

    #[test]
    fn a_plan_of_capacity_0_is_not_served() {
        type Memory = plan_memory!(mission: 2, fence: 0, rally: 1);
        assert_eq!(PlanType::ALL.map(|plan| plan.is_served(&Memory::CAPACITIES)), [true, false, true]);
        let mut memory = Memory::new();
        let view = memory.view();
        assert_eq!(PlanType::ALL.map(|plan| view.capacity(plan)), [2, 0, 1]);
    }

    #[test]
    fn going_live_replaces_the_whole_plan() {
        let item = |x| Item { x, ..Default::default() };
        let mut memory = <plan_memory!(mission: 3, fence: 0, rally: 2)>::new();
        let mut view = memory.view();
        for (items, id) in [(&[1, 2, 3][..], 7), (&[4], 8), (&[], 0)] {
            for x in items {
                view.stage(item(*x));
            }
            assert!(!view.is_live(PlanType::Mission, id) || items.is_empty());
            view.go_live(PlanType::Mission, id);
            let live = view.live(PlanType::Mission);
            assert!(live.items().iter().map(|item| item.x).eq(items.iter().copied()));
            assert_eq!((live.id(), view.staged(), view.count(PlanType::Rally)), (id, 0, 0));
        }
    }
}
