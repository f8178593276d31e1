//! The rover's board, sound or with one fault.

use std::collections::VecDeque;

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use mavstack::dialect::{Attitude, GpsFixType, Heartbeat, MavAutopilot, MavProtocolCapability, MavState, MavType};
use mavstack::frame::{Version, encode};
use mavstack::message::LatLon;
use mavstack::prelude::*;
use mavstack::storage::Store;
use mavstack::telemetry::{Battery, GpsFix, Home, Motion};
use mavstack_rover::{Mavlink, Rover, Tuning, config};
use mavstack_station::Client;
use mavstack_station::kit::{self, Board, Firmware, LineConfig, LineError, Port, RamFlash, Rig};

type Flash = RamFlash<4, 4_096>;

/// The baud rate of the line.
pub const BAUD: u32 = 57_600;
/// The baud rate of a line that carries less than the rover streams.
pub const SLOW_BAUD: u32 = 2_400;
/// The bytes of the DMA's buffer that is too short.
const DMA_LEN: usize = 64;
/// How long an erase takes.
const ERASE: Duration = Duration::from_secs(2);
/// How long a flight loop stands still that waits for the storage.
const PAUSE: Duration = Duration::from_secs(3);
/// A driver sends this many bytes in a second without loss. Beyond that, it loses one byte of this many.
const BUSY: (u64, u64) = (2_000, 100);
/// The time slots of a radio.
const SLOT: Duration = Duration::from_millis(80);

/// What is wrong with the board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// Nothing.
    None,
    /// The baud rates differ: bytes are damaged both ways.
    Baud,
    /// The UART's FIFO of 64 bytes is polled every 20 ms.
    Fifo,
    /// The UART's FIFO of 12 bytes is polled every 10 ms: it does not hold a frame.
    TinyFifo,
    /// The DMA's buffer is emptied only when the line is idle.
    DmaCut,
    /// The stack is polled every 200 ms.
    SlowPoll,
    /// `Stack::poll` is not called.
    NoPoll,
    /// An erase takes 2 s, and each stored parameter needs one.
    Erase,
    /// Milliseconds are passed as microseconds.
    ClockMillis,
    /// `LinkConfig` has a higher rate than the line.
    Streams,
    /// The component id is 50.
    Component,
    /// A timer sends the heartbeats, with numbers of its own.
    Timer,
    /// The same, and an erase takes 2 s.
    TimerErase,
    /// The main loop hangs, and a timer sends the heartbeats.
    TimerHangs,
    /// A log is written to the same port.
    Log,
    /// The board has no power.
    Dead,
    /// The flight loop stands still for 3 s when a parameter is stored; another task polls the link.
    SlowLoop,
    /// A driver loses bytes while it sends more than 2,000 a second.
    BusyTx,
    /// None: a radio with time slots is between the board and the station.
    SlottedRadio,
    /// None: a gimbal of the same system streams other values.
    Gimbal,
    /// A parameter that was changed keeps its new value.
    KeepsValue,
    /// The capabilities announce a fence, which the stack does not have.
    Promises,
}

/// The board's firmware.
pub struct BoardFirmware {
    fault: Fault,
    stack: Box<StackOf<Mavlink>>,
    /// The vehicle.
    pub rover: Rover,
    store: Store<Flash>,
    dma: Dma,
    radio: Radio,
    /// When the timer sends its next heartbeat, and with which number.
    timer: (Instant, u8),
    /// Until when the main loop stands still.
    busy_until: Instant,
    speed: f32,
    /// The current second, and the bytes sent in it.
    sent: (u64, u64),
    /// The value that a parameter keeps.
    kept: Option<f32>,
}

