"""The log of `--log`, read back with pymavlink, and the firmware's own log in a flood of noise."""

import random
import signal
import subprocess
import time

import pytest
from conftest import Gcs, is_armed
from plans import MISSION, differences, plan
from pymavlink import mavutil
from transfer import upload

mavlink = mavutil.mavlink

# What a line of 115,200 baud brings (bytes/s).
LINE_RATE = 11_520

# Those that have heartbeats.
COMPONENTS = (mavlink.MAV_COMP_ID_AUTOPILOT1, mavlink.MAV_COMP_ID_CAMERA, mavlink.MAV_COMP_ID_GIMBAL)

# The heartbeats of a component are steady if so many gaps in a row are between these limits (s).
STEADY, MIN_GAP, MAX_GAP = 8, 0.5, 1.5

# The time to start (s). QEMU's firmware is built first, which takes a moment even if it is up to date.
START = 120


class Logged:
    """A separate vehicle that writes a log."""

    def __init__(self, program, port, folder):
        self.port, self.log, self.output = port, folder / "flight.tlog", folder / "output.txt"
        command = [*program, "--port-base", str(port), "--log", self.log]
        with self.output.open("w") as output:
            self.process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=output, stderr=output)
        try:
            self.says("Press Ctrl-C to stop", START)
        except AssertionError:
            self.end()
            raise

    def says(self, text, timeout=5):
        """Waits until the program has printed this text."""
        deadline = time.monotonic() + timeout
        while text not in self.output.read_text():
            assert self.process.poll() is None, self.output.read_text()
            assert time.monotonic() < deadline, f"{text} is not in {self.output.read_text()}"
            time.sleep(0.1)

    def lines(self):
        """Returns the number of lines that the program has printed."""
        return self.output.read_text().count("\n")

    def end(self):
        self.process.kill()
        self.process.wait()


@pytest.fixture
def logged(target, request, tmp_path):
    option = request.config.getoption
    program = [option("program")] if target == "sitl" else [option("xtask"), "qemu"]
    logged = Logged(program, option("spare_port_base"), tmp_path)
    yield logged
    logged.end()


def test_log_contains_both_directions(logged):
    gcs = Gcs(logged.port)
    gcs.mav.heartbeat_send(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)
    # The vehicle has a position fix.
    assert gcs.wait("HEARTBEAT", 15, lambda heartbeat: heartbeat.system_status == mavlink.MAV_STATE_STANDBY)
    items = plan(5)
    assert upload(gcs, items).type == mavlink.MAV_MISSION_ACCEPTED
    logged.says("disarmed, Hold, mission 0/5 not started")
    # A MAVLink 1 frame with an extension, from component 0: the vehicle accepts it (S-8, S-11), so the log contains it.
    gcs.mav.srcComponent = 0
    gcs.mav.mission_request_int_send(1, 1, 0, MISSION, force_mavlink1=True)
    assert gcs.wait("MISSION_ITEM_INT").target_component == 0
    gcs.mav.srcComponent = 190
    # Noise, which includes an incomplete frame, and a key, which no log may contain.
    gcs.mav.setup_signing_send(1, 1, list(range(32)), 7)
    gcs.link.write(b"\xfd\x09\x00noise")
    assert gcs.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == mavlink.MAV_RESULT_ACCEPTED
    assert gcs.wait("HEARTBEAT", where=is_armed)
    logged.says(" armed, Hold, mission 0/5 not started")
    logged.says(" (255/190)")
    gcs.link.write(b"\xfd\x1c\x00\x00")
    gcs.close()
    logged.process.send_signal(signal.SIGINT)
    assert logged.process.wait(timeout=10) == 0, "the exit code after Ctrl-C is not 0"

    ended = time.time()
    file = mavutil.mavlink_connection(str(logged.log))
    messages = []
    while message := file.recv_match():
        messages.append(message)
    file.close()

    def of(kind, system):
        return [message for message in messages if message.get_type() == kind and message.get_srcSystem() == system]

    assert not of("BAD_DATA", 0)
    # pymavlink does not report the sender of a message that it does not know.
    assert {message.get_srcSystem() for message in messages if "UNKNOWN" not in message.get_type()} == {1, 255}
    assert of("HEARTBEAT", 255) and of("HEARTBEAT", 1) and any(map(is_armed, of("HEARTBEAT", 1)))
    sent = [{field: getattr(item, field) for field in items[0]} for item in of("MISSION_ITEM_INT", 255)]
    assert differences(items, sent) == []
    [request] = of("MISSION_REQUEST_INT", 255)
    assert request.get_srcComponent() == 0
    [ack] = of("COMMAND_ACK", 1)
    assert (ack.command, ack.result) == (mavlink.MAV_CMD_COMPONENT_ARM_DISARM, mavlink.MAV_RESULT_ACCEPTED)
    [command] = of("COMMAND_LONG", 255)
    assert command._timestamp <= ack._timestamp
    assert not of("SETUP_SIGNING", 255) and bytes(range(32)) not in logged.log.read_bytes()
    times = [message._timestamp for message in messages]
    assert times == sorted(times)
    assert ended - 60 < times[0] and times[-1] <= ended

    # The log contains frames with their times, and nothing else.
    whole = sum(8 + len(message.get_msgbuf()) for message in messages)
    assert logged.log.stat().st_size == whole


