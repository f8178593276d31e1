//! Plans over a line: uploads, downloads and clears as real clients do them.

mod support;

use mavstack::dialect::{MavMissionResult, MavMissionType};
use mavstack::plan_memory;
use support::*;

type Plans = plan_memory!(mission: 50, fence: 0, rally: 0);

fn world() -> World<1, Plans> {
    World::with_plans(Setup::new())
}

/// T-M1
#[test]
fn what_was_uploaded_is_downloaded() {
    let mut world = world();
    for len in [1, 2, 50, 0] {
        let items = plan(len, len);
        let ack = world.upload(0, &items).expect("accepted");
        assert_eq!(ack.r#type, MavMissionResult::ACCEPTED);
        assert_eq!(world.download(0, MavMissionType::MISSION).expect("complete").len(), usize::from(len));
    }
}
