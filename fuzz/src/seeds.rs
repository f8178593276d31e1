//! The seeds of the corpora, from the golden frames and from scripts.

use std::fs;
use std::path::Path;

/// Frames encoded by the reference implementation.
const GOLDEN: &[u8] = include_bytes!("../../tests/golden/common.bin");

/// Splits the golden frames.
fn golden() -> Vec<&'static [u8]> {
    let (mut frames, mut rest) = (Vec::new(), GOLDEN);
    while let [start, len, ..] = *rest {
        let (frame, behind) = rest.split_at(usize::from(len) + if start == 0xFD { 12 } else { 8 });
        frames.push(frame);
        rest = behind;
    }
    frames
}

/// Frames that are complete, truncated, nested and damaged.
pub fn decode() -> Vec<Vec<u8>> {
    let frames = golden();
    let picked: Vec<_> = frames.iter().step_by(37).collect();
    let mut seeds = Vec::new();
    for (index, frame) in picked.iter().enumerate() {
        let other = picked[(index + 1) % picked.len()];
        seeds.push([&[0, 0], **frame].concat());
        // In pieces, with a small budget, after a false start byte.
        seeds.push([&[1, 3, 1, 7, 200, 0xFD, 30], **frame, other].concat());
        let mut damaged = [&[0, 0], **frame, other].concat();
        damaged[3] ^= 0x10;
        seeds.push(damaged);
    }
    seeds.push([&[1, 0][..], &[0xFD; 600]].concat());
    seeds.push([&[1, 0][..], &[0xFE, 0xFF].repeat(300)].concat());
    // An unknown id from a known sender, followed by a frame.
    seeds.push([&[0, 0, 0xFD, 2, 0, 0, 1, 2, 1, 0xEF, 0xCD, 0xAB, 1, 2, 3, 4], frames[0]].concat());
    // Signed.
    let mut signed = [&[0, 0][..], frames[0]].concat();
    signed[4] = 1;
    signed.extend([7; 13]);
    seeds.push(signed);
    seeds
}

/// One seed for each kind of payload.
pub fn roundtrip() -> Vec<Vec<u8>> {
    let counting: Vec<u8> = (1..=255).collect();
    let payloads: [&[u8]; 4] = [&[], &[0xFF; 255], &[0x7F, 0xC0, 0, 0, 0xFF].repeat(51), &counting];
    let mut seeds = Vec::new();
    for (index, payload) in (0u16..).zip(payloads) {
        for which in (0..6u16).map(|which| (which * 40 + index).to_le_bytes()) {
            seeds.push([&which[..], &[9, 1, 1], payload].concat());
        }
    }
    seeds
}

/// Frames and duplicates, changed at every relevant offset.
pub fn sign() -> Vec<Vec<u8>> {
    let mut seeds = vec![
        vec![0, 0, 1, 2, 0, 0, 0, 1, 2, 1, 0, 2, 1],
        vec![0, 0, 5, 3, 50, 5, 2, 0, 0, 1, 0, 2, 0, 6, 0, 6, 1, 4],
        vec![0x80, 0, 1, 2, 0, 0x80, 2, 1, 0x82, 0, 0x86, 0],
    ];
    for at in [0, 1, 2, 3, 4, 5, 7, 10, 20, 40, 43, 44, 45, 46, 50, 51, 52, 57] {
        for repaired in [0, 0x80] {
            seeds.push(vec![0, 0, 1, 1, 0, repaired, at, 0, 1, 2, 0]);
        }
    }
    seeds
}

