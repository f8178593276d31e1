//! Extended parameters: rules P-40 to P-42.

use crate::support::*;
use mavstack::config::{LinkClass, StreamProfile, TxVersion};
use mavstack::dialect::*;
use mavstack::ext_parameters::ExtValue;
use mavstack::{Address, Context, ExtParameters, LinkConfig, LinkId, Message, Text, Vehicle, VehicleState};

#[derive(mavstack::Stack)]
#[stack(vehicle: Camera, links: 4)]
struct Settings {
    ext_parameters: mavstack::ext_parameters::ExtParamServer,
}

/// A camera with settings of every type.
struct Camera {
    owner: [u8; 128],
    iso: u32,
    shutter: f64,
    /// The answer to a change; `None` sets it.
    refuses: Option<ParamAck>,
    /// Changes that reached the vehicle.
    changes: Vec<u16>,
    /// How many there are.
    count: u16,
}

impl Default for Camera {
    fn default() -> Self {
        Self { owner: [0; 128], iso: 100, shutter: 0.004, refuses: None, changes: Vec::new(), count: 12 }
    }
}

impl Vehicle for Camera {
    fn state(&self) -> Option<VehicleState> {
        None
    }
}

without_commands!(Camera);

/// Names for more parameters than most cameras have.
fn name(index: u16) -> &'static str {
    const NAMES: [&str; 12] = [
        "CAM_ISO",
        "CAM_OWNER",
        "CAM_SHUTTER",
        "U8",
        "I8",
        "U16",
        "I16",
        "I32",
        "U64",
        "I64",
        "F32",
        "SIXTEEN_LETTERS_",
    ];
    NAMES.get(usize::from(index)).copied().unwrap_or("MORE")
}

impl ExtParameters for Camera {
    fn ext_param_count(&self) -> u16 {
        self.count
    }

    fn ext_param(&self, index: u16) -> Option<(&str, ExtValue<'_>)> {
        let value = match index {
            0 => ExtValue::U32(self.iso),
            1 => ExtValue::Custom(&self.owner),
            2 => ExtValue::F64(self.shutter),
            3 => ExtValue::U8(200),
            4 => ExtValue::I8(-2),
            5 => ExtValue::U16(60_000),
            6 => ExtValue::I16(-300),
            7 => ExtValue::I32(-70_000),
            8 => ExtValue::U64(u64::MAX - 1),
            9 => ExtValue::I64(i64::MIN),
            10 => ExtValue::F32(-0.5),
            11 => ExtValue::Custom(b"short"),
            _ => ExtValue::U8(1),
        };
        (index < self.count).then_some((name(index), value))
    }

    fn set_ext_param(&mut self, _: &mut Context<'_>, index: u16, value: ExtValue<'_>, _: mavstack::Peer) -> ParamAck {
        self.changes.push(index);
        if let Some(result) = self.refuses {
            return result;
        }
        match (index, value) {
            (0, ExtValue::U32(iso @ 100..=6_400)) => self.iso = iso,
            (1, ExtValue::Custom(bytes)) => self.owner.copy_from_slice(bytes),
            (2, ExtValue::F64(shutter)) => self.shutter = shutter,
            _ => return ParamAck::VALUE_UNSUPPORTED,
        }
        ParamAck::ACCEPTED
    }
}

type Site = World<4, Settings>;

fn site() -> Site {
    let uart = LinkConfig::uart(115_200).with_streams(StreamProfile::Off);
    let links = [uart, uart, uart.with_version(TxVersion::V1), uart.with_class(LinkClass::HighLatency)];
    Site::of(Setup { links, ..Setup::new() })
}

fn bytes(front: &[u8]) -> Text<128> {
    let mut bytes = [0; 128];
    bytes[..front.len()].copy_from_slice(front);
    Text::from_wire(bytes)
}

fn send<M: Message>(site: &mut Site, link: usize, from: Address, message: &M) {
    let frame = site.gcs[link].frame_from(from, message);
    assert_eq!(site.stack.receive(site.clock.now(), LinkId(link as u8), &frame, &mut site.vehicle), frame.len());
}

fn set(site: &mut Site, link: usize, name: &str, param_type: MavParamExtType, value: &[u8]) {
    let (target_system, target_component) = (1, 1);
    let param_id = Text::new(name);
    let set = ParamExtSet { target_system, target_component, param_id, param_value: bytes(value), param_type };
    send(site, link, STATION, &set);
}

