"""The telemetry link over UDP: the vehicle sends to its configured peer, and accepts frames from this peer only."""

import socket
import time

from conftest import Gcs, found_by_mavsdk
from mavsdk.plugins.mission_raw import MissionItem, MissionRaw
from plans import FENCE, MISSION, PLANS, RALLY, differences, plan
from pymavlink import mavutil
from qgc import Qgc
from transfer import ACCEPTED, DENIED, as_dict, download, upload, upload_part

V2 = 0xFD


def frame_lengths(datagram):
    """Returns the lengths of the MAVLink 2 frames in a datagram, or None if it does not consist of whole frames."""
    lengths, at = [], 0
    while at < len(datagram):
        if datagram[at] != V2 or at + 12 > len(datagram):
            return None
        lengths.append(12 + datagram[at + 1])
        at += lengths[-1]
    return lengths if at == len(datagram) else None


def test_datagrams_hold_whole_frames(port):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", port))
        receiver.settimeout(3)
        for _ in range(10):
            datagram = receiver.recv(65536)
            assert frame_lengths(datagram), datagram.hex()


def test_only_the_configured_peer_is_accepted(port):
    """A datagram from another sender to the vehicle's port is neither answered nor executed."""
    gcs = Gcs(port, "udpin")
    (vehicle,) = gcs.link.clients
    arm = gcs.mav.command_long_encode(1, 1, mavutil.mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.settimeout(1.5)
        stranger.sendto(arm.pack(gcs.mav), vehicle)
        try:
            assert not stranger.recv(65536)
        except (TimeoutError, ConnectionRefusedError):
            pass
    assert not gcs.wait("HEARTBEAT").base_mode & mavutil.mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert gcs.command(mavutil.mavlink.MAV_CMD_REQUEST_MESSAGE, 148) == mavutil.mavlink.MAV_RESULT_ACCEPTED
    gcs.close()


def test_plans_are_uploaded_and_downloaded(port, figure):
    with found_by_mavsdk(f"udpin://127.0.0.1:{port}") as system:
        missions = MissionRaw(system)
        items = plan(100)
        began = time.monotonic()
        missions.upload_mission([MissionItem(**item) for item in items])
        uploaded = time.monotonic()
        back = [as_dict(item) for item in missions.download_mission()]
        figure(f"MAVSDK over UDP: 100 items up {uploaded - began:.1f} s, down {time.monotonic() - uploaded:.1f} s")
        assert differences(items, back) == []
        for kind, up, down in [
            (FENCE, missions.upload_geofence, missions.download_geofence),
            (RALLY, missions.upload_rally_points, missions.download_rallypoints),
        ]:
            items = PLANS[kind](16)
            up([MissionItem(**item, mission_type=kind) for item in items])
            assert differences(items, [as_dict(item) for item in down()]) == []
        missions.clear_mission()
        assert missions.download_mission() == []


def test_qgroundcontrol_connects(port):
    """QGroundControl's default: a connection over UDP without any configuration."""
    gcs = Gcs(port, "udpin")
    try:
        qgc = Qgc(gcs)
        qgc.connect()
        assert qgc.is_ready and all(step.is_answered for step in qgc.steps), qgc.steps
        assert len(qgc.parameters) == qgc.parameter_count
    finally:
        gcs.close()


def test_two_clients(port, other):
    """One client over UDP, one over TCP."""
    gcs = Gcs(port, "udpin")
    try:
        started = upload_part(gcs, plan(20), 10)
        assert upload(other, plan(5, 1)).type == DENIED
        for seq in range(10, 20):
            assert started.next().seq == seq
            started.send(seq)
        assert started.next().type == ACCEPTED
        assert differences(plan(20), download(other).items) == []
        bad = plan(5, 1)
        bad[3]["x"] = 900_000_001
        assert upload(gcs, bad).type == mavutil.mavlink.MAV_MISSION_INVALID_PARAM5_X
        assert differences(plan(20), download(gcs).items) == []
    finally:
        gcs.close()


def test_vanished_client(port, other):
    """PX4/PX4-Autopilot#27132"""
    gcs = Gcs(port, "udpin")
    try:
        upload_part(gcs, plan(20), 10)
    finally:
        gcs.close()
    died = time.monotonic()
    while upload(other, plan(5, 1)).type == DENIED:
        assert time.monotonic() - died < 10, "no other client can upload"
        time.sleep(0.1)
