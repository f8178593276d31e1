//! Fields that must not be logged: keys and passwords (SEC-15).

use super::Field;

/// A secret field: encoded like `T`, but not shown by `Debug` and `defmt::Format`.
///
/// The generator uses it for keys and passwords in `common`; private messages declare it themselves. A decoded message
/// holds a copy of the secret, which the reader should overwrite after use.
///
/// `==` stops at the first difference, so it is for tests only: do not verify passwords with it.
///
/// ```
/// use mavstack::message::Secret;
///
/// mavstack::message! {
///     pub struct Unlock: UNLOCK = 52_003 {
///         door: u8,
///         code: Secret<[u8; 4]>,
///     }
/// }
/// let unlock = Unlock { door: 1, code: Secret([4, 7, 1, 1]) };
/// assert_eq!(format!("{unlock:?}"), "Unlock { door: 1, code: Secret }");
/// assert_eq!(unlock.code.0, [4, 7, 1, 1]);
/// ```
#[derive(Clone, Copy, Default, PartialEq, Eq)]
pub struct Secret<T>(pub T);

impl<T: Field> Field for Secret<T> {
    const SIZE: usize = T::SIZE;
    const ELEMENT: usize = T::ELEMENT;
    const WIRE_TYPE: &'static str = T::WIRE_TYPE;
    const IS_ARRAY: bool = T::IS_ARRAY;
    const ZERO: Self = Self(T::ZERO);

    #[inline(always)]
    fn read(payload: &[u8], at: usize) -> Self {
        Self(T::read(payload, at))
    }

    #[inline(always)]
    fn write(&self, payload: &mut [u8], at: usize) {
        self.0.write(payload, at);
    }
}

impl<T> core::fmt::Debug for Secret<T> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("Secret")
    }
}

#[cfg(feature = "defmt")]
impl<T> defmt::Format for Secret<T> {
    fn format(&self, f: defmt::Formatter<'_>) {
        defmt::write!(f, "Secret");
    }
}
