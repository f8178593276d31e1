//! Two dialogues at once.

use crate::{Dialogue, Failure, Io, Received};

/// Two dialogues at once. Ends when the first one ends; the second one, for example sticks at a rate, runs beside it.
///
/// An end of the second one is ignored.
#[derive(Debug)]
pub struct Beside<A, B> {
    main: A,
    side: Option<B>,
}

impl<A: Dialogue, B: Dialogue> Beside<A, B> {
    /// Runs `side` for as long as `main` takes.
    pub fn new(main: A, side: B) -> Self {
        Self { main, side: Some(side) }
    }
}

impl<A: Dialogue, B: Dialogue> Dialogue for Beside<A, B> {
    type Output = A::Output;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<A::Output, Failure>> {
        if self.side.as_mut().is_some_and(|side| side.poll(io).is_some()) {
            self.side = None;
        }
        self.main.poll(io)
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        if let Some(side) = &mut self.side {
            side.receive(io, frame);
        }
        self.main.receive(io, frame);
    }
}
