//! `cargo xtask ulog`: what is in a flight log in the format ULog, and one topic of it as CSV.
//!
//! Reads <https://docs.px4.io/main/en/dev_log/ulog_file_format.html> as far as the demo vehicle writes it. Left out: formats inside of
//! formats, parameters, and appended data. pyulog and PlotJuggler read all of it.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::PathBuf;

use clap::Args;

use crate::system::Result;

/// Print a summary of a flight log in the format ULog, or a topic of it as CSV.
///
/// Ground stations download the demo vehicle's logs: with MAVProxy, `log list` and `log download 0 flight.ulg`.
#[derive(Args)]
pub struct Ulog {
    /// The log.
    file: PathBuf,
    /// Print the values of this topic, such as vehicle_attitude, in a row for each time.
    #[arg(long, value_name = "NAME")]
    topic: Option<String>,
}

impl Ulog {
    pub fn run(&self) -> Result {
        let file = self.file.display();
        let bytes = std::fs::read(&self.file).map_err(|error| format!("{file}: {error}"))?;
        let log = Log::parse(&bytes).map_err(|fault| format!("{file}: {fault}"))?;
        let text = match &self.topic {
            Some(name) => log.csv(name).map_err(|fault| format!("{file}: {fault}"))?,
            None => log.summary(),
        };
        print!("{text}");
        Ok(())
    }
}

/// A field of a topic.
#[derive(Clone, Debug, PartialEq)]
struct Field {
    name: String,
    kind: Kind,
    /// The number of elements.
    count: usize,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Signed(usize),
    Unsigned(usize),
    Float,
    Double,
}

impl Kind {
    fn of(name: &str) -> Option<Self> {
        Some(match name {
            "int8_t" => Self::Signed(1),
            "int16_t" => Self::Signed(2),
            "int32_t" => Self::Signed(4),
            "int64_t" => Self::Signed(8),
            "uint8_t" | "bool" | "char" => Self::Unsigned(1),
            "uint16_t" => Self::Unsigned(2),
            "uint32_t" => Self::Unsigned(4),
            "uint64_t" => Self::Unsigned(8),
            "float" => Self::Float,
            "double" => Self::Double,
            _ => return None,
        })
    }

    const fn size(self) -> usize {
        match self {
            Self::Signed(size) | Self::Unsigned(size) => size,
            Self::Float => 4,
            Self::Double => 8,
        }
    }

    /// Returns a value as a text; its bytes are little-endian.
    fn show(self, bytes: &[u8]) -> String {
        let mut wide = [0; 8];
        wide[..bytes.len()].copy_from_slice(bytes);
        let value = u64::from_le_bytes(wide);
        match self {
            Self::Unsigned(_) => value.to_string(),
            Self::Signed(size) => (value.cast_signed() << (64 - 8 * size) >> (64 - 8 * size)).to_string(),
            Self::Float => f32::from_bits(u32::from_le_bytes([wide[0], wide[1], wide[2], wide[3]])).to_string(),
            Self::Double => f64::from_bits(value).to_string(),
        }
    }
}

/// A topic, and its values in order of time.
#[derive(Debug)]
struct Topic {
    name: String,
    fields: Vec<Field>,
    values: Vec<Vec<u8>>,
}

impl Topic {
    /// Returns the time of the values at `index` (µs).
    fn time(&self, index: usize) -> u64 {
        self.values[index].first_chunk().map_or(0, |bytes| u64::from_le_bytes(*bytes))
    }
}

/// A log.
#[derive(Debug, Default)]
struct Log {
    /// When it was begun (µs since boot).
    start: u64,
    /// What identifies the vehicle, such as its name.
    information: Vec<(String, String)>,
    /// The topics by their ids.
    topics: BTreeMap<u16, Topic>,
    /// Time (µs), level and text.
    texts: Vec<(u64, char, String)>,
    /// The number of bytes at the end that are no whole message.
    rest: usize,
}

const MAGIC: &[u8] = b"ULog\x01\x12\x35";

impl Log {
    fn parse(bytes: &[u8]) -> std::result::Result<Self, String> {
        let header = bytes.strip_prefix(MAGIC).and_then(|rest| rest.split_first_chunk::<9>());
        let Some(([_, time @ ..], mut rest)) = header else { return Err("no ULog: its first bytes differ".to_owned()) };
        let mut log = Self { start: u64::from_le_bytes(*time), ..Self::default() };
        let mut formats = BTreeMap::new();
        while let Some(([low, high, kind], behind)) = rest.split_first_chunk() {
            let Some((content, next)) = behind.split_at_checked(u16::from_le_bytes([*low, *high]).into()) else {
                break;
            };
            log.take(*kind, content, &mut formats)?;
            rest = next;
        }
        log.rest = rest.len();
        Ok(log)
    }

