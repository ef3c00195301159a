"""Files spoilt by chance, but knowingly: a place of a JSON tree, a cell of a table, a number of a mesh, or bytes."""

from __future__ import annotations

import io
import json
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import PurePath
from random import Random
from typing import Any

Spoilt = tuple[bytes, str]
"""The file's new content, and in words what was done to it."""

TEXT = frozenset({".toml", ".yml", ".yaml", ".xml", ".csv", ".txt", ".xyz", ".obj", ".mtl", ".jsonl", ".cal", ".dat"})
_HUGE = "9" * 400
_DEEP = 100_000
_MANY = 200_000
_TOKEN = re.compile(rb'"[^"\n]*"|[^\s,;:=<>\[\]{}"]+')
_ODD_VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 0.5, 2**31, 2**63, int(_HUGE), 1e308, -1e308, 5e-324, float("nan"), float("inf"),
    float("-inf"), "", " ", "nan", "1", "x" * 100_000, "\0", "\ud800", "\x1b[31m", "a\nb", "../../../outside",
    "/outside", "é", "\uff11", [], {}, [[]], [None], {"": 0}, [0.0] * _MANY, "2026-01-31",
)  # fmt: skip
_ODD_TOKENS = (
    "", "0", "-1", "1", "0.5", "2147483648", "18446744073709551616", _HUGE, "1e308", "-1e308", "1e999", "nan", "inf",
    "-inf", "true", '""', "null", "~", "x" * 100_000, "1,5", "0x10", "1_000", "é", "\uff11", "\0", "\x1b[31m", "[",
    "]" * 50, "{", "../../../outside", "/outside", "'", '"', "[" * 5_000, "1979-05-27", "0/0/0", "#", "=", ":",
)  # fmt: skip
_BOMBS = {
    "yml": (
        "&a [x,x,x,x,x,x,x,x]\nb: &b [*a,*a]\n" + "".join(f"c{k}: &c{k} [*c{k - 1},*c{k - 1}]\n" for k in range(1, 40)),
        '!!python/object/apply:os.system ["exit 1"]', "*nowhere", "&a [*a]",
    ),
    "xml": (
        '<!DOCTYPE a [<!ENTITY a "' + "a" * 1000 + '">'
        + "".join(f'<!ENTITY a{k} "{"&a;" if k == 0 else f"&a{k - 1};" * 10}">' for k in range(9)) + "]>&a8;",
        '<!DOCTYPE a [<!ENTITY f SYSTEM "file:///dev/zero">]>&f;',
    ),
}  # fmt: skip
_NUMBERS = tuple(
    struct.pack(form, value)
    for form, value in (
        *(("<f", each) for each in (float("nan"), float("inf"), 3e38, -3e38, 1e-45, 0.0)),
        *(("<d", each) for each in (float("nan"), float("inf"), 1e308, 5e-324)),
        *(("<I", each) for each in (0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)),
        *((">I", each) for each in (1, 0x7FFFFFFF, 0xFFFF)),
        *(("<Q", each) for each in (1 << 40, (1 << 64) - 1)),
    )
)


def spoil(name: str, data: bytes, rng: Random) -> Spoilt:
    """Change a file's content in one way that suits its kind."""
    suffix = PurePath(name).suffix.lower()
    ways: list[Callable[[bytes, Random], Spoilt]] = [_bytes]
    if suffix == ".json":
        ways += [_tree] * 5 + [_text_form, _tokens]
    elif suffix in TEXT:
        ways += [_lines, _tokens, _tokens, _tokens, _text_form]
        ways += [_columns] * 2 if suffix == ".csv" else []
        ways += [lambda text, chance: _bomb(text, chance, suffix[1:])] if suffix[1:] in _BOMBS else []
    elif suffix == ".glb":
        ways += [_glb] * 3 + [_numbers]
    elif suffix == ".ply":
        ways += [_ply_header, _ply_header, _numbers]
    elif suffix == ".png":
        ways += [_png_size, _numbers]
    elif suffix in (".jpg", ".jpeg"):
        ways += [_jpeg_size, _numbers]
    elif suffix == ".npz":
        ways += [_npz, _npz]
    else:
        ways += [_numbers, _numbers]
    try:
        return rng.choice(ways)(data, rng)
    except (ValueError, LookupError, RecursionError, struct.error, zipfile.BadZipFile):  # it was spoilt before
        return _bytes(data, rng)


