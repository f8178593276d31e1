//! The other components of a firmware: an autopilot may also be a gimbal and a camera.

use crate::dialect::MavType;
use crate::message::ComponentId;

/// The maximum number of components of a firmware, besides the autopilot.
pub const MAX_COMPONENTS: usize = 3;

/// A component of the firmware besides the autopilot: an entry of [`Components::COMPONENTS`](crate::Components::COMPONENTS).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Component {
    /// Its id, in the vehicle's system: see MAV_COMPONENT in the definitions.
    pub id: ComponentId,
    /// HEARTBEAT.type.
    pub r#type: MavType,
}

impl Component {
    /// Returns a component: `Component::new(ComponentId::new(154), MavType::GIMBAL)`.
    pub const fn new(id: ComponentId, r#type: MavType) -> Self {
        Self { id, r#type }
    }

    /// Checks the components of a firmware: at most [`MAX_COMPONENTS`], with ids that are valid and different.
    #[allow(clippy::indexing_slicing, clippy::arithmetic_side_effects, reason = "const-evaluated")]
    #[doc(hidden)]
    pub const fn check(components: &[Self]) {
        assert!(components.len() <= MAX_COMPONENTS, "a firmware has at most 3 components besides the autopilot");
        let mut i = 0;
        while i < components.len() {
            assert!(
                components[i].id.wire() != 0,
                "component 0 is every component: give each of `COMPONENTS` an id of its own"
            );
            let mut j = 0;
            while j < i {
                assert!(components[i].id.wire() != components[j].id.wire(), "two of `COMPONENTS` have the same id");
                j += 1;
            }
            i += 1;
        }
    }

    /// Whether one of the components has this id.
    #[allow(clippy::indexing_slicing, clippy::arithmetic_side_effects, reason = "const-evaluated")]
    pub(crate) const fn is_one(components: &[Self], id: u8) -> bool {
        let (mut i, mut is_one) = (0, false);
        while i < components.len() {
            is_one |= components[i].id.wire() == id;
            i += 1;
        }
        is_one
    }

    /// Checks that the component of a service is one of the firmware's.
    pub(crate) const fn check_service(components: &[Self], component: Option<ComponentId>) {
        let Some(component) = component else { return };
        assert!(
            Self::is_one(components, component.wire()),
            "a service has a `COMPONENT` that the firmware does not: add it to `COMPONENTS` of `impl Components`, and \
             `components` to `#[stack]`"
        );
    }
}
