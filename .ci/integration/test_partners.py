"""Components that the vehicle talks to by itself: a gimbal in pymavlink, and an arm authoriser in MAVSDK (O-3)."""

import contextlib
import math
import struct
import threading
import time

import pytest
from conftest import is_armed
from mavsdk import Configuration, Mavsdk
from mavsdk.plugins.arm_authorizer_server import ArmAuthorizerServer, RejectionReason
from pymavlink import mavutil

mavlink = mavutil.mavlink

ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
IN_PROGRESS = mavlink.MAV_RESULT_IN_PROGRESS
# The vehicle has a gimbal and a camera of its own; these are other ones.
GIMBAL = (1, mavlink.MAV_COMP_ID_GIMBAL2)
CAMERA = (1, mavlink.MAV_COMP_ID_CAMERA2)
# The system id of the authoriser.
AUTHORISER = 10
ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
POINT = mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW


class Component:
    """A component on the connection of an existing client. Sends a heartbeat once a second."""

    def __init__(self, line, address, kind):
        self.mav = mavlink.MAVLink(line.link, *address)
        self.kind = kind
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self._beat, daemon=True)
        self.thread.start()

    def _beat(self):
        while not self.ended.is_set():
            self.mav.heartbeat_send(self.kind, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE)
            self.ended.wait(1)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.ended.set()
        self.thread.join()


def point(gcs, pitch, yaw, timeout=3.0):
    flags = mavlink.GIMBAL_MANAGER_FLAGS_YAW_IN_VEHICLE_FRAME
    return gcs.command(POINT, pitch, yaw, math.nan, math.nan, flags, 0, GIMBAL[1], timeout=timeout)


def eventually(act, timeout=5.0):
    """Repeats `act` until it returns something true."""
    deadline = time.monotonic() + timeout
    while time.monotonic() < deadline:
        if result := act():
            return result
        time.sleep(0.1)
    raise AssertionError("it does not happen")


def test_gimbal_is_pointed_on_its_own_link(gcs, other):
    """A ground station's command becomes a message to the gimbal, and to nobody else."""
    with Component(other, GIMBAL, mavlink.MAV_TYPE_GIMBAL):
        eventually(lambda: point(gcs, 0, 0) == ACCEPTED)
        # Its message may arrive after the answer.
        assert other.wait("GIMBAL_DEVICE_SET_ATTITUDE")
        other.drain()
        gcs.drain()
        for pitch, yaw in [(-30, 90), (-90, 0), (45, -180)]:
            assert point(gcs, pitch, yaw) == ACCEPTED
            message = other.wait("GIMBAL_DEVICE_SET_ATTITUDE")
            assert message, "the gimbal hears nothing"
            assert (message.target_system, message.target_component) == GIMBAL
            p, y = math.radians(pitch) / 2, math.radians(yaw) / 2
            expected = [
                math.cos(y) * math.cos(p),
                -math.sin(y) * math.sin(p),
                math.cos(y) * math.sin(p),
                math.sin(y) * math.cos(p),
            ]
            # The vehicle approximates each sine and cosine to 1e-6.
            assert message.q == pytest.approx(expected, abs=3e-6)
        assert not [m for m in gcs.take_all() if m.get_type() == "GIMBAL_DEVICE_SET_ATTITUDE"]
    # Five seconds after its last heartbeat the gimbal is gone.
    eventually(lambda: point(gcs, 0, 0) == mavlink.MAV_RESULT_TEMPORARILY_REJECTED, timeout=10)


@contextlib.contextmanager
def authorised(gcs):
    """The vehicle arms only if the authoriser permits it."""

    def set_authoriser(value):
        # An INT32 in the bytes of the float.
        name = b"COM_ARM_AUTH_ID"
        gcs.mav.param_set_send(1, 1, name, float_of(value), mavlink.MAV_PARAM_TYPE_INT32)
        echo = gcs.wait("PARAM_VALUE", where=lambda message: message.param_id == name.decode())
        return echo and echo.param_value == float_of(value)

    eventually(lambda: set_authoriser(AUTHORISER))
    yield
    eventually(lambda: set_authoriser(0))


def float_of(value):
    return struct.unpack("<f", struct.pack("<i", value))[0]


