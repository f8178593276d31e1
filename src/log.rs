//! Log events: one per protocol transition and drop reason, compiled to nothing without the feature `defmt`.

/// Something a developer at the bench wants to see.
#[cfg(feature = "defmt")]
macro_rules! event {
    ($($arg:tt)*) => { defmt::debug!($($arg)*) };
}

/// Without a logger the arguments are type-checked and dropped.
#[cfg(not(feature = "defmt"))]
macro_rules! event {
    ($format:literal $(, $arg:expr)* $(,)?) => { { $( let _ = &$arg; )* } };
}