/// Images, records and scripts, for each geometry.
pub fn record() -> Vec<Vec<u8>> {
    let mut seeds = Vec::new();
    for geometry in 0..5 {
        seeds.push(vec![0, geometry, 0, 0]);
        seeds.push([&[0, geometry, 0, 0][..], b"ML\x01\x01 and something else"].concat());
        // Records: a plan with one waypoint, a parameter by its key, a key, the vehicle's own, of newer firmware, a lost one.
        let mut plan = vec![1, 0, 0];
        plan.resize(32, 0);
        plan.extend([3, 16, 0, 1]);
        plan.resize(52, 0);
        plan.extend([1, 0, 0, 0, 2]);
        plan.resize(64, 0);
        let record = |kind, options, content: &[u8]| [&[kind, options, content.len() as u8 / 2], content].concat();
        let mut all = vec![1, geometry];
        all.extend(record(0, 0, &plan));
        all.extend(record(1, 0, &[0x12, 0x34, 0x56, 0x78, 5, 0, 0, 0]));
        all.extend(record(2, 0, &[0x55; 42]));
        all.extend(record(3, 0, &[1, 2, 3, 4]));
        seeds.push(all.clone());
        all.extend(record(6, 0, &[9; 250]));
        seeds.push(all.clone());
        all.extend(record(0, 0x80, &[]));
        seeds.push(all);
        seeds.push([&[1, geometry][..], &record(1, 0x40, &[7; 16])].concat());
        seeds.push([&[1, geometry][..], &record(0, 0x10, &plan)].concat());
        for torn in 0..3 {
            let mut script = vec![2, geometry, torn];
            for kind in 0..6 {
                script.extend([kind, 10 + kind, 0xFF, 0xFF]);
            }
            for (kind, fuel) in [(0u8, 0u16), (0, 100), (1, 255), (2, 300), (0, 500), (3, 257), (0, 700), (2, 900)] {
                let [low, high] = fuel.to_le_bytes();
                script.extend([kind, 30 + torn, low, high]);
            }
            seeds.push(script);
            // Compaction, damage, and compaction with damage.
            for (page, byte) in [(0u8, 100), (0, 230), (1, 250), (2, 10), (3, 255), (5, 240)] {
                let mut script =
                    vec![2, geometry, torn, 0, 20, 0xFF, 0xFF, 2, 7, 0xFF, 0xFF, 6, 3, 3, 1, 9, 0xFF, 0xFF];
                script.extend([7, 0, page, 0, byte, 1, 6, 4, 15, 1, 2, 0xFF, 0xFF]);
                seeds.push(script);
            }
        }
    }
    seeds
}

/// Small definitions that use every construct.
pub fn dialect() -> Vec<Vec<u8>> {
    let xml = |inner: &str| format!("<?xml version=\"1.0\"?>\n<mavlink>\n{inner}\n</mavlink>\n").into_bytes();
    vec![
        xml(""),
        xml("<include>minimal.xml</include><version>3</version><dialect>9</dialect>"),
        xml("<enums><enum name=\"COLOUR\" bitmask=\"true\"><description>x</description>\
             <entry value=\"1\" name=\"COLOUR_RED\"><description>r</description></entry>\
             <entry value=\"2**3\" name=\"COLOUR_BLUE\"/><entry value=\"0x10\" name=\"COLOUR_2\"><deprecated since=\"2020-01\" \
             replaced_by=\"\"/></entry></enum></enums><messages><message id=\"60001\" name=\"PAINT\">\
             <description>d</description><field type=\"uint8_t\" name=\"colour\" enum=\"COLOUR\" display=\"bitmask\">c</field>\
             <field type=\"char[10]\" name=\"label\">l</field><field type=\"float\" name=\"type\" units=\"m/s\" \
             invalid=\"NaN\" minValue=\"-1\" maxValue=\"1e3\">t</field><extensions/>\
             <field type=\"uint16_t[4]\" name=\"cells\" multiplier=\"1E-2\">e</field></message></messages>"),
        xml("<enums><enum name=\"MAV_CMD\"><entry value=\"31000\" name=\"MAV_CMD_OWN\" hasLocation=\"true\" \
             isDestination=\"true\"><param index=\"1\" label=\"Speed\" units=\"m/s\" minValue=\"0\" maxValue=\"9\" increment=\"1\"/>\
             <param index=\"2\" label=\"Mode\" enum=\"MAV_CMD\"/><param index=\"5\" label=\"Latitude\"/>\
             <param index=\"7\" reserved=\"true\" default=\"NaN\"/></entry></enum></enums>"),
        xml("<messages><message id=\"16777216\" name=\"A\"/></messages>"),
        xml(
            "<messages><message id=\"1\" name=\"A\"><field type=\"uint8_t_mavlink_version\" name=\"v\"/><wip/></message></messages>",
        ),
        b"<mavlink><messages><message></mavlink>".to_vec(),
        b"<!DOCTYPE x [<!ENTITY a \"b\">]><mavlink>&a;</mavlink>".to_vec(),
        vec![0xFF, 0xFE, 0],
    ]
}

