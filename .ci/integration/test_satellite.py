"""The high-latency link: the handover from the radio to the satellite and back, as the protocol describes it, and its cost. Every
byte that is sent on the link is checked."""

import math
import threading

import pytest
from companion import Companion
from conftest import Gcs, is_armed
from plans import HOME, plan
from pymavlink import mavutil
from rates import steady_gaps
from satellite import START, STOP, Satellite
from test_mavproxy import MavProxy
from test_params import INT32, REAL32, read, write
from transfer import upload

mavlink = mavutil.mavlink

ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
DENIED = mavlink.MAV_RESULT_DENIED
LATER = mavlink.MAV_RESULT_TEMPORARILY_REJECTED
# The 16-bit form of the modes in HIGH_LATENCY2: PX4's main mode and sub-mode.
HOLD, MISSION, RETURN = 4 | 3 << 8, 4 | 4 << 8, 4 | 5 << 8
# wp_num while no mission is flown.
NO_ITEM = 65_535
# The time between two reports (s).
PERIOD = 2


@pytest.fixture
def satellite(port, other):
    """A satellite modem on a link with a short report period."""
    write(other, "MAV_2_HL_FREQ", REAL32, 1 / PERIOD)
    satellite = Satellite(port + 2)
    yield satellite
    # A STOP that looks like a duplicate of an earlier one must be sent again.
    while satellite.control(STOP) == LATER:
        pass
    satellite.listen(0.5)
    satellite.end()
    write(other, "MAV_HL_LOSS_T", INT32, 0)
    write(other, "MAV_2_HL_FREQ", REAL32, 0.015)


@pytest.fixture
def beating(port):
    """Ground stations on the radio that send heartbeats until they fall silent."""
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
    """Returns the value of one of the vehicle's counters."""
    other.drain()
    return read(other, name).value


def test_handover(satellite, other, beating, figure):
    """L-3, L-10, L-11, L-15, L-23: the radio is lost, START, only HIGH_LATENCY2 is sent, the radio is back, STOP."""
    before = {name: count(other, name) for name in ("STAT_HL_BYTES", "STAT_HL_CREDITS")}
    gcs = beating()
    assert satellite.listen(2) == [], "a message was sent although the radio works"

    gcs.fall_silent()
    gcs.close()
    assert satellite.control(START) == ACCEPTED
    (report,) = satellite.until("HIGH_LATENCY2", timeout=1.5)
    assert (report.get_srcSystem(), report.get_srcComponent()) == (1, 1)
    assert (report.type, report.autopilot) == (mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_GENERIC)
    assert (report.custom_mode, report.failure_flags, report.wp_num) == (HOLD, 0, NO_ITEM)
    assert abs(report.latitude - 473_977_420) < 100 and abs(report.longitude - 85_455_940) < 100
    assert (report.altitude, report.groundspeed, report.windspeed, report.temperature_air) == (488, 0, 0, -128)
    assert 0 < report.battery <= 100 and (report.eph, report.epv) == (9, 14)
    # In seconds, by the vehicle's clock.
    next_time = lambda: satellite.until("HIGH_LATENCY2", timeout=2 * PERIOD)[-1].timestamp / 1000
    steady_gaps(next_time, 3, lambda gaps: all(abs(gap - PERIOD) <= 0.3 for gap in gaps))
    assert set(kinds(satellite.listen(0.5))) <= {"HIGH_LATENCY2"}, "another message was sent"
    # A second START causes one more report at once, and restarts the period.
    assert satellite.control(START) == ACCEPTED
    satellite.until("HIGH_LATENCY2", timeout=1.5)

    # The radio is back. Both links are in use until the ground station stops the reports.
    gcs = beating()
    satellite.until("HIGH_LATENCY2", 2, timeout=3 * PERIOD)
    assert gcs.wait("HEARTBEAT") and gcs.wait("ATTITUDE")
    assert not gcs.wait("HIGH_LATENCY2", 1), "HIGH_LATENCY2 was sent on the radio (L-2)"
    assert gcs.command(mavlink.MAV_CMD_CONTROL_HIGH_LATENCY, STOP) == ACCEPTED
    assert gcs.command(mavlink.MAV_CMD_CONTROL_HIGH_LATENCY, STOP) == ACCEPTED
    satellite.listen(0.5)
    assert satellite.listen(2 * PERIOD) == []

    # The vehicle's counters agree with the received bytes.
    spent = {name: count(other, name) - was for name, was in before.items()}
    assert spent == {"STAT_HL_BYTES": len(satellite.received), "STAT_HL_CREDITS": satellite.credits()}
    sent = f"{len(satellite.frames())} messages, {len(satellite.received)} bytes, {satellite.credits()} credits"
    figure(f"handover by satellite and back: {sent}")


