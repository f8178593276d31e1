//! Measures the stack usage of the firmware `loop` by stack painting. A script exercises every function of the same loop.
//! `cargo measure stack` runs it and compares the result with the computed bound. For measurements only.
#![no_std]
#![no_main]
#![allow(unsafe_code, reason = "paints the unused memory below the stack")]

use cortex_m_rt::entry;
use mavstack::dialect::{
    CommandInt, CommandLong, EncapsulatedData, Heartbeat, ManualControl, MavCmd, MavFrame, MavMissionType, MavModeFlag,
    MavParamType, MavType, MissionClearAll, MissionCount, MissionItemInt, MissionRequestInt, MissionRequestList,
    MissionSetCurrent, ParamRequestList, ParamSet, RequestDataStream, SetMode, SetupSigning, Timesync,
};
use mavstack::frame::{MAX_FRAME_LEN, Version, encode, encode_signed};
use mavstack::message::Secret;
use mavstack::plan::PlanCounters;
use mavstack::signing::SigningKey;
use mavstack::{Address, Instant, LinkId, Message, Text};
use mavstack_demo::LINKS;
use mavstack_qemu::board::{Board, Uart};
use mavstack_qemu::line::Line;
use mavstack_qemu::memory::{self, FlashStore};

const PAINT: u32 = 0xC5C5_C5C5;
/// Distance from the stack pointer that stays unpainted, for the stack frame of `paint` and its callees.
const MARGIN: u32 = 256;
/// Simulated period of the loop (ms).
const PERIOD: u64 = 10;
const PASSES: u64 = 6_000;
/// Length of the script: one frame per pass. It repeats.
const LEN: u64 = 190;

const VEHICLE: u8 = 1;
const KEY: [u8; 32] = [0x42; 32];

