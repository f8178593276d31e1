//! mavstack: receives 12 message types, reads every field of each, and sends 8 types.
#![no_std]
#![no_main]

use core::hint::black_box;
use core::mem::MaybeUninit;

use mavstack::dialect::{
    CommandAck, CommandInt, CommandLong, Heartbeat, MavAutopilot, MavCmd, MavMissionResult, MavModeFlag, MavResult,
    MavSeverity, MavState, MavType, MissionAck, MissionClearAll, MissionCount, MissionItemInt, MissionRequestInt,
    MissionRequestList, ParamRequestList, ParamRequestRead, ParamSet, ParamValue, Statustext,
};
use mavstack::frame::{Decoder, Version, encode};
use mavstack::message::Dialect;
use mavstack::{Address, Frame, Instant, Message, Text};
use mavstack_compare_firmware::{Uart, measure};

mavstack::dialect! {
    struct Twelve: [
        Heartbeat, CommandLong, CommandInt, MissionCount, MissionItemInt, MissionRequestInt, MissionRequestList,
        MissionAck, MissionClearAll, ParamRequestList, ParamRequestRead, ParamSet,
    ];
}

struct Tx {
    seq: u8,
    frame: [u8; 280],
}

impl Tx {
    fn send<M: Message>(&mut self, message: &M) {
        let len = encode(message, Version::V2, Address::new(1, 1), self.seq, &mut self.frame).unwrap_or(0);
        self.seq = self.seq.wrapping_add(1);
        Uart::send(self.frame.get(..len).unwrap_or_default());
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

static mut TX: Tx = Tx { seq: 0, frame: [0; 280] };
static mut DECODER: MaybeUninit<Decoder> = MaybeUninit::uninit();

fn app(mut uart: Uart) -> u32 {
    // SAFETY: only this function uses them, and it is not reentered.
    let (tx, decoder) = unsafe { (&mut *(&raw mut TX), (*(&raw mut DECODER)).write(Decoder::default())) };
    let mut frames = 0;
    loop {
        let len = uart.take(decoder.spare());
        if len == 0 {
            return frames;
        }
        decoder.filled(len, Instant::ZERO);
        let mut budget = Decoder::MIN_BUDGET;
        while let Some(frame) = decoder.next(Instant::ZERO, Twelve::MESSAGES, &mut budget, |_| false) {
            frames += 1;
            if cfg!(feature = "framing") {
                black_box(frame.raw());
            } else {
                handle(&frame, tx);
            }
        }
    }
}

#[cortex_m_rt::entry]
fn main() -> ! {
    measure(app)
}
