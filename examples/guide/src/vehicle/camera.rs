//! A camera that the autopilot triggers.

use mavstack::camera::{CameraControl, Image, Shot};
use mavstack::dialect::{CameraCapFlags, CameraInformation, MavResult, MavType};
use mavstack::message::ComponentId;
use mavstack::prelude::*;

/// MAV_COMP_ID_CAMERA.
const CAMERA: ComponentId = ComponentId::new(100);

struct Mapper;

#[derive(Stack)]
#[stack(vehicle: Mapper, links: 2, components)]
struct Mavlink {
    camera: CameraControl<[Image; 32]>,
}

impl Components for Mapper {
    const COMPONENTS: &'static [Component] = &[Component::new(CAMERA, MavType::CAMERA)];
}

impl Camera for Mapper {
    const COMPONENT: Option<ComponentId> = Some(CAMERA);
    const FLAGS: CameraCapFlags = CameraCapFlags::CAPTURE_IMAGE;

    fn camera_information(&self, information: &mut CameraInformation) {
        information.vendor_name = *Text::new("Acme").wire();
        information.model_name = *Text::new("Mapper").wire();
    }

    fn take_image(&mut self, cx: &mut Context<'_>, _: u32) -> Shot {
        // Pulse the trigger line here.
        Shot::Taken(Image::at(cx.now()))
    }
}

impl Vehicle for Mapper {
    fn state(&self) -> Option<VehicleState> {
        None
    }
}

impl Commands for Mapper {
    fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
        MavResult::UNSUPPORTED.into()
    }
}
