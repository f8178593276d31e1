"""The ground end of the satellite link."""

import math
import socket
import time

from pymavlink import mavutil

mavlink = mavutil.mavlink

# No other message may be sent on it (L-4): COMMAND_INT, COMMAND_LONG, COMMAND_ACK, COMMAND_CANCEL, HIGH_LATENCY2.
ALLOWED = {75, 76, 77, 80, 235}
START, STOP = 1, 0
# The billing unit in bytes. A part of a unit costs a whole one.
CREDIT = 50


class Satellite:
    """Checks every received byte: each belongs to a frame, and each frame is of an allowed message."""

    def __init__(self, port, system=255):
        self.address = (system, 190)
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=3)
        self.mav = mavlink.MAVLink(self, *self.address)
        self.received = b""
        # The decoded messages, and their total length in bytes.
        self.messages, self.decoded = [], 0

    def write(self, frame):
        self.socket.sendall(frame)

    def send_command(self, command, *params):
        params = [*params, *[0.0] * (7 - len(params))]
        self.mav.command_long_send(1, 1, command, 0, *params)

    def command(self, command, *params):
        """Sends a COMMAND_LONG and returns the result of its acknowledgement."""
        self.send_command(command, *params)
        (ack,) = self.until("COMMAND_ACK")
        assert (ack.command, ack.target_system, ack.target_component) == (command, *self.address)
        return ack.result

    def control(self, enable):
        return self.command(mavlink.MAV_CMD_CONTROL_HIGH_LATENCY, enable)

    def until(self, kind, count=1, timeout=5.0):
        """Waits for `count` messages of a kind, and takes them."""
        deadline = time.monotonic() + timeout
        while len(found := [message for message in self.messages if message.get_type() == kind]) < count:
            left = deadline - time.monotonic()
            # What arrived in time counts, even if this program did not run for a moment.
            assert self._receive(left) or left > 0, f"no {kind} in {timeout} s"
        self.messages = [message for message in self.messages if message not in found]
        return found

    def listen(self, seconds):
        """Returns the messages received before and not taken, and those received within this time."""
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            self._receive(left)
        messages, self.messages = self.messages, []
        return messages

    def _receive(self, seconds):
        """Returns whether something was received."""
        self.socket.settimeout(max(seconds, 0.001))
        try:
            data = self.socket.recv(4096)
        except TimeoutError:
            return False
        assert data, "the vehicle has closed the line"
        self.received += data
        for message in self.mav.parse_buffer(data) or []:
            assert message.get_msgId() in ALLOWED, message
            self.decoded += len(message.get_msgbuf())
            self.messages.append(message)
        return True

    def frames(self):
        """Returns the lengths of all received frames."""
        lengths, at = [], 0
        while at < len(self.received):
            assert self.received[at] == 0xFD, self.received[at:].hex()
            lengths.append(12 + self.received[at + 1])
            at += lengths[-1]
        assert at == len(self.received) == self.decoded, "half a frame"
        return lengths

    def credits(self):
        return sum(math.ceil(length / CREDIT) for length in self.frames())

    def end(self):
        self.socket.close()
        self.frames()
