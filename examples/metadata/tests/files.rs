//! A ground station follows COMPONENT_METADATA to the description of the parameters.

use std::io::Read as _;

use example_metadata::{Boat, Mavlink, Tuning};
use lzma_rust2::XzReader;
use mavstack::dialect::{CommandLong, Common, ComponentMetadata, MavCmd};
use mavstack::frame::{Decoder, MAX_FRAME_LEN, Version, encode};
use mavstack::message::Dialect;
use mavstack::metadata::{self, MetadataFile};
use mavstack::{Address, Config, Duration, Files, Instant, LinkConfig, LinkId, Pulse, StackOf};

static PULSE: Pulse = Pulse::new();
const LINK: LinkId = LinkId(0);

/// Requests COMPONENT_METADATA of the boat, and returns its answer.
fn requested() -> Option<ComponentMetadata> {
    let mut stack = StackOf::<Mavlink>::new(Config::new(Address::new(1, 1), &PULSE), [LinkConfig::uart(57_600)]);
    let (mut boat, mut decoder, mut now) = (Boat, Decoder::default(), Instant::from_millis(1));
    let command = CommandLong {
        command: MavCmd::REQUEST_MESSAGE,
        param1: 397.0,
        target_system: 1,
        target_component: 1,
        ..CommandLong::UNKNOWN
    };
    let mut frame = [0; MAX_FRAME_LEN];
    let len = encode(&command, Version::V2, Address::new(255, 190), 0, &mut frame).expect("the buffer fits any frame");
    stack.receive(now, LINK, &frame[..len], &mut boat);
    for _ in 0..1_000 {
        stack.poll(now, &mut boat);
        let bytes = stack.transmit(now, LINK, &mut boat).to_vec();
        stack.transmitted(LINK, bytes.len());
        let _ = decoder.push(&bytes, now);
        while let Some(frame) = decoder.next(now, Common::MESSAGES, &mut u32::MAX.clone(), |_| true) {
            if let Some(metadata) = frame.decode() {
                return Some(metadata);
            }
        }
        now += Duration::from_millis(1);
    }
    None
}

/// O-1: the message names the general file, that names the description, and each has the checksum of the next.
#[test]
fn files_are_made_from_the_declaration() {
    let [general, description] = Boat::FILES else { panic!("{:?}", Boat::FILES) };
    let answer = requested().expect("sent");
    assert_eq!(answer.uri.as_str(), Some("mftp:///general.json"));
    assert_eq!(answer.file_crc, metadata::file_crc(general.bytes()));

    let named = MetadataFile::parameters("mftp:///parameters.json.xz", metadata::file_crc(description.bytes()));
    let mut expected = String::new();
    metadata::general(&mut expected, &[named]).expect("a string takes all");
    assert_eq!(general.bytes(), expected.as_bytes());

    let (mut unpacked, mut declared) = (String::new(), String::new());
    XzReader::new(description.bytes(), false).read_to_string(&mut unpacked).expect("a valid file");
    metadata::parameters::<Tuning>(&mut declared).expect("a string takes all");
    assert_eq!(unpacked, declared);
    assert!(unpacked.contains(r#""bitmask":[{"index":0,"description":"GPS"}"#), "{unpacked}");
}
