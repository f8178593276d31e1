//! The flight logs: from arming to disarming, the vehicle records its attitude, position, battery and state, and all texts.
//!
//! A client that streams the log gets the same records, on the ground too, where none are stored: a stream evicts no log of a flight.

use mavstack::dialect::MavResult;
use mavstack::logs::{LogInfo, LogRead};
use mavstack::{Context, Duration, Instant, LogStreaming, Logs, Peer, StackOf};

use super::{Mode, Quadrotor};
use crate::angle::{cos, sin};
use crate::app::Mavlink;
use crate::logs::LogMemory;
use crate::ulog::{self, Record};

/// The period of the attitude. The other topics have a multiple of it.
const PERIOD: Duration = Duration::from_millis(200);

/// The room for records that a client has not got yet: those of two seconds.
const QUEUE_LEN: usize = 1_024;

/// The records for a client, oldest first. One without room is dropped, and the next one that has room comes behind a record of how
/// long nothing was queued.
#[derive(Clone, Debug)]
struct Queue {
    bytes: [u8; QUEUE_LEN],
    first: usize,
    len: usize,
    /// When the first record was dropped.
    dropped: Option<Instant>,
}

impl Queue {
    const EMPTY: Self = Self { bytes: [0; QUEUE_LEN], first: 0, len: 0, dropped: None };

    /// Adds a record, or drops it.
    #[inline(never)]
    fn push(&mut self, now: Instant, record: &[u8]) {
        let mut dropout = [0; ulog::DROPOUT_LEN];
        if let Some(since) = self.dropped {
            dropout = ulog::dropout((now - since).as_millis());
        }
        let dropout = if self.dropped.is_some() { dropout.as_slice() } else { &[] };
        if dropout.len() + record.len() > QUEUE_LEN - self.len {
            self.dropped = self.dropped.or(Some(now));
            return;
        }
        self.dropped = None;
        for byte in dropout.iter().chain(record) {
            if let Some(to) = self.bytes.get_mut((self.first + self.len) % QUEUE_LEN) {
                *to = *byte;
                self.len += 1;
            }
        }
    }

    /// Takes up to `out.len()` bytes. Returns how many.
    fn take(&mut self, out: &mut [u8]) -> usize {
        let len = out.len().min(self.len);
        for (to, from) in out.iter_mut().zip(self.bytes.iter().cycle().skip(self.first)).take(len) {
            *to = *from;
        }
        (self.first, self.len) = ((self.first + len) % QUEUE_LEN, self.len - len);
        len
    }
}

/// What is recorded, and where.
#[derive(Clone, Debug)]
pub(super) struct Recorder {
    memory: Option<&'static LogMemory>,
    record: Record,
    now: Instant,
    /// A log was begun, and has not ended. It may be full.
    is_on: bool,
    is_full: bool,
    /// A client streams the log since then.
    streaming: Option<Instant>,
    queue: Queue,
    /// When the next attitude is due, and the number of those so far. It wraps.
    due: Instant,
    periods: u8,
    /// The mode that was recorded last.
    mode: Mode,
    /// The number of the last text.
    text: u16,
}

impl Recorder {
    pub(super) const NONE: Self = Self {
        memory: None,
        record: Record::EMPTY,
        now: Instant::ZERO,
        is_on: false,
        is_full: false,
        streaming: None,
        queue: Queue::EMPTY,
        due: Instant::ZERO,
        periods: 0,
        mode: Mode::Hold,
        text: 0,
    };

    /// Whether records are stored or streamed.
    fn is_recording(&self) -> bool {
        self.streaming.is_some() || (self.is_on && !self.is_full)
    }

    /// Adds the record to the log, and to the stream. A log that fills the memory ends.
    #[inline(never)]
    fn write(&mut self) {
        let bytes = self.record.bytes();
        if self.is_on && !self.is_full {
            self.is_full = !self.memory.is_some_and(|memory| memory.append(bytes));
        }
        if self.streaming.is_some() {
            self.queue.push(self.now, bytes);
        }
    }

