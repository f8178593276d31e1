//! What one link may cost another: rules. Each figure is what a radio of 57,600 bit/s carries while requests
//! flood the stack. Without a flood it carries 250 ATTITUDE in 5 s, in 35 % of its rate.

use super::order::{Loaded, WINGMAN};
use crate::support::*;
use mavstack::config::StreamProfile;
use mavstack::dialect::*;
use mavstack::param::ParamTable;
use mavstack::{Duration, LinkConfig, Message, Text};

/// The rate of the radio (bytes/s).
const RATE: usize = 5_760;

/// The link of the radio, and the link on which the others flood.
const RADIO: usize = 0;
const OTHER: usize = 1;

/// A vehicle with a radio, whose station is silent, and a fast link without streams.
fn site() -> Loaded {
    let fast = LinkConfig::uart(921_600).with_streams(StreamProfile::Off);
    let links = [LinkConfig::uart(57_600).with_streams(StreamProfile::Onboard), fast];
    let down = Wire { bytes_per_second: RATE as u64, tx_fifo: 512, ..Wire::default() };
    let lines = [LineConfig { down, ..LineConfig::default() }, LineConfig::default()];
    let mut world = Loaded::of(Setup { links, lines, ..Setup::new() });
    world.run_for(secs(1));
    world.gcs[RADIO].forget();
    world
}

/// Runs for 5 s, and floods `every` so many milliseconds. Returns the number of ATTITUDE messages on the radio.
fn flood(world: &mut Loaded, every: u64, mut requests: impl FnMut(&mut Gcs, u64)) -> usize {
    for ms in 0..5_000 {
        if ms % every == 0 {
            requests(&mut world.gcs[OTHER], ms / every);
        }
        world.step();
    }
    world.gcs[RADIO].count_of::<Attitude>()
}

/// What the radio carries without a flood.
#[test]
fn calm() {
    let mut world = site();
    let attitudes = flood(&mut world, 5_000, |_, _| {});
    let bytes: usize = world.gcs[RADIO].received.iter().map(|frame| frame.raw.len()).sum();
    let percent = 100 * bytes / (5 * RATE);
    assert!((248..=252).contains(&attitudes) && (30..=60).contains(&percent), "{attitudes}, {percent} %");
}

/// A setting of the extended parameter to the value that it has.
fn ext_set() -> ParamExtSet {
    let mut value = [0; 128];
    value[0] = 1;
    ParamExtSet {
        target_system: 1,
        target_component: 1,
        param_id: Text::new("CAM_ISO"),
        param_value: Text::from_wire(value),
        param_type: MavParamExtType::UINT8,
    }
}

/// A setting of the parameter to the value that it has.
fn unchanged_set(world: &mut Loaded, index: u16) -> ParamSet {
    world.gcs[OTHER].send(&ParamRequestRead {
        param_index: index as i16,
        target_system: 1,
        target_component: 1,
        ..ParamRequestRead::default()
    });
    let value = world.expect::<ParamValue>(OTHER, secs(1));
    ParamSet {
        param_value: value.param_value,
        target_system: 1,
        target_component: 1,
        param_id: value.param_id,
        param_type: value.param_type,
    }
}

/// The requests of a station that is refused everything that it asks for.
fn refused(gcs: &mut Gcs, number: u64) {
    let zoom = [f32::NAN; 7];
    match number % 4 {
        0 => gcs.send(&MissionSetCurrent { seq: 900, target_system: 1, target_component: 1 }),
        1 => gcs.command_long(MavCmd::SET_CAMERA_ZOOM, zoom),
        2 => gcs.command_long(MavCmd::IMAGE_START_CAPTURE, [0.0, 0.0, 1.0, number as f32, 0.0, 0.0, 0.0]),
        _ => gcs.command_long(MavCmd(32_100), [1.0, 1.0, 0.0, 3.0, 0.0, 0.0, 0.0]),
    }
}

/// 50 PARAM_EXT_SET a second on another link. Before: 0 of 250.
#[test]
fn ext_sets() {
    let mut world = site();
    let attitudes = flood(&mut world, 20, |gcs, _| gcs.send(&ext_set()));
    assert!(attitudes >= 125, "{attitudes} of 250");
}

/// 1,000 PARAM_SET a second of an unchanged value on another link. Before: 0 of 250.
#[test]
fn unchanged_sets() {
    let mut world = site();
    let set = unchanged_set(&mut world, 0);
    world.gcs[RADIO].forget();
    let attitudes = flood(&mut world, 1, |gcs, _| gcs.send(&set));
    assert!(attitudes >= 125, "{attitudes} of 250");
}

