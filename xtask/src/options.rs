//! `cargo xtask size --options`: what each option adds to the smallest vehicle.

use std::collections::HashMap;
use std::fs;

use crate::firmware::{Measured, Size, build_measured, measure};
use crate::size::{END, SIZING, grouped, is_by_another};
use crate::system::{Result, root};
use crate::toolchain::{self, Choice, TARGET};

/// The table is between these lines of docs/sizing.md.
const BEGIN: &str = "<!-- Written by `cargo xtask size --options --accept`. -->";
const TOTALS_BEGIN: &str = "<!-- Written by `cargo xtask size --options --accept` too. -->";

/// An option: its features in `examples/size`, those of what it is compared with, and how many of it there are then.
struct Row(&'static str, &'static str, &'static str, i64);

/// The features of the smallest vehicle, and those beyond which it grows.
const SMALLEST: &str = "";

const GROUPS: [(&str, &[Row]); 9] = [
    (
        "links and peers",
        &[
            Row("a second link", "link-2", SMALLEST, 1),
            Row("a third link", "link-3", "link-2", 1),
            Row("a peer more than 8", "peers-16", SMALLEST, 8),
        ],
    ),
    (
        "telemetry",
        &[
            Row("texts, room for 4", "texts", SMALLEST, 1),
            Row("room for a text more", "texts-8", "texts", 4),
            Row("streams: 4 messages of yours, room for 8", "streams", SMALLEST, 1),
            Row("room for a stream more, on each link", "streams-24", "streams", 16),
        ],
    ),
    (
        "plans",
        &[
            Row("missions of up to 100 items: the engine, 400 bytes of RAM, and the items", "mission", SMALLEST, 1),
            Row("a mission item more, which is staged too", "mission-200", "mission", 100),
            Row("a fence of 40 and rally points for 10 beside it", "plans-3", "mission", 1),
            Row(
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
            Row("8 of them; PARAM_ERROR and the hash are always there", "parameters", SMALLEST, 1),
            Row("a parameter more", "parameters-16", "parameters", 8),
        ],
    ),
    (
        "commands",
        &[
            Row("modes, 3 of them", "modes", SMALLEST, 1),
            Row("declared forms and parameters (`Commands::COMMANDS`), one command", "commands-rules", SMALLEST, 1),
            Row("the first typed command", "typed", SMALLEST, 1),
            Row("another, of seven parameters, one of which has a range", "typed-2", "typed", 1),
            Row("commands that take their time, `CommandSlots<2>`", "commands-long", SMALLEST, 1),
            Row("one more at a time", "commands-long-4", "commands-long", 2),
            Row("manual control", "manual", SMALLEST, 1),
            Row("time: TIMESYNC asked on one link, `TimeSlots<1>`", "time", SMALLEST, 1),
        ],
    ),
    (
        "more than one line",
        &[
            Row(
                "forwarding, `ForwardQueues<2>`: 512 bytes for each link, 256 frames remembered",
                "forwarding",
                "link-2",
                1,
            ),
            Row("a byte more in the queue of each of the two", "forwarding-1024", "forwarding", 512),
            Row("a frame more that is remembered", "forwarding-seen-512", "forwarding", 256),
            Row("high latency, the second link being the satellite's", "high-latency", "link-2", 1),
        ],
    ),
    (
        "signing (feature `signing`)",
        &[
            Row("with 16 streams and `--cfg=sha2_backend_soft=\"compact\"`", "signing", SMALLEST, 1),
            Row("one more sender to remember", "signing-32", "signing", 16),
            Row("a second link, when links sign", "signing,link-2", "signing", 1),
        ],
    ),
    (
        "storage (feature `storage`)",
        &[
            Row("missions in NOR flash", "store-plans", "mission", 1),
            Row("missions in FRAM, driver included", "store-plans-fram", "mission", 1),
            Row("parameters in NOR flash, alone", "store-parameters", "parameters", 1),
            Row(
                "parameters in NOR flash, beside missions there",
                "store-plans,store-parameters",
                "store-plans,parameters",
                1,
            ),
            Row("the signing key in NOR flash, alone", "store-key", "signing", 1),
            Row(
                "the signing key in NOR flash, beside missions there",
                "store-plans,store-key",
                "store-plans,signing",
                1,
            ),
        ],
    ),
    (
        "the UART, and less",
        &[
            Row("`io::SerialQueues<64, 64>`", "queues", SMALLEST, 1),
            Row("a table of the 8 messages that you hear, not all of common", "messages-few", SMALLEST, 1),
        ],
    ),
];

/// Whole firmwares, less what is no vehicle.
const TOTALS: [(&str, &str); 4] = [
    ("rover: one link, 100 items, 8 parameters, texts", "texts,mission,parameters"),
    (
        "copter: two links, 100 + 40 + 10 items and 16 parameters in flash, 4 streams, texts, modes, long commands, manual \
         control, time",
        "plan-texts,texts,streams,plans-3,parameters-16,modes,commands-rules,commands-long,manual,time,link-2,store-plans,\
         store-parameters,typed",
    ),
    (
        "everything: that and forwarding, high latency, signing, the key in flash",
        "plan-texts,texts,streams,plans-3,parameters-16,modes,commands-rules,commands-long,manual,time,forwarding,\
         high-latency,signing,store-plans,store-parameters,store-key,typed",
    ),
    (
        "everything, with a table of 8 messages",
        "plan-texts,texts,streams,plans-3,parameters-16,modes,commands-rules,commands-long,manual,time,forwarding,\
         high-latency,signing,store-plans,store-parameters,store-key,typed,messages-few",
    ),
];

/// Each firmware is built once. What the optimizer makes of the rest differs from one to the other by some hundred bytes, so a
/// difference can be below zero; only what whole firmwares take is held to the table.
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
    let mut options =
        vec![row("heartbeat, commands, 8 peers, one link, all of common", difference(size_of("")?, empty), 1)];
    for (group, rows) in GROUPS {
        options.push(format!("| **{group}** | | |"));
        for Row(name, with, without, count) in rows {
            options.push(row(name, difference(size_of(with)?, size_of(without)?), *count));
        }
    }
    let mut totals = Vec::new();
    for (name, features) in TOTALS {
        totals.push(row(name, difference(size_of(features)?, empty), 1));
    }
    let [options, totals] =
        [options, totals].map(|rows| format!("\n| | flash | RAM |\n|---|---|---|\n{}\n", rows.join("\n")));
    println!("{options}{totals}");

    let path = root().join(SIZING);
    let text = fs::read_to_string(&path).map_err(|error| format!("{SIZING}: {error}"))?;
    let (_, was) = replaced(&text, TOTALS_BEGIN, &totals)?;
    if accepts {
        let (text, _) = replaced(&text, BEGIN, &options)?;
        let (text, _) = replaced(&text, TOTALS_BEGIN, &totals)?;
        return fs::write(&path, text).map_err(|error| format!("{SIZING}: {error}"));
    }
    let has_moved = |(is, was): (u64, u64)| is.abs_diff(was) * 100 > was;
    let (is, was) = (numbers(&totals), numbers(was));
    if is.len() == was.len() && !is.into_iter().zip(was).any(has_moved) {
        return Ok(());
    }
    if is_by_another(choice, &text) {
        return Ok(());
    }
    Err(format!("not what {SIZING} says: where that is meant, `cargo xtask size --options --accept` writes it there"))
}

/// The text with another table behind the line `begin`, and the one that was there.
fn replaced<'a>(text: &'a str, begin: &str, table: &str) -> Result<(String, &'a str)> {
    let missing = || format!("{SIZING} has no table behind {begin}");
    let (before, rest) = text.split_once(&format!("{begin}\n")).ok_or_else(missing)?;
    let (was, after) = rest.split_once(END).ok_or_else(missing)?;
    Ok((format!("{before}{begin}\n{table}{END}{after}"), was))
}

