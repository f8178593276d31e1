//! Damages streams as a noisy line does.
//!
//! The comparison with other libraries uses it too.

use super::Rng;

/// The kinds of damage.
#[derive(Clone, Copy)]
pub struct Damage {
    pub flips: bool,
    pub losses: bool,
    pub bursts: bool,
}

/// Damages one in ten of `frames` in each enabled way. Returns the stream and the intact frames: those without a changed, lost or
/// inserted byte.
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
            // A burst before or after a frame leaves the frame intact.
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
