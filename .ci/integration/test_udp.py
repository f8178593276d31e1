"""The telemetry link over UDP: the vehicle sends to us, and answers us alone."""

import socket
import time

from conftest import Gcs, found_by_mavsdk
from mavsdk.plugins.mission_raw import MissionItem, MissionRaw
from plans import differences, plan
from pymavlink import mavutil

V2 = 0xFD


def frame_lengths(datagram):
    """The lengths of the MAVLink 2 frames in it, or None if it does not consist of whole ones."""
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


def test_only_the_peer_is_heard(port):
    """A stranger's datagram to the vehicle's own port is not answered and not acted on."""
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


def test_a_plan_goes_up_and_comes_down(port, figure):
    items = plan(100)
    with found_by_mavsdk(f"udpin://127.0.0.1:{port}") as system:
        missions = MissionRaw(system)
        began = time.monotonic()
        missions.upload_mission([MissionItem(**item) for item in items])
        uploaded = time.monotonic()
        back = [{field: getattr(item, field) for field in items[0]} for item in missions.download_mission()]
        figure(f"MAVSDK over UDP: 100 items up {uploaded - began:.1f} s, down {time.monotonic() - uploaded:.1f} s")
    assert differences(items, back) == []
