"""Compiled kernel that reads a JPEG's entropy-coded data without decoding the image.

It follows ITU-T T.81, annexes F and G, and finds errors that decoders ignore: undefined codes, too many coefficients in
a block, impossible brightness, and data that end before or after the image.
"""

import numpy as np

from mammometry.base.machine.compiled import kernel, small_kernel
from mammometry.geometry.arrays import Array, Int32, Int64, UInt8, UInt16
from mammometry.io.photographs.jpeg_stream import AC_REFINED, DC_FIRST, DC_REFINED, SEQUENTIAL

DAMAGED = -1  # returned in place of a position in the stream
_LARGEST_DC_BITS, _LARGEST_AC_BITS = 11, 10  # of 8-bit samples: T.81, F.1.2.1 and F.1.2.2
COLUMNS = 6
"""Columns that describe a component of a scan: blocks across and down in a unit, blocks in a row, index of its first
block, numbers of its tables as 16 × DC + AC, and the largest DC."""


@small_kernel
def _peek(data, bit):  # type: ignore[no-untyped-def]
    """The next 16 bits."""
    place = np.uintp(bit >> 3)  # unsigned, so that numba does not test for negative indices
    one, two = np.uintp(1), np.uintp(2)
    three = (np.int64(data[place]) << 16) | (np.int64(data[place + one]) << 8) | np.int64(data[place + two])
    return (three >> (8 - (bit & 7))) & 0xFFFF


@small_kernel
def _symbol(data, bit, table):  # type: ignore[no-untyped-def]
    """The next symbol + 256 × the length of its code. 0 for an undefined code."""
    bits = _peek(data, bit)
    entry = np.int64(table[np.uintp(65536 + (bits >> 6))])  # a small table for short codes
    return entry if entry != 0 else np.int64(table[np.uintp(bits)])


@small_kernel
def _difference(data, bit, size):  # type: ignore[no-untyped-def]
    """A signed value of `size` bits (T.81, F.2.2.1)."""
    value = _peek(data, bit) >> (16 - size)
    return value if size == 0 or value >> (size - 1) else value - (1 << size) + 1


@kernel
def _dc(data, bit, table, dc, block, previous, shift, largest):  # type: ignore[no-untyped-def]
    """Read a block's DC coefficient. Returns the position after it, or `DAMAGED`."""
    entry = _symbol(data, bit, table)
    size = entry & 255
    if entry == 0 or size > _LARGEST_DC_BITS:
        return DAMAGED
    bit += entry >> 8
    value = previous + (_difference(data, bit, size) << shift)
    dc[block] = value
    return bit + size if -largest <= value <= largest else DAMAGED


@kernel
def _ac(data, bit, table):  # type: ignore[no-untyped-def]
    """Skip the AC coefficients of a sequential block. Returns the position after them, or `DAMAGED`."""
    k = 1
    while k < 64:
        entry = _symbol(data, bit, table)
        if entry == 0:
            return DAMAGED
        bit += entry >> 8
        run, size = (entry >> 4) & 15, entry & 15
        if size == 0:
            if run == 0:
                break
            if run != 15:
                return DAMAGED
            k += 16
            if k > 64:
                return DAMAGED
        else:
            k += run + 1
            bit += size
            if k > 64 or size > _LARGEST_AC_BITS:
                return DAMAGED
    return bit


@kernel
def _ac_first(data, bit, table, known, band):  # type: ignore[no-untyped-def]
    """Read a band's first bits (G.1.2.2). Returns next position or `DAMAGED`, and number of empty blocks."""
    k = band[0]
    while k <= band[1]:
        entry = _symbol(data, bit, table)
        if entry == 0:
            return DAMAGED, 0
        bit += entry >> 8
        run, size = (entry >> 4) & 15, entry & 15
        if size == 0:
            if run < 15:
                return bit + run, (1 << run) + (_peek(data, bit) >> (16 - run)) - 1
            k += 16
        else:
            k += run
            bit += size
            if k > band[1] or size > _LARGEST_AC_BITS:
                return DAMAGED, 0
            known[k] = 1
            k += 1
    return (bit, 0) if k == band[1] + 1 else (DAMAGED, 0)


