//! `cargo xtask size --options`: what each option adds to the smallest vehicle.

use std::collections::HashMap;

use crate::firmware::{Measured, Size, build_measured, measure};
use crate::system::Result;
use crate::toolchain::{self, Choice, TARGET};

/// An option: its features in `examples/size`, those of what it is compared with, and how many of it there are then.
struct Row(&'static str, &'static str, &'static str, i64);

const ROWS: [Row; 40] = [
    Row("a second link", "link-2", "", 1),
    Row("a third link", "link-3", "link-2", 1),
    Row("a peer more than 8", "peers-16", "", 8),
    Row("texts: room for 4", "texts", "", 1),
    Row("room for a text more", "texts-8", "texts", 4),
    Row("streams: 4 messages, room for 8", "streams", "", 1),
    Row("room for a stream more", "streams-24", "streams", 16),
    Row("mission of 100 items", "mission", "", 1),
    Row("a mission item more", "mission-200", "mission", 100),
    Row("fence of 40 and rally of 10 beside it", "plans-3", "mission", 1),
    Row("parameters: 8", "parameters", "", 1),
    Row("a parameter more", "parameters-16", "parameters", 8),
    Row(
        "plan-texts, with mission and parameters",
        "plan-texts,texts,mission,parameters",
        "texts,mission,parameters",
        1,
    ),
    Row("modes: 3", "modes", "", 1),
    Row("rules for commands: 1", "commands-rules", "", 1),
    Row("a typed command", "typed", "", 1),
    Row("another typed command", "typed-2", "typed", 1),
    Row("commands that take their time: 2", "commands-long", "", 1),
    Row("a command more that takes its time", "commands-long-4", "commands-long", 2),
    Row("manual control", "manual", "", 1),
    Row("time, asked for on 1 link", "time", "", 1),
    Row("forwarding between two links", "forwarding", "link-2", 1),
    Row("a byte more in the queue of each of them", "forwarding-1024", "forwarding", 512),
    Row("a frame more that is remembered", "forwarding-seen-512", "forwarding", 256),
    Row("high latency, on the second link", "high-latency", "link-2", 1),
    Row("signing, 16 streams", "signing", "", 1),
    Row("a signing stream more", "signing-32", "signing", 16),
    Row("a link more that signs", "signing,link-2", "signing", 1),
    Row("mission in NOR flash", "store-plans", "mission", 1),
    Row("mission in FRAM", "store-plans-fram", "mission", 1),
    Row("parameters in NOR flash", "store-parameters", "parameters", 1),
    Row("the same beside a mission there", "store-plans,store-parameters", "store-plans,parameters", 1),
    Row("signing key in NOR flash", "store-key", "signing", 1),
    Row("the same beside a mission there", "store-plans,store-key", "store-plans,signing", 1),
    Row("an interrupt's queues of 64 bytes", "queues", "", 1),
    Row("few messages in place of all of common", "messages-few", "", 1),
    Row("rover: texts, mission, parameters", "texts,mission,parameters", "", 1),
    Row(
        "copter: all but forwarding, high latency, signing",
        "plan-texts,texts,streams,plans-3,parameters-16,modes,commands-rules,commands-long,manual,time,link-2,store-plans,\
         store-parameters,typed",
        "",
        1,
    ),
    Row(
        "everything",
        "plan-texts,texts,streams,plans-3,parameters-16,modes,commands-rules,commands-long,manual,time,forwarding,\
         high-latency,signing,store-plans,store-parameters,store-key,typed",
        "",
        1,
    ),
    Row(
        "everything, with few messages",
        "plan-texts,texts,streams,plans-3,parameters-16,modes,commands-rules,commands-long,manual,time,forwarding,\
         high-latency,signing,store-plans,store-parameters,store-key,typed,messages-few",
        "",
        1,
    ),
];

/// Each firmware is built once. What the optimizer makes of the rest differs from one to the other by some ten bytes, so a
/// difference can be below zero.
pub fn report(choice: Option<Choice>) -> Result {
    let choice = toolchain::prepare(choice, &[TARGET])?;
    let mut built = HashMap::new();
    let build =
        |bin, features| measure(&build_measured(choice, &Measured { bin, features, target: TARGET, level: "s" })?);
    let empty = build("empty", "")?;
    let mut size_of = |features: &'static str| match built.get(features) {
        Some(size) => Ok(*size),
        None => {
            let size = build("options", features)?;
            built.insert(features, size);
            Result::Ok(size)
        }
    };
    let mut rows = vec![("heartbeat, commands, 8 peers, one link", difference(size_of("")?, empty), 1)];
    for Row(name, with, without, count) in ROWS {
        rows.push((name, difference(size_of(with)?, size_of(without)?), count));
    }
    println!("\n{TARGET:52} {:>14} {:>18}", "flash, bytes", "static RAM, bytes");
    for (name, (flash, ram), count) in rows {
        println!("{name:52} {:>14} {:>18}", share(flash, count), share(ram, count));
    }
    Ok(())
}

fn difference(of: Size, from: Size) -> (i64, i64) {
    (of.flash.cast_signed() - from.flash.cast_signed(), of.ram.cast_signed() - from.ram.cast_signed())
}

/// `bytes` for each of `count`, with a decimal where it does not go even.
fn share(bytes: i64, count: i64) -> String {
    let tenths = bytes * 10 / count;
    if tenths % 10 == 0 { (tenths / 10).to_string() } else { format!("{:.1}", tenths as f64 / 10.0) }
}
