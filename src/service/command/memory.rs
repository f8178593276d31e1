//! Commands that outlast their first answer: those that still run, and those that must not be carried out twice.
//!
//! Rules C-12 and C-20 to C-24. One fixed table for both, kept by the vehicle that has such commands, so that one that has
//! none pays nothing for it. The states of a place are drawn at [`CommandMemory`].

use core::ops::{Deref, DerefMut};

use super::copies::REPEATED_WITHIN;
use super::{Copies, LATE, Once, SOON, SignedAt, is_well_after};
use crate::dialect::{CommandAck, MavCmd, MavResult};
use crate::frame::Address;
use crate::link::{LinkClass, LinkId, LinkMask, Outbox};
use crate::time::{Duration, Instant};
use crate::vehicle::{Command, CommandPosition, Outcome};

/// From one IN_PROGRESS to the next (C-20).
const REPEAT_EVERY: Duration = Duration::from_secs(1);

/// And when the progress changes, not sooner than this: a flight loop may tell it in every pass, and others use the line too.
const CHANGE_EVERY: Duration = Duration::from_millis(100);

/// A final ACK that a link has not taken for so long is given up: its place is needed, and nobody waits for it any longer.
const GIVE_UP_AFTER: Duration = Duration::from_secs(10);

/// COMMAND_ACK.progress when there is none to tell.
pub(super) const NO_PROGRESS: u8 = 255;

/// Room for `N` commands that run, or ran within the last three seconds, or must not be carried out twice: see
/// [`CommandMemory`].
pub type CommandSlots<const N: usize> = CommandMemory<[CommandSlot; N]>;

