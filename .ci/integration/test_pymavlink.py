"""Basic services with pymavlink, message by message."""

import socket
import statistics
import time

import pytest
from conftest import is_armed
from plans import MISSION, differences, plan
from pymavlink import mavutil
from rates import steady_gaps
from transfer import clear, download, send_item, upload

mavlink = mavutil.mavlink

def test_heartbeat_has_identity_and_rate(gcs, figure):
    """H-1 to H-4: identity and rate."""

    def next_time():
        heartbeat = gcs.wait("HEARTBEAT", timeout=3)
        assert heartbeat, "a heartbeat is missing"
        assert (heartbeat.get_srcSystem(), heartbeat.get_srcComponent()) == (1, 1)
        assert heartbeat.type == mavlink.MAV_TYPE_QUADROTOR
        assert heartbeat.autopilot == mavlink.MAV_AUTOPILOT_GENERIC
        assert heartbeat.mavlink_version == 3
        assert not is_armed(heartbeat)
        return time.monotonic()

    is_right = lambda gaps: abs(statistics.mean(gaps) - 1) < 0.03 and 0.5 < min(gaps) and max(gaps) < 1.5
    gaps = steady_gaps(next_time, 11, is_right)
    figure(f"heartbeat: mean {statistics.mean(gaps):.4f} s, {min(gaps):.3f} to {max(gaps):.3f} s")


def test_autopilot_version_on_request(gcs):
    """Q-1, Q-9: the message follows its ACCEPTED, and reports exactly the existing capabilities."""
    gcs.send_command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    got = {}
    for _ in range(2):
        message = gcs.wait(["COMMAND_ACK", "AUTOPILOT_VERSION"])
        assert message, f"only {list(got)} came"
        got[message.get_type()] = message
    assert got["COMMAND_ACK"].result == mavlink.MAV_RESULT_ACCEPTED
    capabilities = got["AUTOPILOT_VERSION"].capabilities
    has = "MISSION_INT MISSION_FENCE MISSION_RALLY COMMAND_INT MAVLINK2 FTP COMPONENT_IMPLEMENTS_GIMBAL_MANAGER"
    for bit in has.split():
        assert capabilities & getattr(mavlink, f"MAV_PROTOCOL_CAPABILITY_{bit}"), f"{bit} is missing"
    for bit in ("FLIGHT_TERMINATION", "SET_ATTITUDE_TARGET", "PARAM_ENCODE_C_CAST"):
        assert not capabilities & getattr(mavlink, f"MAV_PROTOCOL_CAPABILITY_{bit}"), f"{bit} is claimed"


@pytest.mark.parametrize(
    "command, params, result",
    [
        (42424, (), "UNSUPPORTED"),
        (mavlink.MAV_CMD_REQUEST_MESSAGE, (16_000_000,), "DENIED"),
        (mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (0.5,), "DENIED"),
        (mavlink.MAV_CMD_NAV_TAKEOFF, (), "TEMPORARILY_REJECTED"),
    ],
)
def test_command_gets_exactly_one_answer(gcs, command, params, result):
    """C-3, C-4: this includes refused and unknown commands."""
    assert gcs.command(command, *params) == getattr(mavlink, f"MAV_RESULT_{result}")
    assert gcs.wait("COMMAND_ACK", timeout=1.5) is None, "a second answer"


def test_script_with_default_settings_is_answered(port):
    """S-11: without `source_component`, pymavlink sends as component 0."""
    link = mavutil.mavlink_connection(f"tcp:127.0.0.1:{port}")
    try:
        assert link.wait_heartbeat(timeout=5)
        link.mav.command_long_send(1, 1, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, 148, 0, 0, 0, 0, 0, 0)
        assert link.recv_match(type="COMMAND_ACK", blocking=True, timeout=3).result == mavlink.MAV_RESULT_ACCEPTED
        assert link.recv_match(type="AUTOPILOT_VERSION", blocking=True, timeout=3)
    finally:
        link.close()


def test_mavlink_1_station_downloads_a_plan(gcs):
    """S-8: with `force_mavlink1`, pymavlink sends a message's extensions too."""
    items = plan(3)
    assert upload(gcs, items).type == mavlink.MAV_MISSION_ACCEPTED
    gcs.mav.mission_request_list_send(1, 1, MISSION, force_mavlink1=True)
    count = gcs.wait("MISSION_COUNT")
    assert count and count.count == 3
    for seq in range(3):
        gcs.mav.mission_request_int_send(1, 1, seq, MISSION, force_mavlink1=True)
        item = gcs.wait("MISSION_ITEM_INT")
        assert item and item.seq == seq
    gcs.mav.mission_ack_send(1, 1, mavlink.MAV_MISSION_ACCEPTED, MISSION, force_mavlink1=True)


