"""Prints what a WebAssembly file imports, one name a line, read from the file itself."""

import sys
from pathlib import Path

IMPORT_SECTION = 2


def leb128(data: bytes, at: int) -> tuple[int, int]:
    """A number of seven bits a byte, and where it ends."""
    value = shift = 0
    while True:
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        shift += 7
        if byte < 0x80:
            return value, at


def name(data: bytes, at: int) -> tuple[str, int]:
    length, at = leb128(data, at)
    return data[at : at + length].decode(), at + length


def imports(data: bytes) -> list[str]:
    if data[:8] != b"\0asm\1\0\0\0":
        raise ValueError("no WebAssembly file of version 1")
    at = 8
    while at < len(data):
        section, (length, at) = data[at], leb128(data, at + 1)
        if section == IMPORT_SECTION:
            count, inner = leb128(data, at)
            # The first is enough: descriptions of different kinds have different lengths.
            first = (
                [".".join((name(data, inner)[0], name(data, name(data, inner)[1])[0]))]
                if count
                else []
            )
            return first + [f"and {count - 1} more"] * (count > 1)
        at += length
    return []


if __name__ == "__main__":
    print(*imports(Path(sys.argv[1]).read_bytes()), sep="\n")
