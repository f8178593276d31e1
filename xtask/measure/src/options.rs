//! `cargo measure options`: what each option adds to the smallest vehicle, and what whole vehicles take.

use std::collections::HashMap;

use crate::figures::{Figure, Figures, grouped, settle};
use crate::firmware::{Measured, Size, build_measured, measure};
use crate::size::TOLERANCE;
use crate::system::Result;
use crate::toolchain::{self, Choice, TARGET};

/// An option: the begin of its figures' keys, its name, its features in `examples/size`, the features that it is compared with, and
/// by how many the difference is divided.
struct Row(&'static str, &'static str, &'static str, &'static str, i64);

/// The features of the smallest vehicle, the begin of its figures' keys, and its name.
const SMALLEST: &str = "";
const BASE: (&str, &str) = ("base", "heartbeat, commands, 8 peers, one link, all of common");

const GROUPS: [(&str, &[Row]); 11] = [
    (
        "links and peers",
        &[
            Row("link-2", "a second link", "link-2", SMALLEST, 1),
            Row("link-3", "a third link", "link-3", "link-2", 1),
            Row("peer", "one more peer", "peers-16", SMALLEST, 8),
        ],
    ),
    (
        "telemetry",
        &[
            Row("texts", "texts, room for 4", "texts", SMALLEST, 1),
            Row("text", "room for one more text", "texts-8", "texts", 4),
            Row("streams", "streams: 4 messages of yours", "streams", SMALLEST, 1),
            Row("stream", "one more stream, on one link", "streams-20", "streams", 16),
            Row("events", "events, the last 16 kept, on one link", "events", SMALLEST, 1),
            Row("event", "one more event that is kept", "events-32", "events", 16),
            Row("events-checks", "arming checks as events, two of them", "events-checks", "events", 1),
            Row("messages", "messages of yours to a peer or to all, on one link", "messages,streams", "streams", 1),
        ],
    ),
    (
        "plans",
        &[
            Row(
                "missions",
                "missions of up to 100 items: the engine, and the items, which are staged too",
                "mission",
                SMALLEST,
                1,
            ),
            Row("item", "one more mission item, which is staged too", "mission-200", "mission", 100),
            Row("fence-rally", "a fence of 40 and 10 rally points in addition", "plans-3", "mission", 1),
            Row(
                "plan-texts",
                "feature `plan-texts` (default): why a plan or parameter was refused",
                "plan-texts,texts,mission,parameters",
                "texts,mission,parameters",
                1,
            ),
        ],
    ),
    (
        "parameters",
        &[
            Row("parameters", "8 parameters, with PARAM_ERROR and the hash", "parameters", SMALLEST, 1),
            Row("parameter", "one more parameter", "parameters-16", "parameters", 8),
            Row("run-time", "8 parameters in a `RuntimeTable`", "parameters-run-time", SMALLEST, 1),
            Row(
                "run-time-room",
                "room for one more parameter in a `RuntimeTable`",
                "parameters-run-time-16",
                "parameters-run-time",
                8,
            ),
            Row(
                "external",
                "8 parameters in a `ParamBackend`, with values in the vehicle",
                "parameters-external",
                SMALLEST,
                1,
            ),
        ],
    ),
    (
        "commands",
        &[
            Row("modes", "3 modes", "modes", SMALLEST, 1),
            Row("rules", "declared commands (`Commands::POLICIES`), one of them", "commands-rules", SMALLEST, 1),
            Row("typed", "the first typed command", "typed", SMALLEST, 1),
            Row("typed-2", "another, with seven parameters, one of them with a range", "typed-2", "typed", 1),
            Row("client", "commands to other components, 2 at a time, on one link", "client", SMALLEST, 1),
            Row("client-slot", "one more command to another component at a time", "client-4", "client", 2),
            Row(
                "components",
                "a second component, with commands and heartbeats, on one link",
                "components",
                SMALLEST,
                1,
            ),
            Row("long-commands", "long-running commands, 2 at a time", "commands-long", SMALLEST, 1),
            Row("long-command", "one more long-running command at a time", "commands-long-4", "commands-long", 2),
            Row("manual", "manual control", "manual", SMALLEST, 1),
            Row("setpoints", "setpoints of a companion computer", "setpoints", SMALLEST, 1),
            Row("operator-control", "operator control, on one link", "operator-control", SMALLEST, 1),
            Row("gimbal-manager", "a gimbal manager, on one link", "gimbal-manager", SMALLEST, 1),
            Row("gimbal-remote", "a gimbal device on a link behind it", "gimbal-remote", "gimbal-manager", 1),
            Row("gimbal-device", "a gimbal device, on one link", "gimbal-device", SMALLEST, 1),
            Row("time", "PING, and TIMESYNC requests, on one link", "time", SMALLEST, 1),
        ],
    ),
    (
        "a camera",
        &[
            Row("camera", "a camera that takes images and remembers 16, on one link", "camera", SMALLEST, 1),
            Row("camera-image", "one more remembered image", "camera-64", "camera", 48),
            Row(
                "camera-full",
                "a camera with video, modes, zoom, focus, a stream and a storage in addition",
                "camera-full",
                "camera",
                1,
            ),
            Row("ext-parameters", "extended parameters, on one link", "ext-parameters", SMALLEST, 1),
        ],
    ),
    (
        "files",
        &[
            Row("files", "a server of files, 2 at a time, on one link", "files", SMALLEST, 1),
            Row("files-session", "one more file at a time", "files-4", "files", 2),
            Row("files-params", "that, and 8 parameters as a file", "files,parameters", "parameters", 1),
            Row("files-upload", "uploads of parameters, of up to 512 bytes", "files-upload", "files,parameters", 1),
            Row("files-plans", "a server of files, and a mission as a file", "files,mission", "mission", 1),
            Row("files-plans-upload", "uploads of missions as files", "files-plans-upload", "files,mission", 1),
            Row("logs", "downloads of flight logs", "logs", SMALLEST, 1),
            Row("log-streaming", "the running log, streamed", "log-streaming", SMALLEST, 1),
        ],
    ),
    (
        "more than one link",
        &[
            Row("forwarding", "forwarding: 512 bytes for each link, 256 frames remembered", "forwarding", "link-2", 1),
            Row("forwarding-byte", "one more byte in the queue of each link", "forwarding-1024", "forwarding", 512),
            Row("forwarding-frame", "one more remembered frame", "forwarding-seen-512", "forwarding", 256),
            Row("high-latency", "high latency, on the second link", "high-latency", "link-2", 1),
        ],
    ),
    (
        "signing (feature `signing`)",
        &[
            Row(
                "signing",
                "signing for 16 senders, with `--cfg=sha2_backend_soft=\"compact\"`",
                "signing",
                SMALLEST,
                1,
            ),
            Row("signing-sender", "one more sender", "signing-32", "signing", 16),
            Row("signing-link", "a second link that signs", "signing,link-2", "signing", 1),
        ],
    ),
    (
        "storage (feature `storage`)",
        &[
            Row("store-missions", "missions in NOR flash", "storage,mission", "mission", 1),
            Row("store-missions-fram", "missions in FRAM, driver included", "store-fram,mission", "mission", 1),
            Row("store-parameters", "parameters in NOR flash", "storage,parameters", "parameters", 1),
            Row("store-key", "the signing key in NOR flash", "storage,signing", "signing", 1),
            Row(
                "store-missions-parameters",
                "missions and parameters in NOR flash",
                "storage,mission,parameters",
                "mission,parameters",
                1,
            ),
            Row(
                "store-all",
                "missions, parameters and the key in NOR flash",
                "storage,mission,parameters,signing",
                "mission,parameters,signing",
                1,
            ),
        ],
    ),
    (
        "UART queues, and a smaller table",
        &[
            Row("queues", "`io::SerialQueues<64, 64>`", "queues", SMALLEST, 1),
            Row(
                "few-messages",
                "a table of 8 received messages, in place of all of common",
                "messages-few",
                SMALLEST,
                1,
            ),
        ],
    ),
];