def test_command_for_another_component_is_not_answered(gcs):
    """C-2."""
    gcs.mav.command_long_send(1, 77, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
    gcs.mav.command_long_send(2, 1, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
    assert gcs.wait("COMMAND_ACK", timeout=1.5) is None
    assert not is_armed(gcs.wait("HEARTBEAT"))


def test_plan_is_uploaded_downloaded_and_cleared(gcs):
    """M-20, M-39, M-50, M-60."""
    items = plan(12)
    assert upload(gcs, items).type == mavlink.MAV_MISSION_ACCEPTED
    assert differences(items, download(gcs).items) == []
    assert clear(gcs) == mavlink.MAV_MISSION_ACCEPTED
    assert download(gcs) == (0, [])
    assert clear(gcs) == mavlink.MAV_MISSION_ACCEPTED, "clearing is idempotent (M-52)"


def test_full_plan(gcs, capacity, figure):
    """Fills the capacity, one item at a time."""
    items = plan(capacity)
    began = time.monotonic()
    assert upload(gcs, items).type == mavlink.MAV_MISSION_ACCEPTED
    uploaded = time.monotonic()
    assert differences(items, download(gcs).items) == []
    figure(f"pymavlink: {capacity} items up {uploaded - began:.1f} s, down {time.monotonic() - uploaded:.1f} s")
    assert clear(gcs) == mavlink.MAV_MISSION_ACCEPTED


def test_plan_that_is_too_long_is_refused_before_its_first_item(gcs, capacity):
    """M-21."""
    items = plan(3)
    assert upload(gcs, items).type == mavlink.MAV_MISSION_ACCEPTED
    gcs.mav.mission_count_send(1, 1, capacity + 1, MISSION)
    message = gcs.wait(["MISSION_REQUEST_INT", "MISSION_ACK"])
    assert message.get_type() == "MISSION_ACK" and message.type == mavlink.MAV_MISSION_NO_SPACE
    assert differences(items, download(gcs).items) == []


def test_refused_item_keeps_the_old_plan(gcs):
    """M-1, M-38, M-73: the plan is refused with a result code and a text that names the item, and nothing changes."""
    items = plan(3)
    assert upload(gcs, items).type == mavlink.MAV_MISSION_ACCEPTED
    bad = plan(5)
    bad[2]["command"] = mavlink.MAV_CMD_NAV_SPLINE_WAYPOINT
    assert upload(gcs, bad).type == mavlink.MAV_MISSION_UNSUPPORTED
    assert gcs.wait("STATUSTEXT", where=lambda text: "2" in text.text), "no text names item 2"
    assert differences(items, download(gcs).items) == []


def test_disconnect_inside_a_frame_does_not_affect_the_next_client(connect):
    for _ in range(3):
        gcs = connect()
        request = gcs.mav.command_long_encode(
            1, 1, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION, 0, 0, 0, 0, 0, 0
        )
        frame = request.pack(gcs.mav)
        gcs.link.write(frame[: len(frame) // 2])
        gcs.close()

        # Sent once: the rest of the first client's frame must not cost the second client its first frame.
        gcs = connect()
        assert gcs.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 148) == mavlink.MAV_RESULT_ACCEPTED
        assert gcs.wait("AUTOPILOT_VERSION")
        gcs.close()


def test_upload_can_restart_after_a_disconnect(connect):
    """M-1, M-22: the old plan stays until the new one is complete."""
    gcs = connect()
    old, new = plan(4), plan(9)
    assert upload(gcs, old).type == mavlink.MAV_MISSION_ACCEPTED
    gcs.mav.mission_count_send(1, 1, len(new), MISSION)
    for seq in range(3):
        assert gcs.wait("MISSION_REQUEST_INT", where=lambda request: request.seq == seq)
        send_item(gcs, new[seq])
    gcs.close()

    gcs = connect()
    assert differences(old, download(gcs).items) == []
    assert upload(gcs, new).type == mavlink.MAV_MISSION_ACCEPTED
    assert differences(new, download(gcs).items) == []


def test_second_client_on_a_busy_port(connect, port, target):
    """sitl closes the second TCP connection; QEMU leaves it waiting. The first client is still served."""
    gcs = connect()
    with socket.create_connection(("127.0.0.1", port), timeout=3) as second:
        if target == "sitl":
            assert second.recv(1) == b"", "the second connection is not closed at once"
        assert gcs.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 148) == mavlink.MAV_RESULT_ACCEPTED


def test_all_three_links_at_once(gcs, other, port):
    """The companion's link carries heartbeats, the satellite link does not (H-7). Neither disturbs telemetry."""
    satellite = mavutil.mavlink_connection(f"tcp:127.0.0.1:{port + 2}", source_system=255, source_component=190)
    try:
        assert other.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 148) == mavlink.MAV_RESULT_ACCEPTED
        assert gcs.wait("COMMAND_ACK", timeout=0.5) is None, "the answer was also sent on another link"
        assert satellite.recv_match(type="HEARTBEAT", blocking=True, timeout=2.5) is None
        assert gcs.wait("HEARTBEAT") and other.wait("HEARTBEAT")
    finally:
        satellite.close()