/// Files of real programs, and lines that are hard to parse.
pub fn wpl() -> Vec<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/wpl");
    let mut files: Vec<_> = fs::read_dir(folder).expect("the tests' files").flatten().map(|file| file.path()).collect();
    files.sort();
    files.retain(|file| file.is_file() && file.extension().is_some_and(|extension| extension != "py"));
    let mut seeds: Vec<Vec<u8>> = Vec::new();
    for (index, file) in files.iter().enumerate() {
        let text = fs::read(file).expect("a file that can be read");
        seeds.push([&[1][..], &text].concat());
        seeds.push([&[(index as u8 * 10) << 1], &text[..]].concat());
    }
    let row = |text: &str| [b"\x40QGC WPL 110\n", text.as_bytes(), b"\n"].concat();
    seeds.push(row("0\t1\t0\t16\t0\t0\t0\t0\t47.3977420\t8.5455940\t488.1\t1"));
    seeds.push(row(
        "0 0 3 177 1e0 -1 inf -nan 90.00000005 -180 1e-45 0\r\n# x\r\n1 0 2 177 0 .5 +5. 3.4028235e38 nan 0 16777217 1",
    ));
    seeds.push(row("0 0 1 16 0.1 1e-10 99999999999999999999 1e38 214748.3646 -214748.3648 0 1"));
    seeds
}

