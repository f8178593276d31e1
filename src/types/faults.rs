//! Counters of promises that the vehicle's hooks did not keep.

/// Answers of the vehicle's hooks that promise what does not happen. Each is a mistake in the firmware, and a text reports it. The
/// counters wrap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct HookFaults {
    /// Commands to which a hook answered IN_PROGRESS although no slot for a [long](crate::command::LongCommands) command holds them:
    /// nothing would end them. They were answered FAILED (C-20).
    pub unfinished: u32,
    /// Modes that were [accepted](crate::Modes::set_mode) and not reported within a second (C-18).
    pub unreported_modes: u32,
}

impl HookFaults {
    pub(crate) const ZERO: Self = Self { unfinished: 0, unreported_modes: 0 };
}