def test_mission_progress_is_reported_by_satellite(satellite, other, gcs):
    """What QGroundControl shows of a flight: the mode, which it shifts by 16 bits to that of the heartbeat, and the current item,
    which is the same as on the radio."""
    write(other, "MAV_2_HL_FREQ", REAL32, 1)
    waypoint = dict(plan(2)[1], param1=0.0, param2=0.0, param4=math.nan, z=6.0)
    corners = [(200, 0), (200, 200), (0, 200), (0, 0)]
    items = [dict(waypoint, seq=seq, x=HOME[0] + n, y=HOME[1] + e) for seq, (n, e) in enumerate(corners)]
    assert upload(gcs, [dict(item, param1=1.5) for item in items]).type == mavlink.MAV_MISSION_ACCEPTED
    assert gcs.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == ACCEPTED
    assert gcs.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 5) == ACCEPTED
    assert gcs.wait("VFR_HUD", 15, lambda hud: hud.alt > 492), "it does not take off"
    assert gcs.command(mavlink.MAV_CMD_CONTROL_HIGH_LATENCY, START) == ACCEPTED
    assert gcs.command(mavlink.MAV_CMD_MISSION_START, 0, 0) == ACCEPTED
    flown = []
    reports = []
    while not flown or flown[-1] != NO_ITEM:
        reports += satellite.until("HIGH_LATENCY2", timeout=3)
        if reports[-1].custom_mode == MISSION or flown:
            flown.append(reports[-1].wp_num)
        assert len(reports) < 90, flown
        messages = gcs.take_all()
        told = {each.custom_mode for each in messages if each.get_type() == "HEARTBEAT" and each.get_srcComponent() == 1}
        at = [each.seq for each in messages if each.get_type() == "MISSION_CURRENT"]
        if told == {reports[-1].custom_mode << 16} and len(set(at)) == 1 and reports[-1].custom_mode == MISSION:
            # The vehicle may advance to the next item between two messages.
            assert reports[-1].wp_num - at[0] in (0, 1), (reports[-1], at)
    assert sorted(set(flown)) == [0, 1, 2, 3, NO_ITEM] and flown == sorted(flown), flown
    modes = {report.custom_mode for report in reports if report.wp_num != NO_ITEM}
    assert modes == {MISSION} and reports[-1].custom_mode == HOLD
    assert {report.failure_flags for report in reports} == {0}
    assert all(abs(report.latitude - HOME[0]) < 400 and 492 <= report.altitude <= 496 for report in reports[1:])


def test_failures_are_reported_by_satellite(vehicle, port):
    """HIGH_LATENCY2 reports the failures of SYS_STATUS in its own flags: here a GPS receiver without a fix."""
    # After this, the vehicle has been running for less than a minute.
    vehicle.cut()
    write(vehicle.gcs, "SIM_GPS_FIX_TIME", INT32, 60_000)
    try:
        satellite = Satellite(getattr(vehicle, "port", port) + 2)

        def has_fix(status):
            return status.onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_SENSOR_GPS

        assert vehicle.gcs.wait("SYS_STATUS", where=lambda status: not has_fix(status))
        satellite.listen(0.3)
        assert satellite.control(START) == ACCEPTED
        (report,) = satellite.until("HIGH_LATENCY2")
        assert report.failure_flags == mavlink.HL_FAILURE_FLAG_GPS
        assert (report.latitude, report.longitude, report.eph, report.epv) == (0, 0, 255, 255)
        write(vehicle.gcs, "SIM_GPS_FIX_TIME", INT32, 2_000)
        assert vehicle.gcs.wait("SYS_STATUS", 5, has_fix)
        satellite.listen(0.3)
        assert satellite.control(START) == ACCEPTED
        # Ten seconds after the last one that was forced (L-17).
        (report,) = satellite.until("HIGH_LATENCY2", timeout=12)
        assert report.failure_flags == 0 and abs(report.latitude - HOME[0]) < 100
        assert satellite.control(STOP) == ACCEPTED
        satellite.end()
    finally:
        write(vehicle.gcs, "SIM_GPS_FIX_TIME", INT32, 2_000)


