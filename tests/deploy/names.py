"""A DNS server on the loopback that replaces Docker's: service names with the current addresses of
their containers."""

import contextlib
import random
import socket
import sys
import threading

from commands import AS_ROOT, Failure, run

A, IN = 1, 1
NAME_ERROR = 3
# Binds the address and passes the socket to its parent, on standard input.
BIND = """
import socket, sys
bound = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
bound.bind((sys.argv[1], 53))
socket.send_fds(socket.socket(fileno=0), [b"."], [bound.fileno()])
"""


class Names:
    """Answers for `addresses`, a table from a name to a list of addresses that may change while it
    runs."""

    def __init__(self):
        self.addresses = {}
        self.host, self.socket = self._bind()
        self.thread = threading.Thread(target=self._serve, daemon=True)

    @staticmethod
    def _bind():
        """Resolvers use port 53, which only root can bind; a loopback address of its own avoids
        conflicts."""
        for _ in range(20):
            network = f"127.{random.randint(64, 250)}.{random.randint(1, 250)}"
            ours, theirs = socket.socketpair()
            with ours, theirs:
                done = run(
                    *AS_ROOT, sys.executable, "-c", BIND, f"{network}.53", check=False, stdin=theirs
                )
                if done.returncode == 0:
                    _, (number,), _, _ = socket.recv_fds(ours, 1, 1)
                    return network, socket.socket(fileno=number)
        raise Failure(
            "no address of the loopback has port 53 free: "
            f"{done.stderr.decode(errors='replace')[-300:]}"
        )

    @property
    def server(self):
        return f"{self.host}.53"

    def address(self, number):
        """An address beside the name server's own."""
        return f"{self.host}.{number}"

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.socket.close()

    def _serve(self):
        while True:
            try:
                question, asker = self.socket.recvfrom(4096)
            except OSError:
                return
            with contextlib.suppress(OSError, IndexError, ValueError):
                self.socket.sendto(self.answer(question), asker)

    def answer(self, question):
        labels, at = [], 12
        while question[at]:
            labels.append(question[at + 1 : at + 1 + question[at]].decode("ascii").lower())
            at += 1 + question[at]
        kind = int.from_bytes(question[at + 1 : at + 3], "big")
        addresses = self.addresses.get(".".join(labels))
        found = [a for a in addresses or [] if kind == A]
        status = NAME_ERROR if addresses is None else 0
        # Header: response, recursion available; one question, the answers, no authority, no
        # additional records.
        head = (
            question[:2]
            + bytes([0x81, 0x80 | status])
            + b"".join(n.to_bytes(2, "big") for n in (1, len(found), 0, 0))
        )
        # Each answer: the name of the question, an address, TTL of one second.
        records = b"".join(
            b"\xc0\x0c" + bytes([0, A, 0, IN, 0, 0, 0, 1, 0, 4]) + socket.inet_aton(a)
            for a in found
        )
        return head + question[12 : at + 5] + records
