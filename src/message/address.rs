//! Addresses: systems and their components.

/// Defines an id of 8 bits whose width is private.
macro_rules! id {
    ($(#[$doc:meta])* $Id:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        pub struct $Id(u8);

        impl $Id {
            /// As a target: all of them (S-11). No sender has this id.
            pub const ALL: Self = Self(0);

            /// Returns the id with this number.
            #[inline]
            pub const fn new(id: u8) -> Self {
                Self(id)
            }

            /// Returns whether it means all.
            #[inline]
            pub const fn is_all(self) -> bool {
                self.0 == 0
            }

            /// Returns the id as the fields of today's messages carry it, such as `target_system`.
            #[inline]
            pub const fn wire(self) -> u8 {
                self.0
            }
        }

        impl From<u8> for $Id {
            #[inline]
            fn from(id: u8) -> Self {
                Self(id)
            }
        }
    };
}

id! {
    /// The id of a system, for example a vehicle or a ground station. Its width is private, because MAVLink may get ids of 32
    /// bits (S-9b).
    SystemId
}
id! {
    /// The id of a component of a system. [`MavComponent`](crate::dialect::MavComponent) has MAVLink's well-known ids.
    ComponentId
}

/// The address of a component, as source or target: its system and its own id.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Address {
    /// The system.
    pub system: SystemId,
    /// Its component.
    pub component: ComponentId,
}

impl Address {
    /// Returns the address of component `component` of system `system`.
    #[inline]
    pub const fn new(system: u8, component: u8) -> Self {
        Self { system: SystemId::new(system), component: ComponentId::new(component) }
    }
}