/// Whole vehicles: the begin of their figures' keys, name, features.
const VEHICLES: [(&str, &str, &str); 4] = [
    ("rover", "rover: one link, 100 items, 8 parameters, texts", "texts,mission,parameters"),
    (
        "copter",
        "copter: two links, 100 + 40 + 10 items and 16 parameters in flash, 4 streams, texts, modes, long commands, manual \
         control, time",
        "plan-texts,texts,streams,plans-3,parameters-16,modes,commands-rules,commands-long,manual,time,link-2,storage,\
         typed",
    ),
    (
        "everything",
        "everything: that and forwarding, high latency, signing, the key in flash",
        "plan-texts,texts,streams,plans-3,parameters-16,modes,commands-rules,commands-long,manual,time,forwarding,\
         high-latency,signing,storage,typed",
    ),
    (
        "everything-few-messages",
        "everything, with a table of 8 messages",
        "plan-texts,texts,streams,plans-3,parameters-16,modes,commands-rules,commands-long,manual,time,forwarding,\
         high-latency,signing,storage,typed,messages-few",
    ),
];

/// Builds each firmware once. The optimizer changes the rest of each firmware by some hundred bytes, so a difference can be negative,
/// and only the sizes of whole vehicles have a tolerance.
pub fn report(choice: Option<Choice>, accepts: bool) -> Result {
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
    let mut figures = Vec::new();
    let mut add = |id: &str, (name, (flash, ram), count): (&str, (i64, i64), i64), percent: Option<f64>| {
        let cells = [("flash", share(flash, count)), ("ram", share(ram, count))];
        println!("{name}: flash {}, RAM {}", cells[0].1, cells[1].1);
        for (column, value) in cells {
            let figure = Figure::new(format!("{id}.{column}"), value);
            figures.push(percent.map_or(figure.clone(), |percent| figure.within(percent)));
        }
    };
    add(BASE.0, (BASE.1, difference(size_of(SMALLEST)?, empty), 1), None);
    for Row(id, name, with, without, count) in GROUPS.iter().flat_map(|(_, rows)| *rows) {
        add(id, (*name, difference(size_of(with)?, size_of(without)?), *count), None);
    }
    for (id, name, features) in VEHICLES {
        add(id, (name, difference(size_of(features)?, empty), 1), Some(TOLERANCE));
    }
    settle("options", &toolchain::release(choice), &figures, accepts)
}