impl BoardFirmware {
    /// Starts as `main` does after a reset, with this rate in its `LinkConfig`.
    pub fn boot(board: &Board, fault: Fault, baud: u32) -> Self {
        let (pulse, len) = (kit::pulse(), Store::<Flash>::region_len::<Mavlink>());
        let mut config = config(pulse);
        if fault == Fault::Component {
            config = Config {
                r#type: config.r#type,
                durability: config.durability,
                ..Config::new(Address::new(1, 50), pulse)
            };
        }
        if fault == Fault::Promises {
            config.identity.capabilities = MavProtocolCapability::MISSION_FENCE;
        }
        if matches!(fault, Fault::Timer | Fault::TimerErase | Fault::TimerHangs) {
            config.pulse = None;
        }
        let stack = StackOf::<Mavlink>::new(config, [LinkConfig::uart(baud)]);
        let mut firmware = Self {
            fault,
            stack: Box::new(stack),
            rover: rover(pulse),
            store: Store::new(board.flash(len), 0..len),
            dma: Dma::default(),
            radio: Radio::default(),
            timer: (Instant::ZERO, 0),
            busy_until: Instant::ZERO,
            speed: 2.0,
            sent: (0, 0),
            kept: None,
        };
        let _ = firmware.stack.restore(Instant::ZERO, &mut firmware.store, &mut firmware.rover);
        firmware
    }

    /// The time as the firmware passes it.
    fn time(&self, now: Instant) -> Instant {
        match self.fault {
            Fault::ClockMillis => Instant::from_micros(now.as_millis()),
            _ => now,
        }
    }

    /// The interrupt of a timer that sends heartbeats.
    fn on_timer(&mut self, now: Instant, port: &mut Port) {
        let has_timer = [Fault::Timer, Fault::TimerErase, Fault::TimerHangs, Fault::Gimbal].contains(&self.fault);
        if !has_timer || now < self.timer.0 {
            return;
        }
        if self.fault == Fault::Gimbal {
            self.send_as_gimbal(now, port);
            return;
        }
        let heartbeat = Heartbeat {
            r#type: MavType::GROUND_ROVER,
            autopilot: MavAutopilot::GENERIC,
            system_status: MavState::STANDBY,
            custom_mode: mavstack_rover::HOLD,
            mavlink_version: 3,
            ..Heartbeat::default()
        };
        let mut frame = [0; 64];
        let len = encode(&heartbeat, Version::V2, Address::new(1, 1), self.timer.1, &mut frame).expect("room");
        let _ = port.write(&frame[..len]);
        self.timer = (now + Duration::from_secs(1), self.timer.1.wrapping_add(1));
    }

    /// Sends what a gimbal streams, with angles in degrees and a clock of its own.
    fn send_as_gimbal(&mut self, now: Instant, port: &mut Port) {
        let heartbeat = Heartbeat { r#type: MavType::GIMBAL, autopilot: MavAutopilot::INVALID, ..Heartbeat::default() };
        let time_boot_ms = u32::try_from(now.as_millis() * 7).expect("a test is short");
        let attitude = Attitude { time_boot_ms, yaw: 271.0, ..Attitude::default() };
        let mut frames = [0; 128];
        let from = Address::new(1, 154);
        let first = encode(&heartbeat, Version::V2, from, self.timer.1, &mut frames).expect("room");
        let second = encode(&attitude, Version::V2, from, self.timer.1.wrapping_add(1), &mut frames[first..]);
        let _ = port.write(&frames[..first + second.expect("room")]);
        self.timer = (now + Duration::from_millis(40), self.timer.1.wrapping_add(2));
    }

    /// Whether the main loop stands still: it stores a parameter, or hangs.
    fn is_stalled(&mut self, now: Instant) -> bool {
        let speed = self.stack.parameters().get(Tuning::SPEED_MAX);
        if speed != self.speed {
            let time = match self.fault {
                Fault::Erase | Fault::TimerErase => ERASE,
                Fault::SlowLoop => PAUSE,
                _ => Duration::ZERO,
            };
            (self.speed, self.busy_until) = (speed, now + time);
        }
        now < self.busy_until || self.fault == Fault::Dead || self.fault == Fault::TimerHangs
    }
}

/// A rover whose sensors all have values.
fn rover(pulse: &'static Pulse) -> Rover {
    let place = LatLon { latitude: 473_977_000, longitude: 85_456_000 };
    let mut rover = Rover::new(pulse);
    rover.motion = Motion {
        position: Some(place),
        altitude: 500.0,
        relative_altitude: 0.0,
        velocity: [0.0; 3],
        attitude: [0.0, 0.0, 1.0],
        rates: [0.0; 3],
        airspeed: 0.0,
        groundspeed: 0.0,
        throttle: 0.0,
    };
    rover.gps = GpsFix {
        fix_type: GpsFixType::_3D_FIX,
        position: Some(place),
        altitude: 500.0,
        satellites: Some(12),
        ..GpsFix::UNKNOWN
    };
    rover.home = Some(Home { position: place, altitude: 500.0, local: [0.0; 3] });
    rover.battery = Battery { voltage: 12.2, remaining: 0.8, ..Battery::UNKNOWN };
    rover
}

impl Firmware for BoardFirmware {
    fn fly(&mut self, now: Instant) {
        if !self.is_stalled(now) {
            let now = self.time(now);
            self.rover.drive(now, &mut self.stack);
        }
    }

