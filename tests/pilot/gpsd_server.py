"""A server that speaks gpsd's protocol."""

import contextlib
import json
import socket
import socketserver
import threading

from processes import until


class GpsdServer(socketserver.ThreadingTCPServer):
    """Speaks gpsd's protocol: greets, waits to be watched, and reports what the test gives it."""

    allow_reuse_address = True
    daemon_threads = True

    def __init__(self, port=0, greeting=b'{"class":"VERSION","release":"3.22","proto_major":3,"proto_minor":14}\n'):
        self.lines, self.greeting = [], greeting
        super().__init__(("127.0.0.1", port), _GpsdHandler)
        threading.Thread(target=self.serve_forever, daemon=True).start()

    @property
    def address(self):
        return f"127.0.0.1:{self.server_address[1]}"

    def report(self, **tpv):
        self.raw(json.dumps({"class": "TPV", "device": "/dev/gps0", "mode": 3} | tpv).encode() + b"\n")

    def raw(self, line):
        until(lambda: self.lines)
        for link in self.lines:
            link.sendall(line)

    def stop(self):
        self.shutdown()
        self.server_close()
        for link in self.lines:
            with contextlib.suppress(OSError):  # the other end has left before
                link.shutdown(socket.SHUT_RDWR)


class _GpsdHandler(socketserver.StreamRequestHandler):
    server: GpsdServer

    def handle(self):
        self.wfile.write(self.server.greeting)
        if self.rfile.readline().startswith(b"?WATCH={"):
            self.server.lines.append(self.request)
            self.rfile.readline()
