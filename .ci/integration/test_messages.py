"""Messages on request and streams, as ground stations request them (Q-1 to Q-7)."""

import time

import pytest
from mavsdk.plugins.telemetry import Telemetry
from pymavlink import mavutil
from rates import Meter, settled_errors

mavlink = mavutil.mavlink

ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
DENIED = mavlink.MAV_RESULT_DENIED

STREAMED = [
    "SYS_STATUS",
    "SYSTEM_TIME",
    "GPS_RAW_INT",
    "ATTITUDE",
    "LOCAL_POSITION_NED",
    "GLOBAL_POSITION_INT",
    "VFR_HUD",
    "BATTERY_STATUS",
    "HOME_POSITION",
    "EXTENDED_SYS_STATE",
    "RC_CHANNELS",
    "MISSION_CURRENT",
]
# The messages whose rates can be set.
STREAMS = [name for name in STREAMED if name != "MISSION_CURRENT"]


def message_id(name):
    return getattr(mavlink, f"MAVLINK_MSG_ID_{name}")


def set_interval(gcs, name, micros):
    return gcs.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_id(name), micros)


def interval(gcs, name):
    """Returns the interval that the vehicle reports (us)."""
    assert gcs.command(mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, message_id(name)) == ACCEPTED
    told = gcs.wait("MESSAGE_INTERVAL", where=lambda message: message.message_id == message_id(name))
    assert told, f"no MESSAGE_INTERVAL for {name}"
    return told.interval_us


def measure(gcs, wanted):
    """Measures until the mean interval of each message (us) is right. Returns the largest relative error with its message."""
    gcs.drain()
    meter = Meter()

    def take():
        message = gcs.hear(None, 2)
        assert message, "the streams stopped"
        meter.take(message.get_type(), message.to_dict())
        return meter

    return settled_errors(take, wanted)


@pytest.fixture
def client(gcs):
    """A ground station that restores the streams after the test."""
    yield gcs
    for name in STREAMS:
        set_interval(gcs, name, 0)


def test_telemetry_is_sent_without_a_request(client):
    """H-8: a ground station need not request the messages that it displays."""
    missing, deadline = set(STREAMED), time.monotonic() + 8
    while missing and time.monotonic() < deadline:
        message = client.wait(list(missing), 1)
        missing -= {message.get_type()} if message else set()
    assert not missing


@pytest.mark.parametrize("name", [*STREAMED, "ATTITUDE_QUATERNION", "AUTOPILOT_VERSION"])
def test_request_message(client, name):
    """Q-1, Q-2"""
    for each in STREAMS:
        set_interval(client, each, -1)
    assert client.command(mavlink.MAV_CMD_REQUEST_MESSAGE, message_id(name)) == ACCEPTED
    assert client.wait(name, 0.5), f"no {name}"


def test_each_battery_has_its_rate(client):
    """Q-3, Q-4: a request and an interval apply to one battery, or to both."""

    def heard(seconds):
        """Returns how often each battery reports."""
        counts, deadline = {0: 0, 1: 0}, time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            if message := client.wait("BATTERY_STATUS", left):
                counts[message.id] += 1
        return counts

    battery = message_id("BATTERY_STATUS")
    assert client.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, battery, -1) == ACCEPTED
    for index, packs in [(0, {0: 1, 1: 1}), (1, {0: 0, 1: 1})]:
        client.drain()
        client.send_command(mavlink.MAV_CMD_REQUEST_MESSAGE, battery, index)
        assert heard(1) == packs
    assert client.command(mavlink.MAV_CMD_REQUEST_MESSAGE, battery, 2) == DENIED
    assert client.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, battery, 200_000, 1) == ACCEPTED
    client.drain()
    counts = heard(4)
    assert counts[0] == 0 and 15 <= counts[1] <= 25
    assert client.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, battery, 500_000) == ACCEPTED
    client.drain()
    counts = heard(4)
    assert all(6 <= count <= 10 for count in counts.values())


@pytest.mark.parametrize("number", [42_000, -1, 1.5, float("nan"), message_id("COMMAND_ACK")])
def test_unavailable_message_is_denied(client, number):
    """Q-1: the vehicle answers DENIED, so that the client does not wait for the message."""
    assert client.command(mavlink.MAV_CMD_REQUEST_MESSAGE, number) == DENIED


