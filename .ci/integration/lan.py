"""An Ethernet with the vehicle and hosts of a test. QEMU sends and receives the frames as UDP datagrams of this machine."""

import select
import socket
import struct
import time

from pymavlink.dialects.v20 import common

ARP, IPV4, UDP = 0x0806, 0x0800, 17
PORT = 14550
DHCP_SERVER, DHCP_CLIENT = 67, 68
DISCOVER, OFFER, REQUEST, ACK = 1, 2, 3, 5


def checksum(header):
    total = sum(struct.unpack(f">{len(header) // 2}H", header))
    total = (total & 0xFFFF) + (total >> 16)
    return 0xFFFF ^ (total & 0xFFFF) ^ (total >> 16)


class Lan:
    """The hosts are numbers in the vehicle's network, 10.0.2.0/24. Host 2 is a DHCP server if it has something to assign."""

    VEHICLE = 15

    def __init__(self, ours, emulators):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", ours))
        self.socket.connect(("127.0.0.1", emulators))
        self.nic = f"socket,udp=127.0.0.1:{ours},localaddr=127.0.0.1:{emulators}"
        self.vehicle = b"\xff" * 6
        self.answering = set()
        # The address to assign, once, and for how long (s).
        self.lease = None
        # The last part of the vehicle's address in the last datagram.
        self.source = None
        self.mav = common.MAVLink(None, srcSystem=255, srcComponent=190)

    def close(self):
        self.socket.close()

    @staticmethod
    def mac(host):
        return bytes([2, 0, 0, 0, 0, host])

    @staticmethod
    def ip(host):
        return bytes([10, 0, 2, host])

    def send(self, host, message):
        """Sends a message from a host to the vehicle."""
        self.send_datagram(host, self.ip(self.source or self.VEHICLE), (PORT, PORT), message.pack(self.mav))

    def send_datagram(self, host, to, ports, payload):
        udp = struct.pack(">HHHH", *ports, 8 + len(payload), 0) + payload
        header = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 20 + len(udp), 0, 0, 64, UDP, 0, self.ip(host), to)
        header = header[:10] + struct.pack(">H", checksum(header)) + header[12:]
        self.socket.send(self.vehicle + self.mac(host) + struct.pack(">H", IPV4) + header + udp)

    def assign(self, request):
        """Answers a request of DHCP. The server then falls silent, so the lease cannot be renewed."""
        if not self.lease:
            return
        host, seconds = self.lease
        # smoltcp sends the type as the first option.
        answer = {DISCOVER: OFFER, REQUEST: ACK}[request[242]]
        if answer == ACK:
            self.lease = None
        reply = bytes([2, 1, 6, 0]) + request[4:8] + bytes(8) + self.ip(host) + self.ip(2) + bytes(4) + request[28:240]
        options = bytes([53, 1, answer, 54, 4, *self.ip(2), 1, 4, 255, 255, 255, 0, 51, 4, *struct.pack(">I", seconds), 255])
        self.send_datagram(2, b"\xff" * 4, (DHCP_SERVER, DHCP_CLIENT), reply + options)

    def receive(self, timeout):
        """Returns the last part of the address and the frame of the next datagram within `timeout` (s), or None. Answers ARP meanwhile."""
        deadline = time.monotonic() + timeout
        while (left := deadline - time.monotonic()) > 0 and select.select([self.socket], [], [], left)[0]:
            try:
                frame = self.socket.recv(2048)
            except ConnectionRefusedError:
                # The emulator has not started yet.
                continue
            self.vehicle = frame[6:12]
            kind = int.from_bytes(frame[12:14], "big")
            if kind == ARP and frame[20:22] == b"\0\1" and frame[41] in self.answering:
                asked, sender = frame[41], frame[22:32]
                reply = struct.pack(">HHBBH", 1, IPV4, 6, 4, 2) + self.mac(asked) + self.ip(asked) + sender
                self.socket.send(self.vehicle + self.mac(asked) + struct.pack(">H", ARP) + reply)
            elif kind == IPV4 and frame[23] == UDP:
                port = int.from_bytes(frame[36:38], "big")
                if port == DHCP_SERVER:
                    self.assign(frame[42:])
                elif port == PORT:
                    self.source = frame[29]
                    return frame[33], frame[42:]
        return None
