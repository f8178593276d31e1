"""Ground stations on the network of the vehicle, which the emulator maps to UDP ports of this machine."""

import collections
import select
import socket
import statistics
import sys
import time

from pymavlink import mavutil
from pymavlink.dialects.v20 import common

mavlink = mavutil.mavlink

# Where the fields are in a MAVLink 2 frame: sequence number, component, message id, payload (zeros at its end are left out).
SEQ, COMPONENT, ID, PAYLOAD = 4, 6, slice(7, 10), slice(10, -2)
# Telemetry whose payload begins with the vehicle's time (ms since boot).
TIMED = [
    mavlink.MAVLINK_MSG_ID_ATTITUDE,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
]
# The most PINGs without an answer.
UNANSWERED = 64
# Linux's socket option to report discarded datagrams.
SO_RXQ_OVFL = 40


class Counter:
    """A fast station: it sends PINGs at a rate, and counts received frames by message and lost ones by sequence numbers."""

    def __init__(self, port):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        # As much as the system permits: this program may not run for a while.
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        if sys.platform == "linux":
            self.socket.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
        self.socket.connect(("127.0.0.1", port))
        self.mav = common.MAVLink(None, srcSystem=253, srcComponent=190)
        self.mav.seq = 0
        self.seqs = {}
        self.counts = collections.Counter()
        # Frames of telemetry, by the vehicle's quarter of a second.
        self.quarters = collections.Counter()
        self.lost = 0
        # Datagrams that the system has discarded, because this program did not receive them in time: in all, and before `restart`.
        self.discarded_in_all = self.discarded_before = 0

    def restart(self):
        """Counts from 0."""
        self.counts.clear()
        self.quarters.clear()
        self.lost, self.discarded_before = 0, self.discarded_in_all

    @property
    def discarded(self):
        return self.discarded_in_all - self.discarded_before

    def send(self, message):
        self.socket.send(message.pack(self.mav))
        self.mav.seq = (self.mav.seq + 1) % 256

    def heartbeat(self):
        self.send(self.mav.heartbeat_encode(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0))

    def request(self, message, interval):
        """Requests a message at an interval (µs), or not at all (-1)."""
        params = [message, interval, 0, 0, 0, 0, 0]
        self.send(self.mav.command_long_encode(1, 1, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0, *params))

    def receive(self, timeout):
        """Counts what is received within `timeout` (s)."""
        if not select.select([self.socket], [], [], timeout)[0]:
            return
        while True:
            try:
                datagram, reports, *_ = self.socket.recvmsg(2048, socket.CMSG_SPACE(4), socket.MSG_DONTWAIT)
            except BlockingIOError:
                return
            for _, _, report in reports:
                self.discarded_in_all = int.from_bytes(report, sys.byteorder)
            assert len(datagram) == 12 + datagram[1], "a datagram is one frame"
            component = datagram[COMPONENT]
            expected = self.seqs.get(component, datagram[SEQ])
            self.lost += (datagram[SEQ] - expected) % 256
            self.seqs[component] = (datagram[SEQ] + 1) % 256
            message = int.from_bytes(datagram[ID], "little")
            self.counts[message] += 1
            if message in TIMED:
                self.quarters[int.from_bytes(datagram[PAYLOAD][:4], "little") // 250] += 1

    def rate(self):
        """Returns the rate of the telemetry (frames/s) by the vehicle's own time. It is the median of the whole quarters of a second: on a
        busy machine, this program and the emulator may not run for a moment."""
        return 4 * statistics.median(count for _, count in sorted(self.quarters.items())[1:-1])

    def run(self, duration, pings):
        """Sends `pings` PINGs a second for `duration` (s). Returns their number, and how long it took (s).

        It pauses while many are unanswered: on a busy machine the emulator may not run for longer than the emulated controller
        can buffer frames, which would be no loss by the vehicle.
        """
        total, sent, beats = duration * pings, 0, 0
        answered, began = self.counts[mavlink.MAVLINK_MSG_ID_PING], time.monotonic()
        while (elapsed := time.monotonic() - began) < duration or sent < total:
            assert elapsed < 2 * duration, f"{sent} of {total} pings were sent"
            if elapsed >= beats:
                self.heartbeat()
                beats += 1
            unanswered = sent - (self.counts[mavlink.MAVLINK_MSG_ID_PING] - answered) - self.discarded
            for _ in range(min(int(min(elapsed, duration) * pings) - sent, UNANSWERED - unanswered)):
                self.send(self.mav.ping_encode(0, sent, 0, 0))
                sent += 1
            self.receive(0.001)
        return sent, elapsed

    def close(self):
        self.socket.close()
