//! What each client sends, byte by byte and second by second: a vehicle of the test's own answers.

use mavstack::dialect::{
    Common, CurrentEventSequence, Event, FileTransferProtocol, LogData, LogRequestData, MavFtpErr, MavFtpOpcode,
    RequestEvent, ResponseEventError, SetupSigning,
};
use mavstack::frame::{Decoder, MAX_FRAME_LEN, Version, encode};
use mavstack::message::Dialect;
use mavstack::{Address, Duration, Instant, Message};
use mavstack_station::events::Follow;
use mavstack_station::files::{Download, Operation, Packet};
use mavstack_station::logs::{self, Log};
use mavstack_station::signing::Setup;
use mavstack_station::{Client, Dialogue, Failure, Station};

const VEHICLE: Address = Address::new(1, 1);

/// A dialogue, and the vehicle that the test plays.
struct Script<D: Dialogue> {
    station: Station,
    dialogue: D,
    now: Instant,
    decoder: Decoder,
    result: Option<Result<D::Output, Failure>>,
}

impl<D: Dialogue> Script<D> {
    fn new(client: Client, dialogue: D) -> Self {
        let station = Station::new(client).with_heartbeats(None).with_version(Version::V2).with_target(VEHICLE);
        Self { station, dialogue, now: Instant::ZERO, decoder: Decoder::new(Duration::MAX), result: None }
    }

    /// Returns the messages that the station sends within this time.
    fn sent<M: Message>(&mut self, within: Duration) -> Vec<M> {
        let end = self.now + within;
        let mut sent = Vec::new();
        while self.now <= end && self.result.is_none() {
            self.result = self.station.advance(self.now, &mut self.dialogue);
            let output = self.station.take_output();
            let mut rest = &output[..];
            while !rest.is_empty() {
                rest = &rest[self.decoder.push(rest, self.now)..];
                while let Some(frame) = self.decoder.next(self.now, Common::MESSAGES, &mut u32::MAX.clone(), |_| false)
                {
                    sent.extend(frame.decode::<M>());
                }
            }
            self.now += Duration::from_millis(10);
        }
        sent
    }

    fn packets(&mut self, within: Duration) -> Vec<Packet> {
        self.sent::<FileTransferProtocol>(within).iter().map(Packet::from).collect()
    }

    fn answer<M: Message>(&mut self, message: &M) {
        let mut frame = [0; MAX_FRAME_LEN];
        let len = encode(message, Version::V2, VEHICLE, 0, &mut frame).expect("every message fits");
        self.station.receive(self.now, &frame[..len]);
    }

    /// Answers an FTP request.
    fn reply(&mut self, request: &Packet, opcode: MavFtpOpcode, offset: u32, data: &[u8]) {
        let mut packet = Packet::request(opcode, offset, data);
        (packet.number, packet.session) = (request.number.wrapping_add(1), request.session);
        packet.request = request.opcode;
        let message = packet.message(self.station.address());
        self.answer(&message);
    }
}

const MOMENT: Duration = Duration::from_millis(20);
const SECOND: Duration = Duration::from_secs(1);

#[test]
fn ftp_requests_have_the_clients_form() {
    for client in Client::ALL {
        let mut script = Script::new(client, Download::new("/file"));
        let open = &script.packets(MOMENT)[0];
        let path: &[u8] = if client == Client::Mavsdk { b"/file\0" } else { b"/file" };
        assert_eq!((open.opcode, &open.data[..]), (MavFtpOpcode::OPENFILERO, path), "{client}");
        script.reply(open, MavFtpOpcode::ACK, 0, &10u32.to_le_bytes());
        let burst = &script.packets(MOMENT)[0];
        let size = if client == Client::Pymavlink { 80 } else { 239 };
        assert_eq!((burst.opcode, burst.size, burst.offset), (MavFtpOpcode::BURSTREADFILE, size, 0), "{client}");
        let step = if client == Client::QGroundControl { 2 } else { 1 };
        assert_eq!(burst.number.wrapping_sub(open.number), step, "{client}");
    }
}

