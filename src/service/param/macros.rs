//! `parameters!` generates a table with typed access from a declaration with one line per parameter.

/// Declares a vehicle's parameters: a struct that holds their values, and a constant for each of them.
///
/// A row has the parameter's name on the wire, type, default, range and unit. The doc comment is the description that ground
/// stations show. The types are `u8`, `i8`, `u16`, `i16`, `u32`, `i32` and `f32`. Prefer `i32` and `f32`: every client can read and
/// set them, while MAVSDK lists no unsigned parameters and cannot set integers of 8 and 16 bits (P-19). Integers beyond 2^24 are
/// not exact for clients that cast (P-2).
///
/// ```
/// mavstack::parameters! {
///     /// The parameters of this rover.
///     pub struct Tuning {
///         /// Voltage below which it returns home.
///         BAT_LOW: f32 = 10.5, 9.0..=12.6, "V" { decimals: 1, increment: 0.1 };
///         /// Action when the last ground station is lost.
///         FS_GCS_ACT: i32 = 1, 0..=2, "" { values: { 0 => "None", 1 => "Hold", 2 => "Return" }, category: "Failsafe" };
///         /// Sensors that it uses.
///         SENSORS: i32 = 5, 0..=7, "" { bitmask: { 0 => "GPS", 1 => "Compass", 2 => "Sonar" }, reboot_required };
///         /// Number of starts.
///         STAT_STARTS: i32 = 0, 0..=i32::MAX, "" { read_only };
///         /// MAVLink system id.
///         SYS_ID: i32 = 1, 1..=254, "" { system_id };
///     }
/// }
/// use mavstack::param::ParamTable;
///
/// let mut tuning = Tuning::new();
/// assert_eq!((tuning.get(Tuning::BAT_LOW), tuning.get(Tuning::SYS_ID)), (10.5, 1));
/// // The new value is sent to the ground stations.
/// assert!(tuning.set(Tuning::STAT_STARTS, 7));
/// assert_eq!(tuning.get(Tuning::STAT_STARTS), 7);
/// assert_eq!((Tuning::INFO[0].name(), Tuning::DETAILS[0].unit), ("BAT_LOW", "V"));
/// ```
///
/// # Attributes
///
/// Attributes are optional. They stand in braces behind the unit, in any order.
///
/// | attribute | effect |
/// |---|---|
/// | `read_only` | only the vehicle itself sets it; a client gets PARAM_ERROR READ_ONLY, and a text that names it |
/// | `reboot_required` | a change takes effect after the next start: ground stations say so |
/// | `volatile` | it is not stored |
/// | `system_id` | the vehicle's MAVLink system id: see below |
/// | `values: { 0 => "Off", 1 => "On" }` | names of values: a ground station offers them as a list |
/// | `bitmask: { 0 => "GPS", 2 => "Sonar" }` | names of bits, 0 is the lowest: a ground station shows boxes to tick |
/// | `decimals: 2` | the number of decimals that a ground station shows |
/// | `increment: 0.5` | the step by which a ground station changes it |
/// | `category: "System"` | the part of a ground station's list |
/// | `group: "Battery"` | its part of the category; otherwise the part of its name before the first `_` |
///
/// The last six rows are for [`metadata::parameters`](crate::metadata), which ground stations read. They take no flash and
/// no RAM. Constants may stand in place of numbers.
///
/// # The system id
///
/// A parameter with `system_id` replaces the system of [`Config::address`](crate::Config::address): its default at
/// [`begin`](crate::Stack::begin), and its stored value as soon as the parameters were read. A client's change takes effect at
/// the next start, as in PX4, because the answer to the change would come from another vehicle. Its range lies within 1 to 254: 0 means
/// everyone, and 255 is a ground station's.
///
/// A vehicle that restores its parameters beside the loop, by [`attach_storage`](crate::Stack::attach_storage), has the default until
/// then. So call [`restore`](crate::Stack::restore) before the loop if there may be several vehicles.
///
/// # What does not compile
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
/// There are no other types and attributes, and the name of the hash is reserved:
///
/// ```compile_fail
/// mavstack::parameters! { pub struct Tuning { A: u64 = 0, 0..=1, ""; } }
/// ```
///
/// ```compile_fail
/// mavstack::parameters! { pub struct Tuning { A: i32 = 0, 0..=1, "" { hidden }; } }
/// ```
///
/// ```compile_fail
/// mavstack::parameters! { pub struct Tuning { _HASH_CHECK: u32 = 0, 0..=1, ""; } }
/// ```
///
/// Named values and bits lie within the range, each once, and a system id is 1 to 254:
///
/// ```compile_fail
/// mavstack::parameters! { pub struct Tuning { A: i32 = 0, 0..=1, "" { values: { 0 => "Off", 2 => "On" } }; } }
/// ```
///
/// ```compile_fail
/// mavstack::parameters! { pub struct Tuning { A: i32 = 0, 0..=7, "" { bitmask: { 3 => "Sonar" } }; } }
/// ```
///
/// ```compile_fail
/// mavstack::parameters! { pub struct Tuning { A: i32 = 1, 1..=255, "" { system_id }; } }
/// ```
#[macro_export]
macro_rules! parameters {
    (
        $(#[$meta:meta])*
        $vis:vis struct $name:ident {
            $(
                $(#[doc = $doc:literal])*
                $param:ident: $ty:ident = $default:expr, $range:expr, $unit:literal
                    $({ $($key:ident $(: $value:tt)?),* $(,)? })?;
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

            const __ATTRIBUTES: [$crate::__private::ParamAttributes; Self::__NAMES.len()] = [$(
                $crate::__private::ParamAttributes::new($unit, concat!($($doc),*))
                    $($(.$key($($crate::__parameter_attribute!($key $ty $value))?))*)?,
            )+];

            const __DETAILS: [$crate::param::ParamDetails; Self::__NAMES.len()] =
                $crate::__private::details(&Self::__ATTRIBUTES);

            const __TABLE: [$crate::param::ParamInfo; Self::__NAMES.len()] = [$(
                $crate::__private::attributes_at(
                    &Self::__ATTRIBUTES,
                    $crate::__private::position(Self::__NAMES, stringify!($param)),
                )
                .flagged($crate::param::ParamInfo::$ty(stringify!($param), $default, &($range)).info()),
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
                const ATTRIBUTES: $crate::__private::ParamAttributes = $crate::__private::attributes_at(
                    &$name::__ATTRIBUTES,
                    $crate::__private::position($name::__NAMES, NAME),
                );
                const INFO: $crate::param::ParamInfo = ROW.info();
                type Checked = $crate::__private::Checked<
                    $param, $ty, { ROW.is_named(NAME) }, { ROW.is_within_range() }, IS_IN_ORDER,
                >;
                type Detailed = $crate::__private::Detailed<
                    $param,
                    $ty,
                    { ATTRIBUTES.has_valid_values(&INFO) },
                    { ATTRIBUTES.has_valid_bits(&INFO) },
                    { ATTRIBUTES.has_valid_steps(&INFO) },
                    { ATTRIBUTES.has_valid_system_id(&INFO, &$name::__ATTRIBUTES) },
                >;
                Checked::row($default);
                Detailed::row($default)
            };
        )+

        impl $crate::param::ParamTable for $name {
            const INFO: &'static [$crate::param::ParamInfo] = &Self::__TABLE;
            const DETAILS: &'static [$crate::param::ParamDetails] = &Self::__DETAILS;

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

            const SYSTEM_ID: Option<u16> = $crate::__private::system_id(&Self::__ATTRIBUTES);

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
