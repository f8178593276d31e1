//! The flight logs: from arming to disarming, and while a client streams the log, the vehicle records its attitude, position, battery
//! and state, and all texts.

use mavstack::dialect::MavResult;
use mavstack::logs::{LogInfo, LogRead};
use mavstack::{Context, Duration, Instant, LogStreaming, Logs, Peer};

use super::{Mode, Quadrotor};
use crate::angle::{cos, sin};
use crate::app::Mavlink;
use crate::logs::LogMemory;
use crate::ulog::{self, Record};

/// The period of the attitude. The other topics have a multiple of it.
const PERIOD: Duration = Duration::from_millis(200);

/// What is recorded, and where.
#[derive(Clone, Debug)]
pub(super) struct Recorder {
    memory: Option<&'static LogMemory>,
    record: Record,
    /// A log was begun, and has not ended. It may be full.
    is_on: bool,
    is_full: bool,
    /// A client streams the log: from this place on, after the definitions.
    is_streaming: bool,
    streamed: u32,
    definitions: u32,
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
        is_on: false,
        is_full: false,
        is_streaming: false,
        streamed: 0,
        definitions: 0,
        due: Instant::ZERO,
        periods: 0,
        mode: Mode::Hold,
        text: 0,
    };

    /// Adds the record to the log. A log that fills the memory ends.
    #[inline(never)]
    fn write(&mut self) {
        let bytes = self.record.bytes();
        self.is_full |= !self.memory.is_some_and(|memory| memory.append(bytes));
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
        self.definitions = self.size();
    }

    /// Returns the number of the log that is written, the newest one.
    fn newest(&self) -> u16 {
        self.memory.map_or(0, |memory| memory.count().saturating_sub(1))
    }

    /// Returns its size.
    fn size(&self) -> u32 {
        self.memory.and_then(|memory| memory.info(self.newest())).map_or(0, |info| info.size)
    }

    /// Reads a part of it that ends at `end`, and returns the number of bytes.
    fn read(&self, offset: u32, end: u32, out: &mut [u8]) -> usize {
        let len = out.len().min(end.saturating_sub(offset) as usize);
        let out = out.get_mut(..len).unwrap_or_default();
        let is_read = self.memory.is_some_and(|memory| memory.read(self.newest(), offset, out));
        if is_read { len } else { 0 }
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
    pub(crate) fn record(&mut self, now: Instant, stack: &Mavlink) {
        let is_on = self.armed || self.recorder.is_streaming;
        if is_on && !self.recorder.is_on {
            self.recorder.begin(now, self.calendar.unix_usec(now).unwrap_or(0));
        }
        if !self.recorder.is_on || self.recorder.is_full {
            self.recorder.is_on &= is_on;
            return;
        }
        self.record_texts(now, stack);
        if self.mode != self.recorder.mode || !is_on {
            self.record_status(now);
        }
        self.recorder.is_on = is_on;
        if is_on && now >= self.recorder.due {
            self.record_topics(now);
        }
    }

    #[inline(never)]
    fn record_texts(&mut self, now: Instant, stack: &Mavlink) {
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
        self.recorder.due = self.recorder.due.after(PERIOD).max(now);
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

/// The stream is read from the log in memory.
impl LogStreaming for Quadrotor {
    fn start_log_stream(&mut self, cx: &mut Context<'_>, _: Peer) -> MavResult {
        if self.recorder.memory.is_none() {
            return MavResult::UNSUPPORTED;
        }
        if !self.recorder.is_on {
            self.recorder.begin(cx.now(), self.calendar.unix_usec(cx.now()).unwrap_or(0));
        }
        (self.recorder.is_streaming, self.recorder.streamed) = (true, self.recorder.size());
        MavResult::ACCEPTED
    }

    fn stop_log_stream(&mut self, _: &mut Context<'_>) {
        self.recorder.is_streaming = false;
    }

    fn read_log_definitions(&mut self, offset: u32, out: &mut [u8]) -> usize {
        self.recorder.read(offset, self.recorder.definitions, out)
    }

    fn log_data_len(&self) -> usize {
        self.recorder.size().saturating_sub(self.recorder.streamed) as usize
    }

    fn take_log_data(&mut self, out: &mut [u8]) -> usize {
        let len = self.recorder.read(self.recorder.streamed, self.recorder.size(), out);
        self.recorder.streamed += len as u32;
        len
    }
}