/// Complete sessions.
pub fn session() -> Vec<Vec<u8>> {
    const SECOND: &[u8] = &[11];
    let upload = |link: u8, plan: u8, count: u8| vec![10, link, plan | count << 2];
    let usual = |route: u8, which: u8, a: u8, b: u8| vec![2, route, which, a, b];
    let mut seeds = vec![
        // Uploads on all links, sequential and concurrent.
        [&[0, 0], SECOND, &upload(0, 0, 5), SECOND, &upload(0, 1, 2), SECOND, &upload(1, 2, 3), SECOND].concat(),
        [&[0x10, 8], SECOND, &upload(3, 0, 8), SECOND, &upload(0, 0, 4), &upload(1, 0, 3), SECOND, SECOND].concat(),
        [&[0, 0], SECOND, &upload(0, 0, 5), SECOND, &usual(4, 5, 0xFF, 0), SECOND, &usual(4, 1, 0, 0), SECOND].concat(),
        // Commands while lines stall and recover.
        [&[0, 0], SECOND, &[9, 0, 9, 1, 9, 2, 9, 0x40, 6, 0, 1, 9, 0, 9, 4, 0, 9, 9, 6, 0, 0], SECOND].concat(),
        [&[0x18, 0], SECOND, &[9, 3, 9, 0x83, 9, 0xC3, 9, 0x80], SECOND, &[6, 3, 7], SECOND].concat(),
        // The flight loop stops, the vehicle reports no state, time jumps.
        [&[0, 1], SECOND, &[8, 0, 0], SECOND, &[8, 0, 0], SECOND, &[8, 1, 0], SECOND, &[8, 1, 0, 1, 100, 1, 4], SECOND]
            .concat(),
        // Forwarding: a peer on each link, then frames addressed to it; forwarded frames return.
        [
            &[0x40, 0][..],
            &usual(4 << 2, 0, 10, 0),
            &usual(1 | 5 << 2, 0, 1, 0),
            &usual(7 << 2, 0, 6, 0),
            SECOND,
            &usual(1 | 5 << 2 | 0x20, 12, 0, 3),
            &usual(0x20, 12, 0, 2),
            SECOND,
            &[5, 4, 0, 5, 1, 0, 5, 1, 9],
            SECOND,
        ]
        .concat(),
        // The satellite.
        [&[0x20, 0], SECOND, &usual(2, 12, 11, 1), SECOND, SECOND, &[1, 100], SECOND, &usual(2, 12, 11, 8), SECOND]
            .concat(),
        // A key is set and removed.
        [&[0x08, 0], SECOND, &usual(3, 20, 1, 1), SECOND, &[9, 0x83, 9, 3], SECOND, &usual(0x83, 20, 0, 1), SECOND]
            .concat(),
        // Long-running commands.
        [&[0, 0], SECOND, &usual(0, 12, 2, 0), SECOND, &[8, 6, 40], SECOND, &usual(0, 14, 2, 0), &[8, 5, 0], SECOND]
            .concat(),
        // Any message, any bytes.
        [
            &[0x40, 0][..],
            &[3, 0, 0, 0, 9],
            &[1; 9],
            &[3, 4, 40, 0, 40],
            &[2; 40],
            &[4, 1, 9, 0xFD, 5, 0, 0, 0, 1, 1, 0, 0],
            SECOND,
        ]
        .concat(),
    ];
    seeds.extend(hostile());
    // Every usual message, also addressed to others.
    for route in [0, 1 | 1 << 2, 3 | 0x80, 0x20 | 5 << 2] {
        let mut seed = vec![0x70, 0];
        (0..24).for_each(|which| {
            seed.extend(usual(route, which, which, 3));
            seed.extend([0, 3, 20]);
        });
        seeds.push([&seed, SECOND].concat());
    }
    // A power cut while a plan or a parameter is written.
    for fuel in [1u16, 30, 200, 300, 600, 900, 1_500] {
        let [low, high] = fuel.to_le_bytes();
        let cut = [7, 0, low, high];
        seeds
            .push([&[0, 0], SECOND, &upload(0, 0, 6), SECOND, SECOND, &cut, &upload(0, 0, 3), SECOND, SECOND].concat());
        let cut = [7, 1, low, high];
        seeds.push(
            [&[0x40, 4], SECOND, &usual(0, 11, 80, 1), &cut, SECOND, SECOND, &usual(0, 11, 9, 2), SECOND].concat(),
        );
    }
    for fault in [0x28, 0x30, 0x38] {
        seeds.push(
            [&[0, 0], SECOND, &[7, fault, 1, 0][..], &upload(0, 0, 6), SECOND, SECOND, &[8, 11, 0], SECOND].concat(),
        );
    }
    seeds
}