/// The figures of a table whose names have no columns.
fn numbers(table: &str) -> Vec<u64> {
    let cells = table.lines().flat_map(|line| line.split('|').skip(2));
    cells.filter_map(|cell| cell.trim().replace(',', "").parse().ok()).collect()
}

fn row(name: &str, (flash, ram): (i64, i64), count: i64) -> String {
    let cell = |bytes| if bytes == 0 { " |".to_owned() } else { format!(" {} |", share(bytes, count)) };
    format!("| {name} |{}{}", cell(flash), cell(ram))
}

fn difference(of: Size, from: Size) -> (i64, i64) {
    (of.flash.cast_signed() - from.flash.cast_signed(), of.ram.cast_signed() - from.ram.cast_signed())
}

/// `bytes` for each of `count`, with a decimal where it does not go even.
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
    fn figures_are_written_for_people_and_read_again() {
        assert_eq!(
            [(1_234, 1), (-1_808, 1), (27, 8), (-4, 8)].map(|(bytes, count)| share(bytes, count)),
            ["1,234", "−1,808", "3.3", "−0.5"]
        );
        let table = [row("a, b 7", (16_484, 544), 1), row("c", (300, 0), 1)].join("\n");
        assert_eq!(table, "| a, b 7 | 16,484 | 544 |\n| c | 300 | |");
        assert_eq!(numbers(&table), [16_484, 544, 300]);
    }

    #[test]
    fn a_table_is_put_in_place_of_the_old_one() {
        let text = format!("a\n{BEGIN}\nold\n{END}\nb\n");
        assert_eq!(replaced(&text, BEGIN, "new\n"), Ok((format!("a\n{BEGIN}\nnew\n{END}\nb\n"), "old\n")));
        assert!(replaced(&text, TOTALS_BEGIN, "").is_err());
    }
}