/// refused requests in turns, 1,000 a second. Before: 0 of 250.
#[test]
fn refused_in_turns() {
    let mut world = site();
    let attitudes = flood(&mut world, 1, refused);
    assert!(attitudes >= 125, "{attitudes} of 250");
}

/// 25 RADIO_STATUS a second that tell of a full buffer, on the radio itself. Before: 3 of 250.
#[test]
fn forged_radio_status() {
    let mut world = site();
    let radio = mavstack::Address::new(51, 68);
    for _ in 0..2 {
        world.gcs[RADIO].forget();
        for _ in 0..125 {
            world.gcs[RADIO].send_from(radio, &RadioStatus { txbuf: 5, ..RadioStatus::default() });
            world.run_for(millis(40));
        }
    }
    let attitudes = world.gcs[RADIO].count_of::<Attitude>();
    assert!(attitudes >= 25, "{attitudes} of 250");
}

/// the list of modes, requested over and over on the radio itself. Before: 0 of 250.
#[test]
fn modes_on_the_radio_itself() {
    let mut world = site();
    for ms in 0..5_000 {
        if ms % 20 == 0 {
            let message = [AvailableModes::ID as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
            world.gcs[RADIO].command_long(MavCmd::REQUEST_MESSAGE, message);
        }
        world.step();
    }
    let attitudes = world.gcs[RADIO].count_of::<Attitude>();
    assert!(attitudes >= 125, "{attitudes} of 250");
}

/// Floods for 5 s, with a CRITICAL text every second. Returns how late the latest arrives on the radio.
fn latest_text(world: &mut Loaded, mut requests: impl FnMut(&mut Gcs, u64)) -> Duration {
    let (mut latest, mut pending) = (Duration::ZERO, None);
    for ms in 0..6_000 {
        if ms < 5_000 {
            requests(&mut world.gcs[OTHER], ms);
            if ms % 1_000 == 500 {
                let text = format!("Engine {ms} failed");
                world.stack.text(world.now(), MavSeverity::CRITICAL, &text);
                pending = Some((world.now(), text));
            }
        }
        world.step();
        let texts = world.gcs[RADIO].all::<Statustext>();
        if let Some((since, text)) = &pending
            && texts.iter().any(|(_, seen)| seen.text.as_str() == Some(text))
        {
            latest = latest.max(world.now() - *since);
            pending = None;
        }
    }
    if pending.is_some() { secs(1_000) } else { latest }
}

/// a text of severity CRITICAL arrives at once, whatever floods. Before: 4 s beside PARAM_SET of all parameters.
#[test]
fn critical_text() {
    let mut world = site();
    let sets: Vec<_> = (0..Tuning::INFO.len() as u16).map(|index| unchanged_set(&mut world, index)).collect();
    world.gcs[RADIO].forget();
    let late = latest_text(&mut world, |gcs, ms| gcs.send(&sets[ms as usize % sets.len()]));
    assert!(late <= millis(250), "{} ms late beside unchanged values", late.as_millis());
    let mut world = site();
    let late = latest_text(&mut world, refused);
    assert!(late <= millis(250), "{} ms late beside refusals", late.as_millis());
}

/// long forwarded frames and streams that each fill the radio share it by bytes. Before: 87 % forwarded, because they
/// took turns by frame.
#[test]
fn forwarded() {
    let mut world = site();
    world.gcs[RADIO]
        .command_long(MavCmd::SET_MESSAGE_INTERVAL, [Attitude::ID as f32, 5_000.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    world.run_for(millis(500));
    world.gcs[RADIO].forget();
    flood(&mut world, 20, |gcs, _| {
        gcs.send_from(WINGMAN, &Tunnel { payload: [1; 128], payload_length: 128, ..Tunnel::default() });
    });
    let bytes = |forwarded: bool| -> usize {
        let frames = world.gcs[RADIO].received.iter();
        frames.filter(|frame| (frame.header.source == WINGMAN) == forwarded).map(|frame| frame.raw.len()).sum()
    };
    let percent = 100 * bytes(true) / (bytes(true) + bytes(false));
    assert!((40..=60).contains(&percent), "{percent} % forwarded");
}

/// Streams fill the radio, and the other link floods with settings of all parameters in turns. Returns the bytes of all values,
/// and how late the answers are to the reads of the radio's own station.
fn saturated(reads: bool) -> (usize, Duration) {
    let mut world = site();
    let sets: Vec<_> = (0..Tuning::INFO.len() as u16).map(|index| unchanged_set(&mut world, index)).collect();
    for id in [Attitude::ID, GlobalPositionInt::ID] {
        let interval = [id as f32, 5_000.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        world.gcs[RADIO].command_long(MavCmd::SET_MESSAGE_INTERVAL, interval);
        world.run_for(millis(500));
    }
    world.gcs[RADIO].forget();
    let (mut asked, mut latest) = (None, Duration::ZERO);
    for ms in 0..5_000 {
        world.gcs[OTHER].send(&sets[ms % sets.len()]);
        if reads && ms % 500 == 100 {
            let (target_system, target_component) = (1, 1);
            let read = ParamRequestRead { param_index: 0, target_system, target_component, ..Default::default() };
            world.gcs[RADIO].send(&read);
            asked = Some(world.now());
        }
        world.step();
        let is_new = |(at, value): &(_, ParamValue)| value.param_index == 0 && Some(*at) >= asked;
        if asked.is_some() && world.gcs[RADIO].all::<ParamValue>().iter().any(is_new) {
            latest = latest.max(world.now() - asked.take().unwrap());
        }
    }
    let is_value = |frame: &&Received| frame.header.id == ParamValue::ID;
    let bytes = world.gcs[RADIO].received.iter().filter(is_value).map(|frame| frame.raw.len()).sum();
    (bytes, if asked.is_some() { secs(1_000) } else { latest })
}

/// beside streams that fill the radio, the answers to what other links ask for take a tenth of it. Before: 97 %.
#[test]
fn tenth() {
    let (bytes, _) = saturated(false);
    assert!(bytes <= RATE * 5 / 10 + 280, "{bytes} bytes of values");
}

/// a tenth is for other links, so that a flood does not defer what the radio's own station asks for.
#[test]
fn own_answers() {
    let (_, latest) = saturated(true);
    assert!(latest <= millis(1_500), "{} ms", latest.as_millis());
}

/// what waits is not lost: the last value arrives, of a parameter that another link changes all the time.
#[test]
fn last_value() {
    let mut world = site();
    let set = unchanged_set(&mut world, 0);
    let interval = [Attitude::ID as f32, 5_000.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    world.gcs[RADIO].command_long(MavCmd::SET_MESSAGE_INTERVAL, interval);
    world.run_for(millis(500));
    for number in 0..1_000 {
        world.gcs[OTHER].send(&ParamSet { param_value: set.param_value + (number % 2) as f32, ..set });
        world.step();
    }
    world.run_for(millis(500));
    let last = |link: usize| world.gcs[link].all::<ParamValue>().last().map(|(_, value)| value.param_value);
    assert!(last(OTHER).is_some());
    assert_eq!(last(RADIO), last(OTHER));
}

/// what is due to other links shares its tenth by turns. The other link floods with settings of all parameters, and has all turns
/// marked twice a second. The radio's station asks for the camera once a second, the vehicle reaches an item and says something. Before,
/// the values took all of the tenth: 0 of 20 each.
#[test]
fn turns_share_the_tenth() {
    let mut world = site();
    let sets: Vec<_> = (0..Tuning::INFO.len() as u16).map(|index| unchanged_set(&mut world, index)).collect();
    for id in [Attitude::ID, GlobalPositionInt::ID] {
        let interval = [id as f32, 5_000.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        world.gcs[RADIO].command_long(MavCmd::SET_MESSAGE_INTERVAL, interval);
        world.run_for(millis(500));
    }
    world.gcs[RADIO].forget();
    for ms in 0..20_000 {
        if ms % 50 == 0 {
            world.gcs[OTHER].send(&sets[ms / 50 % sets.len()]);
        }
        if ms % 500 == 250 {
            let other = &mut world.gcs[OTHER];
            other.command_long(MavCmd::REQUEST_CAMERA_INFORMATION, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
            other.send(&MissionRequestList { target_system: 1, target_component: 1, ..Default::default() });
            other.send(&LogErase { target_system: 1, target_component: 1 });
        }
        if ms % 1_000 == 500 {
            let camera = [CameraInformation::ID as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
            world.gcs[RADIO].command_long(MavCmd::REQUEST_MESSAGE, camera);
        }
        if ms % 1_000 == 700 {
            let now = world.now();
            world.stack.mission_item_reached(now, (ms / 1_000) as u16);
            world.stack.text(now, MavSeverity::ERROR, &*format!("Own {ms}"));
        }
        world.step();
    }
    let radio = &world.gcs[RADIO];
    let is_own = |text: &(_, Statustext)| text.1.text.as_str().is_some_and(|text| text.starts_with("Own"));
    let own = radio.all::<Statustext>().iter().filter(|text| is_own(text)).count();
    let (camera, reached) = (radio.count_of::<CameraInformation>(), radio.count_of::<MissionItemReached>());
    println!("camera {camera}, reached {reached}, texts {own} of 20; {} values", radio.count_of::<ParamValue>());
    assert!([camera, reached, own].iter().all(|count| *count >= 15), "camera {camera}, reached {reached}, texts {own}");
}