const HEAD: &str = "| | flash | RAM |\n|---|---|---|\n";

/// Returns the table of options in docs/sizing.md.
pub fn table(figures: &Figures) -> String {
    let mut text = HEAD.to_owned() + &row(figures, BASE.0, BASE.1);
    for (group, rows) in GROUPS {
        text += &format!("| **{group}** | | |\n");
        rows.iter().for_each(|Row(id, name, ..)| text += &row(figures, id, name));
    }
    text
}

/// Returns the table of whole vehicles in docs/sizing.md.
pub fn vehicles(figures: &Figures) -> String {
    VEHICLES.iter().fold(HEAD.to_owned(), |text, (id, name, _)| text + &row(figures, id, name))
}

fn row(figures: &Figures, id: &str, name: &str) -> String {
    let cell = |column: &str| match figures.get(&format!("options.{id}.{column}")) {
        None | Some("0") => " |".to_owned(),
        Some(value) => format!(" {value} |"),
    };
    format!("| {name} |{}{}\n", cell("flash"), cell("ram"))
}

fn difference(of: Size, from: Size) -> (i64, i64) {
    (of.flash.cast_signed() - from.flash.cast_signed(), of.ram.cast_signed() - from.ram.cast_signed())
}

/// Divides `bytes` by `count`, with one decimal where there is a remainder.
fn share(bytes: i64, count: i64) -> String {
    let tenths = bytes * 10 / count;
    let sign = if tenths < 0 { "−" } else { "" };
    let (whole, rest) = (tenths.unsigned_abs() / 10, tenths.unsigned_abs() % 10);
    if rest == 0 { format!("{sign}{}", grouped(whole)) } else { format!("{sign}{}.{rest}", grouped(whole)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_written_for_people() {
        assert_eq!(
            [(1_234, 1), (-1_808, 1), (27, 8), (-4, 8), (0, 1)].map(|(bytes, count)| share(bytes, count)),
            ["1,234", "−1,808", "3.3", "−0.5", "0"]
        );
    }

    /// A key that two rows share would show one of them in both.
    #[test]
    fn each_row_has_figures_of_its_own() {
        let rows = GROUPS.iter().flat_map(|(_, rows)| *rows).map(|Row(id, ..)| *id);
        let mut ids: Vec<_> = rows.chain(VEHICLES.map(|(id, ..)| id)).chain([BASE.0]).collect();
        let count = ids.len();
        ids.sort_unstable();
        ids.dedup();
        assert_eq!(ids.len(), count);
    }
}
