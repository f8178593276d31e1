//! How transfers share a link: rules D-4, F-8, LOG-8, LOG-14, P-11.

use super::*;
use mavstack::dialect::{
    Attitude, FileTransferProtocol, GlobalPositionInt, LoggingData, MavCmd, ParamRequestList, ParamValue, SysStatus,
};
use mavstack::param::ParamTable;
use mavstack_station::files::Download;

#[derive(mavstack::Stack)]
#[stack(
    vehicle: TestVehicle,
    links: 1,
    parameters: Tuning,
    streams,
    commands: { slots: 3 },
    files: { sessions: 2 },
    logs,
)]
struct Loaded {
    log_streaming: mavstack::logs::LogStreamer,
}

/// A ground station that has everything transferred at once.
struct Busy {
    world: World<1, Loaded>,
    file: Talk<Download>,
    rate: usize,
    has_list: bool,
}

/// The parts of a link (%).
#[derive(Debug, Default)]
struct Parts {
    list: usize,
    file: usize,
    log: usize,
    streamed_log: usize,
    streams: usize,
}

impl Parts {
    fn bulk(&self) -> usize {
        self.file + self.log + self.streamed_log
    }

    fn least(&self) -> usize {
        self.file.min(self.log).min(self.streamed_log)
    }
}

impl Busy {
    fn new(baud: u32, step: u64) -> Self {
        let link = LinkConfig::uart(baud).with_streams(StreamProfile::Off);
        let down = Wire { bytes_per_second: u64::from(baud / 10), tx_fifo: 512, ..Wire::default() };
        let lines = [LineConfig { down, ..LineConfig::default() }];
        let mut world = World::<1, Loaded>::of(Setup { links: [link], lines, step: millis(step), ..Setup::new() });
        let bytes = content(0, 1_000_000);
        world.vehicle.files.content.insert("big.bin".to_string(), bytes.clone());
        world.vehicle.logs.data = bytes.clone();
        world.vehicle.logs.content = vec![bytes];
        world.gcs[0].heartbeat_period = Some(secs(1));
        let file = Talk::new(Client::QGroundControl, STATION, Download::new("big.bin"));
        Self { world, file, rate: baud as usize / 10, has_list: false }
    }

    /// Has streams sent that would fill any link.
    fn begin_streams(&mut self) {
        for id in [Attitude::ID, GlobalPositionInt::ID, SysStatus::ID] {
            let interval = [id as f32, 1_000.0, 0.0, 0.0, 0.0, 0.0, 0.0];
            self.world.gcs[0].command_long(MavCmd::SET_MESSAGE_INTERVAL, interval);
            self.world.run_for(millis(200));
        }
    }

    /// Begins a log download and the stream of the running log. The file is downloaded all the time.
    fn begin_transfers(&mut self) {
        self.world.gcs[0].send(&data(0, 0, u32::MAX));
        self.world.gcs[0].command_long(MavCmd::LOGGING_START, [0.0; 7]);
        self.run(2_000);
    }

    /// Runs for some milliseconds.
    fn run(&mut self, ms: u64) {
        let end = self.world.now() + millis(ms);
        let last = Tuning::INFO.len() as u16 - 1;
        let mut seen = self.world.gcs[0].received.len();
        let mut is_asked = false;
        while self.world.now() < end {
            self.world.step();
            let (now, gcs) = (self.world.now(), &mut self.world.gcs[0]);
            assert_eq!(self.file.poll(now, gcs), None, "the file is longer");
            let mut values = gcs.received[seen..].iter().filter_map(|frame| frame.decode::<ParamValue>());
            is_asked &= !values.any(|value| value.param_index == last);
            seen = gcs.received.len();
            if self.has_list && !is_asked {
                gcs.send(&ParamRequestList { target_system: 1, target_component: 1 });
                is_asked = true;
            }
        }
    }

    /// Returns the parts of the link in the next ten seconds. That of the list is its rate from its first value to its last.
    fn parts(&mut self) -> Parts {
        self.world.gcs[0].forget();
        self.run(10_000);
        let gcs = &self.world.gcs[0];
        let percent = |ids: &[u32]| {
            let frames = gcs.received.iter().filter(|frame| ids.contains(&frame.header.id));
            frames.map(|frame| frame.raw.len()).sum::<usize>() * 100 / 10 / self.rate
        };
        let values = gcs.all::<ParamValue>();
        let pairs = values.windows(2).filter(|pair| pair[1].1.param_index > pair[0].1.param_index);
        let pauses: Vec<_> = pairs.map(|pair| (pair[1].0 - pair[0].0).as_micros() as usize).collect();
        let list = (37 * 1_000_000 * 100 * pauses.len()).checked_div(pauses.iter().sum::<usize>() * self.rate);
        Parts {
            list: list.unwrap_or(0),
            file: percent(&[FileTransferProtocol::ID]),
            log: percent(&[LogData::ID]),
            streamed_log: percent(&[LoggingData::ID]),
            streams: percent(&[Attitude::ID, GlobalPositionInt::ID, SysStatus::ID]),
        }
    }
}

/// D-4, P-11, F-8, LOG-8, LOG-14: beside the list of parameters, a file, a log and the running log, streams that would fill the
/// link have the rest of it. The three share 30 % of the rate by turns.
#[test]
fn all_transfers_together_leave_streams_their_part() {
    for (baud, step) in [(57_600, 1), (57_600, 20), (115_200, 1), (115_200, 5)] {
        let mut busy = Busy::new(baud, step);
        busy.begin_streams();
        busy.begin_transfers();
        let beside_streams = busy.parts();
        busy.has_list = true;
        let all = busy.parts();
        let case = format!("{baud} baud, polls {step} ms apart: {all:?}, without the list {beside_streams:?}");
        println!("{case}");
        assert!(all.streams >= 25 && (30..=45).contains(&all.list), "{case}");
        assert!(beside_streams.streams >= 60, "{case}");
        for parts in [all, beside_streams] {
            assert!((27..=33).contains(&parts.bulk()) && parts.least() >= 4, "{case}");
        }
    }
}

/// D-4, F-8, LOG-8, LOG-14: without streams the three use all of the link, and none waits for another.
#[test]
fn transfers_have_an_idle_link_by_turns() {
    for baud in [57_600, 115_200] {
        let mut busy = Busy::new(baud, 1);
        busy.begin_transfers();
        let parts = busy.parts();
        assert!(parts.bulk() >= 90 && parts.least() >= 14, "{baud} baud: {parts:?}");
    }
}
