//! `parameters!` generates a table with typed access from a declaration with one line per parameter.

/// Declares a vehicle's parameters: a struct that holds their values, and a constant for each of them.
///
/// A line has the parameter's name on the wire, type, default, range, unit, and optional flags: `read_only` (only the vehicle
/// itself sets it), `reboot_required` (a change takes effect after the next start) and `volatile` (not stored). The types are
/// `u8`, `i8`, `u16`, `i16`, `u32`, `i32` and `f32`. Prefer `i32` and `f32`: every client can read and set them, while MAVSDK lists no
/// unsigned parameters and cannot set integers of 8 and 16 bits (P-19). Integers beyond 2^24 are not exact for clients that
/// cast (P-2).
///
/// ```
/// mavstack::parameters! {
///     /// The parameters of this rover.
///     pub struct Tuning {
///         /// Voltage below which it returns home.
///         BAT_LOW: f32 = 10.5, 9.0..=12.6, "V";
///         /// Number of starts.
///         STAT_STARTS: i32 = 0, 0..=i32::MAX, "", [read_only];
///         /// System id.
///         SYS_ID: i32 = 1, 1..=254, "", [reboot_required];
///     }
/// }
/// use mavstack::param::ParamTable;
///
/// let mut tuning = Tuning::new();
/// assert_eq!((tuning.get(Tuning::BAT_LOW), tuning.get(Tuning::SYS_ID)), (10.5, 1));
/// // The new value is sent to the ground stations.
/// assert!(tuning.set(Tuning::STAT_STARTS, 7));
/// assert_eq!(tuning.get(Tuning::STAT_STARTS), 7);
/// assert_eq!((Tuning::INFO[0].name(), Tuning::UNITS[0]), ("BAT_LOW", "V"));
/// ```
///
/// A table that clients could not handle does not compile. A name is ASCII and has at most 16 bytes (P-1):
///
/// ```compile_fail
/// mavstack::parameters! { pub struct Tuning { A_NAME_OF_17_BYTES: i32 = 0, 0..=1, ""; } }
/// ```
///
/// ```compile_fail
/// mavstack::parameters! { pub struct Tuning { SCHRÄGE: i32 = 0, 0..=1, ""; } }
/// ```
///
/// Names are unique and in ASCII order; otherwise the hash of the table would differ from the ground station's (P-20):
///
/// ```compile_fail
/// mavstack::parameters! { pub struct Tuning { B: i32 = 0, 0..=1, ""; A: i32 = 0, 0..=1, ""; } }
/// ```
///
/// ```compile_fail
/// mavstack::parameters! { pub struct Tuning { A: i32 = 0, 0..=1, ""; A: i32 = 0, 0..=1, ""; } }
/// ```
///
/// The default lies within the range, and floats are finite:
///
/// ```compile_fail
/// mavstack::parameters! { pub struct Tuning { A: i32 = 3, -2..=2, ""; } }
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
/// There are no other types and flags, and the name of the hash is reserved:
///
/// ```compile_fail
/// mavstack::parameters! { pub struct Tuning { A: u64 = 0, 0..=1, ""; } }
/// ```
///
/// ```compile_fail
/// mavstack::parameters! { pub struct Tuning { A: i32 = 0, 0..=1, "", [hidden]; } }
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
            memory: $crate::__private::ParamValues<{ [$(stringify!($param)),+].len() }>,
        }

        #[allow(missing_docs, non_upper_case_globals, reason = "a parameter's name is its name on the wire")]
        #[allow(dead_code, reason = "some parameters are only for the ground")]
        impl $name {
            $(
                $(#[doc = $doc])*
                pub const $param: $crate::Param<Self, $ty> =
                    $crate::Param::__at($crate::__private::position(Self::__NAMES, stringify!($param)));
            )+

            const __NAMES: &'static [&'static str] = &[$(stringify!($param)),+];

            const __TABLE: [$crate::param::ParamInfo; Self::__NAMES.len()] = [$(
                $crate::param::ParamInfo::$ty(stringify!($param), $default, &($range)).info()$($(.$flag())*)?,
            )+];

            /// Returns a table with every parameter at its default.
            pub fn new() -> Self {
                let mut table = <Self as $crate::__private::ParamMemory>::VACANT;
                $crate::__private::ParamMemory::begin(&mut table);
                table
            }

            /// Returns a parameter's value, without a search.
            #[inline]
            pub fn get<T: $crate::param::ParamType>(&self, param: $crate::Param<Self, T>) -> T {
                self.memory.get(param)
            }

            /// Sets a parameter, even a read-only one, and sends the new value to the ground stations. Returns false, without a
            /// change, if the value is out of range or not a finite number.
            pub fn set<T: $crate::param::ParamType>(&mut self, param: $crate::Param<Self, T>, value: T) -> bool {
                $crate::param::ParamTable::table_mut(self).set(param, value)
            }
        }

        // Each row is checked at the declaration, not at the first use. For the compiler's message, the struct has the name of the
        // parameter, and the default its place.
        $(
            #[allow(non_camel_case_types, clippy::upper_case_acronyms, reason = "a parameter's name is its name on the wire")]
            #[allow(dead_code, reason = "the struct is only a name")]
            const _: () = {
                struct $param {}
                const NAME: &str = stringify!($param);
                const ROW: $crate::__private::Row = $crate::param::ParamInfo::$ty(NAME, $default, &($range));
                const IS_IN_ORDER: bool = $crate::__private::is_in_order($name::__NAMES, NAME);
                type Checked = $crate::__private::Checked<
                    $param, $ty, { ROW.is_named(NAME) }, { ROW.is_within_range() }, IS_IN_ORDER,
                >;
                Checked::row($default)
            };
        )+

        impl $crate::param::ParamTable for $name {
            const INFO: &'static [$crate::param::ParamInfo] = &Self::__TABLE;
            const UNITS: &'static [&'static str] = &[$($unit),+];
            const DESCRIPTIONS: &'static [&'static str] = &[$(concat!($($doc),*)),+];

            fn table_mut(&mut self) -> $crate::__private::TableMut<'_> {
                self.memory.table_mut(Self::INFO)
            }
        }

        impl $crate::__private::Values for $name {
            fn values(&self) -> &[u32] {
                self.memory.values()
            }
        }

        impl $crate::__private::ParamMemory for $name {
            type Service = $crate::__private::ParamService;

            const VACANT: Self = Self { memory: $crate::__private::ParamValues::VACANT };

            fn begin(&mut self) {
                self.memory.begin(<Self as $crate::param::ParamTable>::INFO);
            }
        }

        impl Default for $name {
            fn default() -> Self {
                Self::new()
            }
        }
    };
}
