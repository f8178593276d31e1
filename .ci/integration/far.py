"""A long round trip: a TCP proxy that delays every byte by a fixed time in each direction."""

import queue
import socket
import threading
import time


class Far:
    """Listens on its own port for one client, and delivers every byte `delay` seconds late in both directions."""

    def __init__(self, port, delay):
        self.delay = delay
        self.vehicle = socket.create_connection(("127.0.0.1", port), timeout=10)
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.url = "tcpout://127.0.0.1:{}".format(self.listener.getsockname()[1])
        self.client = None
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self):
        try:
            self.client, _ = self.listener.accept()
        except OSError:
            return
        for end in (self.vehicle, self.client):
            end.settimeout(None)
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for source, sink in ((self.vehicle, self.client), (self.client, self.vehicle)):
            line = queue.SimpleQueue()
            threading.Thread(target=self._take, args=(source, line), daemon=True).start()
            threading.Thread(target=self._give, args=(line, sink), daemon=True).start()

    def _take(self, source, line):
        try:
            while data := source.recv(4096):
                line.put((time.monotonic() + self.delay, data))
        except OSError:
            pass
        line.put(None)

    @staticmethod
    def _give(line, sink):
        try:
            while entry := line.get():
                due, data = entry
                time.sleep(max(0.0, due - time.monotonic()))
                sink.sendall(data)
        except OSError:
            pass

    def close(self):
        for end in (self.listener, self.vehicle, self.client):
            if end:
                end.close()
