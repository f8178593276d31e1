"""Operator control (O-5): two ground stations in pymavlink, one of which is in control."""

import newer  # noqa: F401  It defines CONTROL_STATUS.
import pytest
from pymavlink import mavutil
from test_partners import Component, eventually

mavlink = mavutil.mavlink

ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
FAILED = mavlink.MAV_RESULT_FAILED
NOT_IN_CONTROL = 10
ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
REQUEST_OPERATOR_CONTROL = 32100
TAKEOVER_ALLOWED = 2


def request(station, allow, timeout=10):
    """Requests control. Returns the result."""
    return station.command(REQUEST_OPERATOR_CONTROL, 1, allow, timeout, station.address[0])


def release(station):
    return station.command(REQUEST_OPERATOR_CONTROL, 0, 0, 0, station.address[0])


def status(station, owner):
    """Returns whether takeover is allowed, now that this system is in control: it is sent every second."""
    station.drain()
    told = station.wait("CONTROL_STATUS", 3, lambda told: told.gcs_main == owner)
    assert told, f"no CONTROL_STATUS with system {owner} in control"
    assert told.flags & 1 and list(told.gcs_secondary) == [0] * 10
    return bool(told.flags & TAKEOVER_ALLOWED)


@pytest.fixture
def stations(gcs, other):
    """The two stations, both alive. Nobody is in control before and after."""
    kind = mavlink.MAV_TYPE_GCS
    with Component(gcs, gcs.address, kind), Component(other, other.address, kind):
        assert status(gcs, 0)
        yield gcs, other
        for station in (gcs, other):
            release(station)
        assert status(gcs, 0)


def test_takeover_with_consent(stations):
    """The second station gets control when the first one consents. Until then, its commands are answered NOT_IN_CONTROL."""
    gcs, other = stations
    assert eventually(lambda: request(gcs, allow=0) == ACCEPTED)
    assert not status(gcs, 255) and not status(other, 255)
    assert other.command(ARM, 1) == NOT_IN_CONTROL
    assert other.command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION) == ACCEPTED

    gcs.drain()
    assert request(other, allow=1, timeout=20) == FAILED
    notice = gcs.wait("COMMAND_LONG", 3, lambda told: told.command == REQUEST_OPERATOR_CONTROL)
    assert notice, "the owner is not told of the request"
    assert (notice.target_system, notice.target_component) == gcs.address
    assert (notice.param1, notice.param2, notice.param3, notice.param4) == (1, 1, 20, 254)
    gcs.mav.command_ack_send(REQUEST_OPERATOR_CONTROL, ACCEPTED, 0, 0, 1, 1)
    assert not gcs.wait("COMMAND_LONG", 3), "it is told again, although it has answered"

    assert request(gcs, allow=1) == ACCEPTED
    assert status(other, 255)
    assert request(other, allow=0) == ACCEPTED
    assert not status(gcs, 254)
    assert gcs.command(ARM, 1) == NOT_IN_CONTROL
    assert other.command(ARM, 1) == ACCEPTED
    assert other.command(ARM, 0) == ACCEPTED


def test_lost_owner_releases_control(gcs, other):
    """Control is released when the owner's heartbeats stop."""
    with Component(gcs, gcs.address, mavlink.MAV_TYPE_GCS):
        assert eventually(lambda: request(gcs, allow=0) == ACCEPTED)
        assert other.command(ARM, 0) == NOT_IN_CONTROL
    told = other.wait("CONTROL_STATUS", 8, lambda told: told.gcs_main == 0)
    assert told, "control is not released"
    assert other.command(ARM, 0) == ACCEPTED