fn read(site: &mut Site, link: usize, param_index: i16, name: &str) {
    let (target_system, target_component) = (1, 1);
    let read = ParamExtRequestRead { param_index, target_system, target_component, param_id: Text::new(name) };
    send(site, link, STATION, &read);
}

/// The only answer that a link has received.
fn ack(site: &mut Site, link: usize) -> ParamExtAck {
    site.run_for(millis(60));
    let acks = site.gcs[link].all::<ParamExtAck>();
    let [(_, ack)] = acks[..] else { panic!("{acks:?}") };
    site.gcs[link].forget();
    ack
}

/// P-40, P-42: each type is sent by its bytes, little-endian, with zeros after it.
#[test]
fn values_have_their_real_types() {
    let mut site = site();
    site.vehicle.owner[..3].copy_from_slice(b"a\0b");
    send(&mut site, 0, STATION, &ParamExtRequestList { target_system: 1, target_component: 1 });
    site.run_for(secs(3));
    let values = site.gcs[0].all::<ParamExtValue>();
    let expected: [(MavParamExtType, &[u8]); 12] = [
        (MavParamExtType::UINT32, &100u32.to_le_bytes()),
        (MavParamExtType::CUSTOM, b"a\0b"),
        (MavParamExtType::REAL64, &0.004f64.to_le_bytes()),
        (MavParamExtType::UINT8, &[200]),
        (MavParamExtType::INT8, &[254]),
        (MavParamExtType::UINT16, &60_000u16.to_le_bytes()),
        (MavParamExtType::INT16, &(-300i16).to_le_bytes()),
        (MavParamExtType::INT32, &(-70_000i32).to_le_bytes()),
        (MavParamExtType::UINT64, &(u64::MAX - 1).to_le_bytes()),
        (MavParamExtType::INT64, &i64::MIN.to_le_bytes()),
        (MavParamExtType::REAL32, &(-0.5f32).to_le_bytes()),
        (MavParamExtType::CUSTOM, b"short"),
    ];
    assert_eq!(values.len(), expected.len());
    for ((index, (_, value)), (kind, front)) in (0u16..).zip(values).zip(expected) {
        assert_eq!((value.param_index, value.param_count, value.param_type), (index, 12, kind));
        assert_eq!(value.param_id.as_str(), Some(name(index)));
        assert_eq!(value.param_value.wire(), bytes(front).wire(), "{}", name(index));
    }
    assert_eq!(site.gcs[1].count_of::<ParamExtValue>(), 0, "only where it was requested");
}

/// P-42: the list takes 40 % of a link, and begins again when it is requested again.
#[test]
fn list_is_paced() {
    let mut site = site();
    site.vehicle.count = 100;
    let list = ParamExtRequestList { target_system: 1, target_component: 0 };
    send(&mut site, 0, STATION, &list);
    site.run_for(secs(1));
    let values = site.gcs[0].all::<ParamExtValue>();
    // 161 bytes each, of 11,520 bytes a second.
    assert!((26..=31).contains(&values.len()), "{}", values.len());
    site.gcs[0].forget();
    send(&mut site, 0, STATION, &list);
    site.run_for(secs(6));
    let indices: Vec<_> = site.gcs[0].all::<ParamExtValue>().iter().map(|(_, value)| value.param_index).collect();
    let begin = indices.iter().position(|index| *index == 0).expect("from the start");
    assert!(begin <= 1);
    assert_eq!(indices[begin..], (0..100).collect::<Vec<_>>());
    site.gcs[0].forget();
    site.run_for(secs(2));
    assert!(site.gcs[0].received.is_empty(), "it has ended");
}

/// P-42: a parameter is read by name or index, once for requests that wait. One that does not exist is not answered.
#[test]
fn parameters_are_read() {
    let mut site = site();
    for (index, name) in [(3, ""), (3, "ignored"), (-1, "SIXTEEN_LETTERS_"), (12, ""), (-1, "NONE"), (-1, "CAM_IS")] {
        read(&mut site, 1, index, name);
    }
    site.run_for(millis(100));
    let values = site.gcs[1].all::<ParamExtValue>();
    assert_eq!(values.iter().map(|(_, value)| value.param_index).collect::<Vec<_>>(), [3, 11]);
}