#[test]
fn ftp_sessions_end_as_the_client_ends_them() {
    for (client, opcode, is_awaited) in [
        (Client::QGroundControl, MavFtpOpcode::RESETSESSION, true),
        (Client::Mavsdk, MavFtpOpcode::TERMINATESESSION, true),
        (Client::MavProxy, MavFtpOpcode::TERMINATESESSION, false),
        (Client::Pymavlink, MavFtpOpcode::TERMINATESESSION, true),
    ] {
        let mut script = Script::new(client, Download::new("/file"));
        let open = script.packets(MOMENT).remove(0);
        script.reply(&open, MavFtpOpcode::ACK, 0, &10u32.to_le_bytes());
        let burst = script.packets(MOMENT).remove(0);
        let mut data = Packet::request(MavFtpOpcode::ACK, 0, b"0123456789");
        (data.number, data.session, data.request) = (burst.number.wrapping_add(1), burst.session, burst.opcode);
        data.is_last = true;
        let message = data.message(client.address());
        script.answer(&message);
        let mut next = script.packets(MOMENT).remove(0);
        if client == Client::QGroundControl {
            // It learns by a further burst that the file has ended.
            assert_eq!((next.opcode, next.offset), (MavFtpOpcode::BURSTREADFILE, 10));
            script.reply(&next, MavFtpOpcode::NAK, 10, &[MavFtpErr::EOF.0]);
            next = script.packets(MOMENT).remove(0);
        }
        assert_eq!(next.opcode, opcode, "{client}");
        assert_eq!(script.result.is_none(), is_awaited, "{client}");
        script.reply(&next, MavFtpOpcode::ACK, 0, &[]);
        script.packets(MOMENT);
        assert_eq!(script.result, Some(Ok(b"0123456789".to_vec())), "{client}");
    }
}

/// A server that answers with session 0 whatever the request's, as MAVSDK's, is understood until pymavlink has closed a file.
#[test]
fn pymavlink_counts_the_sessions_that_it_has_ended() {
    let mut script = Script::new(Client::Pymavlink, Download::new("/file"));
    let first = script.packets(MOMENT).remove(0);
    script.reply(&first, MavFtpOpcode::NAK, 0, &[MavFtpErr::FILENOTFOUND.0]);
    let end = script.packets(MOMENT).remove(0);
    assert_eq!((first.session, end.session, end.opcode), (0, 0, MavFtpOpcode::TERMINATESESSION));
    (script.dialogue, script.result) = (Download::new("/other"), None);
    let second = script.packets(MOMENT).remove(0);
    assert_eq!((second.session, second.number), (1, end.number + 1));

    // Without a file there is no session to end.
    let mut script = Script::new(Client::Pymavlink, Operation::remove("/file"));
    assert_eq!(script.packets(SECOND * 30).len(), 1);
    assert!(matches!(script.result, Some(Err(Failure::Timeout { .. }))));
}

/// A repetition with the same number is answered from the server's memory; one with a new number is carried out again.
#[test]
fn ftp_repetitions_have_the_clients_numbers_and_times() {
    for (client, sends, is_same) in [
        (Client::QGroundControl, 4, false),
        (Client::Mavsdk, 10, true),
        (Client::MavProxy, 11, true),
        (Client::Pymavlink, 1, true),
    ] {
        let mut script = Script::new(client, Operation::remove("/file"));
        let mut sent = script.packets(SECOND * 30);
        // The end of the session, after a failure.
        sent.retain(|packet| packet.opcode == MavFtpOpcode::REMOVEFILE);
        let first = sent[0].number;
        assert_eq!(sent.len(), sends, "{client}");
        assert_eq!(sent.iter().all(|packet| packet.number == first), is_same, "{client}");
        assert!(matches!(script.result, Some(Err(Failure::Timeout { .. }))), "{client}");
    }
}

