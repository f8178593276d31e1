"""Plans and arming with MAVProxy."""

import pathlib
import re
import subprocess
import sys
import threading
import time

import pytest
from plans import FENCE, FIELDS, MISSION, RALLY, differences, plan, same
from transfer import ACCEPTED, download, ids, upload

# The mode number of Hold: PX4's main mode 4 and sub-mode 3.
HOLD = 4 << 16 | 3 << 24
MISSION_FILE = """\
QGC WPL 110
0	1	3	22	0	0	0	0	47.397742	8.545594	10	1
1	0	3	16	1.5	0	0	nan	47.397842	8.545594	12	1
2	0	3	178	1	5	-1	0	0	0	0	1
3	0	3	16	0	0	0	0	47.397842	-8.545695	12.25	1
4	0	3	177	1	2	0	0	0	0	0	1
"""
FENCE_FILE = """\
QGC WPL 110
0	0	3	5001	4	1	0	0	47.395	8.543	0	1
1	0	3	5001	4	1	0	0	47.395	8.548	0	1
2	0	3	5001	4	1	0	0	47.4	8.548	0	1
3	0	3	5001	4	1	0	0	47.4	8.543	0	1
4	0	0	5000	0	0	0	0	47.397742	8.545594	30	1
5	0	3	5004	25.5	0	0	0	47.399	8.5475	0	1
"""
RALLY_FILE = """\
QGC WPL 110
0	0	3	5100	0	0	0	0	47.397	8.545	15	1
1	0	0	5100	0	0	0	0	47.398	-8.546	500.5	1
"""
# The older format of fences: the return point, the vertices, and the first vertex again.
OLD_FENCE_FILE = """\
47.397742 8.545594
47.395 8.543
47.395 8.548
47.4 8.548
47.395 8.543
"""


def rows(text):
    """Returns the numbers in a file, row by row."""
    header, *lines = text.splitlines()
    assert header == "QGC WPL 110"
    return [[float(word) for word in line.split()] for line in lines]


def items(text):
    """Returns the items that MAVProxy sends for a file. It truncates positions after the seventh decimal."""
    found = []
    for seq, current, frame, command, *params, x, y, z, autocontinue in rows(text):
        # Commands without a position have plain numbers in these fields.
        x, y = (int(x * 1e7), int(y * 1e7)) if command not in (177, 178) else (int(x), int(y))
        found.append(dict(zip(FIELDS, [seq, frame, command, current, autocontinue, *params, x, y, z])))
    return found


def is_close(a, b):
    """Compares two values to six decimals."""
    return same(a, b) or abs(a - b) < 1.5e-6


