"""Check that a JPEG is complete and undamaged, by reading its entropy-coded data (ITU-T T.81).

libjpeg, and so every program that shows photographs, fills in damaged parts without an error.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from mammometry.geometry.arrays import Array, Int64, UInt8

_FRAMES = (0xC0, 0xC1, 0xC2)  # start of frame: baseline, extended sequential, progressive (T.81, table B.1)
_OTHER_FRAMES = {*range(0xC3, 0xD0)} - {0xC4, 0xC8, 0xCC}  # lossless, differential, arithmetic
_DHT, _DQT, _DRI, _SOS, _EOI, _SOI, _TEM = 0xC4, 0xDB, 0xDD, 0xDA, 0xD9, 0xD8, 0x01  # markers (T.81, table B.1)
_FIRST_RESTART = 0xD0  # RST0, followed by seven others
_AMPLITUDE = 1024  # largest DC coefficient of a block of level-shifted 8-bit samples: 8 × 128
_ALIGNMENT = 7  # most padding bits in the last byte of an interval
SEQUENTIAL, DC_FIRST, DC_REFINED, AC_FIRST, AC_REFINED = range(5)
"""Kinds of scans. The last four are those of progressive JPEGs."""
PADDING = 512
"""Padding after the data, bytes: longer than the longest codes of a block, because the end is tested after a block."""


class DamagedJpegError(ValueError):
    """A JPEG that violates ITU-T T.81. The message states where."""


class TruncatedJpegError(DamagedJpegError):
    """A JPEG that ends before its pixels end."""

    def __init__(self) -> None:
        super().__init__("it is truncated")


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Order in which a JPEG's luminance blocks are coded."""

    unit_wh: tuple[int, int]
    """Size of a unit (MCU), pixels."""
    units_across: int
    """Units in a row."""
    interval: int
    """Units between restart markers. 0: no markers."""


@dataclass(frozen=True)
class _Component:
    number: int
    across: int
    down: int
    quantization: int
    first_block: int
    blocks_wh: tuple[int, int]
    """Blocks in the image."""
    stored_blocks_wh: tuple[int, int]
    """Blocks in complete units of all components."""


@dataclass
class _Decoder:
    """Decoder state set by the markers read so far."""

    tables: Array = field(default_factory=lambda: np.zeros((8, 65536 + 1024), dtype=np.uint16))
    known_tables: set[int] = field(default_factory=set)
    dc_steps: dict[int, int] = field(default_factory=dict)
    interval: int = 0
    """Units between restart markers. 0: none."""
    components: dict[int, _Component] = field(default_factory=dict)
    units_wh: tuple[int, int] = (0, 0)
    progressive: bool = False
    layout: Layout | None = None
    coded: set[int] = field(default_factory=set)
    """Components whose DC coefficients have been read."""
    dc: Array = field(default_factory=lambda: np.zeros(0, dtype=np.int32))
    known: Array = field(default_factory=lambda: np.zeros((1, 64), dtype=np.uint8))


def check_jpeg(content: bytes, tables: bytes | None = None) -> Layout:
    """Check that the first image of a JPEG is complete and correctly coded.

    Data after the first image are ignored, because cameras store previews there.

    Args:
        content: the file, or the part of a TIFF.
        tables: quantisation and Huffman tables, if a TIFF stores them separately.

    Raises:
        DamagedJpegError: it is damaged.
        TruncatedJpegError: the file ends before its pixels end.
    """
    decoder = _Decoder()
    try:
        if tables:
            _read(np.frombuffer(tables, dtype=np.uint8), decoder)
        _read(np.frombuffer(content, dtype=np.uint8), decoder)
    except DamagedJpegError:
        raise
    except IndexError:
        raise TruncatedJpegError from None
    except (KeyError, ValueError):
        raise DamagedJpegError("its markers are inconsistent") from None
    if decoder.layout is None or decoder.coded != set(decoder.components):
        raise DamagedJpegError("some of its pixels are missing")
    return decoder.layout


def _read(data: UInt8[Array, " n"], decoder: _Decoder) -> None:
    """Read markers and scans up to the end of the first image."""
    after = np.flatnonzero(data[:-1] == 0xFF) + 1
    codes = data[after]
    real = (codes != 0) & (codes != 0xFF)
    marks, codes = after[real] - 1, codes[real]
    restart = (codes & 0xF8) == _FIRST_RESTART
    stops, restarts = marks[~restart], marks[restart]
    place = 0
    while True:
        while data[place] == 0xFF and data[place + 1] == 0xFF:
            place += 1
        if data[place] != 0xFF:
            raise DamagedJpegError("a marker is missing")
        marker = int(data[place + 1])
        place += 2
        if marker == _EOI:
            return
        if marker in (_SOI, _TEM):
            continue
        length = _number(data, place)
        segment = data[place + 2 : place + length]
        if length < 2 or len(segment) != length - 2:
            raise TruncatedJpegError
        place += length
        if marker == _SOS:
            stop = np.searchsorted(stops, place)
            if stop == len(stops):
                raise TruncatedJpegError
            end = int(stops[stop])
            cuts = restarts[np.searchsorted(restarts, place) : np.searchsorted(restarts, end)]
            _walk(segment, data, place, end, cuts, decoder)
            place = end
        else:
            _define(marker, segment, decoder)