#[test]
fn logs_are_requested_as_the_client_does() {
    let log = Log { id: 3, size: 50_000, time_utc: 0 };
    for (client, first) in [
        (Client::QGroundControl, (0, 46_080)),
        (Client::Mavsdk, (0, 46_080)),
        (Client::MavProxy, (0, u32::MAX)),
        (Client::Pymavlink, (0, u32::MAX)),
    ] {
        let mut script = Script::new(client, logs::Download::new(log));
        let sent: Vec<LogRequestData> = script.sent(MOMENT);
        assert_eq!(sent.iter().map(|request| (request.ofs, request.count)).collect::<Vec<_>>(), [first], "{client}");
        // Two gaps: blocks 1 and 3.
        for block in [0, 2, 4] {
            script.answer(&LogData { ofs: block * 90, id: 3, count: 90, data: [0; 90] });
        }
        let sent: Vec<LogRequestData> = script.sent(SECOND);
        let requests: Vec<_> = sent.iter().map(|request| (request.ofs, request.count)).collect();
        let expected: &[_] = match client {
            Client::QGroundControl | Client::Mavsdk => &[(90, 90), (90, 90)],
            Client::MavProxy | Client::Pymavlink => &[(90, 90), (270, 90)],
        };
        assert_eq!(requests, expected, "{client}");
    }
}

#[test]
fn a_key_is_sent_as_often_as_the_client_does() {
    for (client, copies) in Client::ALL.into_iter().zip([2, 1, 1, 1]) {
        let mut script = Script::new(client, Setup::new([7; 32], 1_000));
        let sent: Vec<SetupSigning> = script.sent(SECOND * 6);
        assert_eq!(sent.len(), copies, "{client}");
        assert!(matches!(script.result, Some(Err(Failure::Timeout { .. }))), "{client}");
    }
}

/// The numbers of events wrap, and a gap is requested one by one, again after 100 ms.
#[test]
fn events_are_requested_as_libevents_does() {
    let event = |sequence| Event { sequence, ..Event::default() };
    let mut script = Script::new(Client::QGroundControl, Follow::new().until(5, SECOND * 10));
    let sequence = 65_534;
    script.sent::<RequestEvent>(MOMENT);
    script.answer(&CurrentEventSequence { sequence, ..CurrentEventSequence::default() });
    script.answer(&event(65_535));
    // 0 and 1 are missing.
    script.answer(&event(2));
    let requested = |sent: &[RequestEvent]| sent.iter().map(|sent| sent.first_sequence).collect::<Vec<_>>();
    assert_eq!(requested(&script.sent(Duration::from_millis(250))), [0, 0, 0]);
    script.answer(&event(0));
    script.answer(&CurrentEventSequence { sequence: 4, ..CurrentEventSequence::default() });
    let sent = script.sent::<RequestEvent>(MOMENT);
    assert_eq!((sent[0].first_sequence, sent[0].last_sequence), (1, 1));
    // The vehicle has 3 and 4 only.
    let Address { system, component } = Client::QGroundControl.address();
    script.answer(&ResponseEventError {
        sequence: 1,
        sequence_oldest_available: 3,
        target_system: system.wire(),
        target_component: component.wire(),
        ..ResponseEventError::default()
    });
    assert_eq!(requested(&script.sent(MOMENT)), [3]);
    script.answer(&event(3));
    assert_eq!(requested(&script.sent(MOMENT)), [4]);
    script.answer(&event(4));
    script.answer(&event(5));
    script.sent::<RequestEvent>(MOMENT);
    assert_eq!(script.dialogue.lost(), 2);
    let events = script.result.expect("five events").unwrap();
    assert_eq!(events.iter().map(|event| event.sequence).collect::<Vec<_>>(), [65_535, 0, 3, 4, 5]);
}
