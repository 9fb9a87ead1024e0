"""A minimal WebSocket client (RFC 6455) for drags."""

import base64
import os
import select
import socket
import time

TEXT, BINARY, CLOSE, PING, PONG = 1, 2, 8, 9, 10
WENT_AWAY = 1006


class Closed(Exception):
    """The connection is closed; `code` is the close code."""

    def __init__(self, code):
        super().__init__(code)
        self.code = code


class Refused(Exception):
    """The upgrade was rejected."""

    def __init__(self, status, headers):
        super().__init__(status)
        self.status, self.headers = status, headers


class WebSocket:
    def __init__(self, host, port, path, timeout=5.0, connected=None, headers=None):
        """`connected`: a socket to use, such as one with TLS."""
        self.socket = connected or socket.create_connection((host, port), timeout=timeout)
        self.socket.settimeout(timeout)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.buffer, self.begun = b"", None
        key = base64.b64encode(os.urandom(16)).decode()
        more = "".join(f"{name}: {value}\r\n" for name, value in (headers or {}).items())
        self.socket.sendall(
            f"GET {path} HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\nConnection: "
            "Upgrade\r\n"
            f"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: {key}\r\n{more}\r\n".encode()
        )
        while b"\r\n\r\n" not in self.buffer:
            self._more()
        head, _, self.buffer = self.buffer.partition(b"\r\n\r\n")
        line, *lines = head.decode("latin-1").split("\r\n")
        headers = {
            name.lower(): value.strip()
            for name, _, value in (line.partition(":") for line in lines)
        }
        if (status := int(line.split()[1])) != 101:
            self.close()
            raise Refused(status, headers)

    def _more(self):
        try:
            got = self.socket.recv(1 << 18)
        except OSError:
            got = b""
        if not got:
            self.close()
            raise Closed(WENT_AWAY)
        self.buffer += got

    def send(self, payload, kind=TEXT):
        mask = os.urandom(4)
        masked = bytes(b ^ mask[i % 4] for i, b in enumerate(payload))
        length = len(payload)
        head = (
            bytes([0x80 | kind, 0x80 | length])
            if length < 126
            else bytes([0x80 | kind, 0xFE]) + length.to_bytes(2, "big")
        )
        try:
            self.socket.sendall(head + mask + masked)
        except OSError:
            # The other side has closed the connection, and may have said why: that has arrived.
            while True:
                while frame := self._frame():
                    if frame[1] == CLOSE:
                        raise self._closed(frame[2]) from None
                self._more()

    def receive(self, until):
        """The next message as (kind, bytes), or None after the deadline."""
        while True:
            while (frame := self._frame()) is None:
                # TLS may have read more than was asked for.
                pending = getattr(self.socket, "pending", lambda: 0)()
                if (
                    not pending
                    and not select.select(
                        [self.socket], [], [], max(0.0, until - time.monotonic())
                    )[0]
                ):
                    return None
                self._more()
            last, kind, payload = frame
            if kind == PING:
                self.send(payload, PONG)
            elif kind == CLOSE:
                raise self._closed(payload)
            else:
                # A message may consist of several frames; the first has its kind.
                kind, before = self.begun or (kind, b"")
                self.begun = None if last else (kind, before + payload)
                if last:
                    return kind, before + payload

    def _closed(self, payload):
        self.close()
        return Closed(int.from_bytes(payload[:2], "big") or WENT_AWAY)

    def _frame(self):
        """A complete received frame as (final, kind, bytes), or None. Servers do not mask."""
        if len(self.buffer) < 2:
            return None
        length, at = self.buffer[1] & 127, 2
        if length > 125:
            at = 4 if length == 126 else 10
            length = int.from_bytes(self.buffer[2:at], "big")
        if len(self.buffer) < at + length:
            return None
        head, payload = self.buffer[0], self.buffer[at : at + length]
        self.buffer = self.buffer[at + length :]
        return bool(head & 0x80), head & 15, payload

    def close(self):
        self.socket.close()
