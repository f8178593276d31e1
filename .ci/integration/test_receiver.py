"""The pilot's receiver on the second link, as ExpressLRS sends (J-10 to J-13), beside a stick through MAVSDK on the first."""

import math
import threading
import time

from mavsdk.plugins.manual_control import ManualControl
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry.telemetry import FlightMode
from pymavlink import mavutil
from test_mavsdk_flight import Sticks, Watched, action, start, until  # noqa: F401  `action` is a fixture.

mavlink = mavutil.mavlink

ELRS = (255, mavlink.MAV_COMP_ID_TELEMETRY_RADIO)
# The parameters of DO_SET_MODE for Position mode.
POSITION = (129, 3, 0)


class Receiver:
    """Sends RC_CHANNELS_OVERRIDE and RADIO_STATUS, up to 100 times a second, and no HEARTBEAT. Shares the connection of a client."""

    CENTRED = (1500, 1500, 1500, 1500)

    def __init__(self, line):
        self.line = line
        self.mav = mavlink.MAVLink(line.link, *ELRS)
        self.sticks = self.CENTRED
        # Without a transmitter only RADIO_STATUS is sent.
        self.hears = True
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self._send, daemon=True)

    def _send(self):
        while not self.ended.wait(0.01):
            frames = [mavlink.MAVLink_radio_status_message(255, 200, 100, 9, 0, 0, 0)]
            if self.hears:
                channels = (*self.sticks, *[1500] * 12)
                frames.append(mavlink.MAVLink_rc_channels_override_message(1, 0, *channels))
            # Both in one write, as the receiver does.
            self.line.link.write(b"".join(frame.pack(self.mav) for frame in frames))

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.ended.set()
        self.thread.join()


def speed(watched):
    """Returns the speed to the north and to the east (m/s). The vehicle keeps its heading."""
    velocity = watched.now.velocity
    return velocity.north_m_s, velocity.east_m_s


def says(line, text, timeout=5):
    return line.wait("STATUSTEXT", timeout, lambda told: told.text.startswith(text))


def test_receiver_beside_manual_control(system, action, other):  # noqa: F811
    """The receiver steers without a heartbeat. While it is alive, the stick through MAVSDK is refused; while it is silent, that one
    steers; and when the receiver is back, it takes over."""
    watched, control = Watched(system), ManualControl(system)
    # On a busy machine the threads that send may not run for longer than half a second.
    Param(system).set_param_float("COM_RC_LOSS_T", 2.0)
    action.set_takeoff_altitude(3.0)
    action.arm()
    action.takeoff()
    until(lambda: watched.height > 2.3 and watched.is_still(), 30, "it takes off")
    heading = math.radians(watched.telemetry.attitude_euler().yaw_deg)

    def ahead():
        north, east = speed(watched)
        return north * math.cos(heading) + east * math.sin(heading)

    other.drain()
    sticks = None
    with Receiver(other) as receiver:
        try:
            assert says(other, "Sticks: system 255 component 68, link 1"), "the holder is not told"
            # MAVSDK does not ask for the mode before it has sent sticks of its own.
            assert other.command(mavlink.MAV_CMD_DO_SET_MODE, *POSITION) == mavlink.MAV_RESULT_ACCEPTED
            sticks = Sticks(control)
            # MAVSDK's stick backwards, the receiver's forwards: the second channel is low.
            sticks.at = (-0.5, 0.0, 0.5, 0.0)
            receiver.sticks = (1500, 1250, 1500, 1500)
            until(lambda: ahead() > 2, 30, "it flies ahead")
            time.sleep(2)
            assert ahead() > 2 and watched.telemetry.flight_mode() == FlightMode.POSCTL

            receiver.hears = False
            assert says(other, "Sticks: system 245", 10), "MAVSDK's stick does not steer"
            until(lambda: start(control), 10, "it takes MAVSDK's sticks")
            until(lambda: ahead() < -2, 30, "it flies back")

            receiver.hears = True
            assert says(other, "Sticks: system 255 component 68, link 1", 10), "the receiver does not take over"
            until(lambda: ahead() > 2, 30, "it flies ahead again")
            receiver.sticks = receiver.CENTRED
            until(watched.is_still, 20, "it stands still")
        finally:
            if sticks:
                sticks.let_go()
    until(lambda: watched.telemetry.flight_mode() == FlightMode.HOLD, 10, "it holds")
    action.land()
    until(lambda: not watched.telemetry.armed(), 60, "it lands")
