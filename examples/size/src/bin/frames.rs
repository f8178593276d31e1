//! Frames and messages only: receives 12 message types, reads every field of each, and sends 8 types.
#![no_std]
#![no_main]

use core::hint::black_box;

use embedded_io::{Read, ReadReady, Write};
use mavstack::dialect::{
    CommandAck, CommandInt, CommandLong, Heartbeat, MavAutopilot, MavCmd, MavMissionResult, MavModeFlag, MavResult,
    MavSeverity, MavState, MavType, MissionAck, MissionClearAll, MissionCount, MissionItemInt, MissionRequestInt,
    MissionRequestList, ParamRequestList, ParamRequestRead, ParamSet, ParamValue, Statustext,
};
use mavstack::frame::{Decoder, Version, encode};
use mavstack::message::Dialect;
use mavstack::{Address, Frame, Instant, Message, Text};
use mavstack_size::{Place, Uart, entry, now_micros};

mavstack::dialect! {
    struct Twelve: [
        Heartbeat, CommandLong, CommandInt, MissionCount, MissionItemInt, MissionRequestInt, MissionRequestList,
        MissionAck, MissionClearAll, ParamRequestList, ParamRequestRead, ParamSet,
    ];
}

struct Tx {
    uart: Uart,
    seq: u8,
    frame: [u8; 280],
}

impl Tx {
    fn send<M: Message>(&mut self, message: &M) {
        let len = encode(message, Version::V2, Address::new(1, 1), self.seq, &mut self.frame).unwrap_or(0);
        self.flush(len);
    }

    fn flush(&mut self, len: usize) {
        self.seq = self.seq.wrapping_add(1);
        let mut rest = self.frame.get(..len).unwrap_or_default();
        while !rest.is_empty() {
            let sent = self.uart.write(rest).unwrap_or(0);
            rest = rest.get(sent..).unwrap_or_default();
        }
    }

    fn acknowledge(&mut self, command: MavCmd, frame: &Frame<'_>) {
        self.send(&CommandAck {
            command,
            result: black_box(MavResult::ACCEPTED),
            progress: 255,
            result_param2: 0,
            target_system: frame.source().system.wire(),
            target_component: frame.source().component.wire(),
        });
    }
}

/// Decodes a message so that every field is used.
fn read<M: Message>(frame: &Frame<'_>) -> M {
    black_box(M::decode(frame.payload()))
}

fn handle(frame: &Frame<'_>, tx: &mut Tx) {
    match frame.id() {
        Heartbeat::ID => {
            let _: Heartbeat = read(frame);
            tx.send(&Heartbeat {
                custom_mode: black_box(1),
                r#type: MavType::QUADROTOR,
                autopilot: MavAutopilot::GENERIC,
                base_mode: black_box(MavModeFlag::SAFETY_ARMED),
                system_status: black_box(MavState::ACTIVE),
                mavlink_version: 3,
            });
        }
        CommandLong::ID => tx.acknowledge(read::<CommandLong>(frame).command, frame),
        CommandInt::ID => tx.acknowledge(read::<CommandInt>(frame).command, frame),
        MissionCount::ID => {
            let count: MissionCount = read(frame);
            tx.send(&MissionRequestInt { seq: count.count, mission_type: count.mission_type, ..Default::default() });
        }
        MissionItemInt::ID => {
            let item: MissionItemInt = read(frame);
            tx.send(&MissionAck {
                r#type: black_box(MavMissionResult::ACCEPTED),
                mission_type: item.mission_type,
                ..Default::default()
            });
        }
        MissionRequestInt::ID => {
            let request: MissionRequestInt = read(frame);
            tx.send(&MissionItemInt { seq: request.seq, ..black_box(MissionItemInt::default()) });
        }
        MissionRequestList::ID => {
            let request: MissionRequestList = read(frame);
            tx.send(&MissionCount {
                count: black_box(3),
                mission_type: request.mission_type,
                ..black_box(MissionCount::default())
            });
        }
        MissionAck::ID => drop(read::<MissionAck>(frame)),
        MissionClearAll::ID => drop(read::<MissionClearAll>(frame)),
        ParamRequestList::ID => drop(read::<ParamRequestList>(frame)),
        ParamRequestRead::ID => {
            let request: ParamRequestRead = read(frame);
            tx.send(&ParamValue { param_id: request.param_id, ..black_box(ParamValue::default()) });
        }
        ParamSet::ID => {
            let _: ParamSet = read(frame);
            let severity = black_box(MavSeverity::INFO);
            tx.send(&Statustext { severity, text: Text::new("parameter set"), ..Default::default() });
        }
        _ => {}
    }
}

#[entry]
fn main() -> ! {
    static TX: Place<Tx> = Place::new();
    static DECODER: Place<Decoder> = Place::new();

    let mut uart = Uart;
    let tx = TX.put(Tx { uart: Uart, seq: 0, frame: [0; 280] });
    let decoder = DECODER.put(Decoder::default());
    loop {
        let now = Instant::from_micros(now_micros());
        if uart.read_ready() == Ok(true) {
            let len = uart.read(decoder.spare()).unwrap_or(0);
            decoder.filled(len, now);
        }
        let mut budget = Decoder::MIN_BUDGET;
        while let Some(frame) = decoder.next(now, Twelve::MESSAGES, &mut budget, |_| false) {
            handle(&frame, tx);
        }
    }
}
