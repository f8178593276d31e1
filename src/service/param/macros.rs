//! `parameters!`: from a declaration, one line a parameter, to a table with typed access.

/// Declares a vehicle's parameters: a struct that holds their values, and a constant for each of them.
///
/// A line is the name as it stands on the wire, its type, its default, the range that it takes, its unit, and flags where it
/// has some: `read_only` (only the vehicle itself sets it), `reboot_required` (a change has its effect after the next start)
/// and `volatile` (not stored). The types are `u8`, `i8`, `u16`, `i16`, `u32`, `i32` and `f32`; a `f32` reads the same in
/// every client, whatever it thinks of integers (P-2).
///
/// ```
/// mavstack::parameters! {
///     /// What can be tuned on this rover.
///     pub struct Tuning {
///         /// Voltage under which it goes home.
///         BAT_LOW: f32 = 10.5, 9.0..=12.6, "V";
///         /// How often it was started.
///         STAT_STARTS: u32 = 0, 0..=u32::MAX, "", [read_only];
///         /// System id.
///         SYS_ID: u8 = 1, 1..=254, "", [reboot_required];
///     }
/// }
/// use mavstack::ParamTable;
///
/// let mut tuning = Tuning::new();
/// assert_eq!((tuning.get(Tuning::BAT_LOW), tuning.get(Tuning::SYS_ID)), (10.5, 1));
/// // The ground is told of it.
/// assert!(tuning.set(Tuning::STAT_STARTS, 7));
/// assert_eq!(tuning.get(Tuning::STAT_STARTS), 7);
/// assert_eq!((Tuning::INFO[0].name(), Tuning::UNITS[0]), ("BAT_LOW", "V"));
/// ```
///
/// What clients could not work with does not compile. A name is ASCII and has at most 16 bytes (P-1):
///
/// ```compile_fail
/// mavstack::parameters! { pub struct Tuning { A_NAME_OF_17_BYTES: u8 = 0, 0..=1, ""; } }
/// ```
///
/// ```compile_fail
/// mavstack::parameters! { pub struct Tuning { SCHRÄGE: u8 = 0, 0..=1, ""; } }
/// ```
///
/// Each name stands once, in the order of ASCII, or the hash of the table would not be that of the ground (P-20):
///
/// ```compile_fail
/// mavstack::parameters! { pub struct Tuning { B: u8 = 0, 0..=1, ""; A: u8 = 0, 0..=1, ""; } }
/// ```
///
/// ```compile_fail
/// mavstack::parameters! { pub struct Tuning { A: u8 = 0, 0..=1, ""; A: u8 = 0, 0..=1, ""; } }
/// ```
///
/// The default lies within the range, and no float is anything but a number:
///
/// ```compile_fail
/// mavstack::parameters! { pub struct Tuning { A: i8 = 3, -2..=2, ""; } }
/// ```
///
/// ```compile_fail
/// mavstack::parameters! { pub struct Tuning { A: f32 = f32::NAN, -2.0..=2.0, ""; } }
/// ```
///
/// ```compile_fail
/// mavstack::parameters! { pub struct Tuning { A: f32 = 0.0, -2.0..=f32::INFINITY, ""; } }
/// ```
///
/// There are no other types and no other flags, and the name of the hash is taken:
///
/// ```compile_fail
/// mavstack::parameters! { pub struct Tuning { A: u64 = 0, 0..=1, ""; } }
/// ```
///
/// ```compile_fail
/// mavstack::parameters! { pub struct Tuning { A: u8 = 0, 0..=1, "", [hidden]; } }
/// ```
///
/// ```compile_fail
/// mavstack::parameters! { pub struct Tuning { _HASH_CHECK: u32 = 0, 0..=1, ""; } }
/// ```
#[macro_export]
macro_rules! parameters {
    (
        $(#[$meta:meta])*
        $vis:vis struct $name:ident {
            $(
                $(#[doc = $doc:literal])*
                $param:ident: $ty:ident = $default:expr, $range:expr, $unit:literal $(, [$($flag:ident),* $(,)?])?;
            )+
        }
    ) => {
        $(#[$meta])*
        #[derive(Clone, Debug)]
        $vis struct $name {
            memory: $crate::__ParamMemory<{ [$(stringify!($param)),+].len() }>,
        }

        #[allow(missing_docs, non_upper_case_globals, reason = "a parameter's name is its name on the wire")]
        #[allow(dead_code, reason = "some parameters are only for the ground")]
        impl $name {
            $(
                $(#[doc = $doc])*
                pub const $param: $crate::Param<Self, $ty> = $crate::Param::__at($crate::ParamInfo::position(
                    &Self::__TABLE,
                    &$crate::ParamInfo::$ty(stringify!($param), $default, &($range)),
                ));
            )+

            const __TABLE: [$crate::ParamInfo; [$(stringify!($param)),+].len()] = {
                let table = [$(
                    $crate::ParamInfo::$ty(stringify!($param), $default, &($range))$($(.$flag())*)?,
                )+];
                $crate::ParamInfo::check(&table);
                table
            };

            /// Every parameter with its default.
            pub const fn new() -> Self {
                Self { memory: $crate::__ParamMemory::new(<Self as $crate::ParamTable>::INFO) }
            }

            /// A parameter's value, without a search.
            #[inline]
            pub fn get<T: $crate::ParamType>(&self, param: $crate::Param<Self, T>) -> T {
                self.memory.get(param)
            }

            /// Sets a parameter, also one that is read-only to the ground, which is told. False, and nothing changes, when the
            /// value is out of its range or no number.
            pub fn set<T: $crate::ParamType>(&mut self, param: $crate::Param<Self, T>, value: T) -> bool {
                $crate::ParamTable::table_mut(self).set(param, value)
            }
        }

        // Checked where they are declared, not where they are first used.
        const _: &[$crate::ParamInfo] = <$name as $crate::ParamTable>::INFO;

        impl $crate::ParamTable for $name {
            const INFO: &'static [$crate::ParamInfo] = &Self::__TABLE;
            const UNITS: &'static [&'static str] = &[$($unit),+];
            const DESCRIPTIONS: &'static [&'static str] = &[$(concat!($($doc),*)),+];

            fn table_mut(&mut self) -> $crate::__ParamTableMut<'_> {
                self.memory.table_mut(Self::INFO)
            }
        }

        impl Default for $name {
            fn default() -> Self {
                Self::new()
            }
        }
    };
}
