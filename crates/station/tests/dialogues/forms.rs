//! What exactly each client sends: dialogues with a vehicle that is played by the test, message by message.

use mavstack::dialect::*;
use mavstack::frame::Version;
use mavstack::message::Text;
use mavstack::{Address, Duration, Instant, Item, Message, PlanType};
use mavstack_station::command::{Place, Send};
use mavstack_station::plans::{Clear, Download, Upload, waypoint};
use mavstack_station::streams::Request;
use mavstack_station::{Client, Dialogue, Failure, Station, modes, parameters};

/// A client, and a vehicle that the test plays.
struct Play {
    client: Station,
    vehicle: Station,
    now: Instant,
}

impl Play {
    /// The client has heard a heartbeat of this autopilot.
    fn new(client: Client, autopilot: MavAutopilot) -> Self {
        let vehicle = Station::new(Client::Pymavlink).with_address(Address::new(1, 1)).with_version(Version::V2);
        let mut play = Self { client: Station::new(client), vehicle, now: Instant::ZERO };
        let base_mode = MavModeFlag::CUSTOM_MODE_ENABLED | MavModeFlag::SAFETY_ARMED;
        play.say(&Heartbeat {
            r#type: MavType::QUADROTOR,
            autopilot,
            base_mode,
            custom_mode: 3,
            ..Heartbeat::default()
        });
        play.client.forget_inbox();
        play
    }

    /// The vehicle sends a message.
    fn say<M: Message>(&mut self, message: &M) {
        self.vehicle.send(message);
        let bytes = self.vehicle.take_output();
        self.client.receive(self.now, &bytes);
    }

    /// Lets time pass, in steps of 50 ms. Returns the result if the dialogue ended.
    fn pass<D: Dialogue>(&mut self, millis: u64, dialogue: &mut D) -> Option<Result<D::Output, Failure>> {
        let end = self.now + Duration::from_millis(millis);
        loop {
            let result = self.client.advance(self.now, dialogue);
            let bytes = self.client.take_output();
            self.vehicle.receive(self.now, &bytes);
            if result.is_some() || self.now >= end {
                return result;
            }
            self.now += Duration::from_millis(50);
        }
    }

    /// Returns the number of `M` that the client has sent.
    fn count<M: Message>(&self) -> u64 {
        self.vehicle.seen().count::<M>()
    }

    /// Returns the last `M` that the client has sent.
    fn last<M: Message>(&self) -> M {
        self.vehicle.seen().last().unwrap_or_else(|| panic!("no {}", M::NAME))
    }

    /// The vehicle asks for an item.
    fn ask<D: Dialogue>(&mut self, seq: u16, dialogue: &mut D) -> Option<Result<D::Output, Failure>> {
        let Address { system, component } = self.client.address();
        self.say(&MissionRequestInt {
            seq,
            target_system: system.wire(),
            target_component: component.wire(),
            mission_type: MavMissionType::MISSION,
        });
        self.pass(0, dialogue)
    }

    /// The vehicle ends the upload.
    fn acknowledge(&mut self, result: MavMissionResult) {
        let Address { system, component } = self.client.address();
        self.say(&MissionAck {
            target_system: system.wire(),
            target_component: component.wire(),
            r#type: result,
            mission_type: MavMissionType::MISSION,
            opaque_id: 77,
        });
    }

    /// The vehicle reports a parameter.
    fn value(&mut self, name: &str, index: u16, count: u16, value: parameters::Value) {
        self.say(&ParamValue {
            param_value: value.encode(Client::QGroundControl, parameters::Encoding::Bytewise),
            param_count: count,
            param_index: index,
            param_id: Text::new(name),
            param_type: value.param_type(),
        });
    }
}

fn items(count: usize) -> Vec<Item> {
    vec![waypoint(Place::relative(47.0, 8.0, 20.0)); count]
}

fn generic(client: Client) -> Play {
    Play::new(client, MavAutopilot::GENERIC)
}

