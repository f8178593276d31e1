//! A log of the links' traffic in the ".tlog" format of Mission Planner, QGroundControl, MAVProxy and pymavlink. Each frame is
//! preceded by its time: µs since 1970, as eight bytes, big-endian.
//!
//! The log contains each frame that the vehicle's decoder takes, also if the vehicle then refuses it, and each frame that the vehicle
//! sends. One kind is left out. The vehicle takes a frame with an unknown id if its signature is right (SEC-5). Only the vehicle has the
//! key, so here such a frame counts like one without a signature: its sender must be known, and a frame or silence must follow.
//!
//! Logs are shared, so they contain no secrets:
//!
//! - Messages that carry a secret are omitted.
//! - The hash of a signature is overwritten with zeros, because it allows an offline attack on the passphrase. The link id and
//!   timestamp stay. Log readers have no key and ignore the signature.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{ErrorKind, Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{self, SystemTime, UNIX_EPOCH};

use mavstack::dialect::{AuthKey, CellularConfig, ChangeOperatorControl, SetupSigning, WifiConfigAp};
use mavstack::frame::Decoder;
use mavstack::{Address, Frame, Instant, Message, Vehicle};
use mavstack_demo::Quadrotor;

/// Ids of messages that carry a key, a password or a PIN.
const SECRETS: [u32; 5] =
    [SetupSigning::ID, AuthKey::ID, CellularConfig::ID, ChangeOperatorControl::ID, WifiConfigAp::ID];

/// Length of the hash at the end of a signed frame, in bytes.
const SIGNATURE: usize = 6;

/// A file of frames with their times.
#[derive(Debug)]
pub struct Tlog {
    path: PathBuf,
    /// `None` after a write error.
    file: Mutex<Option<Open>>,
    /// Senders of frames with a valid checksum. As in the vehicle, frames with an unknown id are accepted only from these.
    known_senders: Mutex<BTreeSet<Address>>,
    began: time::Instant,
}

#[derive(Debug)]
struct Open {
    file: File,
    /// The last time written. Times never decrease, even if the machine's clock is set back.
    last: u64,
}

impl Tlog {
    /// Creates the file, or truncates an existing log. Refuses a file that is not a log.
    pub fn create(path: &Path) -> Result<Arc<Self>, String> {
        let failed = |error: std::io::Error| format!("{}: {error}", path.display());
        if !is_log_or_new(path).map_err(failed)? {
            return Err(format!("{} is not a frame log; give --log another name, or move the file", path.display()));
        }
        let file = File::create(path).map_err(failed)?;
        let file = Mutex::new(Some(Open { file, last: 0 }));
        Ok(Arc::new(Self { path: path.into(), file, known_senders: Mutex::default(), began: time::Instant::now() }))
    }

    /// Returns the time since the log was created.
    fn now(&self) -> Instant {
        Instant::from_micros(u64::try_from(self.began.elapsed().as_micros()).unwrap_or(u64::MAX))
    }

    fn is_known_sender(&self, sender: Address) -> bool {
        self.known_senders.lock().unwrap_or_else(PoisonError::into_inner).contains(&sender)
    }

    /// Appends a frame, unless it carries a secret.
    fn record(&self, frame: &Frame<'_>) {
        if frame.is_checked() {
            self.known_senders.lock().unwrap_or_else(PoisonError::into_inner).insert(frame.source());
        }
        if SECRETS.contains(&frame.id()) {
            return;
        }
        let mut bytes = frame.raw().to_vec();
        if frame.header().is_signed() {
            let from = bytes.len().saturating_sub(SIGNATURE);
            bytes[from..].fill(0);
        }
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let now = u64::try_from(since.as_micros()).unwrap_or(u64::MAX);
        let mut open = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(Open { file, last }) = &mut *open else { return };
        *last = now.max(*last);
        // One unbuffered write per frame: the file is complete whenever this program ends.
        if let Err(error) = file.write_all(&[&last.to_be_bytes(), &bytes[..]].concat()) {
            eprintln!("{}: {error}; logging stops", self.path.display());
            *open = None;
        }
    }
}

