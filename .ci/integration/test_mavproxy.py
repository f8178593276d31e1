"""The vehicle as MAVProxy's user sees it."""

import pathlib
import subprocess
import sys
import threading
import time

import pytest

PLAN = """\
QGC WPL 110
0	1	3	22	0	0	0	0	47.3977420	8.5455940	10	1
1	0	3	16	1.5	0	0	0	47.3978421	8.5455940	12	1
2	0	3	16	0	0	0	0	47.3978421	-8.5456941	12.25	1
"""


class MavProxy:
    """A running MAVProxy: commands in, lines out."""

    def __init__(self, port, folder):
        program = pathlib.Path(sys.executable).parent / "mavproxy.py"
        self.process = subprocess.Popen(
            [
                sys.executable,
                "-u",
                program,
                f"--master=tcp:127.0.0.1:{port}",
                f"--state-basedir={folder}",
                "--default-modules=wp,arm",
            ],
            cwd=folder,
            text=True,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
        self.output = ""
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        while text := self.process.stdout.read(1):
            self.output += text

    def say(self, command):
        self.process.stdin.write(command + "\n")
        self.process.stdin.flush()

    def expect(self, text, timeout=15):
        """Waits until it prints this; what it printed up to there is done with."""
        deadline = time.monotonic() + timeout
        while text not in self.output:
            assert time.monotonic() < deadline, f"no {text!r} in:\n{self.output}"
            time.sleep(0.05)
        self.output = self.output.split(text, 1)[1]

    def end(self):
        self.process.kill()
        self.process.wait()


@pytest.fixture
def mavproxy(port, tmp_path):
    mavproxy = MavProxy(port, tmp_path)
    yield mavproxy
    mavproxy.end()


def test_connect_load_list_arm(mavproxy, tmp_path):
    (tmp_path / "plan.txt").write_text(PLAN)
    mavproxy.expect("Detected vehicle 1:1")
    mavproxy.expect("Mode(100)")
    mavproxy.say("wp load plan.txt")
    mavproxy.expect("MISSION_ACK: TYPE_MISSION: ACCEPTED")
    mavproxy.say("wp list")
    mavproxy.expect("Requesting 3 waypoints")
    mavproxy.expect("16 3 47.3978421000 -8.5456941000 12.250000")
    mavproxy.expect("Saved 3 waypoints")
    mavproxy.say("arm throttle")
    mavproxy.expect("COMMAND_ACK: COMPONENT_ARM_DISARM: ACCEPTED")
    mavproxy.expect("ARMED")
    mavproxy.say("disarm")
    mavproxy.expect("DISARMED")
    mavproxy.say("wp clear")
    mavproxy.expect("MISSION_ACK: TYPE_MISSION: ACCEPTED")