def _define(marker: int, segment: UInt8[Array, " n"], decoder: _Decoder) -> None:
    if marker == _DHT:
        for number, table in _huffman_tables(segment):
            decoder.tables[number] = table
            decoder.known_tables.add(number)
    elif marker == _DQT:
        decoder.dc_steps |= _dc_steps(segment)
    elif marker == _DRI:
        decoder.interval = _number(segment, 0)
    elif marker in _FRAMES:
        if decoder.components:
            raise DamagedJpegError("it has two start markers")
        _start(segment, decoder)
        decoder.progressive = marker == _FRAMES[2]
        if decoder.progressive:
            decoder.known = np.zeros((len(decoder.dc), 64), dtype=np.uint8)
    elif marker in _OTHER_FRAMES:
        raise DamagedJpegError("its coding is not used by cameras")


def _number(data: UInt8[Array, " n"], place: int) -> int:
    return int(data[place]) << 8 | int(data[place + 1])


def _huffman_tables(segment: UInt8[Array, " n"]) -> Iterator[tuple[int, Array]]:
    """Index of each table (DC from 0, AC from 4), and symbol + 256 × length by the next 16 bits."""
    place = 0
    while place < len(segment):
        kind, number = segment[place] >> 4, segment[place] & 15
        counts = segment[place + 1 : place + 17].astype(np.int64)
        symbols = segment[place + 17 : place + 17 + counts.sum()].astype(np.uint16)
        lengths = np.repeat(np.arange(1, 17), counts)
        if kind > 1 or number > 3 or len(counts) != 16 or len(symbols) != len(lengths):
            raise DamagedJpegError("its tables are inconsistent")
        spans = 1 << (16 - lengths)
        if spans.sum() > 65536:
            raise DamagedJpegError("its tables are inconsistent")
        table = np.zeros(65536, dtype=np.uint16)
        table[: spans.sum()] = np.repeat(symbols | (lengths << 8).astype(np.uint16), spans)
        short = np.where(table[::64] >> 8 <= 10, table[::64], 0)
        yield int(4 * kind + number), np.concatenate([table, short])
        place += 17 + len(symbols)


def _dc_steps(segment: UInt8[Array, " n"]) -> dict[int, int]:
    """Quantisation step of DC by table number."""
    steps: dict[int, int] = {}
    place = 0
    while place < len(segment):
        wide, number = int(segment[place] >> 4), int(segment[place] & 15)
        steps[number] = _number(segment, place + 1) if wide else int(segment[place + 1])
        place += 1 + 64 * (1 + wide)
    if place != len(segment) or 0 in steps.values():
        raise DamagedJpegError("its tables are inconsistent")
    return steps


