//! Files, by MAVLink FTP: [`Listing`], [`Download`], [`Upload`], [`Operation`] and [`Checksum`].
//!
//! What the clients do differently:
//!
//! | | QGroundControl | MAVSDK | MAVProxy | pymavlink (`mavftp`) |
//! |---|---|---|---|---|
//! | bytes in a packet | 239 | 239 | 239 | 80 |
//! | session | as answered | 0, always | its own, one for each transfer | its own, then as answered |
//! | sequence numbers | go on, 16 bits, a step of 2 | from 0, 16 bits | from 0, 8 bits | from 0, 16 bits |
//! | an answer is awaited for | 1 s | 0.5 s | 1 s, then by the round trip, at least 0.5 s | 1 s, 0.5 s |
//! | OpenFileRO is sent | once | 10 times | 11 times | 3 times |
//! | CreateFile is sent | once | 10 times | 11 times | once |
//! | a page of a directory is requested | 4 times | 10 times | 11 times, first with times | once |
//! | a repetition has | the same number | the same number | the same number, reads and writes a new one | the same number |
//! | a burst that stalls | is continued | the rest is read by ReadFile | is continued | is continued |
//! | gaps are read | one by one, afterwards | one by one, afterwards | 5 at once, during the burst | one every 50 ms, afterwards |
//! | WriteFile | one by one | one by one | 5 at once | 5 at once |
//! | at the end | ResetSessions | TerminateSession, awaited | TerminateSession, not awaited | TerminateSession, awaited |
//! | after a failure | nothing | TerminateSession after a refusal | TerminateSession | TerminateSession |
//!
//! So QGroundControl gives up a download when one packet is lost. [`Again`](crate::Again) is the user who presses the
//! button again. MAVProxy never gives up a transfer that has begun; here it does after a minute without an answer.
//!
//! Sources: QGroundControl's `FTPManager.cc`, MAVSDK's `mavlink_ftp_client.cpp` (4.1), MAVProxy's `mavproxy_ftp.py` (1.8.75),
//! pymavlink's `mavftp.py` (2.4.50), <https://mavlink.io/en/services/ftp.html>.

mod directory;
mod download;
mod operation;
mod packet;
mod requests;
mod rules;
mod upload;

pub use directory::{Entry, EntryKind, Listing};
pub use download::{Download, Reading};
pub use operation::{Checksum, Operation};
pub use packet::{MAX_DATA, Packet};
pub use upload::Upload;

/// Returns the checksum of a file's content as MAVLink FTP defines it: the CRC-32 of IEEE 802.3, reflected, from 0 and without an
/// inversion at the end.
pub fn crc32(bytes: &[u8]) -> u32 {
    bytes.iter().fold(0, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| if crc & 1 == 1 { (crc >> 1) ^ 0xEDB8_8320 } else { crc >> 1 })
    })
}
