//! Single requests: rules LOG-1 to LOG-4, LOG-9.

use super::*;
use mavstack::logs::LogCounters;

/// LOG-1, LOG-2: logs are numbered from 0, and an entry has the size, the time, the number of logs and the last one that was
/// requested. A range is cut at the logs that there are.
#[test]
fn logs_are_listed() {
    let mut field = field(&[100, 90, 0]);
    let list = |field: &mut Field, start, end| {
        let entries: Vec<LogEntry> = answers(field, &LogRequestList { start, end, ..ALL });
        assert!(entries.iter().all(|entry| entry.num_logs == 3));
        let entry = |entry: &LogEntry| (entry.id, entry.size, entry.time_utc, entry.last_log_num);
        entries.iter().map(entry).collect::<Vec<_>>()
    };
    let (first, second, third) = ((0, 100, 1_000, 2), (1, 90, 1_100, 2), (2, 0, 1_200, 2));
    assert_eq!(list(&mut field, 0, u16::MAX), [first, second, third]);
    assert_eq!(list(&mut field, 1, 7), [second, third]);
    assert_eq!(list(&mut field, 1, 1), [(1, 90, 1_100, 1)]);
    // As PX4 answers: a client learns how many there are.
    assert_eq!(list(&mut field, 5, 9), [third]);
    assert_eq!(list(&mut field, 2, 0), [third], "an empty range");
    assert_eq!(list(&mut field, u16::MAX, u16::MAX), [third]);
}

/// LOG-2: without logs there is one entry that says so.
#[test]
fn an_empty_list_is_one_entry() {
    let mut field = field(&[]);
    let entries: Vec<LogEntry> = answers(&mut field, &ALL);
    assert_eq!(entries, [LogEntry::default()]);
}

/// LOG-3, LOG-4: data is sent in blocks of 90 bytes, and the last one is shorter. There is none behind the requested part.
#[test]
fn a_part_is_sent_in_blocks() {
    let mut field = field(&[1_000, 205]);
    let mut get = |id, ofs, count| -> Vec<LogData> {
        let sent: Vec<LogData> = answers(&mut field, &data(id, ofs, count));
        for part in &sent {
            let (from, count) = (part.ofs as usize, usize::from(part.count));
            let log = content(id.into(), 1_000);
            assert_eq!(part.id, id);
            assert_eq!(part.data[..count], log.get(from..).unwrap_or_default()[..count]);
            assert!(part.data[count..].iter().all(|byte| *byte == 0));
        }
        sent
    };
    assert_eq!(parts(&get(1, 0, u32::MAX)), [(0, 90), (90, 90), (180, 25)]);
    assert_eq!(parts(&get(1, 0, 205)), [(0, 90), (90, 90), (180, 25)]);
    assert_eq!(parts(&get(0, 90, 180)), [(90, 90), (180, 90)]);
    assert_eq!(parts(&get(0, 17, 91)), [(17, 90), (107, 1)]);
    assert_eq!(get(0, 0, 0), []);
    // The end: clients that do not know the size stop there.
    assert_eq!(parts(&get(1, 205, 90)), [(205, 0)]);
    assert_eq!(parts(&get(1, u32::MAX, u32::MAX)), [(u32::MAX, 0)]);
}

/// LOG-4: a log whose size is a multiple of 90 has no short block. The request behind it is answered by the end.
#[test]
fn a_log_of_whole_blocks_has_an_end() {
    let mut field = field(&[180]);
    assert_eq!(parts(&answers(&mut field, &data(0, 0, u32::MAX))), [(0, 90), (90, 90)]);
    assert_eq!(parts(&answers(&mut field, &data(0, 180, u32::MAX))), [(180, 0)]);
}

/// LOG-4: a log that does not exist has no answer, because clients would take one without bytes for a part of the log.
#[test]
fn an_unknown_log_is_not_answered() {
    let mut field = field(&[180]);
    for id in [1, u16::MAX] {
        assert_eq!(answers::<_, LogData>(&mut field, &data(id, 0, 90)), []);
    }
    assert_eq!(field.stack.logs().counters(), counted(|counters: &mut LogCounters| counters.unknown = 2));
}

/// LOG-5: a new request of the same client replaces the one before, whatever it is.
#[test]
fn a_new_request_replaces_the_old_one() {
    let mut field = field(&[9_000, 200]);
    send(&mut field, 0, STATION, &data(0, 0, u32::MAX));
    field.run_for(millis(3));
    assert_eq!(answers::<_, LogEntry>(&mut field, &ALL).len(), 2);
    assert!(all::<LogData>(&field, 0).len() <= 2, "what was in the transmit buffer");
    send(&mut field, 0, STATION, &data(0, 0, u32::MAX));
    field.run_for(millis(3));
    let sent: Vec<LogData> = answers(&mut field, &data(1, 90, u32::MAX));
    let of_it: Vec<LogData> = sent.into_iter().filter(|data| data.id == 1).collect();
    assert_eq!(parts(&of_it), [(90, 90), (180, 20)]);
}

/// LOG-9: the vehicle may need time for a read, and nothing else waits for it. What it cannot read has no answer.
#[test]
fn a_slow_log_is_read_later() {
    let mut field = field(&[300]);
    field.vehicle.logs.later = 10;
    assert_eq!(parts(&answers(&mut field, &data(0, 0, 180))), [(0, 90), (90, 90)]);
    assert_eq!(field.vehicle.logs.reads, 12);
    // Asked every five milliseconds, and not in between: a sleeping loop sleeps.
    field.vehicle.logs.later = usize::MAX;
    send(&mut field, 0, STATION, &data(0, 0, 180));
    field.vehicle.logs.reads = 0;
    let passes = field.sleep_for(secs(1));
    assert!((190..=201).contains(&field.vehicle.logs.reads), "{}", field.vehicle.logs.reads);
    assert!(passes < 420, "{passes}");

    field.vehicle.logs.later = 0;
    field.vehicle.logs.is_broken = true;
    assert_eq!(answers::<_, LogData>(&mut field, &data(0, 90, 180)), []);
    assert_eq!(field.stack.logs().counters().failed, 1);
    field.vehicle.logs.is_broken = false;
    assert_eq!(parts(&answers(&mut field, &data(0, 90, 90))), [(90, 90)]);
}

/// LOG-8: an idle service needs no passes.
#[test]
fn an_idle_service_sleeps() {
    let passes = |sizes: &[usize], asks: bool| {
        let mut field = field(sizes);
        if asks {
            assert!(!answers::<_, LogData>(&mut field, &data(0, 0, 90)).is_empty());
        }
        field.run_for(secs(5));
        field.sleep_for(secs(20))
    };
    assert_eq!(passes(&[90], true), passes(&[], false));
}