    fn poll(&mut self, now: Instant, ports: &mut [Port]) {
        self.on_timer(now, &mut ports[0]);
        if self.is_stalled(now) && self.fault != Fault::SlowLoop {
            return;
        }
        if self.fault == Fault::KeepsValue {
            let speed = self.stack.parameters().get(Tuning::SPEED_MAX);
            self.kept = self.kept.or(Some(speed).filter(|speed| *speed != 2.0));
            let _ = self.stack.parameters_mut().set(Tuning::SPEED_MAX, self.kept.unwrap_or(speed));
        }
        let now = self.time(now);
        if self.fault != Fault::NoPoll {
            self.stack.poll(now, &mut self.rover);
        }
        let port = &mut ports[0];
        let _ = match self.fault {
            Fault::DmaCut => {
                self.dma.transfer(port);
                let mut port = DmaPort { port, dma: &mut self.dma };
                self.stack.poll_link(now, LinkId(0), &mut port, &mut self.rover)
            }
            Fault::SlottedRadio => {
                self.radio.transfer(now, port);
                self.stack.poll_link(now, LinkId(0), &mut self.radio, &mut self.rover)
            }
            Fault::BusyTx => {
                let second = now.as_millis() / 1_000;
                self.sent = if self.sent.0 == second { self.sent } else { (second, 0) };
                let mut port = BusyPort { port, sent: &mut self.sent.1 };
                self.stack.poll_link(now, LinkId(0), &mut port, &mut self.rover)
            }
            _ => self.stack.poll_link(now, LinkId(0), port, &mut self.rover),
        };
        if self.fault == Fault::Log && now.as_millis().is_multiple_of(1_000) {
            let _ = port.write(b"loop: 1000 passes\r\n");
        }
        self.stack.persist(now, &mut self.store, &mut self.rover);
    }
}

/// A DMA that fills a short buffer, and hands it over when the line is idle.
#[derive(Default)]
struct Dma {
    filling: Vec<u8>,
    ready: VecDeque<u8>,
}

impl Dma {
    /// Takes what has arrived in this pass.
    fn transfer(&mut self, port: &mut Port) {
        let mut is_idle = true;
        while port.read_ready() == Ok(true) {
            let mut bytes = [0; 64];
            let len = port.read(&mut bytes).unwrap_or(0);
            let room = DMA_LEN - self.filling.len();
            self.filling.extend(&bytes[..len.min(room)]);
            is_idle = false;
        }
        if is_idle {
            self.ready.extend(self.filling.drain(..));
        }
    }
}

/// The UART with this DMA.
struct DmaPort<'a> {
    port: &'a mut Port,
    dma: &'a mut Dma,
}

impl ErrorType for DmaPort<'_> {
    type Error = LineError;
}

impl ReadReady for DmaPort<'_> {
    fn read_ready(&mut self) -> Result<bool, LineError> {
        Ok(!self.dma.ready.is_empty())
    }
}

impl Read for DmaPort<'_> {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, LineError> {
        let len = bytes.len().min(self.dma.ready.len());
        bytes.iter_mut().zip(self.dma.ready.drain(..len)).for_each(|(to, from)| *to = from);
        Ok(len)
    }
}

impl WriteReady for DmaPort<'_> {
    fn write_ready(&mut self) -> Result<bool, LineError> {
        self.port.write_ready()
    }
}