/// Sessions of hostile and odd peers, whose steps are actor and link, what, how often, how far apart: see `session/hostile.rs`.
fn hostile() -> Vec<Vec<u8>> {
    const SECOND: &[u8] = &[11];
    let [owner, other, authoriser, gimbal, companion, radio, wingman, invented] = [0, 4, 8, 12, 16, 20, 24, 28];
    const SATELLITE: u8 = 2;
    // All services, with a private second link, and with a key or without.
    let setup = [0x64, 0];
    let step = |actor: u8, what: u8, times: u8, gap: u8| vec![240, actor, what, times, gap];
    let beats = [step(owner, 0, 0, 1), step(other | 1, 0, 0, 1)].concat();
    vec![
        // The first station takes control and begins everything; the second takes over, and the first goes on.
        [
            &setup[..],
            &beats,
            &step(owner, 2 | 1 << 5, 0, 5),
            &step(owner, 11, 0, 5),
            &step(owner, 13 | 2 << 5, 0, 5),
            &step(owner, 14, 0, 5),
            &step(owner, 18, 0, 5),
            &step(owner, 24, 0, 5),
            &step(other | 1, 2, 0, 5),
            &step(owner, 14, 3, 5),
            &step(owner, 10, 3, 5),
            &step(owner, 12, 0, 5),
            &step(owner, 16, 2, 5),
            &step(owner, 19, 2, 5),
            &step(owner | 2, 15, 0, 5),
            &[9, 0, 9, 1],
            SECOND,
        ]
        .concat(),
        // The vehicle asks another system's component on one link; others answer in its name.
        [
            &setup[..],
            &step(authoriser, 0, 0, 5),
            &step(authoriser, 29, 0, 5),
            &step(authoriser | 1, 4, 3, 5),
            &step(authoriser | 2, 4, 0, 5),
            &step(authoriser, 5, 0, 5),
            &step(authoriser, 4, 0, 5),
            SECOND,
        ]
        .concat(),
        // The gimbal is on the private link; others speak in its name.
        [
            &setup[..],
            &step(gimbal | 1, 1, 0, 5),
            &step(gimbal | 1, 6, 1, 5),
            &step(gimbal, 6, 7, 5),
            &step(gimbal, 7, 1, 5),
            &step(gimbal, 29, 1, 5),
            &step(gimbal, 4, 3, 5),
            &step(gimbal | 1, 4, 0, 5),
            &step(companion, 10, 1, 5),
            &step(companion | 1, 10, 1, 5),
            SECOND,
        ]
        .concat(),
        // What others forward and cause by satellite.
        [
            &setup[..],
            &step(owner | SATELLITE, 10, 0, 5),
            &step(wingman, 28, 15, 1),
            &step(wingman | 1, 28, 15, 1),
            &step(invented, 27, 15, 3),
            SECOND,
        ]
        .concat(),
        // Places: files, logs, commands, peers; and a station that comes late.
        [
            &setup[..],
            &step(invented, 0, 15, 1),
            &step(invented, 17, 15, 1),
            &step(invented, 20, 15, 1),
            &step(invented | 1, 23, 3, 1),
            &step(invented | 1, 22, 7, 1),
            &step(invented, 11, 7, 1),
            &step(invented, 13, 3, 1),
            &step(invented, 26, 1, 1),
            &step(invented, 30, 1, 1),
            &step(radio, 31, 15, 1),
            &step(authoriser, 8, 3, 1),
            &step(authoriser, 9, 3, 1),
            SECOND,
            SECOND,
        ]
        .concat(),
        // Who signs.
        [
            &[0x74, 0][..],
            &step(0x80 | gimbal | 3, 6, 1, 5),
            &step(0x80 | owner | 3, 0, 0, 5),
            &step(owner, 2, 0, 5),
            SECOND,
        ]
        .concat(),
    ]
}

/// A download, an upload, and clients that compete.
pub fn files() -> Vec<Vec<u8>> {
    let ask = |client: u8, session: u8, seq: u8, opcode: u8, size: u8, path: u8| {
        vec![0, client, session, seq, opcode, size, 0, 0, path]
    };
    let pause = vec![3, 5];
    let mut seeds = Vec::new();
    for path in [2, 3, 7, 8] {
        seeds.push([ask(0, 0, 1, 4, 0, path), pause.clone(), ask(0, 0, 2, 15, 100, 0), pause.clone()].concat());
    }
    seeds.push([ask(0, 0, 1, 6, 0, 7), vec![1, 0, 0, 2, 0, 0, 6, 0x1B, 0x67, 0, 0, 6, 0], pause.clone()].concat());
    seeds.push((0..3).flat_map(|client| ask(client, client, 1, 4, 0, 2)).chain([3, 39, 3, 39]).collect());
    seeds.push([ask(1, 1, 1, 14, 0, 2), vec![4, 0], ask(1, 1, 1, 3, 0, 0), vec![5, 0], pause].concat());
    seeds
}
