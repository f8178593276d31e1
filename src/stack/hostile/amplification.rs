//! How much a request makes the vehicle send: rule X-2. `docs/safety.md` has the table, which this prints:
//! `cargo test --features signing,storage --lib amplification -- --nocapture`.

use std::collections::BTreeMap;
use std::format;
use std::string::String;

use super::*;

/// The time after a request in which its answers are counted.
const TIME: Duration = Duration::from_secs(10);

/// What a kind of request causes: bytes of answers for each of its bytes, rounded up.
#[derive(Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
struct Row {
    own: usize,
    other: usize,
}

/// The bytes for each byte that need no row of their own.
const LITTLE: usize = 3;

/// The figure of what goes on as often as was asked for.
const AS_ASKED: usize = usize::MAX;

/// What goes on after its request: streams, and states at an interval.
const ONGOING: [&str; 5] =
    ["SET_MESSAGE_INTERVAL", "REQUEST_DATA_STREAM", "LOGGING_START", "VIDEO_START_CAPTURE", "IMAGE_START_CAPTURE"];

/// What has as much content as the vehicle has: lists, files, logs, and messages of several instances.
const TRANSFERS: [&str; 8] = [
    "PARAM_REQUEST_LIST",
    "PARAM_EXT_REQUEST_LIST",
    "LOG_REQUEST_LIST",
    "LOG_REQUEST_DATA",
    "READFILE",
    "BURSTREADFILE",
    "REQUEST_EVENT",
    "REQUEST_MESSAGE",
];

/// What the vehicle sends after this request, on the asking link and on the idle one. Nobody answers it.
fn single(request: Option<&Request>) -> [usize; 2] {
    let mut field = prepared();
    if let Some(request) = request {
        field.request(ASKING, STATION, request);
    }
    field.sleep_for(TIME);
    assert!(field.hooks <= 32, "{} hooks in a poll", field.hooks);
    [ASKING, IDLE].map(|link| field.bytes(link, |_| true))
}

/// Floods with a request at the rate of its link, and checks what a busy link sends.
fn flooded(calm: &Shares, request: &Request) {
    let mut field = prepared();
    let shares = flood(&mut field, FAST, 1, |field| field.request(ASKING, STATION, request));
    assert!(field.hooks <= 32, "{}: {} hooks in a poll", request.name, field.hooks);
    check(calm, &shares, 1, request.name);
}

/// what each request makes the vehicle send, on its own link and on others. No answer is larger than its bound; on a busy link,
/// requests of others have a tenth.
#[test]
fn amplification() {
    let calm = flood(&mut prepared(), FAST, 1, |_| 0);
    let base = single(None);
    let mut rows: BTreeMap<&str, Row> = BTreeMap::new();
    for request in requests() {
        let len = request.frame(Version::V2, STATION, 0).len();
        let sent = single(Some(&request));
        let [own, other] = [0, 1].map(|link| sent[link].saturating_sub(base[link]).div_ceil(len));
        let row = rows.entry(request.name).or_default();
        let row_of = |bytes| if ONGOING.contains(&request.name) && bytes > 3 { AS_ASKED } else { bytes };
        *row = Row { own: row.own.max(row_of(own)), other: row.other.max(row_of(other)) };
        if other > 0 {
            flooded(&calm, &request);
        }
        let name = request.name;
        if ONGOING.contains(&name) {
            let most = usize::try_from(FAST).expect("a rate") * 10;
            assert!(sent.iter().all(|sent| *sent <= most), "{name}: {sent:?}");
        } else {
            let most = if TRANSFERS.contains(&name) { 40 } else { 12 };
            assert!(own <= most, "{name}: {own} bytes for each");
            assert!(other <= 3, "{name}: {other} bytes for each on another link");
        }
    }
    let table = table(&rows);
    std::print!("{table}");
    let page = include_str!("../../../docs/safety.md");
    assert!(page.contains(&table), "docs/safety.md has another table than this:\n{table}");
}

/// The rows, those with the same figures together.
fn table(rows: &BTreeMap<&str, Row>) -> String {
    let mut kinds: BTreeMap<Row, Vec<&str>> = BTreeMap::new();
    rows.iter().for_each(|(name, row)| kinds.entry(*row).or_default().push(name));
    let mut table = String::from("| same link | another link | requests |\n|---|---|---|\n");
    let figure = |bytes: usize| if bytes == AS_ASKED { String::from("as asked") } else { format!("{bytes}") };
    let mut others = 0;
    for (Row { own, other }, names) in kinds.iter().rev() {
        if *own <= LITTLE && *other <= LITTLE {
            others += names.len();
        } else {
            table += &format!("| {} | {} | {} |\n", figure(*own), figure(*other), names.join(", "));
        }
    }
    table += &format!("| {LITTLE} or less | {LITTLE} or less | {others} other kinds |\n");
    table
}
