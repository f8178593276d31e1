//! The user who presses the button again.

use crate::{Dialogue, Failure, Io, Received};

/// Begins a dialogue again when it was not answered, as a user does whose client has given up.
///
/// Real clients give up early: QGroundControl opens a file once. On a link that loses frames, their users try again.
///
/// ```
/// use mavstack_station::{Again, files::Download};
/// let patient = Again::new(10, || Download::new("@PARAM/param.pck"));
/// ```
#[derive(Debug)]
pub struct Again<D, F> {
    begin: F,
    current: D,
    /// Tries after the current one.
    left: u32,
}

impl<D: Dialogue, F: FnMut() -> D> Again<D, F> {
    /// Tries at most `tries` times, at least once. Only what lost frames may cause is tried again, see
    /// [`Failure::is_by_loss`].
    pub fn new(tries: u32, mut begin: F) -> Self {
        let current = begin();
        Self { begin, current, left: tries.saturating_sub(1) }
    }
}

impl<D: Dialogue, F: FnMut() -> D> Dialogue for Again<D, F> {
    type Output = D::Output;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<D::Output, Failure>> {
        match self.current.poll(io)? {
            Err(failure) if failure.is_by_loss() && self.left > 0 => {
                self.left -= 1;
                self.current = (self.begin)();
                None
            }
            result => Some(result),
        }
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        self.current.receive(io, frame);
    }
}