/// P-41: a change is answered with the new value, on every normal link, so that all ground stations learn of it.
#[test]
fn change_is_acknowledged_to_all() {
    let mut site = site();
    set(&mut site, 0, "CAM_ISO", MavParamExtType::UINT32, &800u32.to_le_bytes());
    let expected = ParamExtAck {
        param_id: Text::new("CAM_ISO"),
        param_value: bytes(&800u32.to_le_bytes()),
        param_type: MavParamExtType::UINT32,
        param_result: ParamAck::ACCEPTED,
    };
    assert_eq!(ack(&mut site, 0), expected);
    assert_eq!(ack(&mut site, 1), expected);
    assert_eq!(site.vehicle.iso, 800);
    // A retransmission.
    set(&mut site, 0, "CAM_ISO", MavParamExtType::UINT32, &800u32.to_le_bytes());
    assert_eq!(ack(&mut site, 0), expected);
    assert!(site.gcs[3].received.is_empty() && site.gcs[2].received.iter().all(|frame| frame.header.id < 256));
}

/// P-40: bytes after a zero belong to the value.
#[test]
fn custom_value_has_all_its_bytes() {
    let mut site = site();
    let value: Vec<u8> = (0..128).map(|byte| if byte % 5 == 0 { 0 } else { byte }).collect();
    set(&mut site, 0, "CAM_OWNER", MavParamExtType::CUSTOM, &value);
    let ack = ack(&mut site, 0);
    assert_eq!((ack.param_result, &ack.param_value.wire()[..]), (ParamAck::ACCEPTED, &value[..]));
    assert_eq!(site.vehicle.owner[..], value[..]);
    assert_eq!(ExtValue::Custom(b"Ann\0junk").text(), Some("Ann"));
    assert_eq!((ExtValue::Custom(&[0xFF]).text(), ExtValue::U8(65).text()), (None, None));
}

/// P-41: a parameter that does not exist, another type, and a value that the vehicle refuses are answered, with the present value.
/// Only the last reaches the vehicle.
#[test]
fn refusals_have_the_present_value() {
    for (name, kind, value, changes) in [
        ("CAM_ISO", MavParamExtType::UINT32, 7u32, 1),
        ("CAM_ISO", MavParamExtType::INT32, 800, 0),
        ("CAM_ISO", MavParamExtType(0), 800, 0),
        ("CAM_ISO", MavParamExtType(77), 800, 0),
    ] {
        let mut site = site();
        set(&mut site, 0, name, kind, &value.to_le_bytes());
        let ack = ack(&mut site, 0);
        assert_eq!(ack.param_result, ParamAck::VALUE_UNSUPPORTED, "{kind:?}");
        let present = (MavParamExtType::UINT32, bytes(&100u32.to_le_bytes()));
        assert_eq!((ack.param_type, ack.param_value), present);
        assert_eq!((site.vehicle.iso, site.vehicle.changes.len()), (100, changes));
    }
    let mut site = site();
    set(&mut site, 0, "NONE", MavParamExtType::UINT8, &[1]);
    let unknown = ack(&mut site, 0);
    assert_eq!((unknown.param_id.as_str(), unknown.param_result), (Some("NONE"), ParamAck::VALUE_UNSUPPORTED));
    assert_eq!((unknown.param_value, unknown.param_type), (bytes(&[]), MavParamExtType::UINT8));
    site.vehicle.refuses = Some(ParamAck::FAILED);
    set(&mut site, 0, "CAM_ISO", MavParamExtType::UINT32, &800u32.to_le_bytes());
    assert_eq!(ack(&mut site, 0).param_result, ParamAck::FAILED);
}

