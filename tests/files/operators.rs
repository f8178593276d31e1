//! Who changes files: F-2 and O-5.

use super::*;
use mavstack::dialect::MavCmd;

#[derive(mavstack::Stack)]
#[stack(
    vehicle: TestVehicle,
    links: 1,
    plans: { mission: 5 },
    parameters: Tuning,
    commands: { slots: 3 },
    operator_control,
    files: { sessions: 2, upload: 512 },
)]
pub(super) struct Controlled;

use MavFtpOpcode as Op;

/// All requests that change something.
const CHANGES: [(Op, &[u8]); 11] = [
    (Op::CREATEFILE, b"log.bin"),
    (Op::CREATEFILE, b"@MISSION/mission.dat"),
    (Op::CREATEFILE, b"@PARAM/param.pck"),
    (Op::OPENFILEWO, b"log.bin"),
    (Op::OPENFILEWO, b"@MISSION/mission.dat"),
    (Op::WRITEFILE, b"abc"),
    (Op::REMOVEFILE, b"log.bin"),
    (Op::TRUNCATEFILE, b"log.bin"),
    (Op::RENAME, b"log.bin\0new.bin"),
    (Op::CREATEDIRECTORY, b"d"),
    (Op::REMOVEDIRECTORY, b"d"),
];
/// Requests that only read.
const READS: [(Op, &[u8]); 6] = [
    (Op::LISTDIRECTORY, b"/"),
    (Op::CALCFILECRC, b"log.bin"),
    (Op::OPENFILERO, b"@MISSION/mission.dat"),
    (Op::OPENFILERO, b"log.bin"),
    (Op::READFILE, b""),
    (Op::TERMINATESESSION, b""),
];

pub(super) struct Field {
    pub(super) world: World<1, Controlled>,
    seq: u16,
}

impl Field {
    pub(super) fn new() -> Self {
        let uart = LinkConfig::uart(921_600).with_own_system(true).with_streams(StreamProfile::Off);
        let mut world = World::<1, Controlled>::of(Setup { links: [uart], ..Setup::new() });
        world.gcs[0].takes_unknown = true;
        world.vehicle.files.content.insert("log.bin".to_string(), pattern(1_000));
        Self { world, seq: 0 }
    }

    fn send<M: mavstack::Message>(&mut self, from: Address, message: &M) {
        let frame = self.world.gcs[0].frame_from(from, message);
        self.world.stack.receive(self.world.clock.now(), LinkId(0), &frame, &mut self.world.vehicle);
    }

    /// Requests control.
    pub(super) fn take_control(&mut self, from: Address) {
        self.send(from, &Gcs::heartbeat());
        let id = f32::from(from.system.wire());
        let request = self.world.gcs[0].long(MavCmd(32_100), [1.0, 1.0, 10.0, id, 0.0, 0.0, 0.0]);
        self.send(from, &request);
        self.world.run_for(millis(20));
        assert_eq!(self.world.stack.operator(self.world.now()), Some(from.system));
    }

    /// Sends a request, and returns its answer: the error, if it is one.
    pub(super) fn ask(&mut self, from: Address, opcode: Op, data: &[u8]) -> Option<Result<(), MavFtpErr>> {
        self.seq += 10;
        self.world.gcs[0].forget();
        self.send(from, &request(self.seq, 0, opcode, data.len() as u8, 0, data));
        self.world.run_for(millis(100));
        let answers = self.world.gcs[0].all::<FileTransferProtocol>();
        assert!(answers.len() <= 1, "{opcode:?}");
        answers.first().map(|(_, answer)| Packet::of(answer).error().map_or(Ok(()), Err))
    }
}

/// O-5, X-5: a system that is not in control changes no file and uploads nothing, and is told so; but it reads. It loses what it has
/// opened to write before.
#[test]
fn only_the_operator_in_control_changes_files() {
    let mut field = Field::new();
    assert_eq!(field.ask(STATION, Op::OPENFILEWO, b"log.bin"), Some(Ok(())), "nobody is in control");
    assert_eq!(field.ask(STATION, Op::WRITEFILE, b"abc"), Some(Ok(())));
    let content = field.world.vehicle.files.content.clone();
    field.take_control(OTHER_STATION);
    for (opcode, data) in CHANGES {
        assert_eq!(field.ask(STATION, opcode, data), Some(Err(MavFtpErr::FILEPROTECTED)), "{opcode:?}");
    }
    let files = &field.world.vehicle.files;
    assert_eq!((files.changes, files.writes, &files.content), (0, 1, &content));
    for (opcode, data) in READS {
        assert_eq!(field.ask(STATION, opcode, data), Some(Ok(())), "{opcode:?}");
    }
    let component = Address::new(1, 191);
    for from in [OTHER_STATION, component] {
        assert_eq!(field.ask(from, Op::CREATEFILE, b"@MISSION/mission.dat"), Some(Ok(())));
        assert_eq!(field.ask(from, Op::CREATEFILE, b"new.bin"), Some(Ok(())));
        assert_eq!(field.ask(from, Op::WRITEFILE, b"abc"), Some(Ok(())));
        assert_eq!(field.ask(from, Op::TERMINATESESSION, b""), Some(Ok(())));
        assert_eq!(field.ask(from, Op::REMOVEFILE, b"new.bin"), Some(Ok(())));
    }
    assert_eq!(field.world.vehicle.files.content, content);
}

/// O-5: secondary systems change files as they send commands.
#[test]
fn secondary_systems_change_files() {
    let mut field = Field::new();
    field.take_control(OTHER_STATION);
    field.world.stack.operator_control_mut().set_secondaries(&[STATION.system]);
    assert_eq!(field.ask(STATION, Op::REMOVEFILE, b"log.bin"), Some(Ok(())));
}

/// F-2: the vehicle learns who opens a file to write, writes to it or changes it, and may refuse each.
#[test]
fn vehicle_may_refuse_by_sender() {
    let (mut world, mut client) = (world(), client());
    client.create(&mut world, "new.bin").unwrap();
    client.write(&mut world, 0, b"abc").unwrap();
    world.vehicle.files.owner = Some(OTHER_STATION);
    assert_eq!(client.write(&mut world, 3, b"def"), Err(MavFtpErr::FILEPROTECTED));
    for (opcode, path) in [
        (Op::CREATEFILE, "new.bin"),
        (Op::OPENFILEWO, "new.bin"),
        (Op::REMOVEFILE, "new.bin"),
        (Op::TRUNCATEFILE, "new.bin"),
        (Op::RENAME, "new.bin\0old.bin"),
        (Op::CREATEDIRECTORY, "d"),
        (Op::REMOVEDIRECTORY, "d"),
    ] {
        assert_eq!(client.path(&mut world, opcode, path), Err(MavFtpErr::FILEPROTECTED), "{opcode:?}");
    }
    assert_eq!(client.open(&mut world, "new.bin"), Ok(3));
    let mut owner = Client { address: OTHER_STATION, ..client };
    owner.path(&mut world, Op::OPENFILEWO, "new.bin").unwrap();
    owner.write(&mut world, 3, b"def").unwrap();
    assert_eq!(world.vehicle.files.content["new.bin"], b"abcdef");
    assert_eq!(owner.path(&mut world, Op::REMOVEFILE, "new.bin"), Ok(vec![]));
}
