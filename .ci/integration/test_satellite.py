"""The high-latency link: from the radio to the satellite and back, as the protocol's document tells it, and what that
costs. Every byte that leaves is looked at."""

import threading

import pytest
from companion import Companion
from conftest import Gcs, is_armed
from plans import plan
from pymavlink import mavutil
from satellite import START, STOP, Satellite
from test_mavproxy import MavProxy
from test_params import REAL32, UINT16, read, write
from transfer import upload

mavlink = mavutil.mavlink

ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
DENIED = mavlink.MAV_RESULT_DENIED
# As the vehicle has it in 16 bits: PX4's modes, main and sub.
HOLD, RETURN = 4 | 3 << 8, 4 | 5 << 8
# Seconds from one report to the next.
PERIOD = 2


@pytest.fixture
def satellite(port, other):
    """A modem that reports often."""
    write(other, "MAV_2_HL_FREQ", REAL32, 1 / PERIOD)
    satellite = Satellite(port + 2)
    yield satellite
    satellite.control(STOP)
    satellite.listen(0.5)
    satellite.end()
    write(other, "MAV_HL_LOSS_T", UINT16, 0)
    write(other, "MAV_2_HL_FREQ", REAL32, 0.015)


@pytest.fixture
def beating(port):
    """Ground stations on the radio that beat until they are lost."""
    beating = []

    class Beating(Gcs):
        def __init__(self):
            super().__init__(port)
            self.ended = threading.Event()
            self.beat()
            beating.append(self)

        def beat(self):
            self.ended.clear()
            self.thread = threading.Thread(target=self._beat, daemon=True)
            self.thread.start()

        def _beat(self):
            while not self.ended.is_set():
                invalid = mavlink.MAV_AUTOPILOT_INVALID
                self.mav.heartbeat_send(mavlink.MAV_TYPE_GCS, invalid, 0, 0, mavlink.MAV_STATE_ACTIVE)
                self.ended.wait(0.5)

        def fall_silent(self):
            self.ended.set()
            self.thread.join()

    yield Beating
    for gcs in beating:
        gcs.fall_silent()
        gcs.close()


def kinds(messages):
    return [message.get_type() for message in messages]


def count(other, name):
    """How much the vehicle says that it was."""
    other.drain()
    return read(other, name).value


def test_handover(satellite, other, beating, figure):
    """L-3, L-10, L-11, L-15, L-23: link lost, START, HIGH_LATENCY2 and nothing else, link back, STOP."""
    before = {name: count(other, name) for name in ("STAT_HL_BYTES", "STAT_HL_CREDITS")}
    gcs = beating()
    assert satellite.listen(2) == [], "nothing while the radio works"

    gcs.fall_silent()
    gcs.close()
    assert satellite.control(START) == ACCEPTED
    (report,) = satellite.until("HIGH_LATENCY2", timeout=1.5)
    assert (report.get_srcSystem(), report.get_srcComponent()) == (1, 1)
    assert (report.type, report.autopilot) == (mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_GENERIC)
    assert (report.custom_mode, report.failure_flags, report.wp_num) == (HOLD, 0, 65_535)
    assert abs(report.latitude - 473_977_420) < 100 and abs(report.longitude - 85_455_940) < 100
    assert (report.altitude, report.groundspeed, report.windspeed, report.temperature_air) == (488, 0, 0, -128)
    assert 0 < report.battery <= 100 and (report.eph, report.epv) == (9, 14)
    stamps = [report.timestamp, *(each.timestamp for each in satellite.until("HIGH_LATENCY2", 3, timeout=4 * PERIOD))]
    gaps = [b - a for a, b in zip(stamps, stamps[1:])]
    assert all(abs(gap - 1000 * PERIOD) <= 300 for gap in gaps), gaps
    assert satellite.listen(0.5) == [], "no heartbeat, no telemetry, no text"
    # Again: one more at once, and the period begins anew.
    assert satellite.control(START) == ACCEPTED
    satellite.until("HIGH_LATENCY2", timeout=1.5)

    # The radio is back: both run at once, until the ground says that one is enough.
    gcs = beating()
    satellite.until("HIGH_LATENCY2", 2, timeout=3 * PERIOD)
    assert gcs.wait("HEARTBEAT") and gcs.wait("ATTITUDE")
    assert not gcs.wait("HIGH_LATENCY2", 1), "never over the radio (L-2)"
    assert gcs.command(mavlink.MAV_CMD_CONTROL_HIGH_LATENCY, STOP) == ACCEPTED
    assert gcs.command(mavlink.MAV_CMD_CONTROL_HIGH_LATENCY, STOP) == ACCEPTED
    satellite.listen(0.5)
    assert satellite.listen(2 * PERIOD) == []

    # What the vehicle has counted is what came.
    spent = {name: count(other, name) - was for name, was in before.items()}
    assert spent == {"STAT_HL_BYTES": len(satellite.received), "STAT_HL_CREDITS": satellite.credits()}
    sent = f"{len(satellite.frames())} messages, {len(satellite.received)} bytes, {satellite.credits()} credits"
    figure(f"handover by satellite and back: {sent}")