    /// Takes a message.
    fn take(
        &mut self,
        kind: u8,
        content: &[u8],
        formats: &mut BTreeMap<String, Vec<Field>>,
    ) -> std::result::Result<(), String> {
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        match (kind, content) {
            (b'F', _) => {
                let format = text(content);
                let (name, fields) = format.split_once(':').ok_or("a format without a name")?;
                formats.insert(name.to_owned(), fields_of(fields)?);
            }
            (b'I', [len, content @ ..]) => {
                let (key, value) = content.split_at_checked((*len).into()).ok_or("a key is too long")?;
                let key = text(key);
                if let Some((_, key)) = key.split_once(' ').filter(|(kind, _)| kind.starts_with("char[")) {
                    self.information.push((key.to_owned(), text(value)));
                }
            }
            (b'A', [_, low, high, name @ ..]) => {
                let name = text(name);
                let fields = formats.get(&name).cloned().ok_or(format!("{name} has no format"))?;
                let topic = Topic { name, fields, values: Vec::new() };
                self.topics.insert(u16::from_le_bytes([*low, *high]), topic);
            }
            (b'D', [low, high, values @ ..]) => {
                let topic = self.topics.get_mut(&u16::from_le_bytes([*low, *high])).ok_or("data of no topic")?;
                topic.values.push(values.to_vec());
            }
            (b'L', [level, rest @ ..]) => {
                let (time, words) = rest.split_first_chunk().ok_or("a text without a time")?;
                self.texts.push((u64::from_le_bytes(*time), char::from(*level), text(words)));
            }
            _ => {}
        }
        Ok(())
    }

    /// Returns the time since the start (s).
    fn seconds(&self, micros: u64) -> f64 {
        micros.saturating_sub(self.start) as f64 / 1e6
    }

    fn summary(&self) -> String {
        let mut text = String::new();
        for (key, value) in &self.information {
            let _ = writeln!(text, "{key}: {value}");
        }
        let last = self.topics.values().filter_map(|topic| Some(topic.time(topic.values.len().checked_sub(1)?))).max();
        let seconds = self.seconds(last.unwrap_or(self.start));
        let _ = writeln!(text, "begins {:.1} s after boot, and takes {seconds:.1} s\n", self.start as f64 / 1e6);
        for topic in self.topics.values() {
            let _ = writeln!(text, "{:6} × {}", topic.values.len(), topic.name);
        }
        for (time, level, words) in &self.texts {
            let _ = write!(text, "\n{:8.3} s, level {level}: {words}", self.seconds(*time));
        }
        if self.rest > 0 {
            let _ = write!(text, "\nThe last {} bytes are an incomplete message.", self.rest);
        }
        text + "\n"
    }

    fn csv(&self, name: &str) -> std::result::Result<String, String> {
        let Some(topic) = self.topics.values().find(|topic| topic.name == name) else {
            let names: Vec<_> = self.topics.values().map(|topic| topic.name.as_str()).collect();
            return Err(format!("no topic {name}; it has {}", names.join(", ")));
        };
        let columns = topic.fields.iter().flat_map(|Field { name, count, .. }| {
            (0..*count).map(move |index| if *count == 1 { name.clone() } else { format!("{name}[{index}]") })
        });
        let mut text = columns.collect::<Vec<_>>().join(",") + "\n";
        for values in &topic.values {
            let mut rest = values.as_slice();
            let mut cells = Vec::new();
            for Field { kind, count, .. } in &topic.fields {
                for _ in 0..*count {
                    // The padding at the end is not written.
                    let Some((value, behind)) = rest.split_at_checked(kind.size()) else { break };
                    cells.push(kind.show(value));
                    rest = behind;
                }
            }
            text += &(cells.join(",") + "\n");
        }
        Ok(text)
    }
}

/// Returns the fields of a format.
fn fields_of(format: &str) -> std::result::Result<Vec<Field>, String> {
    let fields = format.split(';').filter(|field| !field.is_empty()).map(|field| {
        let (kind, name) = field.split_once(' ').ok_or(format!("the field \"{field}\" has no name"))?;
        let (kind, count) = match kind.split_once('[') {
            Some((kind, count)) => (kind, count.trim_end_matches(']').parse().map_err(|_| "a length is no number")?),
            None => (kind, 1),
        };
        let known = Kind::of(kind).ok_or(format!("the type {kind} is not supported"))?;
        Ok(Field { name: name.to_owned(), kind: known, count })
    });
    fields.collect()
}