@kernel
def _ac_refined(data, bit, table, known, band, empty):  # type: ignore[no-untyped-def]
    """Read a band's next bit (G.1.2.3). Returns next position or `DAMAGED`, and number of empty blocks."""
    k = band[0]
    if empty == 0:
        while k <= band[1]:
            entry = _symbol(data, bit, table)
            if entry == 0:
                return DAMAGED, 0
            bit += entry >> 8
            run, size = (entry >> 4) & 15, entry & 15
            if size > 1:
                return DAMAGED, 0
            if size == 0 and run < 15:
                empty = (1 << run) + (_peek(data, bit) >> (16 - run))
                bit += run
                break
            bit += size
            while k <= band[1]:
                if known[k]:
                    bit += 1
                elif run == 0:
                    break
                else:
                    run -= 1
                k += 1
            if size == 1:
                if k > band[1]:
                    return DAMAGED, 0
                known[k] = 1
            k += 1
    if empty > 0:
        while k <= band[1]:
            bit += known[k]
            k += 1
        empty -= 1
    return bit, empty


@kernel
def walk(
    data: UInt8[Array, " n"],
    spans: Int64[Array, "m 2"],
    tables: UInt16[Array, "8 66560"],
    components: Int64[Array, "c 6"],
    units: Int64[Array, " 3"],
    scan: Int64[Array, " 4"],
    dc: Int32[Array, " b"],
    known: UInt8[Array, "k 64"],
) -> tuple[int, int]:
    """Read one scan.

    Args:
        data: entropy-coded bytes, without stuffing and markers, with `PADDING` more bytes than `spans` use.
        spans: first bit and last bit + 1 of each interval between restart markers.
        tables: symbol + 256 × code length, by the next 16 bits; 0 if undefined. Four tables for DC, four for AC.
        components: one row of `COLUMNS` per component of the scan.
        units: units in a row, in total, and in a restart interval.
        scan: kind, first and last coefficient, number of bits left for later scans.
        dc: DC coefficient of each block. Written by scans that code it.
        known: whether each coefficient of a block is non-zero. Used by progressive scans only.

    Returns:
        Number of units read, and of bits left in the last interval. In an undamaged scan, all units are read, and fewer
        than 8 bits are left.
    """
    kind, shift = scan[0], scan[3]
    band = (scan[1], scan[2])
    across, total, in_stretch = units[0], units[1], units[2]
    previous = np.zeros(len(components), dtype=np.int64)
    unit, left = 0, 0
    for stretch in range(len(spans)):
        bit, end = spans[stretch, 0], spans[stretch, 1]
        previous[:] = 0
        empty = 0
        for unit in range(stretch * in_stretch, min(total, (stretch + 1) * in_stretch)):
            row, column = unit // across, unit % across
            for c in range(len(components)):
                wide, high, blocks_in_row, first, number, largest = components[c]
                for j in range(wide * high):
                    block = first + (row * high + j // wide) * blocks_in_row + column * wide + j % wide
                    if kind in (SEQUENTIAL, DC_FIRST):
                        bit = _dc(data, bit, tables[number >> 4], dc, block, previous[c], shift, largest)
                        if bit == DAMAGED or bit > end:
                            return unit, left
                        previous[c] = dc[block]
                        if kind == SEQUENTIAL:
                            bit = _ac(data, bit, tables[number & 15])
                    elif kind == DC_REFINED:
                        bit += 1
                    elif kind == AC_REFINED:
                        bit, empty = _ac_refined(data, bit, tables[number & 15], known[block], band, empty)
                    elif empty > 0:
                        empty -= 1
                    else:
                        bit, empty = _ac_first(data, bit, tables[number & 15], known[block], band)
                    if bit == DAMAGED or bit > end:
                        return unit, left
        if empty > 0:
            return unit, left
        left = end - bit
        if left > 7:  # more than padding
            return min(total, (stretch + 1) * in_stretch), left
    return total, left