def test_superseded_commands_by_satellite(satellite, other, beating):
    """L-15, L-16: if the sender is heard by radio and sent STOP there, its START by satellite counts as superseded. A sender that is
    heard by satellite only is believed."""
    gcs = beating()
    # Within three seconds this STOP would count as a duplicate of the previous test's STOP by satellite.
    satellite.listen(3.5)
    assert gcs.command(mavlink.MAV_CMD_CONTROL_HIGH_LATENCY, STOP) == ACCEPTED
    assert satellite.control(START) == LATER
    assert satellite.listen(1.5 * PERIOD) == []
    # A START by radio is accepted.
    assert gcs.command(mavlink.MAV_CMD_CONTROL_HIGH_LATENCY, START) == ACCEPTED
    satellite.until("HIGH_LATENCY2", timeout=1.5)
    assert gcs.command(mavlink.MAV_CMD_CONTROL_HIGH_LATENCY, STOP) == ACCEPTED
    gcs.fall_silent()
    gcs.close()
    # Delayed duplicates of both by satellite, and then new commands.
    satellite.listen(6)
    assert satellite.control(START) == LATER
    assert satellite.control(STOP) == ACCEPTED
    assert satellite.listen(1.5 * PERIOD) == []
    assert satellite.control(START) == ACCEPTED
    satellite.until("HIGH_LATENCY2", timeout=1.5)


def test_reports_start_on_link_loss(satellite, other, beating):
    """L-14: the vehicle reports from the loss of the last ground station until one is back."""
    write(other, "MAV_HL_LOSS_T", INT32, 2)
    gcs = beating()
    assert satellite.listen(2) == []
    gcs.fall_silent()
    # The station is lost after 5 s, and reports start 2 s later. The vehicle keeps sending on the radio.
    assert satellite.listen(5.5) == []
    satellite.until("HIGH_LATENCY2", 2, timeout=2 + 2 * PERIOD)
    assert gcs.wait("HEARTBEAT")
    gcs.beat()
    satellite.listen(1)
    assert satellite.listen(2 * PERIOD) == []


@pytest.mark.parametrize("enable", [0.5, 2, -1, float("nan")])
def test_invalid_control_parameter_is_denied(satellite, enable):
    """L-10"""
    assert satellite.control(enable) == DENIED
    assert satellite.listen(1) == []


def test_delayed_command_cannot_start_a_flight(satellite, gcs):
    """L-16: the vehicle refuses to start a flight by satellite. In flight it accepts the command to return."""
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
    assert reports[-1].custom_mode == RETURN and reports[-1].altitude >= 490 and reports[-1].throttle > 0


def test_only_allowed_messages_are_sent_by_satellite(satellite, other, gcs):
    """L-4: no request on any link, and no other sender, causes another message on the satellite link."""
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
        # The same while the vehicle reports.
        assert satellite.control(START) == ACCEPTED
        assert satellite.command(mavlink.MAV_CMD_RUN_PREARM_CHECKS) == ACCEPTED
        mav.param_request_list_send(1, 1)
        assert set(kinds(satellite.listen(2 * PERIOD))) == {"HIGH_LATENCY2"}
    finally:
        companion.end()


def test_command_for_the_companion_is_forwarded(satellite, other):
    """R-13: a command by satellite is forwarded to the companion, and its answer is sent back."""
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


def test_mavproxy_over_the_satellite(vehicle, port, tmp_path):
    """L-24: MAVProxy's user switches high latency on, and MAVProxy detects the vehicle."""
    # The tests before have used up the credits (L-17).
    vehicle.cut()
    # Without the vehicle's id it sends START to all systems, which is DENIED because each would pay (L-17).
    mavproxy = MavProxy(getattr(vehicle, "port", port) + 2, tmp_path, options=["--target-system=1"])
    try:
        mavproxy.say("link hl on")
        mavproxy.expect_all("CONTROL_HIGH_LATENCY: ACCEPTED", "Detected vehicle 1:1")
        mavproxy.say("link hl off")
        mavproxy.expect("CONTROL_HIGH_LATENCY: ACCEPTED")
    finally:
        mavproxy.end()
        vehicle.gcs.command(mavlink.MAV_CMD_CONTROL_HIGH_LATENCY, STOP)
