//! A transport that fails is asked again later: a driver that sleeps does not spin. Rules S-20, X-7.

use crate::support::*;
use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use mavstack::dialect::*;
use mavstack::network::LinkError;
use mavstack::{Instant, LinkId};

const LINK: LinkId = LinkId(0);

/// What fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fault {
    ReadReady,
    Read,
    WriteReady,
    Write,
    /// `write` returns 0.
    Closed,
}

/// A serial line that fails while `fault` is set, as USB does that is unplugged.
#[derive(Default)]
struct Line {
    fault: Option<Fault>,
    /// Bytes to the vehicle are pending.
    received: Vec<u8>,
    written: Vec<u8>,
}

impl Line {
    fn fails(&self, fault: Fault) -> Result<(), LineError> {
        if self.fault == Some(fault) { Err(LineError::Injected) } else { Ok(()) }
    }
}

impl ErrorType for Line {
    type Error = LineError;
}

impl ReadReady for Line {
    fn read_ready(&mut self) -> Result<bool, LineError> {
        self.fails(Fault::ReadReady)?;
        Ok(!self.received.is_empty() || self.fault == Some(Fault::Read))
    }
}

impl Read for Line {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, LineError> {
        self.fails(Fault::Read)?;
        let len = buffer.len().min(self.received.len());
        buffer.iter_mut().zip(self.received.drain(..len)).for_each(|(to, from)| *to = from);
        Ok(len)
    }
}

impl WriteReady for Line {
    fn write_ready(&mut self) -> Result<bool, LineError> {
        self.fails(Fault::WriteReady).map(|()| true)
    }
}

impl Write for Line {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, LineError> {
        self.fails(Fault::Write)?;
        let len = if self.fault == Some(Fault::Closed) { 0 } else { bytes.len().min(7) };
        self.written.extend(&bytes[..len]);
        Ok(len)
    }

    fn flush(&mut self) -> Result<(), LineError> {
        Ok(())
    }
}

/// while a transport fails, in whatever call and with whatever pending, a driver that sleeps until `next_deadline` wakes
/// some ten times a second. When the fault is over, everything is sent within a tenth of a second.
#[test]
fn failing_transport_does_not_keep_the_driver_awake() {
    for fault in [Fault::ReadReady, Fault::Read, Fault::WriteReady, Fault::Write, Fault::Closed] {
        for begun in [0, 3] {
            let mut world = World::new(Setup::<1>::new());
            let mut line = Line::default();
            let mut now = Instant::from_millis(5_000);
            let mut sleep = |world: &mut World<1>, line: &mut Line, until: Instant| {
                let mut passes = 0;
                let mut errors = Vec::new();
                while now < until {
                    world.pulse.tick();
                    world.stack.poll(now, &mut world.vehicle);
                    errors.extend(world.stack.poll_link(now, LINK, line, &mut world.vehicle).err());
                    passes += 1;
                    assert!(passes < 1_000, "{fault:?}: the driver spins");
                    now = world.stack.next_deadline(now).max(now + mavstack::Duration::from_micros(50)).min(until);
                }
                (passes, errors)
            };
            sleep(&mut world, &mut line, Instant::from_millis(6_500));
            // A frame is cut off.
            if begun > 0 {
                world.stack.text(Instant::from_millis(6_500), MavSeverity::INFO, "It is cut off");
                let len = world.stack.transmit(Instant::from_millis(6_500), LINK, &mut world.vehicle).len();
                assert!(len > begun);
                world.stack.transmitted(LINK, begun);
            }
            line.fault = Some(fault);
            world.stack.text(Instant::from_millis(6_500), MavSeverity::INFO, "Pending");
            let (passes, errors) = sleep(&mut world, &mut line, Instant::from_millis(8_500));
            assert!(passes <= 60, "{fault:?}: {passes} passes in 2 s");
            assert!(!errors.is_empty());
            let expected = match fault {
                Fault::ReadReady | Fault::Read => LinkError::Read(LineError::Injected),
                Fault::WriteReady | Fault::Write => LinkError::Write(LineError::Injected),
                Fault::Closed => LinkError::Closed,
            };
            assert!(errors.iter().all(|error| *error == expected), "{errors:?}");
            line.fault = None;
            line.written.clear();
            let (_, errors) = sleep(&mut world, &mut line, Instant::from_millis(8_601));
            assert_eq!(errors, []);
            let is_read = matches!(fault, Fault::ReadReady | Fault::Read);
            assert_eq!(line.written.is_empty(), is_read, "{fault:?}: it is sent when the fault is over");
        }
    }
}
