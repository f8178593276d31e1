//! `command!` generates a typed command from a declaration with one line per parameter.

/// Declares a [`TypedCommand`](crate::message::TypedCommand): a plain struct with the command's parameters under their names.
///
/// The name is followed by the command's [`CommandRule`](crate::CommandRule), each field by the number of its parameter. A
/// field's type implements [`CommandParam`](crate::message::CommandParam). It is an `Option` if NaN means "default" and the rule admits
/// NaN. A command with a location has one field of type [`Location`](crate::message::Location), as parameter 5.
///
/// ```
/// use mavstack::CommandRule;
/// use mavstack::message::ParamRule;
///
/// mavstack::wire_enum! {
///     /// An action of the winch.
///     pub struct WinchAction: u8 {
///         RELAX = 0,
///         WIND = 1,
///     }
/// }
///
/// const WINCH: CommandRule = CommandRule::without_position(31_010, &[
///     ParamRule::integers(1, 0, 1),
///     ParamRule::range(2, -4.0, 4.0).or_nan(),
///     ParamRule::integers(3, 0, 1),
/// ]);
///
/// mavstack::command! {
///     /// Operates our winch.
///     pub struct Winch = WINCH {
///         action: WinchAction = 1,
///         /// (m/s) NaN: as configured.
///         speed: Option<f32> = 2,
///         brake: bool = 3,
///     }
/// }
/// # use mavstack::{Item, dialect::{MavCmd, MavFrame}};
/// # let item = Item { frame: MavFrame::MISSION, command: MavCmd(31_010), params: [1.0, f32::NAN, 0.0, 0.0], ..Item::default() };
/// # assert_eq!(item.decode(), Ok(Winch { action: WinchAction::WIND, speed: None, brake: false }));
/// ```
#[macro_export]
macro_rules! command {
    (
        $(#[$meta:meta])*
        $vis:vis struct $name:ident = $rule:path {
            $( $(#[$field_meta:meta])* $field:ident: $ty:ty = $index:literal ),+ $(,)?
        }
    ) => {
        $(#[$meta])*
        #[allow(missing_docs, reason = "a field's name is its label; MAVLink documents it")]
        #[derive(Clone, Copy, Debug, PartialEq)]
        $vis struct $name {
            $( $(#[$field_meta])* pub $field: $ty, )+
        }

        impl $crate::message::TypedCommand for $name {
            const RULE: $crate::CommandRule = $rule;

            #[inline]
            fn take(params: &mut $crate::message::CommandParams) -> Self {
                Self { $( $field: params.take($index), )+ }
            }
        }

        $crate::__message_format! { $name: $name { $( $field, )+ } }
    };
}