/// Commands with parameters 1 to 7.
const COMMANDS: [(MavCmd, [f32; 7]); 24] = {
    const ANY: f32 = f32::NAN;
    const LAT: f32 = 47.398;
    const LON: f32 = 8.546;
    [
        (MavCmd::COMPONENT_ARM_DISARM, [1.0, 21_196.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        (MavCmd::NAV_TAKEOFF, [ANY, ANY, ANY, 1.0, LAT, LON, 30.0]),
        (MavCmd::DO_SET_HOME, [0.0, ANY, ANY, ANY, LAT, LON, 490.0]),
        (MavCmd::MISSION_START, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        (MavCmd::DO_SET_MISSION_CURRENT, [3.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        (MavCmd::DO_CHANGE_SPEED, [1.0, 12.0, -1.0, 0.0, 0.0, 0.0, 0.0]),
        (MavCmd::DO_SET_MODE, [209.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        (MavCmd::DO_REPOSITION, [5.0, 1.0, 0.0, ANY, LAT, LON, 520.0]),
        (MavCmd::CONDITION_YAW, [90.0, 10.0, 1.0, 0.0, 0.0, 0.0, 0.0]),
        (MavCmd::DO_SET_STANDARD_MODE, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        (MavCmd::NAV_RETURN_TO_LAUNCH, [0.0; 7]),
        (MavCmd::NAV_LAND, [0.0, 0.0, 0.0, 2.0, LAT, LON, ANY]),
        (MavCmd::PREFLIGHT_CALIBRATION, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        (MavCmd::RUN_PREARM_CHECKS, [0.0; 7]),
        (MavCmd::REQUEST_AUTOPILOT_CAPABILITIES, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        (MavCmd::SET_MESSAGE_INTERVAL, [31.0, 20_000.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        (MavCmd::GET_MESSAGE_INTERVAL, [30.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        (MavCmd::CONTROL_HIGH_LATENCY, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        (MavCmd::PREFLIGHT_STORAGE, [1.0, ANY, 0.0, 0.0, 0.0, 0.0, 0.0]),
        (MavCmd::PREFLIGHT_STORAGE, [0.0, ANY, 0.0, 0.0, 0.0, 0.0, 0.0]),
        (MavCmd::REQUEST_MESSAGE, [435.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        (MavCmd::REQUEST_MESSAGE, [300.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        (MavCmd::REQUEST_MESSAGE, [235.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        (MavCmd::DO_FLIGHTTERMINATION, [0.0; 7]),
    ]
};

/// Ids of the messages that the script requests one by one.
const MESSAGES: [u16; 16] = [1, 2, 24, 30, 31, 32, 33, 74, 147, 242, 65, 264, 49, 397, 245, 436];

/// A ground station that sends the script on a link and accepts all output.
struct Station {
    line: Line<MAX_FRAME_LEN>,
    seq: u8,
}

impl Station {
    const SILENT: Self = Self { line: Line::SILENT, seq: 0 };

    /// Sends a message, signed if a timestamp is given. Not inlined, so that only one message is on the stack at a time.
    #[inline(never)]
    fn put<M: Message>(&mut self, message: &M, signed_at: Option<u64>) {
        let from = Address::new(255, 190);
        self.seq = self.seq.wrapping_add(1);
        self.line.put(|frame| {
            let len = match signed_at {
                None => encode(message, Version::V2, from, self.seq, frame),
                Some(time) => encode_signed(message, from, self.seq, &SigningKey::new(KEY), 7, time, frame),
            };
            len.unwrap_or(0)
        });
    }
}

/// Sends the frame of the script for a pass.
#[inline(never)]
fn send_step(station: &mut Station, pass: u64) {
    let step = pass % LEN;
    // Once the key is set, only signed frames are accepted.
    let signed_at = (pass >= LEN).then_some(40_000_000_000_000 + pass * 1_000);
    let heartbeat = Heartbeat { r#type: MavType::GCS, mavlink_version: 3, ..Heartbeat::default() };
    match step {
        0 => station.put(&heartbeat, signed_at),
        1..=60 => upload(station, MavMissionType::MISSION, step - 1, 58, signed_at),
        61..=66 => upload(station, MavMissionType::FENCE, step - 61, 4, signed_at),
        67..=70 => upload(station, MavMissionType::RALLY, step - 67, 2, signed_at),
        71 => station.put(&ParamRequestList { target_system: VEHICLE, target_component: 1 }, signed_at),
        72..=75 => {
            // Valid, out of range, wrong type, unknown name.
            let (name, value) = [("NAV_ACC_RAD", 3.0), ("NAV_ACC_RAD", 1e9), ("MPC_XY_CRUISE", 7.0), ("NOTHING", 1.0)]
                [(step - 72) as usize];
            let param_type = if step == 74 { MavParamType::INT8 } else { MavParamType::REAL32 };
            let (param_value, param_id) = (value, Text::new(name));
            station.put(
                &ParamSet { param_value, target_system: VEHICLE, target_component: 1, param_id, param_type },
                signed_at,
            );
        }
        76..=99 => command(station, COMMANDS[(step - 76) as usize], false, signed_at),
        100..=123 => command(station, COMMANDS[(step - 100) as usize], true, signed_at),
        124..=139 => {
            let id = f32::from(MESSAGES[(step - 124) as usize]);
            command(station, (MavCmd::REQUEST_MESSAGE, [id, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]), false, signed_at);
        }
        140 => station
            .put(&SetMode { custom_mode: 0x0304_0000, target_system: VEHICLE, base_mode: MavModeFlag(209) }, signed_at),
        141 => station.put(&MissionSetCurrent { seq: 900, target_system: VEHICLE, target_component: 1 }, signed_at),
        142 => {
            let list = MissionRequestList {
                target_system: VEHICLE,
                target_component: 1,
                mission_type: MavMissionType::MISSION,
            };
            station.put(&list, signed_at);
        }
        143..=150 => {
            let seq = (step - 143) as u16;
            let mission_type = MavMissionType::MISSION;
            station
                .put(&MissionRequestInt { seq, target_system: VEHICLE, target_component: 1, mission_type }, signed_at);
        }
        151 => station.put(&Timesync { ts1: 1_000, ..Timesync::default() }, signed_at),
        152 => {
            let request =
                RequestDataStream { req_message_rate: 10, target_system: VEHICLE, start_stop: 1, ..Default::default() };
            station.put(&request, signed_at);
        }
        153..=156 => {
            station.put(&ManualControl { target: VEHICLE, x: 500, y: -500, z: 600, ..Default::default() }, signed_at)
        }
        // Broadcasts, which are forwarded.
        157..=164 => station.put(&EncapsulatedData { seqnr: step as u16, data: [0x55; 253] }, signed_at),
        // An invalid polygon with two corners.
        165..=166 => upload(station, MavMissionType::FENCE, step - 165, 2, signed_at),
        167 => {
            let clear =
                MissionClearAll { target_system: VEHICLE, target_component: 1, mission_type: MavMissionType::RALLY };
            station.put(&clear, signed_at);
        }
        // The key is set at the end of the first round.
        LAST if signed_at.is_none() => station.put(
            &SetupSigning {
                initial_timestamp: 40_000_000_000_000,
                target_system: VEHICLE,
                target_component: 1,
                secret_key: Secret(KEY),
            },
            None,
        ),
        _ => station.line.put(|_| 0),
    }
}

const LAST: u64 = LEN - 1;

/// Sends one step of an upload: MISSION_COUNT, then the items one by one.
#[inline(never)]
fn upload(station: &mut Station, mission_type: MavMissionType, step: u64, count: u16, signed_at: Option<u64>) {
    let (target_system, target_component) = (VEHICLE, 1);
    if step == 0 {
        let message = MissionCount { count, target_system, target_component, mission_type, ..MissionCount::default() };
        return station.put(&message, signed_at);
    }
    let seq = (step - 1) as u16;
    let (side, last) = (i32::from(seq), count.saturating_sub(1));
    let (command, param1, x, y) = match mission_type {
        MavMissionType::FENCE => (
            MavCmd::NAV_FENCE_POLYGON_VERTEX_INCLUSION,
            f32::from(count),
            473_977_420 + [-90_000, 90_000, 90_000, -90_000][(seq % 4) as usize],
            85_455_940 + [-90_000, -90_000, 90_000, 90_000][(seq % 4) as usize],
        ),
        MavMissionType::RALLY => (MavCmd::NAV_RALLY_POINT, 0.0, 473_977_420 + side * 500, 85_455_940),
        _ if seq == last => (MavCmd::DO_JUMP, 1.0, 0, 0),
        _ if seq % 7 == 5 => (MavCmd::CONDITION_YAW, 45.0, 0, 0),
        _ => (MavCmd::NAV_WAYPOINT, 0.0, 473_977_420 + side % 8 * 300, 85_455_940 + side * 200),
    };
    let frame = match command {
        MavCmd::DO_JUMP | MavCmd::CONDITION_YAW => MavFrame::MISSION,
        _ => MavFrame::GLOBAL_RELATIVE_ALT_INT,
    };
    let item = MissionItemInt {
        param1,
        param2: if command == MavCmd::DO_JUMP { 3.0 } else { 0.0 },
        x,
        y,
        z: if frame == MavFrame::MISSION { 0.0 } else { 25.0 },
        seq,
        command,
        target_system,
        target_component,
        frame,
        autocontinue: 1,
        mission_type,
        ..MissionItemInt::default()
    };
    station.put(&item, signed_at);
}

/// Sends a command, as COMMAND_INT or COMMAND_LONG.
#[inline(never)]
fn command(station: &mut Station, (command, params): (MavCmd, [f32; 7]), is_int: bool, signed_at: Option<u64>) {
    let [param1, param2, param3, param4, param5, param6, z] = params;
    let (target_system, target_component) = (VEHICLE, 1);
    if is_int {
        let (frame, x, y) = (MavFrame::GLOBAL, (param5 * 1e7) as i32, (param6 * 1e7) as i32);
        let to = CommandInt { target_system, target_component, command, frame, ..CommandInt::default() };
        station.put(&CommandInt { param1, param2, param3, param4, x, y, z, ..to }, signed_at);
    } else {
        let to = CommandLong { target_system, target_component, command, ..CommandLong::default() };
        station.put(&CommandLong { param1, param2, param3, param4, param5, param6, param7: z, ..to }, signed_at);
    }
}

// Linker symbols: the end of static memory, and the start of the stack.
unsafe extern "C" {
    static mut __sheap: u32;
    static mut _stack_start: u32;
}

/// Paints the free memory below the stack.
#[inline(never)]
fn paint() {
    let mut word = &raw mut __sheap;
    let end = cortex_m::register::msp::read().saturating_sub(MARGIN);
    while (word.addr() as u32) < end {
        // SAFETY: above all statics, and well below the current stack pointer.
        unsafe { word.write_volatile(PAINT) };
        word = word.wrapping_add(1);
    }
}

/// Returns the high-water mark of the stack, in bytes.
#[inline(never)]
fn high_water_mark() -> u32 {
    let mut word = &raw mut __sheap;
    let end = &raw mut _stack_start;
    // SAFETY: RAM between the statics and the start of the stack.
    while word < end && unsafe { word.read_volatile() } == PAINT {
        word = word.wrapping_add(1);
    }
    end.addr().saturating_sub(word.addr()) as u32
}

/// Reports to the host. It does not use `core::fmt`, whose indirect calls the stack analysis cannot follow.
#[inline(never)]
fn report(uart: &mut Uart, plans: PlanCounters, mark: u32) {
    let mut text = Text::<120>::EMPTY;
    for number in [mark, plans.accepted, plans.refused] {
        text.push_number(number);
        text.push_str(" ");
    }
    text.push_str("\n");
    for &byte in text.as_bytes() {
        while !uart.has_room() {}
        uart.send(byte);
    }
}

#[entry]
fn main() -> ! {
    static mut STATIONS: [Station; LINKS] = [Station::SILENT; LINKS];

    paint();
    let app = memory::start();
    let Some(Board { uarts: [mut uart, ..], flash, .. }) = Board::take() else { Board::reset() };
    let mut store = FlashStore::new(flash);
    store.restore(app, Instant::ZERO);
    for pass in 0..PASSES {
        let now = Instant::from_millis(1_000 + pass * PERIOD);
        app.control(now);
        // The companion link, which accepts the key, alternates with the radio. The satellite link gets the commands.
        let turn = pass / LEN % 4;
        let link = match turn {
            1 => 0,
            3 if (76..140).contains(&(pass % LEN)) => 2,
            _ => 1,
        };
        if let Some(station) = STATIONS.get_mut(link) {
            send_step(station, pass);
        }
        for (link, station) in (0..).map(LinkId).zip(STATIONS.iter_mut()) {
            let _ = app.serve(now, link, &mut station.line);
        }
        store.persist(app, now);
    }
    let mark = high_water_mark();
    report(&mut uart, app.parts().0.plan_counters(), mark);
    loop {
        cortex_m::asm::wfi();
    }
}