class MavProxy:
    """A running MAVProxy: commands in, lines out."""

    def __init__(self, port, folder, modules="wp,fence,rally,arm", prelude=None, options=()):
        """`prelude` is a program that runs MAVProxy, whose path is its first argument."""
        program = pathlib.Path(sys.executable).parent / "mavproxy.py"
        self.process = subprocess.Popen(
            [
                sys.executable,
                "-u",
                *(["-c", prelude] if prelude else []),
                program,
                f"--master=tcp:127.0.0.1:{port}",
                f"--state-basedir={folder}",
                f"--default-modules={modules}",
                *options,
            ],
            cwd=folder,
            text=True,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
        self.output = ""
        self.lock = threading.Lock()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        while text := self.process.stdout.read(1):
            with self.lock:
                self.output += text

    def say(self, command):
        self.process.stdin.write(command + "\n")
        self.process.stdin.flush()

    def expect(self, text, timeout=15):
        """Waits until MAVProxy prints this text. Returns the output before it, and discards it with the text."""
        deadline = time.monotonic() + timeout
        while text not in self.output:
            assert time.monotonic() < deadline, f"no {text!r} in:\n{self.output}"
            time.sleep(0.05)
        with self.lock:
            before, self.output = self.output.split(text, 1)
        return before

    def expect_all(self, *texts, timeout=15):
        """Waits until MAVProxy has printed all texts, in any order."""
        deadline = time.monotonic() + timeout
        while missing := [text for text in texts if text not in self.output]:
            assert time.monotonic() < deadline, f"no {missing} in:\n{self.output}"
            time.sleep(0.05)

    def ask_until(self, command, text, timeout=15):
        """Repeats a command whose output may be of the time before the last message arrived, until MAVProxy prints this text."""
        self.repeat_until(lambda: self.say(command), text, timeout)

    def repeat_until(self, act, text, timeout=15):
        """Calls `act` until MAVProxy prints this text."""
        deadline = time.monotonic() + timeout
        while text not in self.output:
            assert time.monotonic() < deadline, f"no {text!r} in:\n{self.output}"
            act()
            time.sleep(0.5)

    def end(self):
        self.process.kill()
        self.process.wait()


@pytest.fixture
def mavproxy(port, tmp_path):
    mavproxy = MavProxy(port, tmp_path)
    yield mavproxy
    mavproxy.end()


def test_connect_load_list_arm(mavproxy, tmp_path):
    (tmp_path / "plan.txt").write_text(MISSION_FILE)
    mavproxy.expect("Detected vehicle 1:1")
    mavproxy.expect(f"Mode({HOLD})")
    mavproxy.say("wp load plan.txt")
    mavproxy.expect("MISSION_ACK: TYPE_MISSION: ACCEPTED")
    mavproxy.say("wp list")
    mavproxy.expect("Requesting 5 waypoints")
    mavproxy.expect("16 3 47.3978420000 -8.5456950000 12.250000")
    mavproxy.expect("Saved 5 waypoints")
    mavproxy.say("arm throttle")
    # The heartbeat that reports the arming precedes the answer (H-16).
    mavproxy.expect("ARMED")
    mavproxy.expect("COMMAND_ACK: COMPONENT_ARM_DISARM: ACCEPTED")
    mavproxy.say("disarm")
    mavproxy.expect("DISARMED")
    mavproxy.say("wp clear")
    mavproxy.expect("MISSION_ACK: TYPE_MISSION: ACCEPTED")


def test_plans_in_files(mavproxy, other, tmp_path):
    """Loads, lists, saves and clears each kind of plan. The saved file is equal to the loaded one."""
    mavproxy.expect("Detected vehicle 1:1")
    for kind, command, name, text in [
        (MISSION, "wp", "waypoints", MISSION_FILE),
        (FENCE, "fence", "fence items", FENCE_FILE),
        (RALLY, "rally", "rally items", RALLY_FILE),
    ]:
        (tmp_path / f"{command}.txt").write_text(text)
        count = len(rows(text))
        mavproxy.say(f"{command} load {command}.txt")
        mavproxy.expect(f"Loaded {count} {name} from")
        mavproxy.expect(": ACCEPTED")
        assert differences(items(text), download(other, kind).items) == []
        mavproxy.say(f"{command} list")
        mavproxy.expect(f"Requesting {count} {name}")
        mavproxy.expect(f"Saved {count} {name}")
        mavproxy.say(f"{command} save saved-{command}.txt")
        mavproxy.expect(f"Saved {count} {name} to saved-{command}.txt")
        saved = rows((tmp_path / f"saved-{command}.txt").read_text())
        assert len(saved) == count
        for row, back in zip(rows(text), saved):
            assert len(row) == len(back) == 12 and all(map(is_close, row, back)), (row, back)
    for kind, command in [(RALLY, "rally"), (FENCE, "fence"), (MISSION, "wp")]:
        mavproxy.say(f"{command} clear")
        mavproxy.expect(": ACCEPTED")
        assert download(other, kind) == (0, [])
    assert ids(other) == [0, 0, 0]


def test_mavproxy_lists_a_long_plan(mavproxy, other, figure):
    """MAVProxy has five requests in flight. The vehicle must answer each: MAVProxy repeats a request that was not answered within
    two seconds, and names the item. It also prints an empty list every two seconds."""
    mavproxy.expect("Detected vehicle 1:1")
    assert upload(other, plan(100)).type == ACCEPTED
    began = time.monotonic()
    mavproxy.say("wp list")
    listed = mavproxy.expect("Saved 100 waypoints", timeout=60)
    figure(f"MAVProxy: 100 items listed in {time.monotonic() - began:.1f} s")
    assert not re.search(r"re-requesting \w+ \[\d", listed)


def test_fence_in_the_older_format(mavproxy, other, tmp_path):
    mavproxy.expect("Detected vehicle 1:1")
    (tmp_path / "fence.txt").write_text(OLD_FENCE_FILE)
    mavproxy.say("fence load fence.txt")
    mavproxy.expect("TYPE_FENCE: ACCEPTED")
    back = download(other, FENCE).items
    assert [(item["command"], item["param1"]) for item in back] == [(5000, 0), (5001, 3), (5001, 3), (5001, 3)]
    mavproxy.say("fence list")
    mavproxy.expect("Saved 4 fence items")


def test_refused_plan_is_explained(mavproxy, other, tmp_path):
    """The user sees the reason, and the old plan is unchanged."""
    mavproxy.expect("Detected vehicle 1:1")
    (tmp_path / "good.txt").write_text(MISSION_FILE)
    (tmp_path / "bad.txt").write_text(MISSION_FILE.replace("3	0	3	16	", "3	0	3	82	"))
    mavproxy.say("wp load good.txt")
    mavproxy.expect("TYPE_MISSION: ACCEPTED")
    mavproxy.say("wp load bad.txt")
    mavproxy.expect_all("TYPE_MISSION: UNSUPPORTED", "Mission item 3: command not supported")
    assert differences(items(MISSION_FILE), download(other).items) == []


@pytest.mark.parametrize("form", ["command", "message"])
def test_set_the_current_item(mavproxy, other, tmp_path, form):
    """M-92, M-93: MAVProxy supports both forms."""
    mavproxy.expect("Detected vehicle 1:1")
    if form == "message":
        mavproxy.say("set wp_use_waypoint_set_current 1")
    (tmp_path / "plan.txt").write_text(MISSION_FILE)
    mavproxy.say("wp load plan.txt")
    mavproxy.expect("TYPE_MISSION: ACCEPTED")
    mavproxy.say("wp set 3")
    assert other.wait("MISSION_CURRENT", where=lambda told: told.seq == 3)
    if form == "command":
        mavproxy.expect("DO_SET_MISSION_CURRENT: ACCEPTED")
        mavproxy.say("wp set 9")
        mavproxy.expect("DO_SET_MISSION_CURRENT: FAILED")
    else:
        mavproxy.say("wp set 9")
        mavproxy.expect("Mission item 9 cannot be made current")
