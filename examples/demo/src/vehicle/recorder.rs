//! The flight logs: from arming to disarming, the vehicle records its attitude, position, battery and state, and all texts.

use mavstack::logs::{LogInfo, LogRead};
use mavstack::{Context, Duration, Instant, Logs, Peer};

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
    is_recording: bool,
    /// When the next attitude is due, and the number of those so far. It wraps.
    due: Instant,
    periods: u8,
    /// The mode that was recorded last.
    mode: Mode,
    /// The number of the last text.
    text: u16,
}

impl Recorder {
    pub(super) const NONE: Self =
        Self { memory: None, is_recording: false, due: Instant::ZERO, periods: 0, mode: Mode::Hold, text: 0 };

    /// Adds a record. A log that fills the memory ends.
    fn write(&mut self, mut record: Record) {
        let bytes = record.bytes();
        self.is_recording &= self.memory.is_some_and(|memory| memory.append(bytes));
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
        let Some(memory) = self.recorder.memory else { return };
        if self.armed && !self.was_armed {
            let seconds = self.calendar.unix_usec(now).unwrap_or(0) / 1_000_000;
            memory.begin(u32::try_from(seconds).unwrap_or(0));
            ulog::definitions(now.as_micros(), |bytes| {
                memory.append(bytes);
            });
            (self.recorder.is_recording, self.recorder.due, self.recorder.periods) = (true, now, 0);
        }
        let has_ended = !self.armed && self.was_armed;
        self.was_armed = self.armed;
        if !self.recorder.is_recording {
            return;
        }
        while let Some((number, severity, text)) = stack.text_after(self.recorder.text) {
            self.recorder.text = number;
            self.recorder.write(Record::text(now.as_micros(), severity.0, text));
        }
        if self.mode != self.recorder.mode || has_ended {
            self.record_status(now);
        }
        if has_ended {
            self.recorder.is_recording = false;
        } else if now >= self.recorder.due {
            self.record_topics(now);
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

    fn record_attitude(&mut self, now: Instant) {
        let [roll, pitch, yaw] = self.attitude().map(|angle| angle / 2.0);
        let (sr, cr, sp, cp, sy, cy) = (sin(roll), cos(roll), sin(pitch), cos(pitch), sin(yaw), cos(yaw));
        let mut record = Record::data(ulog::ATTITUDE, now.as_micros());
        record.put_floats(&[
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]);
        record.put_floats(&self.attitude_rates());
        self.recorder.write(record);
    }

    fn record_position(&mut self, now: Instant) {
        let (position, velocity) = (self.local_position(), self.velocity());
        let mut record = Record::data(ulog::LOCAL_POSITION, now.as_micros());
        for vector in [position, velocity] {
            record.put_floats(&[vector.north, vector.east, vector.down]);
        }
        self.recorder.write(record);
    }

    fn record_receiver(&mut self, now: Instant) {
        let Some(position) = self.global_position() else { return };
        let mut record = Record::data(ulog::GPS_POSITION, now.as_micros());
        record.put(&position.latitude.to_le_bytes());
        record.put(&position.longitude.to_le_bytes());
        record.put(&((position.altitude * 1_000.0) as i32).to_le_bytes());
        record.put(&[self.last.satellites]);
        self.recorder.write(record);
    }

    fn record_battery(&mut self, now: Instant) {
        let battery = self.battery;
        let mut record = Record::data(ulog::BATTERY, now.as_micros());
        record.put_floats(&[battery.voltage, battery.current, battery.remaining]);
        self.recorder.write(record);
    }

    /// Records arming and mode, with PX4's numbers.
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
        let mut record = Record::data(ulog::STATUS, now.as_micros());
        record.put(&[1 + u8::from(self.armed), mode]);
        self.recorder.write(record);
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
        let Some(memory) = self.recorder.memory else { return false };
        memory.erase();
        true
    }
}