def _start(segment: UInt8[Array, " n"], decoder: _Decoder) -> None:
    """Compute the layout of all components' blocks (T.81, A.2)."""
    height, width, count = _number(segment, 1), _number(segment, 3), int(segment[5])
    parts = segment[6 : 6 + 3 * count].reshape(count, 3)
    across, down = parts[:, 1] >> 4, parts[:, 1] & 15
    if segment[0] != 8 or not count or not width or not height or not np.all(across) or not np.all(down):
        raise DamagedJpegError("its header is damaged")
    widest, highest = int(across.max()), int(down.max())
    units_wide, units_high = -(-width // (8 * widest)), -(-height // (8 * highest))
    first = 0
    for (number, _, quantization), h, v in zip(parts.tolist(), across.tolist(), down.tolist(), strict=True):
        blocks = (-(-width * h // (8 * widest)), -(-height * v // (8 * highest)))
        stored = (units_wide * h, units_high * v)
        decoder.components[number] = _Component(number, h, v, quantization, first, blocks, stored)
        first += stored[0] * stored[1]
    decoder.units_wh = (units_wide, units_high)
    decoder.dc = np.zeros(first, dtype=np.int32)


def _walk(
    header: UInt8[Array, " h"], data: UInt8[Array, " n"], start: int, end: int, cuts: Int64[Array, " r"],
    decoder: _Decoder,
) -> None:  # fmt: skip
    """Read one scan.

    Args:
        header: scan header after its length.
        data: the file.
        start: first byte of the scan.
        end: first byte after it.
        cuts: positions of its restart markers.
        decoder: state of the decoder, which is updated.
    """
    from mammometry.io.photographs.entropy_kernels import walk  # imported late, since it is compiled

    count = int(header[0])
    parts = [
        (decoder.components[int(number)], int(tables) >> 4, 4 + (int(tables) & 15))
        for number, tables in header[1 : 1 + 2 * count].reshape(count, 2)
    ]
    first, last, bits = (int(value) for value in header[1 + 2 * count : 4 + 2 * count])
    scan = _kind(decoder, parts, (first, last, bits >> 4, bits & 15))
    alone = parts[0][0] if count == 1 else None
    across, down = decoder.units_wh if alone is None else alone.blocks_wh
    total = across * down
    interval = decoder.interval or total
    components = np.array(
        [
            (1 if alone else part.across, 1 if alone else part.down, part.stored_blocks_wh[0], part.first_block,
             dc << 4 | ac, _AMPLITUDE // decoder.dc_steps[part.quantization] + 2)
            for part, dc, ac in parts
        ],
        dtype=np.int64,
    )  # fmt: skip
    wanted = _FIRST_RESTART + np.arange(-(-total // interval) - 1) % 8
    if not np.array_equal(data[cuts + 1], wanted):
        raise DamagedJpegError("its restart markers are missing or out of order")
    plain, spans = _without_stuffing(data, start, end, cuts)
    units = np.array([across, total, interval], dtype=np.int64)
    read, left = walk(plain, spans, decoder.tables, components, units, scan, decoder.dc, decoder.known)
    spare = plain[spans[-1, 1] // 8 - left // 8 : spans[-1, 1] // 8]
    if read < total or (left > _ALIGNMENT and np.any(spare)):  # some programs fill a file's last sector with zeros
        raise DamagedJpegError("its coded pixels are damaged")  # position unknown: wrong codes may be valid for long
    if scan[0] in (SEQUENTIAL, DC_FIRST):
        decoder.coded |= {part.number for part, _, _ in parts}
        if decoder.layout is None:
            every = decoder.components.values()
            wide, high = max(part.across for part in every), max(part.down for part in every)
            unit_wh = (8 * wide // alone.across, 8 * high // alone.down) if alone else (8 * wide, 8 * high)
            decoder.layout = Layout(unit_wh=unit_wh, units_across=across, interval=decoder.interval)


def _kind(
    decoder: _Decoder, parts: list[tuple[_Component, int, int]], scan: tuple[int, int, int, int]
) -> Int64[Array, " 4"]:
    """Kind of a scan for the kernels, band and shift."""
    first, last, before, shift = scan
    if not decoder.progressive:
        kind, first, last, shift = SEQUENTIAL, 1, 63, 0
    elif first == 0:
        kind = DC_REFINED if before else DC_FIRST
    else:
        kind = AC_REFINED if before else AC_FIRST
    if decoder.progressive and (not first <= last <= 63 or (first == 0) != (last == 0) or shift > 13):
        raise DamagedJpegError("its header is damaged")
    for _, dc, ac in parts:
        needed = {dc} if kind in (SEQUENTIAL, DC_FIRST) else set()
        needed |= {ac} if kind in (SEQUENTIAL, AC_FIRST, AC_REFINED) else set()
        if not needed <= decoder.known_tables:
            raise DamagedJpegError("a table is missing")
    return np.array([kind, first, last, shift], dtype=np.int64)


def _without_stuffing(
    data: UInt8[Array, " n"], start: int, end: int, cuts: Int64[Array, " r"]
) -> tuple[UInt8[Array, " p"], Int64[Array, "m 2"]]:
    """Bytes of a scan without stuffing, markers and the padding before them, and its intervals, in bits."""
    coded = data[start:end]
    full = np.flatnonzero(coded[:-1] == 0xFF)
    keep = np.ones(len(coded), dtype=bool)
    keep[full[coded[full + 1] == 0] + 1] = False
    keep[full[coded[full + 1] != 0]] = False  # markers, and fill bytes before them (T.81, B.1.1.2)
    keep[cuts - start + 1] = False
    if len(coded) and coded[-1] == 0xFF:
        keep[-1] = False
    kept = coded[keep]
    plain = np.concatenate([kept, np.zeros(PADDING, dtype=np.uint8)])
    dropped = np.flatnonzero(~keep)
    starts = np.concatenate([[0], cuts - start + 2])
    ends = np.concatenate([cuts - start, [len(coded)]])
    spans = np.stack([starts, ends], axis=1)
    spans -= np.searchsorted(dropped, spans)
    return plain, 8 * spans