    /// Begins a log, with the header and what describes the data.
    #[inline(never)]
    fn begin(&mut self, now: Instant, unix_usec: u64) {
        let Some(memory) = self.memory else { return };
        memory.begin(u32::try_from(unix_usec / 1_000_000).unwrap_or(0));
        (self.is_on, self.is_full, self.due, self.periods) = (true, false, now, 0);
        let mut part = 0;
        loop {
            let bytes = self.record.make_definition(part, now.as_micros());
            if bytes.is_empty() {
                break;
            }
            memory.append(bytes);
            part += 1;
        }
    }

    /// Starts a stream, with the records from now on.
    fn start_stream(&mut self, now: Instant) {
        if !self.is_on {
            (self.due, self.periods) = (now, 0);
        }
        (self.streaming, self.queue.len, self.queue.dropped) = (Some(now), 0, None);
    }

    /// Reads from what a stream begins with. Returns the number of bytes.
    #[inline(never)]
    fn read_definitions(&mut self, offset: u32, out: &mut [u8]) -> usize {
        let began = self.streaming.unwrap_or(self.now).as_micros();
        let (mut before, mut len, mut part) = (offset as usize, 0, 0);
        loop {
            let bytes = self.record.make_definition(part, began);
            if bytes.is_empty() {
                return len;
            }
            for (to, from) in out.iter_mut().skip(len).zip(bytes.iter().skip(before)) {
                *to = *from;
                len += 1;
            }
            before = before.saturating_sub(bytes.len());
            part += 1;
        }
    }
}

impl Quadrotor {
    /// Keeps flight logs in this memory.
    pub(crate) fn keep_logs(&mut self, memory: &'static LogMemory) {
        memory.check();
        self.recorder.memory = Some(memory);
    }

    /// Records the present state. Call it in each pass of the flight loop.
    #[inline(never)]
    pub(crate) fn record(&mut self, now: Instant, stack: &StackOf<Mavlink>) {
        self.recorder.now = now;
        if self.armed && !self.recorder.is_on {
            self.recorder.begin(now, self.calendar.unix_usec(now).unwrap_or(0));
        }
        let ends = self.recorder.is_on && !self.armed;
        if self.recorder.is_recording() {
            self.record_texts(now, stack);
            if self.mode != self.recorder.mode || ends {
                self.record_status(now);
            }
            if now >= self.recorder.due && !ends {
                self.record_topics(now);
            }
        }
        self.recorder.is_on &= self.armed;
    }

    #[inline(never)]
    fn record_texts(&mut self, now: Instant, stack: &StackOf<Mavlink>) {
        while let Some((number, severity, text)) = stack.text_after(self.recorder.text) {
            self.recorder.text = number;
            self.recorder.record.make_text(now.as_micros(), severity.0, text);
            self.recorder.write();
        }
    }

    /// Records the topics that are due.
    #[inline(never)]
    fn record_topics(&mut self, now: Instant) {
        let periods = self.recorder.periods;
        self.recorder.periods = periods.wrapping_add(1);
        self.recorder.due = (self.recorder.due + PERIOD).max(now);
        self.record_attitude(now);
        if periods.is_multiple_of(2) {
            self.record_position(now);
        }
        if periods.is_multiple_of(4) {
            self.record_receiver(now);
            self.record_battery(now);
            self.record_status(now);
        }
    }

    #[inline(never)]
    fn record_attitude(&mut self, now: Instant) {
        let [roll, pitch, yaw] = self.attitude().map(|angle| angle / 2.0);
        let (sr, cr, sp, cp, sy, cy) = (sin(roll), cos(roll), sin(pitch), cos(pitch), sin(yaw), cos(yaw));
        let rates = self.attitude_rates();
        let record = &mut self.recorder.record;
        record.begin_data(ulog::ATTITUDE, now.as_micros());
        record.put_floats(&[
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]);
        record.put_floats(&rates);
        self.recorder.write();
    }

    #[inline(never)]
    fn record_position(&mut self, now: Instant) {
        let vectors = [self.local_position(), self.velocity()];
        let record = &mut self.recorder.record;
        record.begin_data(ulog::LOCAL_POSITION, now.as_micros());
        for vector in vectors {
            record.put_floats(&[vector.north, vector.east, vector.down]);
        }
        self.recorder.write();
    }