def arm_results(gcs, timeout=10.0):
    """Sends a command to arm and returns the results of its acknowledgements, to the final one."""
    gcs.send_command(ARM, 1)
    results = []
    deadline = time.monotonic() + timeout
    while time.monotonic() < deadline:
        ack = gcs.wait("COMMAND_ACK", where=lambda ack: ack.command == ARM)
        if ack and (not results or ack.result != results[-1]):
            results.append(ack.result)
        if ack and ack.result != IN_PROGRESS:
            return results
    raise AssertionError(f"no final answer: {results}")


def test_mavsdk_authorises_arming(port, other):
    """O-3: MAVSDK's authoriser on the telemetry link permits and refuses. A command on the companion's link waits for it."""
    gcs = other
    with authorised(gcs):
        assert arm_results(gcs) == [IN_PROGRESS, mavlink.MAV_RESULT_TEMPORARILY_REJECTED], "no authoriser"
        configuration = Configuration.create_manual(AUTHORISER, mavlink.MAV_COMP_ID_ONBOARD_COMPUTER, True)
        with Mavsdk(configuration) as mavsdk:
            assert mavsdk.add_any_connection(f"tcpout://127.0.0.1:{port}").name == "SUCCESS"
            assert mavsdk.first_autopilot(timeout_s=10)
            server = ArmAuthorizerServer(mavsdk.server_component_by_id(mavlink.MAV_COMP_ID_ONBOARD_COMPUTER))
            answers = {"next": lambda: server.accept_arm_authorization(30)}
            asked = []

            def on_request(system, _):
                asked.append(system)
                threading.Thread(target=lambda: answers["next"](), daemon=True).start()

            server.subscribe_arm_authorization(on_request)
            eventually(lambda: arm_results(gcs)[-1] == ACCEPTED, timeout=20)
            assert asked and set(asked) == {1}
            assert gcs.wait("HEARTBEAT", 5, is_armed)
            assert gcs.command(ARM, 0) == ACCEPTED

            answers["next"] = lambda: server.reject_arm_authorization(False, RejectionReason.BAD_WEATHER, 0)
            results = arm_results(gcs)
            assert results[0] == IN_PROGRESS and results[-1] == mavlink.MAV_RESULT_DENIED
            assert gcs.wait("HEARTBEAT", 5, lambda beat: not is_armed(beat))


def test_payload_is_asked_about_itself(gcs, other):
    """The vehicle requests GIMBAL_DEVICE_INFORMATION of a gimbal in pymavlink, and reads CAM_MODE of a camera: PARAM_EXT."""
    with Component(other, CAMERA, mavlink.MAV_TYPE_CAMERA) as component:
        read = other.wait("PARAM_EXT_REQUEST_READ", 5)
        assert read and read.param_id == "CAM_MODE" and read.param_index == -1
        assert (read.target_system, read.target_component) == CAMERA
        # The first request is lost.
        again = other.wait("PARAM_EXT_REQUEST_READ", 2)
        assert again and again.param_id == read.param_id
        kind = mavlink.MAV_PARAM_EXT_TYPE_UINT8
        component.mav.param_ext_value_send(b"CAM_MODE", b"\x02", kind, 1, 0)
        assert gcs.wait("STATUSTEXT", 3, lambda text: text.text == "Camera: mode 2")
        # On a busy machine the vehicle may have asked once more before the answer.
        other.drain()
        assert not other.wait("PARAM_EXT_REQUEST_READ", 1.5)
    with Component(other, GIMBAL, mavlink.MAV_TYPE_GIMBAL) as component:
        request = other.wait("COMMAND_LONG", 5)
        assert request and request.command == mavlink.MAV_CMD_REQUEST_MESSAGE
        assert request.param1 == mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_INFORMATION and request.confirmation == 0
        again = other.wait("COMMAND_LONG", 2)
        assert again and again.confirmation == 1
        component.mav.command_ack_send(request.command, ACCEPTED, 0, 0, 1, 1)
        limits = [-3.0, 3.0, -1.5, 0.5, -3.0, 3.0]
        component.mav.gimbal_device_information_send(0, b"Maker", b"Model 3", b"", 0, 0, 0, 0, 0, *limits)
        assert gcs.wait("STATUSTEXT", 3, lambda text: text.text == "Gimbal: Model 3")
        other.drain()
        assert not other.wait("COMMAND_LONG", 1.5)
