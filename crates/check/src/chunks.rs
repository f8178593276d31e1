//! Bursts of different sizes to the vehicle: which of their bytes are lost.

use mavstack::Duration;
use mavstack_station::{Drive, Failure};

use crate::examiner::{Examiner, FILL_LEN};

/// The sizes of the bursts, in bytes. The first one is a request alone.
const SIZES: [usize; 8] = [32, 64, 96, 128, 256, 512, 1_024, 2_048];
/// Bursts of each size.
const TRIES: u32 = 4;
/// The pause before each burst.
const PAUSE: Duration = Duration::from_millis(250);
/// How long an answer is awaited, besides the time that it usually takes.
const MARGIN: Duration = Duration::from_millis(500);

/// Bursts of one size, whose last frame is a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Burst {
    /// Its bytes.
    pub bytes: usize,
    /// How often it was sent.
    pub tried: u32,
    /// How often the request was answered.
    pub answered: u32,
    /// The shortest time from the burst to the answer.
    pub fastest: Option<Duration>,
}

impl Burst {
    fn is_mostly_lost(self) -> bool {
        self.answered * 4 <= self.tried
    }
}

/// The results of all sizes.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Chunks {
    /// Bursts with a request at the end, the smallest first.
    pub bursts: Vec<Burst>,
}

impl Chunks {
    /// Returns the size from which on the end of a burst is lost, if small bursts arrive.
    pub fn limit(&self) -> Option<usize> {
        let (first, rest) = self.bursts.split_first()?;
        let lost = rest.iter().rposition(|burst| !burst.is_mostly_lost()).map_or(0, |last| last + 1);
        let arrives = !first.is_mostly_lost() && first.answered * 2 > first.tried;
        rest.get(lost).filter(|_| arrives).map(|burst| burst.bytes)
    }

    /// Returns the rate of the line to the vehicle (bytes/s), by the time that the largest burst took; `None` if it was lost.
    pub fn rate(&self) -> Option<f64> {
        let (first, last) = (self.bursts.first()?, self.bursts.last()?);
        let time = last.fastest?.as_micros().saturating_sub(first.fastest?.as_micros());
        Some((last.bytes - first.bytes) as f64 * 1e6 / time.max(1) as f64)
    }
}

/// Measures all sizes. `rate` is the least rate that the line may have (bytes/s), and `answer_time` that of a request alone.
///
/// # Errors
///
/// The transport failed.
pub fn measure<T: Drive>(examiner: &mut Examiner<'_, T>, rate: f64, answer_time: Duration) -> Result<Chunks, Failure> {
    let mut chunks = Chunks::default();
    for bytes in SIZES {
        let on_the_way = Duration::from_micros((bytes as f64 / rate * 1e6) as u64);
        let patience = on_the_way + answer_time * 2 + MARGIN;
        let mut burst = Burst { bytes, tried: TRIES, answered: 0, fastest: None };
        for _ in 0..TRIES {
            if let Some(time) = send(examiner, bytes - SIZES[0], patience)? {
                burst.answered += 1;
                burst.fastest = Some(burst.fastest.map_or(time, |fastest| fastest.min(time)));
            }
        }
        chunks.bursts.push(burst);
    }
    Ok(chunks)
}

/// Sends a request behind `before` bytes of other frames. Returns the time until its answer.
fn send<T: Drive>(
    examiner: &mut Examiner<'_, T>,
    before: usize,
    patience: Duration,
) -> Result<Option<Duration>, Failure> {
    let end = examiner.now() + PAUSE;
    while examiner.step()? < end {}
    let (echo, now, target) = (examiner.echo, examiner.now(), examiner.target());
    (0..before / FILL_LEN).for_each(|_| examiner.send_fill());
    echo.send(examiner.station(), now, target);
    let is_answered = examiner.until(patience, |frame| echo.is_answer(frame, now))?;
    Ok(is_answered.then(|| examiner.now() - now))
}
