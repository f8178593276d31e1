//! Plan files and pymavlink, which reads and writes them for MAVProxy: it loads our files as the same plan, and we read the
//! files that it saves, to its six decimals (W-3).

use crate::support::pymavlink;
use std::path::Path;
use std::process::Command;

use mavstack::Item;
use mavstack::dialect::{MavCmd, MavFrame};
use mavstack::wpl::{HomeRow, Reader, Writer};

fn read(mut file: &[u8], home_row: HomeRow) -> (Option<Item>, Vec<Item>) {
    let mut reader = Reader::new(home_row).numbered();
    let mut items = Vec::new();
    while let Some(item) = reader.next(&mut file).expect("a good file") {
        items.push(item);
    }
    items.extend(reader.finish().expect("a good file"));
    (reader.home(), items)
}

fn write(home: Option<&Item>, items: &[Item]) -> Vec<u8> {
    let mut file = Writer::HEADER.to_vec();
    let mut writer = Writer::new(if home.is_some() { HomeRow::First } else { HomeRow::None });
    for item in home.into_iter().chain(items) {
        file.extend(writer.row(item).unwrap_or_else(|fault| panic!("{fault}: {item:?}")));
    }
    file
}

/// A command without a position.
const PLAIN: MavCmd = MavCmd::DO_GIMBAL_MANAGER_PITCHYAW;

/// Numbers of all magnitudes, in every frame that a file can have.
fn mission() -> Vec<Item> {
    let frames = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 20, 21];
    let floats = |seed: u32| {
        let value = f32::from_bits(seed.wrapping_mul(2_654_435_761));
        [value, seed as f32 / 8.0, -1.0 / seed as f32, f32::NAN, value.fract()]
            .map(|v| if v.is_nan() { f32::NAN } else { v })
    };
    let item = |seed: u32| {
        let [a, b, c, d, z] = floats(seed);
        Item {
            frame: MavFrame(frames[seed as usize % frames.len()]),
            command: MavCmd([16, 17, 18, 19, 21, 22, 80, 201, 5_000, 31_000][seed as usize % 10]),
            autocontinue: (seed % 2) as u8,
            params: [a, b, c, d],
            x: seed.wrapping_mul(2_246_822_519).cast_signed() / 4,
            y: if seed % 10 == 9 { i32::MAX } else { seed.wrapping_mul(3_266_489_917).cast_signed() },
            z,
        }
    };
    let jump = |to: u32| Item {
        frame: MavFrame::MISSION,
        command: MavCmd::DO_JUMP,
        params: [to as f32, -1.0, 0.0, 0.0],
        x: 0,
        y: 0,
        ..item(1)
    };
    // Parameters 5 and 6 of a command without a position are plain numbers in every frame (M-75).
    let plain = |seed: u32| Item { command: PLAIN, x: seed as i32 * 3_000, y: -(seed as i32), ..item(seed) };
    (1..=300)
        .map(|seed| match seed {
            seed if seed % 50 == 0 => jump(seed - 1),
            seed if seed % 7 == 0 => plain(seed),
            seed => item(seed),
        })
        .collect()
}

/// Returns the decimals of x and y.
fn scale(item: &Item) -> usize {
    match item.frame.0 {
        _ if [PLAIN, MavCmd::DO_JUMP, MavCmd::DO_CHANGE_SPEED].contains(&item.command) => 0,
        0 | 3 | 5 | 6 | 10 | 11 => 7,
        2 => 0,
        _ => 4,
    }
}

/// Rounds an `f32` like pymavlink's `%f`.
fn float_to_six(value: f32) -> f32 {
    // Python reads the shortest text as an `f64`.
    format!("{:.6}", value.to_string().parse::<f64>().unwrap()).parse().unwrap()
}

/// Rounds x or y like pymavlink's `%f`.
fn coordinate_to_six(value: i32, decimals: usize) -> i32 {
    if value == i32::MAX || decimals < 7 {
        return value;
    }
    let text = format!("{:.6}", as_decimal(value, decimals).parse::<f64>().unwrap());
    text.replace('.', "").parse::<i32>().unwrap() * 10
}

fn as_decimal(value: i32, decimals: usize) -> String {
    let sign = if value < 0 { "-" } else { "" };
    let magnitude = value.unsigned_abs();
    let unit = 10u32.pow(decimals.try_into().unwrap());
    format!("{sign}{}.{:0decimals$}", magnitude / unit, magnitude % unit)
}

/// Returns what `mavwp.py` should print for a row.
fn printed(row: usize, item: &Item, home: bool) -> String {
    let bits = |value: f32| if value.is_nan() { "nan".to_owned() } else { format!("{:08x}", value.to_bits()) };
    let [p1, p2, p3, p4] = item.params.map(bits);
    let decimals = scale(item);
    let wide = |value: i32| match value {
        i32::MAX => "nan".to_owned(),
        _ => format!("{:016x}", as_decimal(value, decimals).parse::<f64>().unwrap().to_bits()),
    };
    let (x, y) = (wide(item.x), wide(item.y));
    let (current, frame, command) = (u8::from(home && row == 0), item.frame.0, item.command.0);
    let (z, autocontinue) = (bits(item.z), item.autocontinue);
    format!("{row} {current} {frame} {command} {p1} {p2} {p3} {p4} {z} {x} {y} {autocontinue}")
}

#[test]
fn plan_files_are_exchanged_with_pymavlink() {
    let Some(python) = pymavlink::python() else { return };
    let sample = |name: &str| std::fs::read(Path::new("tests/wpl").join(name)).expect("a sample");
    let (_, fence) = read(&sample("mavproxy_fence.txt"), HomeRow::None);
    let (_, rally) = read(&sample("mavproxy_rally.txt"), HomeRow::None);
    let (home, items) = read(&sample("qgroundcontrol.waypoints"), HomeRow::First);
    let plans =
        [("mission", None, mission()), ("mission", home, items), ("fence", None, fence), ("rally", None, rally)];
    for (number, (kind, home, items)) in plans.into_iter().enumerate() {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
        let path = folder.join(format!("{kind}{number}.txt"));
        let saved = folder.join(format!("{kind}{number}_saved.txt"));
        std::fs::write(&path, write(home.as_ref(), &items)).expect("written");
        let output =
            Command::new(python).args([Path::new("tests/wpl/mavwp.py"), kind.as_ref(), &path, &saved]).output();
        let output = output.expect("python runs");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));

        // pymavlink treats home as an item, and its jumps count rows.
        let mut rows: Vec<_> = home.into_iter().chain(items.iter().copied()).collect();
        for jump in rows.iter_mut().filter(|item| item.command == MavCmd::DO_JUMP) {
            jump.params[0] += f32::from(u8::from(home.is_some()));
        }
        let expected = rows.iter().enumerate().map(|(row, item)| printed(row, item, home.is_some()));
        let loaded = String::from_utf8(output.stdout).expect("text");
        assert_eq!(loaded.lines().collect::<Vec<_>>(), expected.collect::<Vec<_>>(), "{kind} as pymavlink loads it");

        let to_six = |item: Item| Item {
            params: item.params.map(float_to_six),
            x: coordinate_to_six(item.x, scale(&item)),
            y: coordinate_to_six(item.y, scale(&item)),
            z: float_to_six(item.z),
            ..item
        };
        let home_row = if home.is_some() { HomeRow::First } else { HomeRow::None };
        let again = read(&std::fs::read(&saved).expect("saved"), home_row);
        assert_eq!(again, (home.map(to_six), items.into_iter().map(to_six).collect()), "{kind} as pymavlink saves it");
    }
}
