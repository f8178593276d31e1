//! The demo vehicle as tasks of RTIC 2.
//!
//! ```text
//!   priority 8   UART interrupts       ──▶ queue ──┐          ┌── queue ──▶
//!   priority 2   flight, every 10 ms    fly ─▶ pulse │          │
//!   priority 1   comms, every ms                   └▶ serve ──┘  link by link; persist
//! ```
//!
//! Flight and comms share the vehicle and its stack. Flight interrupts comms, but not within a `lock`: comms locks for one bounded
//! call at a time, so flight waits for no more than that ([`mavstack::Config::budget`] says how much it is). What may not even
//! wait for that, say a rate controller, becomes a task above, which shares nothing. The interrupts wait for nobody.
//!
//! When flight hangs and awaits, the heartbeats stop and comms goes on. When it hangs and does not await, both are silent.
#![no_std]
#![no_main]
#![allow(unsafe_code, reason = "in what the macro writes")]

use mavstack_qemu as _;

#[rtic::app(device = mavstack_qemu::device, peripherals = false, dispatchers = [GPIO0, GPIO1])]
mod app {
    use core::future::pending;
    use core::mem::MaybeUninit;

    use mavstack::io::{LoopEnd, SerialQueues, queue_len};
    use mavstack::{Duration, LinkId};
    use mavstack_qemu::board::{self, Board, CLOCK_HZ, COMPANION_BAUD, SATELLITE_BAUD, TELEMETRY_BAUD};
    use mavstack_qemu::device::Interrupt;
    use mavstack_qemu::memory::{self, DemoApp, Memory};
    use mavstack_qemu::serial::SerialInterrupt;
    use rtic_monotonics::systick::prelude::*;

    systick_monotonic!(Mono, 1_000);

    /// How often comms runs, and how long the queues have to be for that.
    const PERIOD: Duration = Duration::from_millis(1);
    const TELEMETRY_LEN: usize = queue_len(TELEMETRY_BAUD, PERIOD);
    const COMPANION_LEN: usize = queue_len(COMPANION_BAUD, PERIOD);
    const SATELLITE_LEN: usize = queue_len(SATELLITE_BAUD, PERIOD);
    static TELEMETRY: SerialQueues<TELEMETRY_LEN, TELEMETRY_LEN> = SerialQueues::new();
    static COMPANION: SerialQueues<COMPANION_LEN, COMPANION_LEN> = SerialQueues::new();
    static SATELLITE: SerialQueues<SATELLITE_LEN, SATELLITE_LEN> = SerialQueues::new();

    #[shared]
    struct Shared {
        app: &'static mut DemoApp,
    }

    #[local]
    struct Local {
        lines: [(LoopEnd<'static>, Interrupt); 3],
        memory: Memory,
        telemetry: SerialInterrupt,
        companion: SerialInterrupt,
        satellite: SerialInterrupt,
    }

    #[init(local = [app: MaybeUninit<DemoApp> = MaybeUninit::uninit()])]
    fn init(cx: init::Context) -> (Shared, Local) {
        let app = memory::make(cx.local.app);
        let Some(Board { uarts: [uart0, uart1, uart2], flash, .. }) = Board::take() else {
            unreachable!("the firmware starts once")
        };
        let mut memory = Memory::new(flash);
        memory.restore(app, board::now());
        Mono::start(cx.core.SYST, CLOCK_HZ);
        // Both are there once, and not yet: they cannot fail.
        let _ = flight::spawn();
        let _ = comms::spawn();
        let local = Local {
            lines: [
                (TELEMETRY.loop_end(), Interrupt::UART0),
                (COMPANION.loop_end(), Interrupt::UART1),
                (SATELLITE.loop_end(), Interrupt::UART2),
            ],
            memory,
            telemetry: SerialInterrupt::new(uart0, TELEMETRY.interrupt_end()),
            companion: SerialInterrupt::new(uart1, COMPANION.interrupt_end()),
            satellite: SerialInterrupt::new(uart2, SATELLITE.interrupt_end()),
        };
        (Shared { app }, local)
    }

    /// Sleeps while there is nothing to do; RTIC's own would not.
    #[idle]
    fn idle(_: idle::Context) -> ! {
        loop {
            cortex_m::asm::wfi();
        }
    }

    /// Flies, and ticks the pulse.
    #[task(priority = 2, shared = [app])]
    async fn flight(mut cx: flight::Context) {
        let mut next = Mono::now();
        loop {
            let hangs = cx.shared.app.lock(|app| {
                app.fly(board::now());
                app.hangs()
            });
            if hangs {
                // For a sensor that does not answer, say.
                pending::<()>().await;
            }
            next += 10.millis();
            Mono::delay_until(next).await;
        }
    }

    /// Speaks for the vehicle, and remembers.
    #[task(priority = 1, shared = [app], local = [lines, memory])]
    async fn comms(mut cx: comms::Context) {
        loop {
            cx.shared.app.lock(|app| app.poll(board::now()));
            for (link, (line, interrupt)) in (0..).map(LinkId).zip(&mut *cx.local.lines) {
                // The stack counts errors and goes on: what was lost in an overrun, checksums find.
                let _ = cx.shared.app.lock(|app| app.serve(board::now(), link, line));
                // There may be something to send, or room again for what comes.
                rtic::pend(*interrupt);
            }
            cx.shared.app.lock(|app| cx.local.memory.persist(app, board::now()));
            let are_sent = !cx.local.lines.iter().any(|(line, _)| line.has_to_send());
            if are_sent && cx.shared.app.lock(|app| app.wants_reboot()) {
                Board::reset();
            }
            Mono::delay(1.millis()).await;
        }
    }

    // The highest priority there is, of three bits: a UART holds a single byte.

    #[task(binds = UART0, priority = 8, local = [telemetry])]
    fn uart0(cx: uart0::Context) {
        cx.local.telemetry.on_interrupt();
    }

    #[task(binds = UART1, priority = 8, local = [companion])]
    fn uart1(cx: uart1::Context) {
        cx.local.companion.on_interrupt();
    }

    #[task(binds = UART2, priority = 8, local = [satellite])]
    fn uart2(cx: uart2::Context) {
        cx.local.satellite.on_interrupt();
    }
}
