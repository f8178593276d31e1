"""Power cuts: a processor reset in QEMU, a killed process in sitl."""

import json
import signal
import socket
import subprocess
import time

from conftest import Gcs
from pymavlink import mavutil


class Qmp:
    """A client of QMP, QEMU's control protocol: one JSON object per line."""

    def __init__(self, port):
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=10)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.lines = self.socket.makefile("rw")
        assert "QMP" in self._read()
        self.execute("qmp_capabilities")

    def _read(self):
        return json.loads(self.lines.readline())

    def execute(self, command, event=None, **arguments):
        """Executes a command, and waits for the event that reports its completion. Returns the command's result."""
        self.lines.write(json.dumps({"execute": command} | ({"arguments": arguments} if arguments else {})) + "\n")
        self.lines.flush()
        wanted, result = {"return", event} - {None}, None
        while wanted:
            message = self._read()
            assert "error" not in message, message
            wanted -= {message.get("event"), *message}
            result = message.get("return", result)
        return result

    def wait(self, event):
        """Waits for an event, at most 30 s."""
        self.socket.settimeout(30)
        while self._read().get("event") != event:
            pass

    def close(self):
        self.lines.close()
        self.socket.close()


class InQemu:
    """The vehicle that all tests share. Its connections survive a reset."""

    def __init__(self, qmp_port, gcs):
        self.qmp = Qmp(qmp_port)
        self.gcs = gcs

    def cut(self):
        """Resets the processor and waits for the vehicle. Returns the messages received before the reset."""
        # While the vehicle is stopped, everything that it sent arrives here.
        self.qmp.execute("stop", event="STOP")
        last_words = self.gcs.take_all()
        self.qmp.execute("system_reset", event="RESET")
        self.gcs.forget_half_a_frame()
        self.qmp.execute("cont", event="RESUME")
        self.is_back()
        return last_words

    def is_back(self):
        """Waits for the first heartbeat after the reset."""
        booting = mavutil.mavlink.MAV_STATE_BOOT
        assert self.gcs.wait("HEARTBEAT", where=lambda heartbeat: heartbeat.system_status == booting)

    def end(self):
        # The test may have ended while the vehicle was stopped.
        self.qmp.execute("cont")
        self.qmp.close()


class InSitl:
    """A separate vehicle, which stores its plans in a file."""

    def __init__(self, program, port, file, *options):
        self.command = [program, "--port-base", str(port), "--storage", file, *options]
        self.port = port
        self._start()

    def _start(self):
        self.process = subprocess.Popen(self.command, stdout=subprocess.DEVNULL)
        self.gcs = None
        deadline = time.monotonic() + 10
        # The companion's link, as in QEMU: it is the fastest one.
        while not self.gcs:
            try:
                socket.create_connection(("127.0.0.1", self.port + 2)).close()
                self.gcs = Gcs(self.port + 1, system=254, is_new=True)
            except ConnectionRefusedError:
                assert self.process.poll() is None, "the vehicle does not start"
                assert time.monotonic() < deadline, "the vehicle does not listen"
                time.sleep(0.01)

    def cut(self):
        """Kills the process and starts it again. Returns the messages received before that."""
        # While the process is stopped, everything that it sent arrives here.
        self.process.send_signal(signal.SIGSTOP)
        last_words = self.gcs.take_all()
        self.process.kill()
        self.process.wait()
        self.gcs.close()
        self._start()
        return last_words

    def end(self):
        self.process.kill()
        self.process.wait()
        if self.gcs:
            self.gcs.close()