impl Write for DmaPort<'_> {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, LineError> {
        self.port.write(bytes)
    }

    fn flush(&mut self) -> Result<(), LineError> {
        self.port.flush()
    }
}

/// A UART whose driver loses bytes while it is busy.
struct BusyPort<'a> {
    port: &'a mut Port,
    /// The bytes sent in this second.
    sent: &'a mut u64,
}

impl ErrorType for BusyPort<'_> {
    type Error = LineError;
}

impl ReadReady for BusyPort<'_> {
    fn read_ready(&mut self) -> Result<bool, LineError> {
        self.port.read_ready()
    }
}

impl Read for BusyPort<'_> {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, LineError> {
        self.port.read(bytes)
    }
}

impl WriteReady for BusyPort<'_> {
    fn write_ready(&mut self) -> Result<bool, LineError> {
        self.port.write_ready()
    }
}

impl Write for BusyPort<'_> {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, LineError> {
        *self.sent += 1;
        let is_lost = *self.sent > BUSY.0 && self.sent.is_multiple_of(BUSY.1);
        if is_lost { Ok(1) } else { self.port.write(&bytes[..1]) }
    }

    fn flush(&mut self) -> Result<(), LineError> {
        self.port.flush()
    }
}

/// A radio whose two ends send in turn.
#[derive(Default)]
struct Radio {
    to_vehicle: VecDeque<u8>,
    from_vehicle: VecDeque<u8>,
}

impl Radio {
    /// Carries what waits in the direction whose slot it is.
    fn transfer(&mut self, now: Instant, port: &mut Port) {
        if (now.as_millis() / SLOT.as_millis()).is_multiple_of(2) {
            while port.read_ready() == Ok(true) {
                let mut bytes = [0; 64];
                let len = port.read(&mut bytes).unwrap_or(0);
                self.to_vehicle.extend(&bytes[..len]);
            }
        } else if !self.from_vehicle.is_empty() && port.write_ready() == Ok(true) {
            let written = port.write(self.from_vehicle.make_contiguous()).unwrap_or(0);
            self.from_vehicle.drain(..written);
        }
    }
}

impl ErrorType for Radio {
    type Error = LineError;
}

impl ReadReady for Radio {
    fn read_ready(&mut self) -> Result<bool, LineError> {
        Ok(!self.to_vehicle.is_empty())
    }
}

impl Read for Radio {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, LineError> {
        let len = bytes.len().min(self.to_vehicle.len());
        bytes.iter_mut().zip(self.to_vehicle.drain(..len)).for_each(|(to, from)| *to = from);
        Ok(len)
    }
}

impl WriteReady for Radio {
    fn write_ready(&mut self) -> Result<bool, LineError> {
        Ok(self.from_vehicle.len() < 1_024)
    }
}

impl Write for Radio {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, LineError> {
        self.from_vehicle.extend(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), LineError> {
        Ok(())
    }
}

/// Returns a rig with this board.
pub fn board(fault: Fault) -> Rig<BoardFirmware> {
    let line = LineConfig::uart(if fault == Fault::Streams { SLOW_BAUD } else { BAUD });
    let line = match fault {
        Fault::Baud => line.with_damage(0.002),
        Fault::Fifo => line.with_rx_fifo(64),
        Fault::TinyFifo => line.with_rx_fifo(12),
        _ => line.with_rx_fifo(512),
    };
    board_on(fault, line)
}

/// Returns a rig with this board on another line.
pub fn board_on(fault: Fault, line: LineConfig) -> Rig<BoardFirmware> {
    let baud = u32::try_from(line.down.bytes_per_second * 10).expect("a baud rate");
    let link_baud = if fault == Fault::Streams { baud * 100 } else { baud };
    let boot = move |board: &Board| BoardFirmware::boot(board, fault, link_baud);
    let mut rig = Rig::new(boot).with_line(line, Client::QGroundControl);
    match fault {
        Fault::Fifo => rig.set_poll_interval(Duration::from_millis(20)),
        Fault::TinyFifo => rig.set_poll_interval(Duration::from_millis(10)),
        Fault::SlowPoll => rig.set_poll_interval(Duration::from_millis(200)),
        _ => {}
    }
    rig
}
