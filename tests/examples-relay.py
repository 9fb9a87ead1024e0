"""A way to a server on which the first drag socket goes silent: its connection stays open, and
nothing is received through it.

examples-relay.py SERVER_PORT      prints its own port
"""

import asyncio
import sys

# What comes of the first socket: the handshake's answer, the grid, and some frames at most.
FIRST = 3
sockets = 0


async def pass_on(reader, writer, pieces=None):
    while data := await reader.read(1 << 16):
        if pieces == 0:
            continue
        pieces = pieces and pieces - 1
        writer.write(data)
        await writer.drain()
    writer.close()


async def relay(reader, writer):
    global sockets
    beginning = await reader.read(1 << 16)
    far_reader, far_writer = await asyncio.open_connection("127.0.0.1", int(sys.argv[1]))
    far_writer.write(beginning)
    is_socket = b"upgrade: websocket" in beginning.lower()
    sockets += is_socket
    await asyncio.gather(
        pass_on(reader, far_writer),
        pass_on(far_reader, writer, FIRST if is_socket and sockets == 1 else None),
        return_exceptions=True,
    )


async def main():
    server = await asyncio.start_server(relay, "127.0.0.1", 0)
    print(server.sockets[0].getsockname()[1], flush=True)
    await server.serve_forever()


asyncio.run(main())
