//! Streams as a bad line delivers them.
//!
//! The comparison with other libraries uses it too.

use super::Rng;

/// How a stream is damaged.
#[derive(Clone, Copy)]
pub struct Damage {
    pub flips: bool,
    pub losses: bool,
    pub bursts: bool,
}

/// Damages a tenth of `frames` in each way, and tells which are left untouched: no byte of theirs is changed or lost, and
/// none comes between.
pub fn damage(frames: &[Vec<u8>], how: Damage, rng: &mut Rng) -> (Vec<u8>, Vec<Vec<u8>>) {
    let (mut stream, mut intact) = (Vec::new(), Vec::new());
    for frame in frames {
        let mut sent = frame.clone();
        if how.flips && rng.chance(0.1) {
            for _ in 0..=rng.below(4) {
                let at = rng.below(sent.len() as u64) as usize;
                sent[at] ^= 1 << rng.below(8);
            }
        }
        if how.losses && rng.chance(0.1) {
            for _ in 0..=rng.below(3) {
                sent.remove(rng.below(sent.len() as u64) as usize);
            }
        }
        if how.bursts && rng.chance(0.1) {
            let at = rng.below(sent.len() as u64 + 1) as usize;
            let burst: Vec<u8> = (0..=rng.below(80)).map(|_| rng.byte()).collect();
            // Before or behind a frame it leaves the frame whole.
            if at == 0 || at == sent.len() {
                if sent == *frame {
                    intact.push(frame.clone());
                }
                stream.extend(if at == 0 { [burst, sent].concat() } else { [sent, burst].concat() });
                continue;
            }
            sent.splice(at..at, burst);
        }
        if sent == *frame {
            intact.push(frame.clone());
        }
        stream.extend(sent);
    }
    (stream, intact)
}