/// One place of a [`CommandMemory`].
#[doc(hidden)]
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CommandSlot {
    key: Key,
    from: Address,
    confirmation: u8,
    is_broadcast: bool,
    state: State,
    /// `at` is not known yet: the vehicle, which changed the slot, has no clock here.
    is_new: bool,
    /// It answered IN_PROGRESS once (C-24), and is not only to be carried out once (C-12).
    is_long: bool,
    progress: u8,
    /// The progress is another one than was told last.
    has_changed: bool,
    /// Where it was asked for.
    links: LinkMask,
    copies: Copies,
    /// Where the next ACK is to be sent.
    owed: LinkMask,
    outcome: Outcome,
    /// When its last IN_PROGRESS was due; for one that is done, when it was.
    at: Instant,
    /// Time from `at` to its last duplicate (ms).
    repeated_after: u16,
    signed_at: SignedAt,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
enum State {
    Free,
    Running,
    Done,
    /// Done a while ago: another command may have its place.
    Past,
}

/// All that makes two commands of one sender the same: number, form, frame, and the bits of the parameters.
type Key = [u32; 8];

fn key(command: &Command) -> Key {
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
        confirmation: 0,
        is_broadcast: false,
        state: State::Free,
        is_new: false,
        is_long: false,
        progress: 0,
        has_changed: false,
        links: LinkMask::NONE,
        copies: Copies::NONE,
        owed: LinkMask::NONE,
        outcome: Outcome { result: MavResult::ACCEPTED, result_param2: 0 },
        at: Instant::ZERO,
        repeated_after: 0,
        signed_at: None,
    };

    fn new(command: &Command, state: State) -> Self {
        Self {
            key: key(command),
            from: command.from.address,
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
        self.state == State::Running && self.command() == command
    }

    fn is_same(&self, command: &Command) -> bool {
        self.from == command.from.address && self.key == key(command)
    }

    /// Whether `command`, which equals this one and came by its link before, retransmits it because it was not answered
    /// (C-12).
    fn is_repeated_by(&self, now: Instant, command: &Command) -> bool {
        let pause = millis(now.since(self.at)).saturating_sub(self.repeated_after);
        (command.confirmation, command.is_broadcast) == (self.confirmation, self.is_broadcast)
            && now.since(self.at) < SOON
            && pause <= REPEATED_WITHIN
    }

    /// Records a duplicate that was [answered](Self::answer).
    fn count(&mut self, now: Instant, command: &Command) {
        let link = command.from.link;
        if !self.copies.lacks(link) && self.is_repeated_by(now, command) {
            // Each other link may deliver it once more too.
            self.copies.run(link);
        } else {
            self.copies.count(link);
        }
        self.repeated_after = millis(now.since(self.at));
    }

    /// Returns the answer if this command is done and `command` is a duplicate of it (C-12, C-24).
    fn answer(&self, now: Instant, command: &Command, signed_at: SignedAt, once: Once) -> Option<Outcome> {
        let is_done = matches!(self.state, State::Done | State::Past);
        let age = now.since(self.at);
        // Only a satellite brings one late.
        let may_be_late = once != Once::No && command.class == LinkClass::HighLatency;
        if !is_done || age >= if may_be_late { LATE } else { SOON } || !self.is_same(command) {
            return None;
        }
        let signed = self.signed_at.zip(signed_at).filter(|_| may_be_late);
        let is_later = signed.is_some_and(|(known, sent)| is_well_after(sent, known));
        let is_earlier = signed.is_some_and(|(known, sent)| is_well_after(known, sent));
        // A command pressed twice comes twice on each link, with the same confirmation.
        let lacks = self.copies.lacks(command.from.link);
        // After TEMPORARILY_REJECTED the client asks again, and the vehicle may do it now.
        let is_final = self.outcome.result != MavResult::TEMPORARILY_REJECTED;
        let is_repeated = once == Once::Yes && is_final && self.is_repeated_by(now, command);
        let is_copy = if lacks { !is_later } else { command.confirmation > self.confirmation || is_repeated };
        let is_known = is_copy || (self.is_long && age < SOON);
        if !is_known {
            return None;
        }
        // ACCEPTED is not for what may be a new one.
        let is_repetition = !lacks && self.links.contains(LinkMask::of(command.from.link));
        let is_sure = age < SOON || (signed.is_some() && !is_later && !is_earlier) || is_repetition;
        Some(if is_sure { self.outcome } else { MavResult::TEMPORARILY_REJECTED.into() })
    }

    /// Whether one more run of `command` belongs here.
    fn is_run_of(&self, command: &Command) -> bool {
        self.state == State::Done && !self.is_long && self.is_same(command)
    }

    /// Takes what is owed on `link`.
    fn take(&mut self, state: State, link: LinkId) -> bool {
        let link = LinkMask::of(link);
        let is_owed = self.state == state && self.owed.contains(link);
        if is_owed {
            self.owed = self.owed.without(link);
        }
        is_owed
    }

    fn ack(&self, outcome: Outcome, progress: u8) -> CommandAck {
        CommandAck {
            command: self.command(),
            result: outcome.result,
            progress,
            result_param2: outcome.result_param2,
            target_system: self.from.system.0,
            target_component: self.from.component.0,
        }
    }
}

/// The vehicle's memory for commands that take their time, and for those that must not be carried out twice. The vehicle
/// keeps it and hands it to the stack by [`Commands::command_memory`](crate::Commands::command_memory).
///
/// A command that takes its time is [started](Self::start) when it comes, and [finished](Self::finish) by the flight loop;
/// nothing in between calls back:
///
/// ```
/// use mavstack::dialect::{MavCmd, MavResult};
/// use mavstack::{Command, CommandMemory, CommandSlots, Commands, Outcome};
///
/// struct Copter { commands: CommandSlots<2>, samples: u8 }
///
/// impl Commands for Copter {
///     fn command(&mut self, command: &Command) -> Outcome {
///         match command.id {
///             MavCmd::PREFLIGHT_CALIBRATION => {
///                 self.samples = 0;
///                 self.commands.start(command)
///             }
///             _ => MavResult::UNSUPPORTED.into(),
///         }
///     }
///
///     fn command_memory(&mut self) -> Option<&mut CommandMemory> {
///         Some(&mut self.commands)
///     }
///
///     fn cancel_command(&mut self, command: MavCmd, _: mavstack::Peer) -> bool {
///         command == MavCmd::PREFLIGHT_CALIBRATION
///     }
/// }
///
/// impl Copter {
///     /// A part of the flight loop.
///     fn calibrate(&mut self) {
///         if !self.commands.is_running(MavCmd::PREFLIGHT_CALIBRATION) {
///             return;
///         }
///         self.samples += 1;
///         self.commands.progress(MavCmd::PREFLIGHT_CALIBRATION, self.samples);
///         if self.samples == 100 {
///             self.commands.finish(MavCmd::PREFLIGHT_CALIBRATION, MavResult::ACCEPTED);
///         }
///     }
/// }
/// ```
///
/// The stack answers the rest: IN_PROGRESS once a second and when the progress changes, though not more than ten times a
/// second and not over a high-latency link, the final ACK on every link that the command came by, `TEMPORARILY_REJECTED` to
/// others while it runs, a repetition without running it again, and COMMAND_CANCEL (C-20 to C-24). A place is in use until
/// three seconds after the command is done; without a free one a command is `TEMPORARILY_REJECTED` (C-22).
///
/// What came by one link comes by satellite half a minute later. So what must be carried out only
/// [once](crate::CommandPolicy::once) is remembered for a minute, for copies by a
/// [high-latency](crate::LinkClass::HighLatency) link only, in a place that nothing else needs: with `N` places at least the
/// last `N` commands, less those that run. Other commands that have ended may be given again after three seconds by any link.
/// A place takes 88 bytes.
///
/// The timers ride on [`Stack::poll`](crate::Stack::poll): while a command runs call that once a second at least, as the
/// heartbeat asks for anyway.
///
/// Each command has a place, until another one needs it:
///
/// ```text
///            start                         finish, COMMAND_CANCEL             every final ACK sent, and 3 s passed
///   free ───────────▶ running ──────────────────────────────────▶ done ───────────────────────────────────▶ past
///     │    IN_PROGRESS at once, at 1 Hz, on change                ▲  a repetition gets the final ACK again
///     └────────────── not idempotent, carried out ────────────────┘
/// ```
///
/// What is past has its place until a minute is over or another command needs it, the oldest first: a copy may still come by
/// satellite (L-16).
#[derive(Clone, Debug)]
pub struct CommandMemory<S: ?Sized = [CommandSlot]> {
    slots: S,
}

impl<const N: usize> CommandMemory<[CommandSlot; N]> {
    /// Nothing runs. All zero bits.
    pub const fn new() -> Self {
        const { assert!(N > 0, "command memory needs a place: CommandSlots<2>, or leave `command_memory` out") };
        Self { slots: [CommandSlot::FREE; N] }
    }
}

impl<const N: usize> Default for CommandMemory<[CommandSlot; N]> {
    fn default() -> Self {
        Self::new()
    }
}

/// The logic works on the unsized form, so the number of places is compiled once.
impl<const N: usize> Deref for CommandMemory<[CommandSlot; N]> {
    type Target = CommandMemory;

    fn deref(&self) -> &CommandMemory {
        self
    }
}

impl<const N: usize> DerefMut for CommandMemory<[CommandSlot; N]> {
    fn deref_mut(&mut self) -> &mut CommandMemory {
        self
    }
}

impl CommandMemory {
    /// `command`, which is being handed to the vehicle, takes its time: IN_PROGRESS, to be returned as it is; or
    /// `TEMPORARILY_REJECTED` when no place is free (C-22), and then it must not be begun.
    pub fn start(&mut self, command: &Command) -> Outcome {
        let Some(slot) = self.vacant().and_then(|place| self.slots.get_mut(place)) else {
            return MavResult::TEMPORARILY_REJECTED.into();
        };
        let started = CommandSlot::new(command, State::Running);
        *slot = CommandSlot { is_new: true, is_long: true, progress: NO_PROGRESS, ..started };
        slot.copies.run(command.from.link);
        MavResult::IN_PROGRESS.into()
    }

    /// How far `command` is, in percent; more than 100 is "not known". Nothing happens when it does not run.
    pub fn progress(&mut self, command: MavCmd, percent: u8) {
        let percent = if percent > 100 { NO_PROGRESS } else { percent };
        if let Some(slot) = self.running(command)
            && slot.progress != percent
        {
            slot.progress = percent;
            slot.has_changed = true;
        }
    }

    /// `command` has ended: its final ACK goes out as soon as its links are polled. False when it does not run, and for
    /// IN_PROGRESS, which is no end.
    pub fn finish(&mut self, command: MavCmd, outcome: impl Into<Outcome>) -> bool {
        let outcome = outcome.into();
        let slot = self.running(command).filter(|_| outcome.result != MavResult::IN_PROGRESS);
        let Some(slot) = slot else { return false };
        event!("command {=u16} done: {=u8}", command.0, outcome.result.0);
        slot.state = State::Done;
        slot.is_new = true;
        slot.outcome = outcome;
        slot.owed = slot.links;
        true
    }

    /// Whether `command` runs.
    pub fn is_running(&self, command: MavCmd) -> bool {
        self.slots.iter().any(|slot| slot.is_running(command))
    }

    fn running(&mut self, command: MavCmd) -> Option<&mut CommandSlot> {
        self.slots.iter_mut().find(|slot| slot.is_running(command))
    }

    /// A place for another command: a free one, or that of the one that is past for longest.
    fn vacant(&self) -> Option<usize> {
        let places = (0..self.slots.len()).zip(&self.slots);
        let places = places.filter(|(_, slot)| matches!(slot.state, State::Free | State::Past));
        places.min_by_key(|(_, slot)| (slot.state == State::Past, slot.at)).map(|(place, _)| place)
    }

    /// Returns the answer to `command` if it is known without carrying it out.
    #[inline(never)]
    pub(crate) fn recall(
        &mut self,
        now: Instant,
        command: &Command,
        signed_at: SignedAt,
        once: Once,
    ) -> Option<Outcome> {
        self.poll(now);
        if let Some(slot) = self.running(command.id) {
            if !slot.is_same(command) {
                return Some(MavResult::TEMPORARILY_REJECTED.into());
            }
            slot.links = slot.links.with(LinkMask::of(command.from.link));
            slot.copies.count(command.from.link);
            return Some(MavResult::IN_PROGRESS.into());
        }
        for slot in &mut self.slots {
            if let Some(answer) = slot.answer(now, command, signed_at, once) {
                slot.count(now, command);
                return Some(answer);
            }
        }
        let has_room = self.vacant().is_some() || self.slots.iter().any(|slot| slot.is_run_of(command));
        (once != Once::No && !has_room).then_some(MavResult::TEMPORARILY_REJECTED.into())
    }

    /// Whether this command of this sender is remembered.
    pub(crate) fn knows(&self, command: &Command) -> bool {
        self.slots.iter().any(|slot| slot.state != State::Free && slot.is_same(command))
    }

    /// `command` was handed to the vehicle, which answered `outcome`.
    #[inline(never)]
    pub(crate) fn settle(
        &mut self,
        now: Instant,
        command: &Command,
        signed_at: SignedAt,
        outcome: Outcome,
        once: Once,
    ) {
        let is_started = |slot: &&mut CommandSlot| slot.is_new && slot.is_long && slot.command() == command.id;
        if let Some(slot) = self.slots.iter_mut().find(is_started) {
            slot.is_new = false;
            slot.at = now;
            slot.signed_at = signed_at;
            if outcome.result == MavResult::IN_PROGRESS {
                return;
            }
            // It thought better of it.
            slot.state = State::Free;
        }
        if once == Once::No {
            return;
        }
        let done = CommandSlot { outcome, at: now, signed_at, ..CommandSlot::new(command, State::Done) };
        let known = self.slots.iter().position(|slot| slot.is_run_of(command));
        if let Some(slot) = known.or_else(|| self.vacant()).and_then(|place| self.slots.get_mut(place)) {
            let copies = if known.is_some() { slot.copies } else { Copies::NONE };
            *slot = CommandSlot { copies, ..done };
            slot.copies.run(command.from.link);
        }
    }

    /// Runs the timers.
    pub(crate) fn poll(&mut self, now: Instant) {
        for slot in &mut self.slots {
            if core::mem::take(&mut slot.is_new) {
                slot.at = now;
            }
            let age = now.since(slot.at);
            match slot.state {
                State::Running if age >= REPEAT_EVERY || (slot.has_changed && age >= CHANGE_EVERY) => {
                    slot.has_changed = false;
                    slot.owed = slot.links;
                    slot.at = now;
                }
                State::Done if age >= GIVE_UP_AFTER || (age >= SOON && slot.owed.is_empty()) => {
                    slot.state = State::Past;
                    slot.owed = LinkMask::NONE;
                }
                State::Past if age >= LATE => slot.state = State::Free,
                _ => {}
            }
        }
    }

    /// Sends a final ACK on this link (C-20). False when none is owed.
    pub(crate) fn next_final(&mut self, tx: &mut Outbox) -> bool {
        let link = tx.link();
        let Some(slot) = self.slots.iter_mut().find_map(|slot| slot.take(State::Done, link).then_some(slot)) else {
            return false;
        };
        tx.send(&slot.ack(slot.outcome, NO_PROGRESS))
    }

    /// Sends an IN_PROGRESS on this link (C-20). False when none is due.
    pub(crate) fn next_progress(&mut self, tx: &mut Outbox) -> bool {
        let link = tx.link();
        let Some(slot) = self.slots.iter_mut().find_map(|slot| slot.take(State::Running, link).then_some(slot)) else {
            return false;
        };
        tx.send(&slot.ack(MavResult::IN_PROGRESS.into(), slot.progress))
    }

    /// How far `command` is, for its first IN_PROGRESS.
    pub(crate) fn progress_of(&self, command: MavCmd) -> u8 {
        let slot = self.slots.iter().find(|slot| slot.is_running(command));
        slot.map_or(NO_PROGRESS, |slot| slot.progress)
    }
}