def test_noise_is_taken_at_line_rate(logged, figure):
    """SEC-2, H-15: random bytes on the companion's link are taken as fast as a line of 115,200 baud brings them, while the firmware
    logs its drops, at most three lines a second. The heartbeats of each component on the telemetry link stay at 1 Hz.

    A PING follows each 1,000 bytes of noise: when the vehicle answers, it has taken the noise. The machine may be busy with other
    tests, which slow the emulator down, so the best two seconds of a minute count, and the best heartbeats in a row.
    """
    chance = random.Random(6)
    gcs, companion = Gcs(logged.port), Gcs(logged.port + 1, system=254)
    sizes, answered, backlog, heartbeats = [], 0, b"", {component: [] for component in COMPONENTS}
    rate = taken = 0
    # What came while the other link was connected.
    gcs.drain()
    lines = logged.lines()
    began = since = time.monotonic()
    is_over = False
    while not is_over or answered < len(sizes):
        now = time.monotonic()
        gaps = {at: [after - before for before, after in zip(times, times[1:])][-STEADY:] for at, times in heartbeats.items()}
        assert now < began + 60, f"noise is taken at {rate:.0f} bytes/s at most; gaps between heartbeats: {gaps}"
        is_steady = all(len(apart) == STEADY and MIN_GAP < min(apart) and max(apart) < MAX_GAP for apart in gaps.values())
        is_over = is_over or (now >= began + 10 and rate >= LINE_RATE and is_steady)
        if not backlog and not is_over and len(sizes) < answered + 3:
            ping = companion.mav.ping_encode(0, len(sizes), 0, 0).pack(companion.mav)
            backlog = chance.randbytes(1_000) + ping
            sizes.append(len(backlog))
        if backlog:
            try:
                backlog = backlog[companion.link.port.send(backlog) :]
            except BlockingIOError:
                pass
        for message in companion.take_all():
            if message.get_type() == "PING" and (message.target_system, message.target_component) == companion.address:
                assert message.seq == answered, "an intact frame was lost in the noise"
                taken += sizes[answered]
                answered += 1
        if now >= since + 2:
            rate, taken, since = max(rate, taken / (now - since)), 0, now
        for message in gcs.take_all():
            if message.get_type() == "HEARTBEAT" and message.get_srcSystem() == 1:
                heartbeats[message.get_srcComponent()].append(now)
        time.sleep(0.002)
    took, lines = now - began, logged.lines() - lines
    gcs.close()
    companion.close()
    assert lines <= 3 * took + 3, f"{lines} lines in {took:.0f} s"
    longest = max(map(max, gaps.values()))
    figure(f"noise: {rate / 1000:.1f} kB/s taken, heartbeats at most {longest:.2f} s apart, {lines / took:.1f} lines/s")


def test_refused_plans_are_logged_once_a_second(logged):
    """SEC-2: uploads that do not fit, 200 a second, are all refused, and logged at most three lines a second."""
    gcs = Gcs(logged.port)
    assert gcs.wait("HEARTBEAT", 15)
    lines, began, refused = logged.lines(), time.monotonic(), 0
    while (now := time.monotonic()) < began + 5:
        gcs.mav.mission_count_send(1, 1, 60_000, MISSION)
        time.sleep(0.005)
        refused += sum(
            message.get_type() == "MISSION_ACK" and message.type == mavlink.MAV_MISSION_NO_SPACE
            for message in gcs.take_all()
        )
    took, lines = now - began, logged.lines() - lines
    gcs.close()
    assert refused > 50 * took, f"{refused} answers in {took:.0f} s"
    assert lines <= 3 * took + 3, f"{lines} lines in {took:.0f} s"