/// P-41: NaN and the infinities are refused before the vehicle, as PARAM_SET refuses them, and the greatest numbers are not.
#[test]
fn numbers_that_are_none_are_refused() {
    for value in [f64::NAN, -f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let mut site = site();
        set(&mut site, 0, "CAM_SHUTTER", MavParamExtType::REAL64, &value.to_le_bytes());
        let ack = ack(&mut site, 0);
        let present = bytes(&0.004f64.to_le_bytes());
        assert_eq!((ack.param_result, ack.param_value), (ParamAck::VALUE_UNSUPPORTED, present), "{value}");
        assert!(site.vehicle.changes.is_empty());
    }
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::from_bits(0x7F80_0001)] {
        let mut site = site();
        set(&mut site, 0, "F32", MavParamExtType::REAL32, &value.to_le_bytes());
        assert_eq!(ack(&mut site, 0).param_result, ParamAck::VALUE_UNSUPPORTED, "{value}");
        assert!(site.vehicle.changes.is_empty());
    }
    let mut site = site();
    set(&mut site, 0, "CAM_SHUTTER", MavParamExtType::REAL64, &f64::MAX.to_le_bytes());
    assert_eq!(ack(&mut site, 0).param_result, ParamAck::ACCEPTED);
    assert_eq!(site.vehicle.shutter, f64::MAX);
}

/// P-41: a change that takes long is IN_PROGRESS first, and answered again at its end.
#[test]
fn long_change_is_answered_twice() {
    let mut site = site();
    site.vehicle.refuses = Some(ParamAck::IN_PROGRESS);
    set(&mut site, 0, "CAM_ISO", MavParamExtType::UINT32, &800u32.to_le_bytes());
    assert_eq!(ack(&mut site, 0).param_result, ParamAck::IN_PROGRESS);
    site.run_for(secs(1));
    site.gcs[1].forget();
    site.vehicle.iso = 800;
    for _ in 0..5 {
        site.stack.ext_parameters.finish(0, ParamAck::ACCEPTED);
        for link in [0, 1] {
            let ack = ack(&mut site, link);
            assert_eq!((ack.param_result, ack.param_value), (ParamAck::ACCEPTED, bytes(&800u32.to_le_bytes())));
        }
    }
}

/// P-41, S-10, L-4: a broadcast changes nothing, and neither does a request on a link that cannot carry the answer.
#[test]
fn change_without_a_possible_answer_is_dropped() {
    let mut site = site();
    for target_system in [0, 2] {
        let (param_id, param_type) = (Text::new("CAM_ISO"), MavParamExtType::UINT32);
        let param_value = bytes(&800u32.to_le_bytes());
        let set = ParamExtSet { target_system, target_component: 1, param_id, param_value, param_type };
        send(&mut site, 0, STATION, &set);
    }
    for link in [2, 3] {
        set(&mut site, link, "CAM_ISO", MavParamExtType::UINT32, &800u32.to_le_bytes());
        read(&mut site, link, 0, "");
        send(&mut site, link, STATION, &ParamExtRequestList { target_system: 1, target_component: 1 });
    }
    site.run_for(secs(1));
    assert!(site.vehicle.changes.is_empty());
    let received = |link: usize| site.gcs[link].received.iter().any(|frame| (320..=324).contains(&frame.header.id));
    assert_eq!([0, 1, 2, 3].map(received), [false; 4]);
}

/// P-41, D-3: a full link delays answers; what has no room for its answer is dropped without effect. A stalled link blocks no
/// other one.
#[test]
fn answers_wait_for_room() {
    let mut site = site();
    let now = site.now();
    site.uarts[0].stall_writes_until(now + secs(1));
    let names = ["CAM_ISO", "CAM_OWNER", "CAM_SHUTTER", "U8"];
    let kinds = [MavParamExtType::UINT32, MavParamExtType::CUSTOM, MavParamExtType::REAL64, MavParamExtType::UINT8];
    // The first one takes the link's buffer.
    site.run_for(millis(2));
    for (name, kind) in names.into_iter().zip(kinds) {
        set(&mut site, 0, name, kind, &400u32.to_le_bytes());
    }
    assert_eq!(site.vehicle.changes, [0, 1, 2], "three at a time");
    assert_eq!(site.stack.link_counters(LinkId(0)).unwrap().no_answer_slot, 1);
    // The other link's request takes the place of one of these.
    site.run_for(millis(100));
    set(&mut site, 1, "U8", MavParamExtType::UINT8, &[1]);
    site.run_for(millis(100));
    let last = *site.gcs[1].all::<ParamExtAck>().last().expect("an answer");
    assert_eq!((last.1.param_id.as_str(), last.1.param_result), (Some("U8"), ParamAck::VALUE_UNSUPPORTED));
    site.run_for(secs(2));
    assert_eq!(site.gcs[0].count_of::<ParamExtAck>(), 3);
}
