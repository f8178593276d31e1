"""A companion computer in pymavlink: component 191 of the vehicle's own system, on the companion's link."""

import threading

from pymavlink import mavutil

mavlink = mavutil.mavlink

ADDRESS = (1, mavlink.MAV_COMP_ID_ONBOARD_COMPUTER)


class Companion:
    """Shares the connection of an existing client, like two programs on one computer. Sends a heartbeat once a second."""

    def __init__(self, line):
        self.line = line
        self.mav = mavlink.MAVLink(line.link, *ADDRESS)
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self._beat, daemon=True)
        self.thread.start()

    def _beat(self):
        while not self.ended.is_set():
            self.beat()
            self.ended.wait(1)

    def beat(self):
        invalid = mavlink.MAV_AUTOPILOT_INVALID
        self.mav.heartbeat_send(mavlink.MAV_TYPE_ONBOARD_CONTROLLER, invalid, 0, 0, mavlink.MAV_STATE_ACTIVE)

    def send(self, message):
        """Sends a message and returns its frame."""
        frame = message.pack(self.mav)
        self.line.link.write(frame)
        return bytes(frame)

    def hear(self, kind, timeout=3.0, where=lambda message: True):
        """Returns the next message of this kind from another sender than the vehicle, or None."""
        return self.line.hear(kind, timeout, lambda message: message.get_srcComponent() != 1 and where(message))

    def end(self):
        self.ended.set()
        self.thread.join()