def _bytes(data: bytes, rng: Random) -> Spoilt:
    """What a bad disk, a bad cable or a bad copy does."""
    if not data:
        return bytes(rng.randrange(256) for _ in range(64)), "64 random bytes in an empty file"
    start = rng.randrange(len(data))
    stop = min(len(data), start + rng.choice((1, 4, 64, 4096)))
    match rng.randrange(9):
        case 0:
            spoilt = bytearray(data)
            places = [rng.randrange(len(data)) for _ in range(rng.choice((1, 1, 4, 32)))]
            for place in places:
                spoilt[place] ^= 1 << rng.randrange(8)
            return bytes(spoilt), f"bits flipped at bytes {sorted(places)}"
        case 1:
            return data[:start], f"cut off after byte {start} of {len(data)}"
        case 2:
            return data[:start] + data[stop:], f"bytes {start} to {stop} dropped"
        case 3:
            return data[:stop] + data[start:], f"bytes {start} to {stop} doubled"
        case 4:
            return data[:start] + bytes(stop - start) + data[stop:], f"bytes {start} to {stop} zeroed"
        case 5:
            noise = bytes(rng.randrange(256) for _ in range(stop - start))
            return data[:start] + noise + data[stop:], f"bytes {start} to {stop} random"
        case 6:
            return b"", "emptied"
        case 7:
            return data + data, "the file twice, end to end"
        case _:
            return b"\x89PNG\r\n\x1a\n" + data, "a PNG's signature before it"


