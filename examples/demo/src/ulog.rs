//! Writes logs in the format ULog: <https://docs.px4.io/main/en/dev_log/ulog_file_format.html>. pyulog, PlotJuggler and Flight Review
//! read them, and `cargo xtask ulog`.

/// A topic: its name and its fields, in PX4's words. Its first field is the time (µs since boot).
pub struct Topic {
    name: &'static str,
    fields: &'static str,
}

macro_rules! topics {
    ($($TOPIC:ident: $name:literal { $($fields:literal)* })*) => {
        /// The topics. The index of a topic is its id.
        const TOPICS: &[Topic] = &[
            $(Topic { name: $name, fields: concat!($name, ":uint64_t timestamp;" $(, $fields)*) },)*
        ];

        topics!(@0u16 $($TOPIC)*);
    };
    (@$id:expr, ) => {};
    (@$id:literal $($TOPIC:ident)*) => { topics!(@@$id, $($TOPIC)*); };
    (@@$id:expr, $TOPIC:ident $($rest:ident)*) => {
        pub const $TOPIC: u16 = $id;
        topics!(@@$id + 1, $($rest)*);
    };
    (@@$id:expr,) => {};
}

topics! {
    ATTITUDE: "vehicle_attitude" { "float[4] q;" "float rollspeed;" "float pitchspeed;" "float yawspeed;" }
    LOCAL_POSITION: "vehicle_local_position" { "float x;" "float y;" "float z;" "float vx;" "float vy;" "float vz;" }
    GPS_POSITION: "vehicle_gps_position" { "int32_t lat;" "int32_t lon;" "int32_t alt;" "uint8_t satellites_used;" }
    BATTERY: "battery_status" { "float voltage_v;" "float current_a;" "float remaining;" }
    STATUS: "vehicle_status" { "uint8_t arming_state;" "uint8_t nav_state;" }
}

/// What identifies the vehicle.
const INFORMATION: [(&str, &str); 2] = [("char[8] sys_name", "mavstack"), ("char[4] ver_hw", "DEMO")];

/// The number of parts of [`definitions`].
pub const PARTS: usize = 2 + INFORMATION.len() + 2 * TOPICS.len();

/// The length of the longest message.
const MAX_LEN: usize = 160;

/// A message of a log, or its header.
pub struct Record {
    bytes: [u8; MAX_LEN],
    len: usize,
}

impl Record {
    /// Returns a message of this kind, without content.
    pub fn new(kind: u8) -> Self {
        let mut record = Self { bytes: [0; MAX_LEN], len: 2 };
        record.put(&[kind]);
        record
    }

    /// Returns the values of a topic, so far only the time (µs since boot).
    pub fn data(topic: u16, micros: u64) -> Self {
        let mut record = Self::new(b'D');
        record.put(&topic.to_le_bytes());
        record.put(&micros.to_le_bytes());
        record
    }

    /// Returns a text. `severity`: MAV_SEVERITY, which is the level.
    pub fn text(micros: u64, severity: u8, text: &[u8]) -> Self {
        let mut record = Self::new(b'L');
        record.put(&[b'0' + (severity & 7)]);
        record.put(&micros.to_le_bytes());
        record.put(text);
        record
    }

    /// Adds content. What has no room is cut off.
    pub fn put(&mut self, content: &[u8]) {
        for (to, from) in self.bytes.iter_mut().skip(self.len).zip(content) {
            *to = *from;
            self.len += 1;
        }
    }

    /// Adds floats.
    pub fn put_floats(&mut self, floats: &[f32]) {
        floats.iter().for_each(|float| self.put(&float.to_le_bytes()));
    }

    /// Returns the bytes, with the size of the message.
    pub fn bytes(&mut self) -> &[u8] {
        // The size counts what follows the size and the kind.
        let size = (self.len as u16).saturating_sub(3);
        if let Some(front) = self.bytes.first_chunk_mut() {
            *front = size.to_le_bytes();
        }
        self.bytes.get(..self.len).unwrap_or_default()
    }
}

/// Returns the header of a file.
fn header(micros: u64) -> [u8; 16] {
    let mut header = *b"ULog\x01\x12\x35\x01\0\0\0\0\0\0\0\0";
    if let Some(time) = header.last_chunk_mut() {
        *time = micros.to_le_bytes();
    }
    header
}

/// Gives the parts of a log that come before all data to `write`: the header and what describes the data.
pub fn definitions(micros: u64, mut write: impl FnMut(&[u8])) {
    write(&header(micros));
    for part in 1..PARTS {
        write(definition(part).bytes());
    }
}

/// Returns a part of the definitions.
fn definition(part: usize) -> Record {
    let Some(part) = part.checked_sub(2) else {
        // No flags, and nothing is appended.
        let mut record = Record::new(b'B');
        record.put(&[0; 40]);
        return record;
    };
    if let Some((key, value)) = INFORMATION.get(part) {
        let mut record = Record::new(b'I');
        record.put(&[key.len() as u8]);
        record.put(key.as_bytes());
        record.put(value.as_bytes());
        return record;
    }
    let topic = part - INFORMATION.len();
    if let Some(Topic { fields, .. }) = TOPICS.get(topic) {
        let mut record = Record::new(b'F');
        record.put(fields.as_bytes());
        return record;
    }
    // All formats come first, then all topics begin.
    let id = topic - TOPICS.len();
    let mut record = Record::new(b'A');
    record.put(&[0]);
    record.put(&(id as u16).to_le_bytes());
    record.put(TOPICS.get(id).map_or("", |topic| topic.name).as_bytes());
    record
}
