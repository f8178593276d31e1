//! Addresses: systems and their components.

/// The id of a system, for example a vehicle or a ground station. 0 is valid as a target only, and means all systems
/// (S-11). A type of its own, because MAVLink may get 32-bit ids (S-9b).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SystemId(pub u8);

/// The id of a component of a system. As a target, 0 means all components (S-11).
/// [`MavComponent`](crate::dialect::MavComponent) has MAVLink's well-known ids.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ComponentId(pub u8);

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
        Self { system: SystemId(system), component: ComponentId(component) }
    }
}