/// Whether the file is missing, empty, or starts with a time and a frame.
fn is_log_or_new(path: &Path) -> std::io::Result<bool> {
    let metadata = match path.metadata() {
        Ok(metadata) => metadata,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(true),
        Err(error) => return Err(error),
    };
    if !metadata.is_file() {
        // For example a pipe.
        return Ok(!metadata.is_dir());
    }
    let mut begin = [0; 9];
    match File::open(path)?.read_exact(&mut begin) {
        Ok(()) => Ok(matches!(begin, [.., 0xFD | 0xFE])),
        Err(error) if error.kind() == ErrorKind::UnexpectedEof => Ok(metadata.len() == 0),
        Err(error) => Err(error),
    }
}

/// Finds the frames in one direction of a link. It uses the same decoder as the vehicle, with the same default settings, but
/// without the vehicle's key.
#[derive(Debug, Default)]
pub struct Frames {
    decoder: Decoder,
}

impl Frames {
    /// Calls `each` with every frame that `bytes` completes, and keeps an incomplete frame for the next call. The bytes must be
    /// undamaged.
    pub fn cut(&mut self, bytes: &[u8], each: impl FnMut(&Frame<'_>)) {
        self.find(Instant::ZERO, bytes, |_| true, each);
    }

    /// Like [`cut`](Self::cut), for bytes received at `now`, which may contain noise. `is_known` is as in
    /// [`Decoder::next`].
    fn find(
        &mut self,
        now: Instant,
        mut bytes: &[u8],
        is_known: impl Fn(Address) -> bool,
        mut each: impl FnMut(&Frame<'_>),
    ) {
        loop {
            // Also called before the first byte, because the time since the last byte decides whether a pending candidate is
            // stale.
            let mut budget = u32::MAX;
            while let Some(frame) = self.decoder.next(now, Quadrotor::MESSAGES, &mut budget, &is_known) {
                each(&frame);
            }
            if bytes.is_empty() {
                return;
            }
            let taken = self.decoder.push(bytes, now);
            bytes = &bytes[taken..];
        }
    }
}

/// Logs the complete frames in one direction of a link. Without a log it does nothing.
#[derive(Debug, Default)]
pub struct Tap {
    tlog: Option<Arc<Tlog>>,
    frames: Frames,
}

impl Tap {
    /// Creates a tap that writes to `tlog`.
    pub fn new(tlog: Option<Arc<Tlog>>) -> Self {
        Self { tlog, frames: Frames::default() }
    }

    /// Logs the frames in these bytes.
    pub fn pass(&mut self, bytes: &[u8]) {
        if let Some(tlog) = &self.tlog {
            let now = tlog.now();
            self.pass_at(now, bytes);
        }
    }

    fn pass_at(&mut self, now: Instant, bytes: &[u8]) {
        if let Some(tlog) = &self.tlog {
            self.frames.find(now, bytes, |sender| tlog.is_known_sender(sender), |frame| tlog.record(frame));
        }
    }

    /// Discards an incomplete frame. Call it when the peer changes.
    pub fn restart(&mut self) {
        self.pass(&[]);
        self.frames = Frames::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mavstack::Address;
    use mavstack::dialect::Heartbeat;
    use mavstack::frame::{MAX_FRAME_LEN, Version, encode, encode_signed};
    use mavstack::signing::SigningKey;

    fn frame<M: Message>(message: &M, version: Version, seq: u8) -> Vec<u8> {
        frame_of(message, version, Address::new(1, 1), seq)
    }

    fn frame_of<M: Message>(message: &M, version: Version, source: Address, seq: u8) -> Vec<u8> {
        let mut bytes = [0; MAX_FRAME_LEN];
        let len = encode(message, version, source, seq, &mut bytes).unwrap();
        bytes[..len].to_vec()
    }

    /// A temporary file, removed when dropped.
    struct Temporary(PathBuf);

    impl Temporary {
        fn new(name: &str) -> Self {
            Self(std::env::temp_dir().join(format!("mavstack-{name}-{}.tlog", std::process::id())))
        }
    }

    impl Drop for Temporary {
        fn drop(&mut self) {
            let _ = std::fs::remove_file(&self.0);
        }
    }

    /// The log contains complete frames with times that never decrease, however the bytes are split. It contains no incomplete
    /// frame, noise or signing key.
    #[test]
    fn the_log_contains_complete_frames_and_no_key() {
        let path = Temporary::new("whole");
        let heartbeat = Heartbeat { mavlink_version: 3, ..Default::default() };
        let frames: Vec<_> = [Version::V1, Version::V2, Version::V2]
            .iter()
            .zip(0..)
            .map(|(version, seq)| frame(&heartbeat, *version, seq))
            .collect();
        let key = frame(&SetupSigning { initial_timestamp: 7, ..Default::default() }, Version::V2, 3);
        let stream = [&[1, 2, 3], &frames[0][..], &frames[1], &key, &frames[2], &frames[0][..9]].concat();

        let before = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_micros();
        let mut tap = Tap::new(Some(Tlog::create(&path.0).unwrap()));
        // At one time: a gap would end a frame.
        stream.chunks(7).for_each(|bytes| tap.pass_at(Instant::ZERO, bytes));
        // The incomplete frame at the end is of a client that has disconnected.
        tap.restart();
        tap.pass(&frames[1]);
        let after = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_micros();

        let log = std::fs::read(&path.0).unwrap();
        let mut rest = &log[..];
        let mut last = before;
        for frame in [&frames[0], &frames[1], &frames[2], &frames[1]] {
            let (time, tail) = rest.split_at(8);
            let time = u128::from(u64::from_be_bytes(time.try_into().unwrap()));
            assert!((last..=after).contains(&time), "{time} is not from {last} to {after}");
            last = time;
            assert_eq!(&tail[..frame.len()], &frame[..]);
            rest = &tail[frame.len()..];
        }
        assert!(rest.is_empty(), "{} bytes more than expected", rest.len());
    }

    mavstack::message! {
        /// A message that the vehicle does not know.
        struct Foreign: FOREIGN = 200 { a: u8, }
    }

    /// S-8, S-11, R-9: the log contains what the vehicle's own decoder accepts. That includes frames of component 0, MAVLink 1
    /// frames with extensions, and frames with an unknown id if their sender is known and a frame or silence follows.
    #[test]
    fn the_log_contains_what_the_vehicle_accepts() {
        let path = Temporary::new("accepted");
        let heartbeat = Heartbeat { mavlink_version: 3, ..Default::default() };
        let (script, stranger) = (Address::new(255, 0), Address::new(9, 9));
        let component_0 = frame_of(&heartbeat, Version::V2, script, 0);
        let foreign = |source, seq| frame_of(&Foreign { a: 1 }, Version::V2, source, seq);
        // MISSION_REQUEST_LIST with a mission type, as pymavlink's `force_mavlink1` sends it.
        let v1 = [0xFE, 3, 0, 255, 190, 43, 1, 1, 1, 0x84, 0x57].to_vec();
        let at = Instant::from_millis;
        let mut tap = Tap::new(Some(Tlog::create(&path.0).unwrap()));
        tap.pass_at(at(0), &[foreign(stranger, 0), component_0.clone(), foreign(script, 1), v1.clone()].concat());
        tap.pass_at(at(10), &foreign(script, 2));
        // Silence.
        tap.pass_at(at(40), &[]);

        let mut rest = &std::fs::read(&path.0).unwrap()[..];
        for frame in [component_0, foreign(script, 1), v1, foreign(script, 2)] {
            let (_, tail) = rest.split_at(8);
            assert_eq!(&tail[..frame.len()], &frame[..]);
            rest = &tail[frame.len()..];
        }
        assert!(rest.is_empty(), "{} bytes more than expected", rest.len());
    }

    /// SEC-5, R-9: without the vehicle's key, a signed frame with an unknown id is logged only if its sender is known. The frame
    /// after it is found in either case.
    #[test]
    fn the_log_needs_no_key_for_unknown_messages_of_known_senders() {
        let path = Temporary::new("vouched");
        let heartbeat = Heartbeat { mavlink_version: 3, ..Default::default() };
        let (known, stranger) = (Address::new(1, 1), Address::new(9, 9));
        let signed = |source, seq| {
            let mut bytes = [0; MAX_FRAME_LEN];
            let key = SigningKey::new([7; 32]);
            let len = encode_signed(&Foreign { a: 1 }, source, seq, &key, 5, 33_000_000_000_000, &mut bytes).unwrap();
            bytes[..len].to_vec()
        };
        let heartbeats = [0, 3].map(|seq| frame(&heartbeat, Version::V2, seq));
        let mut tap = Tap::new(Some(Tlog::create(&path.0).unwrap()));
        let [first, last] = heartbeats;
        tap.pass_at(Instant::ZERO, &[first, signed(stranger, 1), signed(known, 2), last].concat());

        let log = std::fs::read(&path.0).unwrap();
        let mut found = Vec::new();
        let mut frames = Frames::default();
        let mut rest = &log[..];
        while let Some((_, tail)) = rest.split_at_checked(8) {
            let len = usize::from(tail[1]) + if tail[2] == 0 { 12 } else { 25 };
            frames.cut(&tail[..len], |frame| found.push((frame.source(), frame.header().seq)));
            rest = &tail[len..];
        }
        frames.find(Instant::from_millis(100), &[], |_| true, |frame| found.push((frame.source(), frame.header().seq)));
        assert_eq!(found, [(known, 0), (known, 2), (known, 3)]);
    }

    /// SEC-15: a log can be shared. The hash of a signature is zeros and the rest of the frame is unchanged. Messages with a
    /// secret are omitted.
    #[test]
    fn the_log_contains_no_signature_and_no_password() {
        let path = Temporary::new("signed");
        let heartbeat = Heartbeat { mavlink_version: 3, ..Default::default() };
        let mut signed = [0; MAX_FRAME_LEN];
        let key = SigningKey::new([7; 32]);
        let len = encode_signed(&heartbeat, Address::new(1, 1), 0, &key, 5, 33_000_000_000_000, &mut signed).unwrap();
        let signed = &signed[..len];
        let mut tap = Tap::new(Some(Tlog::create(&path.0).unwrap()));
        tap.pass(signed);
        tap.pass(&frame(&AuthKey::default(), Version::V2, 1));
        tap.pass(&frame(&CellularConfig::default(), Version::V2, 2));
        tap.pass(&frame(&ChangeOperatorControl::default(), Version::V2, 3));
        tap.pass(&frame(&WifiConfigAp::default(), Version::V2, 4));

        let log = std::fs::read(&path.0).unwrap();
        let logged = &log[8..];
        assert_eq!(logged.len(), len, "one frame");
        let (front, signature) = logged.split_at(len - SIGNATURE);
        assert_eq!((front, signature), (&signed[..len - SIGNATURE], &[0; SIGNATURE][..]));
        // The link id and the timestamp are unchanged, and the frame is still valid.
        assert_eq!(front[len - SIGNATURE - 7], 5);
        let mut found = 0;
        Frames::default().cut(logged, |frame| found += usize::from(frame.header().is_signed()));
        assert_eq!(found, 1);
    }

    /// A mistyped `--log` overwrites no file.
    #[test]
    fn other_files_are_refused_and_unchanged() {
        let path = Temporary::new("notes");
        for notes in [&b"notes"[..], b"The only copy of my notes."] {
            std::fs::write(&path.0, notes).unwrap();
            let error = Tlog::create(&path.0).unwrap_err();
            assert!(error.contains("mavstack-notes") && error.contains("give --log another name"), "{error}");
            assert_eq!(std::fs::read(&path.0).unwrap(), notes);
        }
        // An empty file and an older log are truncated.
        std::fs::write(&path.0, []).unwrap();
        Tap::new(Some(Tlog::create(&path.0).unwrap())).pass(&frame(&Heartbeat::default(), Version::V2, 0));
        assert!(!std::fs::read(&path.0).unwrap().is_empty());
        Tlog::create(&path.0).unwrap();
        assert_eq!(std::fs::read(&path.0).unwrap(), []);
    }

    #[test]
    fn an_error_names_the_file() {
        let error = Tlog::create(Path::new("/no such folder/flight.tlog")).unwrap_err();
        assert!(error.contains("/no such folder/flight.tlog"), "{error}");
    }
}
