//! Counters of promises that the vehicle's hooks did not keep.

counters! {
    /// Broken promises of the vehicle's hooks. Each is a mistake in the firmware, and a text reports it. The counters
    /// wrap.
    HookFaults {
        /// Commands to which a hook answered IN_PROGRESS although no slot for a [long](crate::command::LongCommands) command holds
        /// them: nothing would end them. They were answered FAILED (C-20).
        count unfinished,
        /// Modes that were [accepted](crate::Modes::set_mode) and not reported within a second (C-18).
        count unreported_modes,
    }
}
