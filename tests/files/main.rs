//! Files by FTP, and the parameters and the plans as files.

#[path = "../support/mod.rs"]
mod support;

mod leases;
mod loss;
mod model;
mod operators;
mod pace;
mod params;
mod plans;
mod requests;
mod sessions;

use mavstack::config::StreamProfile;
use mavstack::dialect::{FileTransferProtocol, MavFtpErr, MavFtpOpcode};
use mavstack::{Address, LinkConfig, LinkId};
use mavstack_station::files::{Download, Upload};
use mavstack_station::{Again, Dialogue};
use support::files::{Packet, request};
use support::*;

#[derive(mavstack::Stack)]
#[stack(
    vehicle: TestVehicle,
    links: 2,
    plans: { mission: 60, fence: 20, rally: 6 },
    parameters: Tuning,
    streams,
    commands: { slots: 3 },
    files: { sessions: 2, upload: 512 },
)]
struct Filed;

type Shelf = World<2, Filed>;

/// A vehicle with two fast links, and a file of 1,000 bytes.
fn world() -> Shelf {
    let link = LinkConfig::uart(921_600).with_streams(StreamProfile::Off);
    let mut world = Shelf::of(Setup { links: [link; 2], ..Setup::new() });
    world.vehicle.files.content.insert("log.bin".to_string(), pattern(1_000));
    world.run_for(millis(10));
    world
}

/// Bytes that differ from place to place; there are zeros among them.
fn pattern(len: usize) -> Vec<u8> {
    (0..len).map(|i| (i * i / 7 + i / 239) as u8).collect()
}

/// A client that asks one by one.
#[derive(Clone, Copy, Debug)]
struct Client {
    address: Address,
    link: usize,
    session: u8,
    seq: u16,
}

/// An answer: its data, or the error.
type Answered = Result<Vec<u8>, MavFtpErr>;

impl Client {
    const fn new(address: Address, link: usize, session: u8) -> Self {
        Self { address, link, session, seq: 0 }
    }

    /// Receives a message now.
    fn send(&self, world: &mut Shelf, message: &FileTransferProtocol) {
        let frame = world.gcs[self.link].frame_from(self.address, message);
        let link = LinkId(self.link as u8);
        assert_eq!(world.stack.receive(world.clock.now(), link, &frame, &mut world.vehicle), frame.len());
    }

    /// Returns what it receives in the next 50 ms.
    fn packets(&self, world: &mut Shelf) -> Vec<Packet> {
        world.gcs[self.link].forget();
        world.run_for(millis(50));
        let packets = world.gcs[self.link].all::<FileTransferProtocol>().into_iter().map(|(_, message)| message);
        let to = |message: &FileTransferProtocol| Address::new(message.target_system, message.target_component);
        packets.filter(|message| to(message) == self.address).map(|message| Packet::of(&message)).collect()
    }

    /// Sends a request, which gets one answer.
    fn ask(&mut self, world: &mut Shelf, opcode: MavFtpOpcode, size: u8, offset: u32, data: &[u8]) -> Answered {
        self.seq = self.seq.wrapping_add(1);
        self.repeat(world, opcode, size, offset, data)
    }

    /// Sends the same request again.
    fn repeat(&self, world: &mut Shelf, opcode: MavFtpOpcode, size: u8, offset: u32, data: &[u8]) -> Answered {
        self.send(world, &request(self.seq, self.session, opcode, size, offset, data));
        let packets = self.packets(world);
        let [answer] = &packets[..] else { panic!("one answer to {opcode:?}: {packets:?}") };
        assert_eq!((answer.seq, answer.session), (self.seq.wrapping_add(1), self.session), "F-4");
        assert_eq!((answer.request, answer.offset), (opcode, offset), "F-4");
        match answer.error() {
            Some(error) => {
                assert_eq!(answer.data.len(), 1, "F-3");
                Err(error)
            }
            None => {
                assert_eq!(answer.opcode, MavFtpOpcode::ACK);
                Ok(answer.data.clone())
            }
        }
    }

    fn path(&mut self, world: &mut Shelf, opcode: MavFtpOpcode, path: &str) -> Answered {
        self.ask(world, opcode, path.len() as u8, 0, path.as_bytes())
    }

    /// Opens a file, and returns its size.
    fn open(&mut self, world: &mut Shelf, path: &str) -> Result<u32, MavFtpErr> {
        let answer = self.path(world, MavFtpOpcode::OPENFILERO, path)?;
        Ok(u32::from_le_bytes(answer.try_into().expect("a size of four bytes")))
    }

    fn create(&mut self, world: &mut Shelf, path: &str) -> Answered {
        self.path(world, MavFtpOpcode::CREATEFILE, path)
    }

    fn read(&mut self, world: &mut Shelf, offset: u32, size: u8) -> Answered {
        self.ask(world, MavFtpOpcode::READFILE, size, offset, &[])
    }

    fn write(&mut self, world: &mut Shelf, offset: u32, data: &[u8]) -> Answered {
        self.ask(world, MavFtpOpcode::WRITEFILE, data.len() as u8, offset, data)
    }

    fn end(&mut self, world: &mut Shelf) -> Answered {
        self.ask(world, MavFtpOpcode::TERMINATESESSION, 0, 0, &[])
    }
}

/// A client at the first ground station.
fn client() -> Client {
    Client::new(STATION, 0, 0)
}