#[cfg(test)]
mod tests {
    use mavstack::dialect::{CommandLong, MavCmd};
    use mavstack::frame::{Version, encode};
    use mavstack::{Address, Instant, Logs, StackOf};
    use mavstack_demo::{App, COMPANION, LogMemory, Mavlink};

    use super::*;

    /// Returns the log of a flight of the demo vehicle that takes some seconds.
    fn flight() -> Vec<u8> {
        let mut app = App::new(Box::new(StackOf::<Mavlink>::VACANT));
        app.keep_logs(Box::leak(Box::new(LogMemory::new())));
        for millis in 0..12_000 {
            let now = Instant::from_millis(millis);
            app.control(now);
            let command = match millis {
                3_000 => Some((MavCmd::COMPONENT_ARM_DISARM, [1.0, 0.0])),
                3_100 => Some((MavCmd::NAV_TAKEOFF, [0.0, 0.0])),
                10_000 => Some((MavCmd::COMPONENT_ARM_DISARM, [0.0, 21_196.0])),
                _ => None,
            };
            let Some((command, [param1, param2])) = command else { continue };
            let command =
                CommandLong { command, param1, param2, target_system: 1, target_component: 1, ..Default::default() };
            let mut frame = [0; 280];
            let len = encode(&command, Version::V2, Address::new(255, 190), 0, &mut frame).expect("a frame");
            let (stack, vehicle) = app.parts();
            stack.receive(now, COMPANION, &frame[..len], vehicle);
        }
        let (_, vehicle) = app.parts();
        let size = vehicle.log_info(0).expect("a log").size;
        let mut log = vec![0; size as usize];
        for (block, bytes) in (0..).zip(log.chunks_mut(90)) {
            vehicle.read_log(0, 90 * block, bytes);
        }
        log
    }

    /// LOG-3: the demo vehicle's log of a flight has its topics at their rates, and the parts of the format in their order.
    #[test]
    fn flight_of_the_demo_is_read() {
        let bytes = flight();
        let log = Log::parse(&bytes).unwrap();
        assert_eq!(log.rest, 0);
        assert_eq!(log.information[0], ("sys_name".to_owned(), "mavstack".to_owned()));
        let counts: Vec<_> = log.topics.values().map(|topic| (topic.name.as_str(), topic.values.len())).collect();
        assert_eq!(
            counts,
            [
                ("vehicle_attitude", 35),
                ("vehicle_local_position", 18),
                ("vehicle_gps_position", 9),
                ("battery_status", 9),
                ("vehicle_status", 12),
            ]
        );
        for topic in log.topics.values() {
            let len: usize = topic.fields.iter().map(|field| field.kind.size() * field.count).sum();
            assert!(topic.values.iter().all(|values| values.len() == len), "{}", topic.name);
        }
        let csv = log.csv("vehicle_status").unwrap();
        let rows: Vec<&str> = csv.lines().collect();
        assert_eq!(rows[0], "timestamp,arming_state,nav_state");
        assert!(rows[1].ends_with(",2,4") && rows[3].ends_with(",2,17") && rows[12].ends_with(",1,4"), "{csv}");
        assert!(log.csv("vehicle_attitude").unwrap().starts_with("timestamp,q[0],q[1],q[2],q[3],rollspeed,"));
        assert!(log.summary().contains("takes 7.0 s"), "{}", log.summary());
        assert_eq!(log.csv("missing").unwrap_err().split(';').next(), Some("no topic missing"));
    }

    /// A log that was cut off is read up to there. Another file is refused.
    #[test]
    fn damaged_files_are_read_as_far_as_possible() {
        let bytes = flight();
        for len in 0..bytes.len() {
            match Log::parse(&bytes[..len]) {
                Ok(log) => assert!(log.rest < 200 && len >= 16),
                Err(_) => assert!(len < 16),
            }
        }
        assert!(Log::parse(b"no log").is_err());
    }

    #[test]
    fn numbers_have_their_sign() {
        assert_eq!(Kind::Signed(1).show(&[0xFF]), "-1");
        assert_eq!(Kind::Signed(4).show(&(-7_i32).to_le_bytes()), "-7");
        assert_eq!(Kind::Unsigned(2).show(&[0xFF, 0xFF]), "65535");
        assert_eq!(Kind::Float.show(&1.5_f32.to_le_bytes()), "1.5");
        assert_eq!(Kind::Double.show(&(-2.25_f64).to_le_bytes()), "-2.25");
    }
}
