"""A client of QEMU's debugger: stops the processor when it has read from an address so many times.

The protocol is GDB's: https://sourceware.org/gdb/current/onlinedocs/gdb.html/Remote-Protocol.html
"""

import socket


class Gdb:
    """The processor is stopped while it is connected, except during `run_until`."""

    def __init__(self, port, address):
        """`address` is what the processor reads, 4 bytes."""
        self.watch = f"3,{address:x},4"
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=10)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.do("Z" + self.watch)

    def do(self, packet):
        """Sends a packet, and waits for OK. The report of the stop at the connection comes before that."""
        self.send(packet)
        while self.receive() != "OK":
            pass

    def send(self, packet):
        self.socket.sendall(f"${packet}#{sum(packet.encode()) % 256:02x}".encode())

    def receive(self):
        data = b""
        while not data.endswith(b"#"):
            # Before a packet: the acknowledgement of ours.
            byte = self.socket.recv(1)
            assert byte, "the debugger has gone"
            data = b"" if byte == b"$" else data + byte
        self.socket.recv(2)
        self.socket.sendall(b"+")
        return data[:-1].decode()

    def run_until(self, reads, silence):
        """Lets the processor run until it has read so many times. Returns whether it has: if it does not read for `silence` (s), it is
        stopped."""
        self.socket.settimeout(silence)
        for _ in range(reads):
            self.send("c")
            try:
                stop = self.receive()
            except TimeoutError:
                self.socket.settimeout(10)
                self.socket.sendall(b"\x03")
                self.receive()
                return False
            assert stop.startswith("T05"), stop
            # QEMU would stop at the same instruction again.
            self.do("z" + self.watch)
            self.send("s")
            self.receive()
            self.do("Z" + self.watch)
        return True

    def leave(self):
        """Lets the processor run on, without the debugger."""
        self.do("z" + self.watch)
        self.do("D")
        self.socket.close()
