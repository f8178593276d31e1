"""Forwarding between a ground station on the telemetry link and a companion computer on its link."""

import json
import queue
import threading
import time

import pytest
from companion import ADDRESS, Companion
from mavsdk.plugins.mavlink_direct import MavlinkDirect
from mavsdk.plugins.mavlink_direct.mavlink_direct import MavlinkMessage
from mavsdk.plugins.telemetry import Telemetry
from pymavlink import mavutil
from satellite import Satellite
from test_mavproxy import MavProxy

mavlink = mavutil.mavlink

ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
REQUEST = mavlink.MAV_CMD_REQUEST_MESSAGE
VERSION = mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION
# MAVSDK retransmits a command after 0.5 s without an answer; less the time of the answer on its way (s).
MAVSDK_RETRY = 0.45


@pytest.fixture
def companion(other):
    companion = Companion(other)
    yield companion
    companion.end()


@pytest.fixture
def satellite(port):
    """Checks that the vehicle forwards nothing to the satellite during the test."""
    satellite = Satellite(port + 2)
    yield satellite
    satellite.listen(0.5)
    satellite.end()
    assert satellite.received == b"", "something was forwarded to the satellite"


def until(condition, timeout, what):
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, f"not in {timeout} s: {what}"
        time.sleep(0.05)


def is_from(message, address):
    return (message.get_srcSystem(), message.get_srcComponent()) == address


def test_mavsdk_and_the_companion(system, companion, satellite):
    """R-1, R-2, R-16: heartbeats, texts, and a command with its answer in each direction."""
    beat = companion.hear("HEARTBEAT", 5, lambda beat: beat.type == mavlink.MAV_TYPE_GCS)
    assert beat, "MAVSDK's heartbeat is not forwarded"
    ground = (beat.get_srcSystem(), beat.get_srcComponent())
    until(lambda: ADDRESS[1] in system.component_ids(), 5, "MAVSDK sees the companion")

    # MAVSDK sends a command to the companion.
    direct = MavlinkDirect(system)
    answers = queue.SimpleQueue()
    fields = dict(target_system=1, target_component=ADDRESS[1], command=31_010, param1=7.5, param2=-1.0)
    command = MavlinkMessage("COMMAND_LONG", 0, 0, *ADDRESS, json.dumps(fields))
    began = time.monotonic()
    threading.Thread(target=lambda: answers.put(direct.send_command(command)), daemon=True).start()
    asked = companion.hear("COMMAND_LONG")
    assert asked and is_from(asked, ground)
    assert (asked.command, asked.param1, asked.param2) == (31_010, 7.5, -1.0)
    companion.mav.command_ack_send(31_010, ACCEPTED, 0, 42, *ground)
    took = time.monotonic() - began
    answer = answers.get(timeout=5)
    assert (answer.system_id, answer.component_id) == ADDRESS
    told = json.loads(answer.fields_json)
    assert (told["result"], told["result_param2"]) == (ACCEPTED, 42)
    # MAVSDK retransmits after half a second. On a busy machine this program may answer later.
    again = companion.hear("COMMAND_LONG", 1)
    assert not again or took > MAVSDK_RETRY, "MAVSDK retransmitted the command: the answer was late or lost"

    # The companion sends a command to MAVSDK, and the test answers it.
    asked = queue.SimpleQueue()
    direct.subscribe_message("COMMAND_LONG", lambda message, _: asked.put(message))
    companion.mav.command_long_send(*ground, 31_011, 0, 42, 0, 0, 0, 0, 0, 0)
    message = asked.get(timeout=3)
    assert (message.system_id, message.component_id) == ADDRESS
    told = json.loads(message.fields_json)
    assert (told["command"], told["param1"]) == (31_011, 42)
    fields = dict(command=31_011, result=mavlink.MAV_RESULT_DENIED, target_system=1, target_component=ADDRESS[1])
    direct.send_message(MavlinkMessage("COMMAND_ACK", 0, 0, *ADDRESS, json.dumps(fields)))
    ack = companion.hear("COMMAND_ACK")
    assert ack and is_from(ack, ground) and (ack.command, ack.result) == (31_011, mavlink.MAV_RESULT_DENIED)
    assert (ack.target_system, ack.target_component) == ADDRESS

    # Both send a command to the vehicle, and each receives only its own answer.
    companion.mav.command_long_send(1, 1, REQUEST, 0, VERSION, 0, 0, 0, 0, 0, 0)
    ack = companion.line.wait("COMMAND_ACK")
    assert (ack.result, ack.target_system, ack.target_component) == (ACCEPTED, *ADDRESS)
    heard = queue.SimpleQueue()
    direct.subscribe_message("COMMAND_ACK", lambda message, _: heard.put(message))
    fields = dict(target_system=1, target_component=1, command=REQUEST, param1=VERSION)
    direct.send_command(MavlinkMessage("COMMAND_LONG", 0, 0, 1, 1, json.dumps(fields)))
    assert heard.get(timeout=3).component_id == 1
    assert not companion.line.wait("COMMAND_ACK", 1)

    # The companion's texts are broadcast.
    texts, messages = queue.SimpleQueue(), queue.SimpleQueue()
    Telemetry(system).subscribe_status_text(lambda text, _: texts.put(text.text))
    direct.subscribe_message("STATUSTEXT", lambda message, _: messages.put(message))
    companion.mav.statustext_send(mavlink.MAV_SEVERITY_NOTICE, b"obstacle map ready")
    message = messages.get(timeout=3)
    assert (message.system_id, message.component_id) == ADDRESS
    assert json.loads(message.fields_json)["text"] == "obstacle map ready"
    assert texts.get(timeout=3) == "obstacle map ready"