#[test]
fn mavsdk_refuses_mission_request_and_wants_the_other_form() {
    let mut play = generic(Client::Mavsdk);
    let mut upload = Upload::new(PlanType::Mission, &items(1));
    play.pass(0, &mut upload);
    play.say(&MissionRequest {
        seq: 0,
        target_system: 245,
        target_component: 190,
        mission_type: MavMissionType::MISSION,
    });
    play.pass(0, &mut upload);
    assert_eq!(play.last::<MissionAck>().r#type, MavMissionResult::UNSUPPORTED);
    assert_eq!(play.count::<MissionItemInt>(), 0);
    play.ask(0, &mut upload);
    assert_eq!(play.last::<MissionItemInt>().current, 1);
    play.acknowledge(MavMissionResult::ACCEPTED);
    assert_eq!(play.pass(0, &mut upload), Some(Ok(77)));
}

/// The reason why a vehicle must not ask again too fast.
#[test]
fn mavsdk_gives_up_when_one_item_is_asked_for_too_often() {
    let mut play = generic(Client::Mavsdk);
    let mut upload = Upload::new(PlanType::Mission, &items(3));
    play.pass(0, &mut upload);
    for _ in 0..5 {
        assert_eq!(play.ask(0, &mut upload), None);
    }
    assert!(matches!(play.ask(0, &mut upload), Some(Err(Failure::Timeout { .. }))));
    assert_eq!(play.count::<MissionItemInt>(), 5);
}

#[test]
fn mavsdk_takes_an_early_acknowledgement_for_an_error() {
    let mut play = generic(Client::Mavsdk);
    let mut upload = Upload::new(PlanType::Mission, &items(2));
    play.pass(0, &mut upload);
    play.ask(0, &mut upload);
    play.acknowledge(MavMissionResult::ACCEPTED);
    assert!(matches!(play.pass(0, &mut upload), Some(Err(Failure::Protocol(_)))));
}

/// If the last item is lost, the vehicle asks again, and MAVProxy says nothing.
#[test]
fn mavproxy_does_not_send_the_last_item_again() {
    let mut play = generic(Client::MavProxy);
    let mut upload = Upload::new(PlanType::Mission, &items(2));
    play.pass(0, &mut upload);
    play.ask(0, &mut upload);
    play.ask(0, &mut upload);
    play.ask(1, &mut upload);
    play.ask(1, &mut upload);
    assert_eq!(play.count::<MissionItemInt>(), 3);
    assert!(play.pass(9_000, &mut upload).is_none());
    assert!(matches!(play.pass(1_100, &mut upload), Some(Err(Failure::Timeout { .. }))));
    assert_eq!(play.count::<MissionCount>(), 1);
}

/// QGroundControl sends any item again, but waits for the end only 1.5 s.
#[test]
fn qgroundcontrol_fails_an_upload_whose_end_is_lost() {
    let mut play = generic(Client::QGroundControl);
    let mut upload = Upload::new(PlanType::Mission, &items(2));
    play.pass(4_000, &mut upload);
    assert_eq!(play.count::<MissionCount>(), 3, "every 1.5 s");
    for seq in [0, 1, 0, 1] {
        play.ask(seq, &mut upload);
    }
    assert_eq!(play.count::<MissionItemInt>(), 4);
    assert!(play.pass(1_450, &mut upload).is_none());
    assert!(matches!(play.pass(100, &mut upload), Some(Err(Failure::Timeout { .. }))));
    assert_eq!((play.count::<MissionCount>(), play.count::<MissionItemInt>()), (3, 4));
}

#[test]
fn qgroundcontrol_refuses_a_request_out_of_range() {
    let mut play = generic(Client::QGroundControl);
    let mut upload = Upload::new(PlanType::Mission, &items(2));
    play.pass(0, &mut upload);
    assert!(matches!(play.ask(2, &mut upload), Some(Err(Failure::Protocol(_)))));
}

/// A script answers in the form in which it was asked.
#[test]
fn a_script_sends_floats() {
    let mut play = generic(Client::Pymavlink);
    let mut upload = Upload::new(PlanType::Mission, &items(1));
    play.pass(0, &mut upload);
    play.say(&MissionRequest {
        seq: 0,
        target_system: 255,
        target_component: 0,
        mission_type: MavMissionType::MISSION,
    });
    play.pass(0, &mut upload);
    assert_eq!(play.last::<MissionItem>().x, 47.0);
}

#[test]
fn only_mavsdk_and_qgroundcontrol_close_a_download() {
    for client in Client::ALL {
        let mut play = generic(client);
        let mut download = Download::new(PlanType::Rally);
        play.pass(0, &mut download);
        let Address { system, component } = play.client.address();
        play.say(&MissionCount {
            count: 0,
            target_system: system.wire(),
            target_component: component.wire(),
            mission_type: MavMissionType::RALLY,
            opaque_id: 0,
        });
        assert!(matches!(play.pass(0, &mut download), Some(Ok(_))), "{client}");
        let closes = matches!(client, Client::QGroundControl | Client::Mavsdk);
        assert_eq!(play.count::<MissionAck>(), u64::from(closes), "{client}");
    }
}

/// MAVProxy asks for five items at a time, the others for one.
#[test]
fn items_are_requested_as_the_client_does() {
    for client in Client::ALL {
        let mut play = generic(client);
        let mut download = Download::new(PlanType::Mission);
        play.pass(0, &mut download);
        play.say(&MissionCount { count: 9, mission_type: MavMissionType::MISSION, ..MissionCount::default() });
        play.pass(0, &mut download);
        let (int, float) = (play.count::<MissionRequestInt>(), play.count::<MissionRequest>());
        let expected = match client {
            Client::QGroundControl | Client::Mavsdk => (1, 0),
            Client::MavProxy => (5, 0),
            Client::Pymavlink => (0, 1),
        };
        assert_eq!((int, float), expected, "{client}");
    }
}

#[test]
fn a_clear_is_repeated_as_the_client_does() {
    let cases = [(Client::QGroundControl, 7), (Client::Mavsdk, 5), (Client::MavProxy, 1), (Client::Pymavlink, 1)];
    for (client, tries) in cases {
        let mut play = generic(client);
        let end = play.pass(20_000, &mut Clear::new(PlanType::Fence));
        assert!(matches!(end, Some(Err(Failure::Timeout { .. }))), "{client}");
        assert_eq!(play.count::<MissionClearAll>(), tries, "{client}");
    }
}

#[test]
fn the_list_of_parameters_is_asked_of_the_component_or_of_all() {
    for client in Client::ALL {
        let mut play = generic(client);
        play.pass(0, &mut parameters::List::new());
        let component = play.last::<ParamRequestList>().target_component;
        assert_eq!(component, u8::from(client != Client::QGroundControl), "{client}");
    }
}

/// One of 60 values arrives: which others the client requests, and when.
#[test]
fn gaps_are_asked_for_in_batches() {
    let cases = [
        (Client::QGroundControl, 3_000, 11),
        (Client::Mavsdk, 2_000, 10),
        (Client::MavProxy, 1_000, 10),
        (Client::Pymavlink, 200, 51),
    ];
    for (client, silence, batch) in cases {
        let mut play = generic(client);
        let mut list = parameters::List::new();
        play.pass(0, &mut list);
        play.value("FIRST", 0, 60, parameters::Value::F32(1.0));
        play.pass(silence - 50, &mut list);
        assert_eq!(play.count::<ParamRequestRead>(), 0, "{client}");
        play.pass(50, &mut list);
        assert_eq!(play.count::<ParamRequestRead>(), batch, "{client}");
    }
}

/// ArduPilot carries integers as numbers, PX4 as bytes; who knows that of a generic autopilot differs.
#[test]
fn integers_are_decoded_by_the_autopilot() {
    let bytewise = |client: Client, autopilot| {
        let mut play = Play::new(client, autopilot);
        let mut read = parameters::Read::new("FENCE_ACT");
        play.pass(0, &mut read);
        play.value("FENCE_ACT", 0, 1, parameters::Value::I32(3));
        match play.pass(0, &mut read) {
            Some(Ok(parameter)) => parameter.value == parameters::Value::I32(3),
            other => panic!("{other:?}"),
        }
    };
    for client in Client::ALL {
        let knows_generic = matches!(client, Client::QGroundControl | Client::Mavsdk);
        assert!(bytewise(client, MavAutopilot::PX4), "{client}");
        assert_eq!(bytewise(client, MavAutopilot::GENERIC), knows_generic, "{client}");
        assert!(!bytewise(client, MavAutopilot::ARDUPILOTMEGA), "{client}");
    }
}

/// A second station on the line: only MAVSDK sees that an answer is not for it.
#[test]
fn answers_to_others_are_taken_by_most() {
    for client in Client::ALL {
        let mut play = generic(client);
        let mut arm = Send::new(MavCmd::COMPONENT_ARM_DISARM, &[1.0]);
        play.pass(0, &mut arm);
        let result = MavResult::ACCEPTED;
        let (target_system, target_component) = (9, 9);
        let command = MavCmd::COMPONENT_ARM_DISARM;
        play.say(&CommandAck { command, result, target_system, target_component, ..CommandAck::default() });
        assert_eq!(play.pass(0, &mut arm).is_some(), client != Client::Mavsdk, "{client}");
    }
}

/// MAVSDK waits 3 s after each IN_PROGRESS, and then repeats the command; QGroundControl does not repeat it.
#[test]
fn silence_after_progress_is_a_failure() {
    for (client, silence, sent) in [(Client::QGroundControl, 1_450, 1), (Client::Mavsdk, 2_950, 4)] {
        let mut play = generic(client);
        let mut calibrate = Send::new(MavCmd::PREFLIGHT_CALIBRATION, &[1.0]);
        play.pass(0, &mut calibrate);
        let (command, result) = (MavCmd::PREFLIGHT_CALIBRATION, MavResult::IN_PROGRESS);
        play.say(&CommandAck { command, result, progress: 10, ..CommandAck::default() });
        assert!(play.pass(silence, &mut calibrate).is_none());
        assert!(matches!(play.pass(5_000, &mut calibrate), Some(Err(Failure::Timeout { .. }))), "{client}");
        assert_eq!(play.count::<CommandLong>(), sent, "{client}");
    }
}

/// QGroundControl counts from the first try, and looks every half second.
#[test]
fn qgroundcontrol_repeats_requests_and_counts_them() {
    let mut play = generic(Client::QGroundControl);
    let mut request = Request::<AutopilotVersion>::new();
    for (millis, sent) in [(1_450, 1), (50, 2), (450, 2), (50, 3)] {
        assert!(play.pass(millis, &mut request).is_none());
        assert_eq!(play.count::<CommandLong>(), sent);
        assert_eq!(u64::from(play.last::<CommandLong>().confirmation), sent - 1);
    }
    // The message alone is not enough.
    play.say(&AutopilotVersion::default());
    assert!(matches!(play.pass(500, &mut request), Some(Err(Failure::Timeout { tries: 3, .. }))));
}

/// MAVSDK asks for the version by the old command every second time.
#[test]
fn mavsdk_falls_back_to_the_old_request() {
    let mut play = generic(Client::Mavsdk);
    let mut request = Request::<AutopilotVersion>::new();
    play.pass(0, &mut request);
    assert_eq!(play.last::<CommandLong>().command, MavCmd::REQUEST_MESSAGE);
    let (command, result) = (MavCmd::REQUEST_MESSAGE, MavResult::UNSUPPORTED);
    play.say(&CommandAck { command, result, ..CommandAck::default() });
    play.pass(50, &mut request);
    assert_eq!(play.last::<CommandLong>().command, MavCmd::REQUEST_AUTOPILOT_CAPABILITIES);
    // The message without its answer is enough.
    play.say(&AutopilotVersion { board_version: 5, ..AutopilotVersion::default() });
    let version = play.pass(0, &mut request).expect("an end").expect("a version");
    assert_eq!(version.board_version, 5);
}

#[test]
fn modes_are_set_in_three_forms() {
    let mut play = generic(Client::QGroundControl);
    let mut set = modes::Set::new(5);
    play.pass(0, &mut set);
    let message = play.last::<SetMode>();
    assert!(message.base_mode.contains(MavModeFlag::SAFETY_ARMED), "the flags of the heartbeat stay");
    assert_eq!(message.custom_mode, 5);
    play.pass(4_000, &mut set);
    assert_eq!(play.count::<SetMode>(), 3);

    let sent = |client, mode| {
        let mut play = generic(client);
        play.pass(0, &mut modes::Set::new(mode));
        let command = play.last::<CommandLong>();
        (command.command, command.param1, command.param2, command.param3)
    };
    // PX4's auto mission: main mode 4, sub mode 4.
    assert_eq!(sent(Client::Mavsdk, 0x0404_0000), (MavCmd::DO_SET_MODE, 129.0, 4.0, 4.0));
    assert_eq!(sent(Client::Mavsdk, 5), (MavCmd::DO_SET_MODE, 129.0, 5.0, 0.0));
    assert_eq!(sent(Client::MavProxy, 5), (MavCmd::DO_SET_MODE, 1.0, 5.0, 0.0));
}

/// A vehicle without PARAM_ERROR reports the value that it kept: a refusal, and no timeout.
#[test]
fn mavsdk_reads_the_old_value_as_a_refusal() {
    let mut play = generic(Client::Mavsdk);
    let mut set = parameters::Set::new("CRUISE", 50.0);
    play.pass(0, &mut set);
    play.value("CRUISE", 0, 1, parameters::Value::F32(5.0));
    play.pass(0, &mut set);
    assert_eq!(play.count::<ParamSet>(), 2, "repeated at once");
    assert_eq!(
        play.pass(3_500, &mut set),
        Some(Err(Failure::Param { name: "CRUISE".into(), error: None, text: None }))
    );
}

/// A type that a test gives is sent in the client's own time.
#[test]
fn a_set_of_a_given_type_has_the_clients_timer() {
    for (client, sets) in [(Client::Mavsdk, 6), (Client::QGroundControl, 3)] {
        let mut play = generic(client);
        let mut set = parameters::Set::typed("CRUISE", parameters::Value::I32(5));
        assert!(matches!(play.pass(4_000, &mut set), Some(Err(Failure::Timeout { .. }))));
        assert_eq!(play.count::<ParamSet>(), sets, "{client}");
    }
}
