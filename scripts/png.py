"""Pictures of 8 bits a channel, rows of (r, g, b) bytes: PNG files, and parts of them side by side. Needs no library."""

import struct
import zlib

SIGNATURE = b"\x89PNG\r\n\x1a\n"


def paeth(a, b, c):
    """Which of left, above and above left is nearest to left + above - above left."""
    p = a + b - c
    pa, pb, pc = abs(p - a), abs(p - b), abs(p - c)
    return a if pa <= pb and pa <= pc else b if pb <= pc else c


def predicted(kind, line, above, i, size):
    """What a filter of this kind takes byte `i` of a row for; `size` bytes make a pixel."""
    left, corner = (line[i - size], above[i - size]) if i >= size else (0, 0)
    return (0, left, above[i], (left + above[i]) // 2, paeth(left, above[i], corner))[kind]


def read(path):
    """The rows of a PNG file with 8 bits a channel, r, g, b or r, g, b, a (which is dropped), not interlaced."""
    data, at, header, packed = path.read_bytes(), 8, None, b""
    if data[:8] != SIGNATURE:
        raise ValueError(f"{path}: no PNG file")
    while at < len(data):
        size, kind = struct.unpack_from(">I4s", data, at)
        body = data[at + 8 : at + 8 + size]
        at += 12 + size
        if kind == b"IHDR":
            header = struct.unpack(">IIBBBBB", body)
        elif kind == b"IDAT":
            packed += body
    width, height, bits, colour, *rest = header
    if bits != 8 or colour not in (2, 6) or any(rest):
        raise ValueError(f"{path}: 8-bit colour that is not interlaced is read")
    size = 3 if colour == 2 else 4
    plain, rows, above = zlib.decompress(packed), [], bytearray(width * size)
    for y in range(height):
        begin = y * (width * size + 1)
        kind, line = plain[begin], bytearray(plain[begin + 1 : begin + 1 + width * size])
        if kind:
            for i in range(len(line)):
                line[i] = (line[i] + predicted(kind, line, above, i, size)) & 255
        rows.append(line)
        above = line
    return rows if size == 3 else [bytearray(v for i, v in enumerate(row) if i % 4 < 3) for row in rows]


def write(path, rows):
    """A PNG file; for each row the filter whose differences are the smallest."""
    packed, above = bytearray(), bytearray(len(rows[0]))
    for line in rows:
        choices = []
        for kind in range(5):
            coded = bytes((v - predicted(kind, line, above, i, 3)) & 255 for i, v in enumerate(line))
            choices.append((sum(min(v, 256 - v) for v in coded), kind, coded))
        _, kind, coded = min(choices)
        packed += bytes([kind]) + coded
        above = line

    def chunk(kind, body):
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", len(rows[0]) // 3, len(rows), 8, 2, 0, 0, 0)
    path.write_bytes(SIGNATURE + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(bytes(packed), 9)) + chunk(b"IEND", b""))


def crop(rows, x, y, width, height):
    return [row[3 * x : 3 * (x + width)] for row in rows[y : y + height]]


def beside(parts, gap=4):
    """Parts of one height from left to right, white between them."""
    white = bytearray(b"\xff" * 3 * gap)
    return [white.join(rows) for rows in zip(*parts)]


def below(parts, gap=4):
    """Parts of one width from top to bottom, white between them."""
    white = [bytearray(b"\xff" * len(parts[0][0])) for _ in range(gap)]
    return [row for i, part in enumerate(parts) for row in (white if i else []) + part]