def test_addressed_and_broadcast_commands(gcs, companion, satellite):
    """R-1, R-2: commands to one component, to a system, to all systems, and to an unknown target."""

    def ask(*target):
        gcs.mav.command_long_send(*target, REQUEST, 0, VERSION, 0, 0, 0, 0, 0, 0)

    # Teaches the vehicle the route to the ground station.
    gcs.mav.heartbeat_send(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE)
    assert companion.hear("HEARTBEAT", where=lambda beat: is_from(beat, gcs.address))
    for target, is_answered, is_forwarded in [
        (ADDRESS, False, True),
        ((1, 1), True, False),
        ((1, 0), True, True),
        ((0, 0), True, True),
        ((1, 77), False, False),
        ((9, 0), False, False),
        ((9, 1), False, False),
    ]:
        ask(*target)
        ack = gcs.wait("COMMAND_ACK", 3 if is_answered else 0.7)
        assert bool(ack) == is_answered, target
        asked = companion.hear("COMMAND_LONG", 3 if is_forwarded else 0.3)
        assert bool(asked) == is_forwarded, target
        assert not asked or (asked.target_system, asked.target_component) == target
    # No frame is sent back to its sender.
    gcs.drain()
    gcs.mav.heartbeat_send(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE)
    assert not gcs.hear("HEARTBEAT", 2, lambda beat: is_from(beat, gcs.address))


def test_frames_are_forwarded_unchanged(gcs, companion, satellite):
    """R-5, R-9, R-10: forwarded frames are identical in every byte, even if the vehicle does not know the message and cannot check
    it."""
    tunnel = mavlink.MAVLink_tunnel_message(0, 0, 40_000, 100, bytes(range(100)).ljust(128, b"\0"))
    companion.mav.seq = 200
    sent = [companion.send(tunnel)]
    # Trailing zeros that were not trimmed, a signature, an unknown flag.
    payload = b"\x01\x02\x00\x00"
    signed = bytes([0xFD, 4, 1, 0x40, 201, *ADDRESS, 0x01, 0x81, 0x02]) + payload + b"\xaa\xbb" + bytes(range(13))
    unknown = bytes([0xFD, 4, 0, 0, 202, *ADDRESS, 0x02, 0x81, 0x02]) + payload + b"\xcc\xdd"
    old = bytes([0xFE, 4, 203, *ADDRESS, 199]) + payload + b"\xee\xff"
    for frame in (signed, unknown, old):
        companion.line.link.write(frame)
        sent.append(frame)
        # The decoder accepts a frame that it cannot check only if silence follows.
        time.sleep(0.15)
    companion.mav.seq = 204
    found = b""
    deadline = time.monotonic() + 5
    while any(frame not in found for frame in sent) and time.monotonic() < deadline:
        found += gcs.link.recv(4096) or b""
    assert [frame in found for frame in sent] == [True] * 4
    # The frames are not sent back on the companion's link.
    assert not companion.hear("TUNNEL", 0.5)


def test_keys_are_not_forwarded(gcs, companion, satellite):
    """R-11"""
    for target in [ADDRESS, (0, 0)]:
        gcs.mav.setup_signing_send(*target, bytes(range(32)), 1)
    gcs.mav.radio_status_send(200, 200, 50, 10, 10, 0, 0)
    assert not companion.hear(["SETUP_SIGNING", "RADIO_STATUS"], 1)


def test_flooding_companion_does_not_delay_answers(gcs, companion, satellite, figure):
    """R-14: forwarding does not delay the vehicle's answers. Frames that exceed the radio's rate are dropped as a whole."""
    ended = threading.Event()

    def talk():
        while not ended.is_set():
            companion.mav.statustext_send(mavlink.MAV_SEVERITY_DEBUG, b"a line of a log that never comes to its end")
            # Twice the rate that the telemetry link carries.
            time.sleep(0.0025)

    talker = threading.Thread(target=talk, daemon=True)
    talker.start()
    try:
        time.sleep(0.5)
        gcs.drain()
        times = []
        for _ in range(30):
            began = time.monotonic()
            assert gcs.command(REQUEST, VERSION) == ACCEPTED
            times.append(time.monotonic() - began)
        gcs.drain()
        time.sleep(1)
        kinds = [message.get_type() for message in gcs.take_all()]
    finally:
        ended.set()
        talker.join()
    worst, median = max(times), sorted(times)[len(times) // 2]
    heard = kinds.count("STATUSTEXT")
    figure(f"a companion talks without end: {heard} lines/s arrive; answers {1e3 * median:.0f} ms, {1e3 * worst:.0f} at most")
    assert median < 0.1 and worst < 1
    assert 20 < heard < 300 and "BAD_DATA" not in kinds and "ATTITUDE" in kinds
    gcs.drain()
    assert gcs.wait("HEARTBEAT")


def test_mavproxy_detects_the_companion(companion, satellite, port, tmp_path):
    """R-16: MAVProxy detects the companion and shows its texts."""
    mavproxy = MavProxy(port, tmp_path)
    try:
        mavproxy.expect_all("Detected vehicle 1:1 ", f"Detected vehicle 1:{ADDRESS[1]} ")
        # MAVProxy shows the texts of one component at a time.
        mavproxy.say(f"vehicle 1:{ADDRESS[1]}")
        text = "obstacle map ready"
        mavproxy.repeat_until(lambda: companion.mav.statustext_send(mavlink.MAV_SEVERITY_NOTICE, text.encode()), text)
        assert companion.hear("HEARTBEAT", 3, lambda beat: beat.type == mavlink.MAV_TYPE_GCS)
    finally:
        mavproxy.end()