@pytest.mark.parametrize("micros", [100_000, 50_000])
def test_requested_rate_is_kept(client, micros, figure):
    """Q-4, Q-5: within 5 % over 40 intervals, by the vehicle's own clock."""
    assert set_interval(client, "ATTITUDE", micros) == ACCEPTED
    assert interval(client, "ATTITUDE") == micros
    error, _ = measure(client, {"ATTITUDE": micros})
    figure(f"ATTITUDE every {micros} us: {micros * (1 + error):.0f} us on average of 40")


def test_all_rates_at_once(other, figure):
    """Q-4, Q-5: all streams, each at a different rate, on the companion's link, which has room for them."""
    wanted = {name: 80_000 + 7_000 * n for n, name in enumerate([*STREAMS, "ATTITUDE_QUATERNION"])}
    try:
        for name, micros in wanted.items():
            assert set_interval(other, name, micros) == ACCEPTED
            assert interval(other, name) == micros
        error, worst = measure(other, wanted)
    finally:
        for name in wanted:
            set_interval(other, name, 0)
    figure(f"{len(wanted)} streams at once: within {100 * abs(error):.2f} % ({worst})")


def test_stream_can_be_stopped_and_restored(client):
    """Q-4, Q-6"""
    usual = interval(client, "VFR_HUD")
    assert usual > 0
    assert set_interval(client, "VFR_HUD", -1) == ACCEPTED
    assert interval(client, "VFR_HUD") == -1
    client.drain()
    assert not client.wait("VFR_HUD", 1)
    assert set_interval(client, "VFR_HUD", 0) == ACCEPTED
    assert interval(client, "VFR_HUD") == usual
    assert client.wait("VFR_HUD", 2)
    for micros in (-2, float("nan")):
        assert set_interval(client, "VFR_HUD", micros) == DENIED


def test_request_data_stream(client):
    """Q-7: MAVProxy and Mission Planner still send REQUEST_DATA_STREAM."""
    client.mav.request_data_stream_send(1, 1, mavlink.MAV_DATA_STREAM_EXTRA1, 10, 1)
    client.wait("HEARTBEAT", 2)
    assert interval(client, "ATTITUDE") == 100_000
    client.mav.request_data_stream_send(1, 1, mavlink.MAV_DATA_STREAM_ALL, 4, 1)
    client.wait("HEARTBEAT", 2)
    assert interval(client, "ATTITUDE") == interval(client, "GLOBAL_POSITION_INT") == 250_000
    client.mav.request_data_stream_send(1, 1, mavlink.MAV_DATA_STREAM_ALL, 4, 0)
    client.wait("HEARTBEAT", 2)
    assert interval(client, "ATTITUDE") == -1


def test_mavsdk_reads_the_telemetry(system):
    telemetry = Telemetry(system)
    telemetry.set_rate_position(10.0)
    telemetry.set_rate_attitude_euler(10.0)
    deadline = time.monotonic() + 10
    while time.monotonic() < deadline:
        position, battery = telemetry.position(), telemetry.battery()
        if abs(position.latitude_deg - 47.397742) < 1e-3 and battery.remaining_percent > 1:
            break
        time.sleep(0.1)
    assert abs(position.latitude_deg - 47.397742) < 1e-3
    assert abs(position.longitude_deg - 8.545594) < 1e-3
    assert not telemetry.in_air() and not telemetry.armed()


def test_aircraft_that_a_receiver_reports_are_kept(gcs):
    """A service of another crate: the demo vehicle has `mavstack-traffic` by a field."""
    flags = mavlink.ADSB_FLAGS_VALID_COORDS | mavlink.ADSB_FLAGS_VALID_ALTITUDE
    # Some 300 m north of the vehicle's home.
    gcs.mav.adsb_vehicle_send(
        0xABCDEF, 474_004_400, 85_455_940, 1, 520_000, 9_000, 6_000, 0, b"HB-ZRC", 7, 1, flags, 7_000
    )
    text = gcs.wait("STATUSTEXT", where=lambda message: message.text.startswith("Aircraft at "))
    assert text, "no text"
    assert int(text.text.split()[2]) < 1_000, text.text
    assert gcs.command(mavlink.MAV_CMD_REQUEST_MESSAGE, message_id("ADSB_VEHICLE")) == ACCEPTED
    aircraft = gcs.wait("ADSB_VEHICLE")
    assert aircraft and (aircraft.ICAO_address, aircraft.callsign) == (0xABCDEF, "HB-ZRC")