def _numbers(data: bytes, rng: Random) -> Spoilt:
    """A number of a binary file, at a place where one may stand."""
    number = rng.choice(_NUMBERS)
    start = 4 * rng.randrange(max(1, len(data) // 4)) + rng.choice((0, 0, 2))
    return data[:start] + number + data[start + len(number) :], f"{number!r} at byte {start}"


# --- JSON ---


def _tree(data: bytes, rng: Random) -> Spoilt:
    """One place of a JSON tree; the rest stays as it was written."""
    tree = json.loads(data)
    places = list(_places(tree))
    at = rng.choice(places)
    odd = rng.choice(_ODD_VALUES)
    said = f"at {'/'.join(map(str, at)) or 'the root'}"
    match rng.randrange(7):
        case 0 if at:
            parent = _found(tree, at[:-1])
            del parent[at[-1]]
            return _dumped(tree), f"{said}: dropped"
        case 1 if at and isinstance(_found(tree, at[:-1]), list):
            _found(tree, at[:-1]).insert(at[-1], _found(tree, at))
            return _dumped(tree), f"{said}: doubled"
        case 1 if at:
            key = json.dumps(at[-1]).encode()
            text = _dumped(tree)
            return text.replace(key + b":", key + b": 7, " + key + b":", 1), f"{said}: its key twice"
        case 2:
            node = _found(tree, at)
            if isinstance(node, list):
                rng.shuffle(node)
            elif isinstance(node, dict):
                items = list(node.items())
                rng.shuffle(items)
                node.clear()
                node |= dict(items)
            return _dumped(tree), f"{said}: in another order"
        case 3:
            text = _dumped(_with(tree, at, "DEEP"))
            return text.replace(b'"DEEP"', b"[" * _DEEP + b"]" * _DEEP, 1), f"{said}: {_DEEP} lists in one another"
        case 4 if at and isinstance(_found(tree, at[:-1]), dict):
            _found(tree, at[:-1])["stranger"] = odd
            return _dumped(tree), f"{said}: a stranger {_short(odd)} beside it"
        case _:
            return _dumped(_with(tree, at, odd)), f"{said}: {_short(odd)}"


def _places(tree: Any, at: tuple[Any, ...] = ()) -> Any:
    """All places of a tree; of a long list the first ones and the last."""
    yield at
    if isinstance(tree, dict):
        for key, value in tree.items():
            yield from _places(value, (*at, key))
    elif isinstance(tree, list):
        for number, value in enumerate(tree):
            if number < 3 or number == len(tree) - 1:
                yield from _places(value, (*at, number))


def _found(tree: Any, at: tuple[Any, ...]) -> Any:
    for key in at:
        tree = tree[key]
    return tree


def _with(tree: Any, at: tuple[Any, ...], value: Any) -> Any:
    if not at:
        return value
    _found(tree, at[:-1])[at[-1]] = value
    return tree


def _dumped(tree: Any) -> bytes:
    return json.dumps(tree, indent=1).encode()


def _short(value: object) -> str:
    text = repr(value) if not isinstance(value, int) or value < 1 << 64 else "an integer of 400 digits"
    return text if len(text) < 60 else f"{text[:40]}… ({len(text)} characters)"


# --- Text ---


def _text_form(data: bytes, rng: Random) -> Spoilt:
    """The same text as other programs write it, and as they should not."""
    text = data.decode("utf-8", "replace")
    forms: tuple[tuple[bytes, str], ...] = (
        (text.encode("utf-16"), "as UTF-16"),
        (text.encode("utf-8-sig"), "with a byte order mark"),
        (text.encode("utf-32"), "as UTF-32"),
        (data.replace(b"e", b"\xe9", 1), "a letter in Latin-1"),
        (data.replace(b"\n", b"\r\n"), "with CR LF"),
        (data.replace(b"\n", b"\r"), "with CR"),
        (data.replace(b"\n", b"\0\n", 1), "a NUL at a line's end"),
        (data.replace(b" ", b"\xc2\xa0"), "with hard spaces"),
        (data + b"\n" * 1000, "a thousand empty lines after it"),
        (b"#" * 3_000_000 + b"\n" + data, "3 MB in the first line"),
    )
    return rng.choice(forms)


def _lines(data: bytes, rng: Random) -> Spoilt:
    lines = data.split(b"\n")
    number = rng.randrange(len(lines))
    match rng.randrange(5):
        case 0:
            del lines[number]
            said = "dropped"
        case 1:
            lines.insert(number, lines[number])
            said = "doubled"
        case 2:
            other = rng.randrange(len(lines))
            lines[number], lines[other] = lines[other], lines[number]
            said = f"exchanged for line {other + 1}"
        case 3:
            lines[number] = b"  " + lines[number]
            said = "indented"
        case _:
            lines[number] = lines[number][: len(lines[number]) // 2]
            said = "cut in half"
    return b"\n".join(lines), f"line {number + 1} {said}"


def _tokens(data: bytes, rng: Random) -> Spoilt:
    """One word or number of a text."""
    found = list(_TOKEN.finditer(data))
    if not found:
        return _bytes(data, rng)
    here = rng.choice(found)
    odd = rng.choice(_ODD_TOKENS)
    spoilt = data[: here.start()] + odd.encode() + data[here.end() :]
    return spoilt, f"{_short(here.group().decode('utf-8', 'replace'))} at byte {here.start()} became {_short(odd)}"


def _columns(data: bytes, rng: Random) -> Spoilt:
    """What spreadsheets do to a table."""
    rows = [line.split(b",") for line in data.splitlines()]
    column = rng.randrange(max(len(row) for row in rows) or 1)
    match rng.randrange(5):
        case 0:
            rows = [row[:column] + row[column + 1 :] for row in rows]
            return _joined(rows), f"column {column + 1} dropped"
        case 1:
            rows = [row[: column + 1] + row[column:] for row in rows]
            return _joined(rows), f"column {column + 1} doubled"
        case 2:
            return data.replace(b".", b",").replace(b",", b";"), "semicolons for commas and points"
        case 3:
            return b"\n".join(b'"' + b",".join(row) for row in rows), "a quote opened on every line"
        case _:
            rows = [rows[0], *rows[1:] * (_MANY // max(1, len(rows)))]
            return _joined(rows), f"{len(rows)} lines"


def _joined(rows: list[list[bytes]]) -> bytes:
    return b"\n".join(b",".join(row) for row in rows) + b"\n"


def _bomb(data: bytes, rng: Random, kind: str) -> Spoilt:
    bomb = rng.choice(_BOMBS[kind])
    found = list(_TOKEN.finditer(data))
    place = rng.choice(found).start() if found else 0
    return data[:place] + bomb.encode() + data[place:], f"{_short(bomb)} at byte {place}"


# --- Binary files that have a structure ---


def _glb(data: bytes, rng: Random) -> Spoilt:
    """The JSON in a GLB, with its lengths put right again."""
    length = struct.unpack_from("<I", data, 12)[0]
    spoilt, said = rng.choice((_tree, _tree, _text_form))(data[20 : 20 + length], rng)
    spoilt += b" " * (-len(spoilt) % 4)
    rest = data[20 + length :]
    head = struct.pack("<4sIIII", b"glTF", 2, 20 + len(spoilt) + len(rest), len(spoilt), 0x4E4F534A)
    return head + spoilt + rest, f"its JSON {said}"


def _ply_header(data: bytes, rng: Random) -> Spoilt:
    end = data.index(b"end_header\n") + len(b"end_header\n")
    spoilt, said = rng.choice((_tokens, _tokens, _lines))(data[:end], rng)
    return spoilt + data[end:], f"its header: {said}"


def _png_size(data: bytes, rng: Random) -> Spoilt:
    """Another size in a PNG's header, with its check sum put right again."""
    width, height = rng.choice(((1, 1), (0, 0), (60_000, 60_000), (2**31 - 1, 2**31 - 1), (100_000_000, 1), (31, 20)))
    head = b"IHDR" + struct.pack(">II", width, height) + data[24:29]
    return data[:12] + head + struct.pack(">I", zlib.crc32(head)) + data[33:], f"its size {width} × {height}"


def _jpeg_size(data: bytes, rng: Random) -> Spoilt:
    """Another size where a JPEG's first frame begins."""
    start = data.index(b"\xff\xc0") + 5
    height, width = rng.choice(((0, 0), (1, 1), (65_500, 65_500), (65_500, 1), (21, 30)))
    return data[:start] + struct.pack(">HH", height, width) + data[start + 4 :], f"its size {width} × {height}"


def _npz(data: bytes, rng: Random) -> Spoilt:
    """One array of a NumPy archive, stored again with a right check sum."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = rng.choice(list(members))
    if name == "tree.npy":
        start = 10 + struct.unpack_from("<H", members[name], 8)[0]
        tree, said = _tree(members[name][start:], rng)
        file = io.BytesIO()
        head = f"{{'descr': '|u1', 'fortran_order': False, 'shape': ({len(tree)},), }}".ljust(117) + "\n"
        file.write(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head.encode() + tree)
        members[name] = file.getvalue()
    else:
        members[name], said = rng.choice((_numbers, _tokens, _bytes))(members[name], rng)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for each, content in members.items():
            archive.writestr(each, content)
    return out.getvalue(), f"its {name}: {said}"