    #[inline(never)]
    fn record_receiver(&mut self, now: Instant) {
        let Some(position) = self.global_position() else { return };
        let record = &mut self.recorder.record;
        record.begin_data(ulog::GPS_POSITION, now.as_micros());
        record.put(&position.latitude.to_le_bytes());
        record.put(&position.longitude.to_le_bytes());
        record.put(&((position.altitude * 1_000.0) as i32).to_le_bytes());
        record.put(&[self.last.satellites]);
        self.recorder.write();
    }

    #[inline(never)]
    fn record_battery(&mut self, now: Instant) {
        let record = &mut self.recorder.record;
        record.begin_data(ulog::BATTERY, now.as_micros());
        record.put_floats(&[self.battery.voltage, self.battery.current, self.battery.remaining]);
        self.recorder.write();
    }

    /// Records arming and mode, with PX4's numbers.
    #[inline(never)]
    fn record_status(&mut self, now: Instant) {
        self.recorder.mode = self.mode;
        let mode = match self.mode {
            Mode::Position => 2,
            Mode::Mission => 3,
            Mode::Hold => 4,
            Mode::Return => 5,
            Mode::Offboard => 14,
            Mode::Takeoff => 17,
            Mode::Land => 18,
        };
        let record = &mut self.recorder.record;
        record.begin_data(ulog::STATUS, now.as_micros());
        record.put(&[1 + u8::from(self.armed), mode]);
        self.recorder.write();
    }
}

impl Logs for Quadrotor {
    fn log_count(&self) -> u16 {
        self.recorder.memory.map_or(0, LogMemory::count)
    }

    fn log_info(&self, id: u16) -> Option<LogInfo> {
        self.recorder.memory?.info(id)
    }

    fn read_log(&mut self, id: u16, offset: u32, out: &mut [u8]) -> LogRead {
        match self.recorder.memory.is_some_and(|memory| memory.read(id, offset, out)) {
            true => LogRead::Done,
            false => LogRead::Failed,
        }
    }

    fn erase_logs(&mut self, _: &mut Context<'_>, _: Peer) -> bool {
        let Some(memory) = self.recorder.memory.filter(|_| !self.recorder.is_on) else { return false };
        memory.erase();
        true
    }

    /// Not while a log is written, which may evict others.
    fn may_read_logs(&self, is_armed: bool) -> bool {
        !is_armed && !self.recorder.is_on
    }
}

impl LogStreaming for Quadrotor {
    fn start_log_stream(&mut self, cx: &mut Context<'_>, _: Peer) -> MavResult {
        self.recorder.start_stream(cx.now());
        MavResult::ACCEPTED
    }

    fn stop_log_stream(&mut self, _: &mut Context<'_>) {
        self.recorder.streaming = None;
    }

    fn read_log_definitions(&mut self, offset: u32, out: &mut [u8]) -> usize {
        self.recorder.read_definitions(offset, out)
    }

    fn log_data_len(&self) -> usize {
        self.recorder.queue.len
    }

    fn take_log_data(&mut self, out: &mut [u8]) -> usize {
        self.recorder.queue.take(out)
    }
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use super::*;

    /// LOG-12: a client that is too slow gets whole records, in order, and how long the others were left out.
    #[test]
    fn a_slow_stream_has_whole_records() {
        let mut queue = Queue::EMPTY;
        for round in 0..5u64 {
            let at = |millis| Instant::from_millis(round * 10_000 + millis);
            for number in 0..30u8 {
                queue.push(at(u64::from(number) * 100), &[number; 50]);
            }
            // The queue had room for 20 of them, and the next one came two seconds after the first that had none.
            let mut bytes = [0; 249];
            let mut taken: Vec<u8> = Vec::new();
            while taken.len() < 500 {
                let len = queue.take(&mut bytes);
                taken.extend(&bytes[..len]);
            }
            queue.push(at(4_000), &[30; 50]);
            while queue.len > 0 {
                let len = queue.take(&mut bytes);
                taken.extend(&bytes[..len]);
            }
            let mut expected: Vec<u8> = (0..20).flat_map(|number| [number; 50]).collect();
            expected.extend([2, 0, b'O']);
            expected.extend(2_000u16.to_le_bytes());
            expected.extend([30; 50]);
            assert!(taken == expected, "{taken:?}");
        }
    }
}
