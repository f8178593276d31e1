//! Operator control between two stations.

use crate::rig::two_stations;
use mavstack::Duration;
use mavstack::dialect::{MavCmd, MavResult};
use mavstack_station::control::{Answer, AwaitNotice, Status, TakeOver, Takeover};
use mavstack_station::{Again, Client, Drive, Failure, GroundStation};

const SECOND: Duration = Duration::from_secs(1);

#[test]
fn control_is_requested_taken_over_and_released() {
    for client in [Client::QGroundControl, Client::Mavsdk, Client::MavProxy] {
        let mut rig = two_stations(client, 0.0, 0);
        rig.connect().unwrap();
        rig.on(1).connect().unwrap();
        rig.wait(SECOND * 2).unwrap();
        assert_eq!(rig.request_control(Takeover::Asked), Ok(Answer::Granted), "{client}");
        let owner = client.address().system.wire();
        assert_eq!(rig.on(1).run(Status::new()).unwrap().gcs_main, owner, "{client}");
        let refused = rig.on(1).command(MavCmd::COMPONENT_ARM_DISARM, &[1.0]);
        let is_not_in_control =
            |failure: &Failure| matches!(failure, Failure::Command { result: MavResult::NOT_IN_CONTROL, .. });
        assert!(refused.as_ref().is_err_and(is_not_in_control), "{client}: {refused:?}");
        // The other one asks, and the owner hears of it.
        assert_eq!(rig.on(1).request_control(Takeover::Asked), Ok(Answer::OwnerAsked), "{client}");
        let notice = rig.run(AwaitNotice::new(SECOND * 5)).unwrap();
        assert_eq!((notice.system, notice.takeover), (200, Takeover::Asked), "{client}");
        assert_eq!(rig.request_control(Takeover::Allowed), Ok(Answer::Granted), "{client}");
        assert_eq!(rig.on(1).run(TakeOver::new(Takeover::Asked, SECOND * 10)), Ok(()), "{client}");
        assert_eq!(rig.run(Status::new()).unwrap().gcs_main, 200, "{client}");
        rig.on(1).release_control().unwrap();
        assert_eq!(rig.run(Status::new()).unwrap().gcs_main, 0, "{client}");
    }
}

#[test]
fn control_is_taken_over_on_a_lossy_line() {
    for seed in 0..3 {
        let mut rig = two_stations(Client::QGroundControl, 0.2, seed);
        rig.connect().unwrap();
        rig.on(1).connect().unwrap();
        rig.wait(SECOND * 3).unwrap();
        let request = |takeover| Again::new(20, move || mavstack_station::control::Request::new(takeover, SECOND * 10));
        assert_eq!(rig.run(request(Takeover::Asked)), Ok(Answer::Granted), "seed {seed}");
        assert_eq!(rig.on(1).run(request(Takeover::Asked)), Ok(Answer::OwnerAsked), "seed {seed}");
        assert_eq!(rig.run(request(Takeover::Allowed)), Ok(Answer::Granted), "seed {seed}");
        let taken = rig.on(1).run(Again::new(20, || TakeOver::new(Takeover::Asked, SECOND * 30)));
        assert_eq!(taken, Ok(()), "seed {seed}");
    }
}
