//! Writes logs in the format ULog: <https://docs.px4.io/main/en/dev_log/ulog_file_format.html>. pyulog, PlotJuggler and Flight Review
//! read them.

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

/// The length of the longest message.
const MAX_LEN: usize = 160;

/// The length of the message that tells of a dropout.
pub const DROPOUT_LEN: usize = 5;

/// Returns the message that tells for how long records were left out (ms, at most 65,535).
pub fn dropout(millis: u64) -> [u8; DROPOUT_LEN] {
    let [low, high] = u16::try_from(millis).unwrap_or(u16::MAX).to_le_bytes();
    [2, 0, b'O', low, high]
}

/// A message of a log that is being made. There is one, because it is large for the call stack.
#[derive(Clone, Debug)]
pub struct Record {
    bytes: [u8; MAX_LEN],
    len: usize,
}

impl Record {
    pub const EMPTY: Self = Self { bytes: [0; MAX_LEN], len: 0 };

    /// Begins a message of this kind.
    pub fn begin(&mut self, kind: u8) {
        self.len = 0;
        self.put(&[0, 0, kind]);
    }

    /// Begins the values of a topic with the time (µs since boot).
    #[inline(never)]
    pub fn begin_data(&mut self, topic: u16, micros: u64) {
        self.begin(b'D');
        self.put(&topic.to_le_bytes());
        self.put(&micros.to_le_bytes());
    }

    /// Makes a text. `severity`: MAV_SEVERITY, which is the level.
    pub fn make_text(&mut self, micros: u64, severity: u8, text: &[u8]) {
        self.begin(b'L');
        self.put(&[b'0' + (severity & 7)]);
        self.put(&micros.to_le_bytes());
        self.put(text);
    }

    /// Adds content. What has no room is cut off.
    #[inline(never)]
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

    /// Makes a part of what comes before all data: 0 is the header, the others describe the data. Returns its bytes; none at the end.
    #[inline(never)]
    pub fn make_definition(&mut self, part: usize, micros: u64) -> &[u8] {
        if part == 0 {
            self.len = 0;
            self.put(b"ULog\x01\x12\x35\x01");
            self.put(&micros.to_le_bytes());
            return self.bytes.get(..self.len).unwrap_or_default();
        }
        let Some(part) = part.checked_sub(2) else {
            // No flags, and nothing is appended.
            self.begin(b'B');
            self.put(&[0; 40]);
            return self.bytes();
        };
        if let Some((key, value)) = INFORMATION.get(part) {
            self.begin(b'I');
            self.put(&[key.len() as u8]);
            self.put(key.as_bytes());
            self.put(value.as_bytes());
            return self.bytes();
        }
        // All formats come first, then all topics begin.
        let part = part - INFORMATION.len();
        if let Some(topic) = TOPICS.get(part) {
            self.begin(b'F');
            self.put(topic.fields.as_bytes());
            return self.bytes();
        }
        let id = part - TOPICS.len();
        let Some(topic) = TOPICS.get(id) else { return &[] };
        self.begin(b'A');
        self.put(&[0]);
        self.put(&(id as u16).to_le_bytes());
        self.put(topic.name.as_bytes());
        self.bytes()
    }
}
