//! Flight logs: lists and downloads, and who gets them.

#[path = "../support/mod.rs"]
mod support;

mod client;
mod directory;
mod downloads;
mod gates;
mod pace;
mod requests;
mod shares;
mod streaming;
mod turns;

use client::Fetch;
use mavstack::config::StreamProfile;
use mavstack::dialect::{LogData, LogEntry, LogErase, LogRequestData, LogRequestEnd, LogRequestList, Statustext};
use mavstack::{Address, LinkConfig, LinkId, Message};
use mavstack_station::Client;
use support::*;

#[derive(mavstack::Stack)]
#[stack(
    vehicle: TestVehicle,
    links: 2,
    streams,
    commands: { slots: 3 },
    operator_control,
    logs,
)]
struct Logged {
    log_streaming: mavstack::logs::LogStreamer,
}

type Field = World<2, Logged>;

const ALL: LogRequestList = LogRequestList { start: 0, end: u16::MAX, target_system: 1, target_component: 1 };
const ERASE: LogErase = LogErase { target_system: 1, target_component: 1 };
const END: LogRequestEnd = LogRequestEnd { target_system: 1, target_component: 1 };

/// Returns the content of a log: bytes that differ from place to place, and there are zeros among them.
fn content(number: usize, len: usize) -> Vec<u8> {
    (0..len).map(|i| (i * i / 7 + i / 90 + 31 * number) as u8).collect()
}

/// A vehicle with two links, and logs of these sizes.
fn with_logs(setup: Setup<2>, sizes: &[usize]) -> Field {
    let mut field = Field::of(setup);
    field.vehicle.logs.content = sizes.iter().enumerate().map(|(number, len)| content(number, *len)).collect();
    field.run_for(millis(10));
    field
}

/// A vehicle with two fast links, and logs of these sizes.
fn field(sizes: &[usize]) -> Field {
    let link = LinkConfig::uart(921_600).with_streams(StreamProfile::Off);
    with_logs(Setup { links: [link; 2], ..Setup::new() }, sizes)
}

/// A request for a part of a log.
fn data(id: u16, ofs: u32, count: u32) -> LogRequestData {
    LogRequestData { ofs, count, id, target_system: 1, target_component: 1 }
}

/// Receives a message now.
fn send<M: Message>(field: &mut Field, link: usize, from: Address, message: &M) {
    let frame = field.gcs[link].frame_from(from, message);
    assert_eq!(field.stack.receive(field.clock.now(), LinkId(link as u8), &frame, &mut field.vehicle), frame.len());
}

/// Returns what a link gets in the next 300 ms, after the ground station has sent this.
fn answers<M: Message, A: Message>(field: &mut Field, message: &M) -> Vec<A> {
    field.gcs[0].forget();
    send(field, 0, STATION, message);
    field.run_for(millis(300));
    all(field, 0)
}

fn all<M: Message>(field: &Field, link: usize) -> Vec<M> {
    field.gcs[link].all::<M>().into_iter().map(|(_, message)| message).collect()
}

/// Returns offset and length of each LOG_DATA.
fn parts(data: &[LogData]) -> Vec<(u32, u8)> {
    data.iter().map(|data| (data.ofs, data.count)).collect()
}

fn texts(field: &Field, link: usize) -> Vec<String> {
    all::<Statustext>(field, link).iter().map(|text| text.text.as_str().unwrap().to_string()).collect()
}

/// Arms or disarms the vehicle.
fn set_armed(field: &mut Field, is_armed: bool) {
    field.vehicle.state = Some(mavstack::VehicleState::new(is_armed));
    field.run_for(millis(10));
}
