"""A separate vehicle in QEMU, started like `cargo qemu`."""

import contextlib
import signal
import subprocess
import time

# The time to start (s). The firmware is built first, which takes a moment even if it is up to date.
START = 120


@contextlib.contextmanager
def running(option, app, file, *options):
    """The firmware of an app on the spare ports. Its output goes to `file`."""
    with open(file, "w") as output:
        process = subprocess.Popen(
            [option("xtask"), "qemu", "--app", app, "--port-base", str(option("spare_port_base")), *options],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
        )
        try:
            deadline = time.monotonic() + START
            while "Press Ctrl-C to stop" not in file.read_text():
                assert process.poll() is None, file.read_text()
                assert time.monotonic() < deadline, "the vehicle does not start"
                time.sleep(0.1)
            yield
        finally:
            # The program then stops its emulator and waits for it.
            process.send_signal(signal.SIGINT)
            try:
                process.wait(timeout=20)
            except subprocess.TimeoutExpired:
                # On Linux this ends the emulator too: its ports must be free for the next test.
                process.kill()
                process.wait()
                raise
