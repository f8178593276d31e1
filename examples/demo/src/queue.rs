//! What waits to be fetched.

/// At most `N` things, in their order; when it is full, what comes is lost.
#[derive(Clone, Copy, Debug)]
pub struct Queue<T, const N: usize>([Option<T>; N]);

impl<T: Copy, const N: usize> Queue<T, N> {
    pub const fn new() -> Self {
        Self([None; N])
    }

    pub fn push(&mut self, thing: T) {
        if let Some(free) = self.0.iter_mut().find(|place| place.is_none()) {
            *free = Some(thing);
        }
    }

    pub fn take(&mut self) -> Option<T> {
        let first = self.0.first_mut()?.take();
        self.0.rotate_left(1);
        first
    }
}
