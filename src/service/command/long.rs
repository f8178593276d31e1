//! Slots for long-running commands, and for commands that must not be carried out twice.
//!
//! Rules C-10, C-12, C-20 to C-24 and SEC-13. One fixed table serves both. It is part of the stack only if `commands` in
//! [`#[stack]`](macro@crate::Stack) declares it, so other firmwares pay nothing. [`LongCommands`] has the state diagram of a slot.

use core::ops::{Deref, DerefMut};

use super::duplicates::{Duplicates, ExecutionLimit, LATE, REPEATED_WITHIN, SOON, is_well_after};
use crate::dialect::{CommandAck, MavCmd, MavResult};
use crate::link::Outbox;
use crate::message::{Address, ComponentId};
use crate::time::{Duration, Instant};
use crate::types::{
    Command, CommandAnswer, CommandPosition, Context, Firmware, LinkClass, LinkId, LinkMask, Outcome, Peer, SignedAt,
};

/// Interval between IN_PROGRESS acknowledgements (C-20).
const REPEAT_EVERY: Duration = Duration::from_secs(1);

/// Minimum interval when the progress changes: a flight loop may report progress in every pass, and other traffic needs the link
/// too.
const CHANGE_EVERY: Duration = Duration::from_millis(100);

/// A final ACK that a link has not accepted after this time is dropped: the client has given up. It keeps its slot from no other
/// command for so long (X-3).
const DROP_AFTER: Duration = Duration::from_secs(10);

/// COMMAND_ACK.progress of a command with unknown progress.
pub(super) const NO_PROGRESS: u8 = 255;

/// Slots for the long-running commands of a vehicle, or none.
pub trait CommandMemory: core::fmt::Debug {
    /// All zero bits.
    const NEW: Self;

    /// Returns the slots, if there are any.
    fn view_mut(&mut self) -> Option<&mut LongCommands>;

    /// The same, for reading.
    fn view(&self) -> Option<&LongCommands>;
}

/// The slots of a firmware whose [`#[stack]`](macro@crate::Stack) has no `commands`: none.
#[derive(Clone, Copy, Debug)]
pub struct NoSlots;

impl CommandMemory for NoSlots {
    const NEW: Self = Self;

    fn view_mut(&mut self) -> Option<&mut LongCommands> {
        None
    }

    fn view(&self) -> Option<&LongCommands> {
        None
    }
}

impl<const N: usize> CommandMemory for CommandSlots<N> {
    const NEW: Self = Self::new();

    fn view_mut(&mut self) -> Option<&mut LongCommands> {
        Some(self)
    }

    fn view(&self) -> Option<&LongCommands> {
        Some(self)
    }
}

/// Slots for `N` commands that are running, ended within the last three seconds, or must not be carried out twice; see
/// [`LongCommands`].
pub type CommandSlots<const N: usize> = LongCommands<[CommandSlot; N]>;