def test_it_reports_by_itself(satellite, other, beating):
    """L-14: when the last ground station is lost, and until there is one again."""
    write(other, "MAV_HL_LOSS_T", UINT16, 2)
    gcs = beating()
    assert satellite.listen(2) == []
    gcs.fall_silent()
    # 5 s until it counts as lost, and the 2; the vehicle goes on talking to it.
    assert satellite.listen(5.5) == []
    satellite.until("HIGH_LATENCY2", 2, timeout=2 + 2 * PERIOD)
    assert gcs.wait("HEARTBEAT")
    gcs.beat()
    satellite.listen(1)
    assert satellite.listen(2 * PERIOD) == []


@pytest.mark.parametrize("enable", [0.5, 2, -1, float("nan")])
def test_neither_start_nor_stop(satellite, enable):
    """L-10"""
    assert satellite.control(enable) == DENIED
    assert satellite.listen(1) == []


def test_commands_that_may_be_old(satellite, gcs):
    """L-16: it does not begin to fly for them; in the air it comes home."""
    assert satellite.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == DENIED
    assert gcs.wait("STATUSTEXT", where=lambda text: "by satellite" in text.text)
    assert not is_armed(gcs.wait("HEARTBEAT"))
    assert gcs.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == ACCEPTED
    assert satellite.command(mavlink.MAV_CMD_NAV_TAKEOFF) == DENIED
    assert upload(gcs, plan(3)).type == mavlink.MAV_MISSION_ACCEPTED
    assert satellite.command(mavlink.MAV_CMD_MISSION_START) == DENIED
    assert gcs.command(mavlink.MAV_CMD_NAV_TAKEOFF) == ACCEPTED
    assert gcs.wait("VFR_HUD", 15, lambda hud: hud.alt > 493), "it does not take off"
    assert satellite.control(START) == ACCEPTED
    assert satellite.command(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH) == ACCEPTED
    assert satellite.control(START) == ACCEPTED
    reports = satellite.until("HIGH_LATENCY2", 2)
    assert reports[-1].custom_mode == RETURN and reports[-1].altitude >= 493 and reports[-1].throttle > 0


def test_nothing_else_leaves(satellite, other, gcs):
    """L-4: whatever is asked, there or elsewhere, and whoever speaks."""
    companion = Companion(other)
    try:
        mav = satellite.mav
        mav.heartbeat_send(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE)
        mav.param_request_list_send(1, 1)
        mav.param_request_read_send(1, 1, b"NAV_ACC_RAD", -1)
        mav.param_set_send(1, 1, b"NAV_ACC_RAD", 9, REAL32)
        mav.mission_request_list_send(1, 1)
        mav.mission_count_send(1, 1, 5)
        mav.mission_clear_all_send(1, 1)
        mav.ping_send(1, 1, 0, 0)
        mav.timesync_send(0, 1)
        mav.request_data_stream_send(1, 1, 0, 10, 1)
        mav.manual_control_send(1, 0, 0, 500, 0, 0)
        mav.file_transfer_protocol_send(0, 1, 1, bytes(251))
        gcs.mav.statustext_send(mavlink.MAV_SEVERITY_ALERT, b"for everybody")
        gcs.mav.ping_send(1, 1, 0, 0)
        companion.mav.statustext_send(mavlink.MAV_SEVERITY_ALERT, b"for everybody")
        companion.mav.param_request_list_send(*satellite.address)
        assert satellite.listen(3) == []
        assert read(other, "NAV_ACC_RAD").value == 2.0
        for name in ("HEARTBEAT", "AUTOPILOT_VERSION", "ATTITUDE", "HIGH_LATENCY2"):
            number = getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
            satellite.command(mavlink.MAV_CMD_REQUEST_MESSAGE, number)
            satellite.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, 200_000)
        assert satellite.listen(2) == []
        # While it reports, all of it once more.
        assert satellite.control(START) == ACCEPTED
        assert satellite.command(mavlink.MAV_CMD_RUN_PREARM_CHECKS) == ACCEPTED
        mav.param_request_list_send(1, 1)
        assert set(kinds(satellite.listen(2 * PERIOD))) == {"HIGH_LATENCY2"}
    finally:
        companion.end()


def test_a_command_for_the_companion(satellite, other):
    """R-13: it comes by satellite, and its answer goes back."""
    companion = Companion(other)
    try:
        other.drain()
        companion.beat()
        satellite.listen(0.5)
        satellite.mav.command_long_send(1, 191, 31_010, 0, 1, 2, 3, 4, 5, 6, 7)
        asked = companion.hear("COMMAND_LONG")
        assert asked and (asked.command, asked.param7) == (31_010, 7)
        companion.mav.command_ack_send(31_010, ACCEPTED, 0, 0, *satellite.address)
        (ack,) = satellite.until("COMMAND_ACK")
        assert ack.get_srcComponent() == 191
    finally:
        companion.end()


def test_mavproxy_over_the_satellite(other, port, tmp_path):
    """L-24: its user switches it on, and sees the vehicle."""
    mavproxy = MavProxy(port + 2, tmp_path)
    try:
        mavproxy.say("link hl on")
        mavproxy.expect_all("CONTROL_HIGH_LATENCY: ACCEPTED", "Detected vehicle 1:1")
        mavproxy.say("link hl off")
        mavproxy.expect("CONTROL_HIGH_LATENCY: ACCEPTED")
    finally:
        mavproxy.end()
        other.command(mavlink.MAV_CMD_CONTROL_HIGH_LATENCY, STOP)
