//! Types that `#[stack]` names: those that are made of several services, or that need a feature of the crate.

/// The list of the files of services: those of [virtual directories](crate::Files).
#[doc(hidden)]
#[macro_export]
macro_rules! __one_of {
    ($uploads:block;) => { $crate::__private::NoFile };
    ($uploads:block; $service:ty, $($rest:ty,)*) => {
        $crate::__private::OneOf<
            $uploads,
            <$service as $crate::__private::HasFiles>::File,
            $crate::__one_of!($uploads; $($rest,)*),
        >
    };
}

/// Signing with this many streams at a time.
#[cfg(feature = "signing")]
#[doc(hidden)]
#[macro_export]
macro_rules! __signing {
    ($n:expr) => { $crate::__private::SigningStreams<{ $n }> };
}

/// Signing without the feature.
#[cfg(not(feature = "signing"))]
#[doc(hidden)]
#[macro_export]
macro_rules! __signing {
    ($n:expr) => {
        ::core::compile_error!(
            "`signing` in `#[stack]` needs the feature `signing` of mavstack: enable it in Cargo.toml"
        )
    };
}

/// The state of storage, and the service of the firmware's own records.
#[cfg(feature = "storage")]
#[doc(hidden)]
#[macro_export]
macro_rules! __storage {
    () => { $crate::__private::Storage };
    ($n:expr) => { $crate::__private::RecordService<{ $n }> };
}

/// Storage without the feature.
#[cfg(not(feature = "storage"))]
#[doc(hidden)]
#[macro_export]
macro_rules! __storage {
    ($($n:expr)?) => {
        ::core::compile_error!(
            "`storage` in `#[stack]` needs the feature `storage` of mavstack: enable it in Cargo.toml"
        )
    };
}