/// A slot of a [`LongCommands`].
#[doc(hidden)]
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CommandSlot {
    key: CommandKey,
    from: Address,
    /// The component to which it is addressed.
    component: ComponentId,
    confirmation: u8,
    is_broadcast: bool,
    state: CommandState,
    /// Whether `at` must be set in the next poll: the vehicle changed the slot without a timestamp.
    is_untimed: bool,
    /// Whether it was answered IN_PROGRESS (C-24), and is not only remembered as a command to be carried out once (C-12).
    is_long: bool,
    progress: u8,
    /// Whether the progress has changed since the last IN_PROGRESS.
    has_changed: bool,
    /// The links on which it was received.
    links: LinkMask,
    duplicates: Duplicates,
    /// The links on which the next ACK is pending.
    pending: LinkMask,
    outcome: Outcome,
    /// When its last IN_PROGRESS was due; if it has ended, when it ended.
    at: Instant,
    /// Time from `at` to the last duplicate (ms).
    repeated_after: u16,
    signed_at: SignedAt,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
enum CommandState {
    Free,
    Running,
    Done,
    /// Done, and another command may evict it.
    Evictable,
}

/// Identifies equal commands of one sender: id, form, frame, and the bits of the parameters.
type CommandKey = [u32; 8];

fn key(command: &Command) -> CommandKey {
    let [id0, id1] = command.id.0.to_le_bytes();
    let (form, p5, p6) = match command.position {
        CommandPosition::Long { param5, param6 } => ([0, 0], param5.to_bits(), param6.to_bits()),
        CommandPosition::Int { frame, x, y } => ([1, frame.0], x.cast_unsigned(), y.cast_unsigned()),
    };
    let [form, frame] = form;
    let [p1, p2, p3, p4] = command.params.map(f32::to_bits);
    [u32::from_le_bytes([id0, id1, form, frame]), p1, p2, p3, p4, p5, p6, command.z.to_bits()]
}

/// Converts to milliseconds, saturating at about a minute.
fn millis(duration: Duration) -> u16 {
    u16::try_from(duration.as_millis()).unwrap_or(u16::MAX)
}

impl CommandSlot {
    /// All zero bits.
    const FREE: Self = Self {
        key: [0; 8],
        from: Address::new(0, 0),
        component: ComponentId::ALL,
        confirmation: 0,
        is_broadcast: false,
        state: CommandState::Free,
        is_untimed: false,
        is_long: false,
        progress: 0,
        has_changed: false,
        links: LinkMask::NONE,
        duplicates: Duplicates::NONE,
        pending: LinkMask::NONE,
        outcome: Outcome { result: MavResult::ACCEPTED, result_param2: 0 },
        at: Instant::ZERO,
        repeated_after: 0,
        signed_at: None,
    };

    fn new(command: &Command, state: CommandState) -> Self {
        Self {
            key: key(command),
            from: command.from.address,
            component: command.component,
            confirmation: command.confirmation,
            is_broadcast: command.is_broadcast,
            state,
            links: LinkMask::of(command.from.link),
            ..Self::FREE
        }
    }

    fn command(&self) -> MavCmd {
        let [head, ..] = self.key;
        let [id0, id1, ..] = head.to_le_bytes();
        MavCmd(u16::from_le_bytes([id0, id1]))
    }

    fn is_running(&self, command: MavCmd) -> bool {
        self.state == CommandState::Running && self.command() == command
    }

    fn is_same(&self, command: &Command) -> bool {
        self.from == command.from.address && self.component == command.component && self.key == key(command)
    }

    /// Whether `command`, which is equal to this one and was received on its link before, is a retransmission because of a lost
    /// answer (C-12).
    fn is_repeated_by(&self, now: Instant, command: &Command) -> bool {
        let pause = millis(now - self.at).saturating_sub(self.repeated_after);
        (command.confirmation, command.is_broadcast) == (self.confirmation, self.is_broadcast)
            && now - self.at < SOON
            && pause <= REPEATED_WITHIN
    }

    /// Records a duplicate that was [answered](Self::answer_to_duplicate).
    fn note(&mut self, now: Instant, command: &Command) {
        let link = command.from.link;
        if !self.duplicates.lacks(link) && self.is_repeated_by(now, command) {
            // Every other link may deliver this retransmission too.
            self.duplicates.run(link);
        } else {
            self.duplicates.note(link);
        }
        self.repeated_after = millis(now - self.at);
    }

    /// Returns the answer if this command is done and `command` is a duplicate of it (C-12, C-24).
    fn answer_to_duplicate(
        &self,
        now: Instant,
        command: &Command,
        signed_at: SignedAt,
        limit: ExecutionLimit,
    ) -> Option<Outcome> {
        let is_done = matches!(self.state, CommandState::Done | CommandState::Evictable);
        let age = now - self.at;
        // Only a high-latency link delays a command for long.
        let may_be_late = limit != ExecutionLimit::None && command.class == LinkClass::HighLatency;
        if !is_done || age >= if may_be_late { LATE } else { SOON } || !self.is_same(command) {
            return None;
        }
        let signed = self.signed_at.zip(signed_at).filter(|_| may_be_late);
        let is_later = signed.is_some_and(|(known, sent)| is_well_after(sent, known));
        let is_earlier = signed.is_some_and(|(known, sent)| is_well_after(known, sent));
        // A command that is given twice is received twice on each link, with the same confirmation.
        let lacks = self.duplicates.lacks(command.from.link);
        // After TEMPORARILY_REJECTED the client tries again, and the vehicle may accept now.
        let is_final = self.outcome.result != MavResult::TEMPORARILY_REJECTED;
        let is_repeated = limit == ExecutionLimit::Once && is_final && self.is_repeated_by(now, command);
        let is_duplicate = if lacks { !is_later } else { command.confirmation > self.confirmation || is_repeated };
        let is_known = is_duplicate || (self.is_long && age < SOON);
        if !is_known {
            return None;
        }
        // A command that may be new must not be answered ACCEPTED.
        let is_retransmission = !lacks && self.links.contains(command.from.link);
        let is_sure = age < SOON || (signed.is_some() && !is_later && !is_earlier) || is_retransmission;
        Some(if is_sure { self.outcome } else { MavResult::TEMPORARILY_REJECTED.into() })
    }

    /// Whether this slot counts the runs of `command`.
    fn is_run_of(&self, command: &Command) -> bool {
        self.state == CommandState::Done && !self.is_long && self.pending.is_empty() && self.is_same(command)
    }

    /// Whether an ACK is pending on `link`: an IN_PROGRESS for `Running`, and the final one for every other state.
    fn is_pending(&self, state: CommandState, link: LinkId) -> bool {
        let is_running = |state| state == CommandState::Running;
        is_running(self.state) == is_running(state) && self.pending.contains(link)
    }

    /// Whether it was received from `sender` on its link. The same address on another link may be another station's (X-1).
    fn is_by(&self, sender: Peer) -> bool {
        self.from == sender.address && self.links.contains(sender.link)
    }

    fn ack(&self, outcome: Outcome, progress: u8) -> CommandAck {
        CommandAck {
            command: self.command(),
            result: outcome.result,
            progress,
            result_param2: outcome.result_param2,
            target_system: self.from.system.wire(),
            target_component: self.from.component.wire(),
        }
    }
}

/// Slots for long-running commands and for commands that must not be carried out twice. `commands` in [`#[stack]`](macro@crate::Stack)
/// declares their number. [`Stack::long_commands`](crate::Stack::long_commands) and
/// [`Stack::long_commands_mut`](crate::Stack::long_commands_mut) give access.
///
/// A long-running command is [started](Context::start) in [`Commands::command`](crate::Commands::command), and
/// [finished](Self::finish) by the flight loop:
///
/// ```
/// use mavstack::dialect::{MavCmd, MavResult};
/// use mavstack::{Command, Commands, Context, Outcome, Peer, Vehicle, VehicleState, StackOf};
///
/// #[derive(mavstack::Stack)]
/// #[stack(vehicle: Copter, links: 1, commands: { slots: 2 })]
/// struct Mavlink;
///
/// struct Copter { samples: u8 }
///
/// impl Commands for Copter {
///     fn command(&mut self, cx: &mut Context<'_>, command: &Command) -> Outcome {
///         match command.id {
///             MavCmd::PREFLIGHT_CALIBRATION => {
///                 self.samples = 0;
///                 cx.start()
///             }
///             _ => MavResult::UNSUPPORTED.into(),
///         }
///     }
///
///     fn cancel_command(&mut self, _: &mut Context<'_>, command: MavCmd, _: Peer) -> bool {
///         command == MavCmd::PREFLIGHT_CALIBRATION
///     }
/// }
/// # impl Vehicle for Copter { fn state(&self) -> Option<VehicleState> { None } }
///
/// /// Called by the flight loop.
/// fn calibrate(copter: &mut Copter, stack: &mut StackOf<Mavlink>) {
///     let commands = stack.long_commands_mut();
///     if !commands.is_running(MavCmd::PREFLIGHT_CALIBRATION) {
///         return;
///     }
///     copter.samples += 1;
///     commands.progress(MavCmd::PREFLIGHT_CALIBRATION, copter.samples);
///     if copter.samples == 100 {
///         commands.finish(MavCmd::PREFLIGHT_CALIBRATION, MavResult::ACCEPTED);
///     }
/// }
/// ```
///
/// The stack does the rest (C-20 to C-24):
///
/// - It sends IN_PROGRESS once a second, and when the progress changes, at most ten times a second; not on high-latency links.
/// - It sends the final ACK on every link on which the command was received.
/// - While the command runs, other commands with its id get `TEMPORARILY_REJECTED`, also those to another
///   [component](crate::Components) of the firmware.
/// - It answers duplicates without running the command again, until its sender has given another command with its id.
/// - It handles COMMAND_CANCEL of the command's sender, and of the system in control. While none is, every system may cancel (X-3).
///
/// A slot is in use until three seconds after the command has ended, whether or not its links take the final ACK. If none is free, the
/// sender with the most slots loses the one that ended first to a sender with fewer on the same link, and a link with more slots loses
/// one to a link with fewer; a running command keeps its slot (X-3). Otherwise the command is `TEMPORARILY_REJECTED` (C-22). A slot
/// takes 88 bytes.
///
/// A duplicate by satellite may arrive half a minute after its original. So a command that must be carried out only
/// [once](crate::command::CommandPolicy::once) is remembered for a minute, for duplicates on a
/// [high-latency](crate::config::LinkClass::HighLatency) link only, in a slot that no other command needs. With `N` slots, these are at
/// least the last `N` commands, less those that are running. Other ended commands may be given again after three seconds on any
/// link.
///
/// The timers run in [`Stack::poll`](crate::Stack::poll). While a command runs, call it at least once a second, as the heartbeat
/// requires anyway.
///
/// The states of a slot:
///
/// ```text
///            start                         finish, COMMAND_CANCEL                        3 s passed
///   free ───────────▶ running ──────────────────────────────────▶ done ──────────────────────────────────▶ evictable
///     │    IN_PROGRESS at once, at 1 Hz, on change                ▲  a duplicate gets the final ACK again
///     └────────────── not idempotent, carried out ────────────────┘
/// ```
///
/// An evictable slot becomes free after a minute, or when another command evicts it, the oldest first, and last those whose final ACK
/// waits for a link. Until then it recognises duplicates that arrive by satellite (L-16).
#[derive(Clone, Debug)]
pub struct LongCommands<S: ?Sized = [CommandSlot]> {
    slots: S,
}

impl<const N: usize> LongCommands<[CommandSlot; N]> {
    /// All slots free. All zero bits.
    pub const fn new() -> Self {
        const { assert!(N > 0, "command memory needs a place: `commands: {{ slots: 2 }}`, or leave `commands` out") };
        Self { slots: [CommandSlot::FREE; N] }
    }
}

impl<const N: usize> Default for LongCommands<[CommandSlot; N]> {
    fn default() -> Self {
        Self::new()
    }
}

/// The logic works on the unsized form, so it is compiled once for any number of slots.
impl<const N: usize> Deref for LongCommands<[CommandSlot; N]> {
    type Target = LongCommands;

    fn deref(&self) -> &LongCommands {
        self
    }
}

impl<const N: usize> DerefMut for LongCommands<[CommandSlot; N]> {
    fn deref_mut(&mut self) -> &mut LongCommands {
        self
    }
}

impl LongCommands {
    /// Whether there is a slot for another long-running command of this sender.
    pub(crate) fn can_start(&self, sender: Peer) -> bool {
        self.free_slot(sender).is_some()
    }

    /// Sets the progress of `command` in percent; more than 100 means "unknown". Has no effect if it is not running.
    pub fn progress(&mut self, command: MavCmd, percent: u8) {
        let percent = if percent > 100 { NO_PROGRESS } else { percent };
        if let Some(slot) = self.running(command)
            && slot.progress != percent
        {
            slot.progress = percent;
            slot.has_changed = true;
        }
    }

    /// Ends `command`: its final ACK becomes pending on its links. Returns false if it is not running, or if the outcome is
    /// IN_PROGRESS, which does not end it.
    pub fn finish(&mut self, command: MavCmd, outcome: impl Into<Outcome>) -> bool {
        let outcome = outcome.into();
        let slot = self.running(command).filter(|_| outcome.result != MavResult::IN_PROGRESS);
        let Some(slot) = slot else { return false };
        event!("command {=u16} done: {=u8}", command.0, outcome.result.0);
        slot.state = CommandState::Done;
        slot.is_untimed = true;
        slot.outcome = outcome;
        slot.pending = slot.links;
        true
    }

    /// Whether `command` is running.
    pub fn is_running(&self, command: MavCmd) -> bool {
        self.slots.iter().any(|slot| slot.is_running(command))
    }

    /// Whether `command` is running in a component for which `is_it` holds. `of`: only if it is this sender's.
    pub(super) fn is_running_in(&self, command: MavCmd, of: Option<Peer>, is_it: impl Fn(ComponentId) -> bool) -> bool {
        let is_its = |slot: &CommandSlot| of.is_none_or(|sender| slot.is_by(sender));
        self.slots.iter().any(|slot| slot.is_running(command) && is_it(slot.component) && is_its(slot))
    }

    fn running(&mut self, command: MavCmd) -> Option<&mut CommandSlot> {
        self.slots.iter_mut().find(|slot| slot.is_running(command))
    }

    /// Returns the index of a slot for another command: a free one, or the evictable one that ended first, or else, of the sender with
    /// the most slots, if the asking one has fewer (X-3). A slot of another link is taken only if that link has more slots than the asking
    /// one's: invented senders on one link leave half of the slots to the others.
    fn free_slot(&self, asking: Peer) -> Option<usize> {
        let link = LinkMask::of(asking.link);
        let rank = |slot: &CommandSlot| {
            let is_answered = slot.pending.is_empty();
            let (places, own) = match slot.state {
                CommandState::Free => return Some(0),
                CommandState::Evictable => return Some(if is_answered { 1 } else { 2 }),
                // Without links, it is the firmware's own.
                CommandState::Done if is_answered && !slot.links.is_empty() => {
                    let is_near = slot.links.contains(asking.link);
                    let [theirs, own] = [(slot.from, slot.links), (asking.address, link)]
                        .map(|(from, links)| self.places(Some(from).filter(|_| is_near), links));
                    (theirs, own)
                }
                CommandState::Running | CommandState::Done => return None,
            };
            (places > own).then_some(usize::MAX.saturating_sub(places))
        };
        let slots = (0..self.slots.len()).zip(&self.slots);
        slots.filter_map(|(index, slot)| Some((rank(slot)?, slot.at, index))).min().map(|(_, _, index)| index)
    }

    /// Returns the number of slots that the commands on one of these links have, while they run and for three seconds; of all senders or
    /// of one.
    fn places(&self, from: Option<Address>, links: LinkMask) -> usize {
        let is_its = |slot: &&CommandSlot| {
            let is_held = matches!(slot.state, CommandState::Running | CommandState::Done);
            is_held && from.is_none_or(|from| slot.from == from) && slot.links.intersects(links)
        };
        // `count` could overflow, as far as the compiler knows.
        self.slots.iter().filter(is_its).fold(0, |places: usize, _| places.saturating_add(1))
    }

    /// Returns the answer to `command` if it is known without carrying it out.
    pub(super) fn recall(
        &mut self,
        now: Instant,
        command: &Command,
        signed_at: SignedAt,
        limit: ExecutionLimit,
    ) -> Option<Outcome> {
        self.poll(now);
        if let Some(slot) = self.running(command.id) {
            if !slot.is_same(command) {
                return Some(MavResult::TEMPORARILY_REJECTED.into());
            }
            slot.links = slot.links.with(LinkMask::of(command.from.link));
            slot.duplicates.note(command.from.link);
            return Some(MavResult::IN_PROGRESS.into());
        }
        for slot in &mut self.slots {
            if let Some(answer) = slot.answer_to_duplicate(now, command, signed_at, limit) {
                slot.note(now, command);
                return Some(answer);
            }
        }
        let has_slot = self.can_start(command.from) || self.slots.iter().any(|slot| slot.is_run_of(command));
        (limit != ExecutionLimit::None && !has_slot).then_some(MavResult::TEMPORARILY_REJECTED.into())
    }

    /// Returns the answer to a command of the firmware itself, if it is running.
    pub(super) fn recall_own(&mut self, now: Instant, command: &Command) -> Option<Outcome> {
        self.poll(now);
        let slot = self.running(command.id)?;
        Some(if slot.is_same(command) { MavResult::IN_PROGRESS } else { MavResult::TEMPORARILY_REJECTED }.into())
    }

    /// Whether a slot has this command of this sender.
    pub(super) fn knows(&self, command: &Command) -> bool {
        self.slots.iter().any(|slot| slot.state != CommandState::Free && slot.is_same(command))
    }

    /// Records the outcome of an executed `command`.
    pub(super) fn record(
        &mut self,
        now: Instant,
        command: &Command,
        signed_at: SignedAt,
        outcome: Outcome,
        limit: ExecutionLimit,
    ) {
        let is_started = outcome.result == MavResult::IN_PROGRESS;
        let replaces_earlier = is_started && limit == ExecutionLimit::None;
        for slot in &mut self.slots {
            if slot.is_same(command) {
                // An earlier run of this command must not answer for the new one.
                if replaces_earlier && slot.pending.is_empty() {
                    slot.state = CommandState::Free;
                }
            } else if slot.command() == command.id && slot.from == command.from.address {
                // Its sender has given another command since, such as disarming after arming. So the earlier command is not a
                // retransmission when it is received again.
                slot.is_long = false;
            }
        }
        let mut known = None;
        let recorded = if is_started {
            CommandSlot { is_long: true, progress: NO_PROGRESS, ..CommandSlot::new(command, CommandState::Running) }
        } else if limit == ExecutionLimit::None {
            return;
        } else {
            known = self.slots.iter().position(|slot| slot.is_run_of(command));
            CommandSlot { outcome, ..CommandSlot::new(command, CommandState::Done) }
        };
        // If there is no free slot, the vehicle must not have started it: no final ACK will be sent.
        if let Some(slot) = known.or_else(|| self.free_slot(command.from)).and_then(|index| self.slots.get_mut(index)) {
            let duplicates = if known.is_some() { slot.duplicates } else { Duplicates::NONE };
            *slot = CommandSlot { duplicates, at: now, signed_at, ..recorded };
            slot.duplicates.run(command.from.link);
        }
    }

    /// Runs the timers.
    pub(super) fn poll(&mut self, now: Instant) {
        for slot in &mut self.slots {
            if core::mem::take(&mut slot.is_untimed) {
                slot.at = now;
            }
            let age = now - slot.at;
            match slot.state {
                CommandState::Running if age >= REPEAT_EVERY || (slot.has_changed && age >= CHANGE_EVERY) => {
                    slot.has_changed = false;
                    slot.pending = slot.links;
                    slot.at = now;
                }
                CommandState::Done if age >= SOON => slot.state = CommandState::Evictable,
                CommandState::Evictable if age >= DROP_AFTER => {
                    slot.pending = LinkMask::NONE;
                    if age >= LATE {
                        slot.state = CommandState::Free;
                    }
                }
                _ => {}
            }
        }
    }

    /// Returns when [`poll`](Self::poll) has an IN_PROGRESS to send.
    pub(super) fn deadline(&self) -> Instant {
        let running = self.slots.iter().filter(|slot| slot.state == CommandState::Running);
        let next = running.map(|slot| slot.at + (if slot.has_changed { CHANGE_EVERY } else { REPEAT_EVERY }));
        next.min().unwrap_or(Instant::NEVER)
    }

    /// Whether a command of the firmware itself has ended since the last poll: the next one answers it.
    pub(super) fn has_own_end(&self) -> bool {
        self.slots.iter().any(|slot| slot.state == CommandState::Done && slot.is_untimed && slot.links.is_empty())
    }

    /// Whether a final ACK is pending on this link.
    pub(super) fn has_final(&self, link: LinkId) -> bool {
        self.slots.iter().any(|slot| slot.is_pending(CommandState::Done, link))
    }

    /// Whether an IN_PROGRESS is pending on this link.
    pub(super) fn has_progress(&self, link: LinkId) -> bool {
        self.slots.iter().any(|slot| slot.is_pending(CommandState::Running, link))
    }

    /// Returns the component's answer to a command of the firmware itself: its result, or its progress if that is due now.
    pub(crate) fn own_answer(
        &self,
        now: Instant,
        own: Address,
        command: MavCmd,
    ) -> Option<(ComponentId, CommandAnswer)> {
        let is_it = |slot: &&CommandSlot| {
            let is_known = matches!(slot.state, CommandState::Running | CommandState::Done);
            is_known && slot.is_long && slot.from == own && slot.command() == command
        };
        let slot = self.slots.iter().find(is_it)?;
        let (outcome, progress) = match slot.state {
            CommandState::Running if slot.at == now => (MavResult::IN_PROGRESS.into(), slot.progress),
            CommandState::Done => (slot.outcome, NO_PROGRESS),
            _ => return None,
        };
        Some((slot.component, CommandAnswer { command, outcome, progress }))
    }

    /// Returns the first slot with an ACK that is pending on `link` in this state. It is pending no longer.
    fn take_pending(&mut self, state: CommandState, link: LinkId) -> Option<&CommandSlot> {
        let slot = self.slots.iter_mut().find(|slot| slot.is_pending(state, link))?;
        slot.pending = slot.pending.without(LinkMask::of(link));
        Some(slot)
    }

    /// Sends a final ACK on this link (C-20). Returns false if none is pending.
    pub(super) fn send_final<F: Firmware>(&mut self, tx: &mut Outbox) -> bool {
        let Some(slot) = self.take_pending(CommandState::Done, tx.link()) else { return false };
        tx.send_from::<F, _>(Some(slot.component), &slot.ack(slot.outcome, NO_PROGRESS))
    }

    /// Sends an IN_PROGRESS on this link (C-20). Returns false if none is pending.
    pub(super) fn send_progress<F: Firmware>(&mut self, tx: &mut Outbox) -> bool {
        let Some(slot) = self.take_pending(CommandState::Running, tx.link()) else { return false };
        tx.send_from::<F, _>(Some(slot.component), &slot.ack(MavResult::IN_PROGRESS.into(), slot.progress))
    }

    /// Returns the progress of `command` for its first IN_PROGRESS.
    pub(super) fn progress_of(&self, command: MavCmd) -> u8 {
        let slot = self.slots.iter().find(|slot| slot.is_running(command));
        slot.map_or(NO_PROGRESS, |slot| slot.progress)
    }
}

impl Context<'_> {
    /// Starts a long-running command: returns IN_PROGRESS, which the hook must return unchanged. If no slot is free, returns
    /// `TEMPORARILY_REJECTED` (C-22); then the command must not be started. [`LongCommands`] has an example.
    pub fn start(&mut self) -> Outcome {
        let result = if self.can_start { MavResult::IN_PROGRESS } else { MavResult::TEMPORARILY_REJECTED };
        result.into()
    }
}
