"""What programs, people and disks do to a file that is otherwise right: its format changes, what it says does not."""

from __future__ import annotations

import io
import json
import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from random import Random

import numpy as np
import tifffile
from PIL import Image
from tests.brought.format_inputs import DOME, Files, camera_files

from mammometry.io.cameras.formats import CameraFormat

Vertices = np.ndarray
Changed = Callable[[Files, Random], Files]


@dataclass(frozen=True)
class Change:
    """One change of a file's format."""

    name: str
    suits: frozenset[str]
    """Kinds of input, one of which is enough."""
    apply: Changed
    words: str = "(?!)"
    """Of a sentence that names it. By default none may be refused."""
    relative: float = 0.0
    """By how much it may move the numbers: what it rounds."""
    makes_binary: bool = False
    """Whether a text is none any more."""


def first(files: Files) -> tuple[str, bytes]:
    return next(iter(files.items()))


def replaced(files: Files, content: bytes, name: str | None = None) -> Files:
    old = first(files)[0]
    return {name or old: content} | {other: files[other] for other in files if other != old}


def on_bytes(change: Callable[[bytes, Random], bytes]) -> Changed:
    return lambda files, rng: replaced(files, change(first(files)[1], rng))


def on_text(change: Callable[[str, Random], str]) -> Changed:
    return on_bytes(lambda data, rng: change(data.decode(), rng).encode())


def on_lines(change: Callable[[list[str], Random], list[str]]) -> Changed:
    return on_text(lambda text, rng: "\n".join(change(text.split("\n"), rng)))


# --- any text ---

_DECIMAL = re.compile(r"(?<![\w.\"/-])(?<!\d,)(-?\d+\.\d+)(?![\w.\"/])(?!,\d{2}[;,\n])")


_POINT = re.compile(r"(?<=\d)\.(?=\d)")
_WIDE = {48 + digit: 0xFF10 + digit for digit in range(10)}


def numbers(pattern: Callable[[float], str]) -> Changed:
    """Write every number with decimals otherwise, but versions and names."""

    def change(text: str, rng: Random) -> str:
        kept = ("<?xml", "%YAML", "<document", "format ascii")
        return "\n".join(
            line if line.startswith(kept) else _DECIMAL.sub(lambda match: pattern(float(match[1])), line)
            for line in text.split("\n")
        )

    return on_text(change)


def in_quotes(files: Files, rng: Random) -> Files:
    return on_text(lambda text, _: _DECIMAL.sub(r'"\1"', text))(files, rng)


def decimal_commas(files: Files, rng: Random) -> Files:
    """As a computer writes numbers that is set to another country; not in versions."""
    return on_text(
        lambda text, rng: "\n".join(
            line if line.startswith(("<?xml", "%YAML", "<document", "format ascii")) else _POINT.sub(",", line)
            for line in text.split("\n")
        )
    )(files, rng)


def latin_1(data: bytes, rng: Random) -> bytes:
    return data.decode().encode("latin-1", "replace")


def sprinkled(data: bytes, rng: Random) -> bytes:
    lines = data.split(b"\n")
    return b"\n".join(line + b"\r" if rng.random() < 0.5 and line else line for line in lines)


_WHERE = r"line \d+|row \d+|JSON|cannot be (read|parsed)|names with values|no triangles|camera|cam|invalid value|a line"
"""Where something stands that is no such text; what it is, only an editor shows."""


# --- tables ---


def separated(by: str, *, comma: bool = False) -> Changed:
    def change(text: str, rng: Random) -> str:
        old = ";" if ";" in text.split("\n", 1)[0] else ","
        text = text.replace(old, "\0")
        text = text.replace(".", ",") if comma else text
        return text.replace("\0", by)

    return on_text(change)


def columns_shuffled(text: str, rng: Random) -> str:
    old = ";" if ";" in text.split("\n", 1)[0] else ","
    rows = [line.split(old) for line in text.strip("\n").split("\n")]
    order = [0, *rng.sample(range(1, len(rows[0])), len(rows[0]) - 1)]  # the first names the subjects
    return "\n".join(old.join(row[place] for place in order) for row in rows) + "\n"


def quoted(text: str, rng: Random) -> str:
    old = ";" if ";" in text.split("\n", 1)[0] else ","
    rows = [line.split(old) for line in text.strip("\n").split("\n")]
    return "\n".join(old.join(f'"{cell}"' for cell in row) for row in rows) + "\n"


def rows_shuffled(lines: list[str], rng: Random) -> list[str]:
    rows = lines[1:-1]
    rng.shuffle(rows)
    return [lines[0], *rows, lines[-1]]


def thousands(mark: str, decimal: str) -> Changed:
    """As a spreadsheet shows numbers: 1.860,25."""

    def change(text: str, rng: Random) -> str:
        old = ";" if ";" in text.split("\n", 1)[0] else ","

        def shown(cell: str) -> str:
            whole, point, decimals = cell.partition(".")
            if not whole.isdigit():
                return cell
            return f"{int(whole):,}".replace(",", mark) + (decimal + decimals if point else "")

        rows = [line.split(old) for line in text.strip("\n").split("\n")]
        return "\n".join(";".join(map(shown, row)) for row in rows) + "\n"

    return on_text(change)


def whole_thousands(text: str, rng: Random) -> str:
    """Whole numbers with a comma between thousands, in every row: nothing says what it means."""
    lines = text.strip("\n").split("\n")
    rows = [re.split("[;,]", line) for line in lines]
    rows = [rows[0], *([row[0], *("" if not cell else f"1,{int(float(cell)) % 900 + 100}" for cell in row[1:])]
                       for row in rows[1:])]  # fmt: skip
    return "\n".join(";".join(row) for row in rows) + "\n"


def renamed_column(text: str, rng: Random) -> str:
    head, rest = text.split("\n", 1)
    return head.replace("_cc", " (cc)").replace("id,u,v", "nr,x,y") + "\n" + rest


def extra_column(text: str, rng: Random) -> str:
    old = ";" if ";" in text.split("\n", 1)[0] else ","
    lines = text.strip("\n").split("\n")
    return "\n".join([f"{lines[0]}{old}note", *(f"{line}{old}ok" for line in lines[1:])]) + "\n"


# --- meshes ---


def dome_faces(rng: Random) -> tuple[Vertices, np.ndarray]:
    """The dome with its vertices and faces in another order."""
    chance = np.random.default_rng(rng.randrange(1 << 32))
    place = chance.permutation(len(DOME.vertices))
    at = np.argsort(place)
    faces = at[DOME.faces][chance.permutation(len(DOME.faces))]
    turns = chance.integers(0, 3, len(faces))
    return DOME.vertices[place], np.stack([np.roll(face, turn) for face, turn in zip(faces, turns, strict=True)])


def ply_of(vertices: Vertices, faces: np.ndarray, *, order: str = "<", real: str = "float", count: str = "uchar",
           names: str = "xyz", beside: str = "", faces_first: bool = False, key: str = "vertex_indices",
           comment: str = "comment units: mm") -> bytes:  # fmt: skip
    """A binary PLY as another program writes it."""
    columns = [
        vertices["xyz".index(name)] if name in "xyz" else np.full(len(vertices[0]), 0.5) for name in names + beside
    ]
    properties = "".join(f"property {real} {name}\n" for name in names + beside)
    elements = [
        (f"element vertex {len(columns[0])}\n{properties}",
         np.stack(columns, axis=1).astype(order + {"float": "f4", "double": "f8"}[real]).tobytes()),
        (f"element face {len(faces)}\nproperty list {count} int {key}\n",
         b"".join(struct.pack(f"{order}{'B' if count == 'uchar' else 'i'}3i", 3, *face) for face in faces.tolist())),
    ]  # fmt: skip
    elements = elements[::-1] if faces_first else elements
    form = "binary_little_endian" if order == "<" else "binary_big_endian"
    head = f"ply\nformat {form} 1.0\n{comment}\n" + "".join(words for words, _ in elements) + "end_header\n"
    return head.encode() + b"".join(content for _, content in elements)


def as_ply(**options: object) -> Changed:
    def change(files: Files, rng: Random) -> Files:
        vertices, faces = dome_faces(rng)
        return replaced(files, ply_of(vertices.T, faces, **options), "mesh.ply")  # type: ignore[arg-type]

    return change


def as_obj(form: str, *, flipped: bool = False, colours: bool = False, group: int = 0) -> Changed:
    def change(files: Files, rng: Random) -> Files:
        vertices, faces = dome_faces(rng)
        faces = faces[:, ::-1] if flipped else faces
        tail = " 0.5 0.5 0.5" if colours else ""
        lines = ["# units: mm", *(f"v {x:.6f} {y:.6f} {z:.6f}{tail}" for x, y, z in vertices.tolist())]
        lines += ["vt 0.5 0.5", "vn 0 0 1"] if "/" in form else []
        for number, face in enumerate(faces.tolist()):
            if group and number % group == 0:
                lines.append(f"g part {number}")
            lines.append("f " + " ".join(form.format(k + 1, back=k - len(vertices)) for k in face))
        return replaced(files, "\n".join(lines).encode(), "mesh.obj")

    return change


def scaled(factor: float, unit: str | None) -> Changed:
    """In another unit, which the file states; None: nobody says so."""

    def change(files: Files, rng: Random) -> Files:
        vertices, faces = dome_faces(rng)
        lines = [f"# units: {unit or 'mm'}", *(f"v {x!r} {y!r} {z!r}" for x, y, z in (vertices * factor).tolist())]
        lines += ["f " + " ".join(str(k + 1) for k in face) for face in faces.tolist()]
        return replaced(files, "\n".join(lines).encode(), "mesh.obj")

    return change


def far_away(files: Files, rng: Random) -> Files:
    """Where single precision has no digits left."""
    vertices, faces = dome_faces(rng)
    return replaced(files, ply_of((vertices + np.array([5e6, 0, 0])).T, faces), "mesh.ply")


def ending(suffix: str | None) -> Changed:
    """Another ending of the name; None: in capitals."""

    def change(files: Files, rng: Random) -> Files:
        name, data = first(files)
        return replaced(files, data, name.upper() if suffix is None else f"mesh{suffix}")

    return change


def ending_of_another(files: Files, rng: Random) -> Files:
    name, data = first(files)
    return replaced(files, data, {"ply": "mesh.stl", "obj": "mesh.ply", "stl": "mesh.obj"}[name[-3:].lower()])


def solid_binary(data: bytes, rng: Random) -> bytes:
    """A binary STL whose header begins as a text's."""
    return b"solid made by a scanner".ljust(80) + data[80:] if data[:5] != b"solid" else data


def counted(data: bytes, count: int) -> bytes:
    """A binary STL whose count says something else."""
    return data if data[:5] == b"solid" else data[:80] + struct.pack("<I", count) + data[84:]


# --- photographs ---


_FINE = {"quality": 98, "subsampling": 0}
_SUFFIX = {"JPEG": "jpg", "TIFF": "tif", "PNG": "png", "BMP": "bmp"}


def resaved(form: str, mode: str = "RGB", ending: str | None = None, **options: object) -> Changed:
    def change(files: Files, rng: Random) -> Files:
        data = first(files)[1]
        with Image.open(io.BytesIO(data)) as image:
            eight = image.convert("RGB")
        if data[:4] in (b"II*\0", b"MM\0*"):
            eight = Image.fromarray((tifffile.imread(io.BytesIO(data)) >> 8).astype(np.uint8))
        buffer = io.BytesIO()
        eight.convert(mode).save(buffer, form, **options)
        return replaced(files, buffer.getvalue(), f"front_left.{ending or _SUFFIX[form]}")

    return change


def turned(orientation: int) -> Changed:
    """Stored turned, with the tag that says so."""
    from PIL import ImageOps

    def change(files: Files, rng: Random) -> Files:
        with Image.open(io.BytesIO(resaved("PNG")(files, rng)["front_left.png"])) as image:
            upright = image.convert("RGB")
        for stored in range(1, 9):  # which of the turns is undone by the tag
            tried = Image.new("RGB", (1, 1))
            tried = ImageOps.exif_transpose(_tagged(upright, stored))
            if np.array_equal(ImageOps.exif_transpose(_tagged(tried, orientation)), upright):
                exif = Image.Exif()
                exif[274] = orientation
                buffer = io.BytesIO()
                tried.save(buffer, "PNG", exif=exif)
                return replaced(files, buffer.getvalue(), "front_left.png")
        raise AssertionError(orientation)

    return change


def _tagged(image: Image.Image, orientation: int) -> Image.Image:
    copy = image.copy()
    copy.getexif()[274] = orientation
    return copy


# --- cameras ---

_FORMS: dict[str, CameraFormat] = {"cameras.json": "json", "front_left.yml": "opencv", "cameras.txt": "colmap",
                                   "camchain.yaml": "kalibr"}  # fmt: skip


def cameras(factor: float = 1.0, *, exchanged: bool = False) -> Changed:
    return lambda files, rng: camera_files(_FORMS[first(files)[0]], factor, exchanged=exchanged)()


# --- JSON, TOML, YAML, XML ---


def dumped(**options: object) -> Changed:
    return on_text(lambda text, rng: json.dumps(json.loads(text), **options))  # type: ignore[arg-type]


def keys_shuffled(text: str, rng: Random) -> str:
    def mixed(node: object) -> object:
        if isinstance(node, dict):
            items = list(node.items())
            rng.shuffle(items)
            return {key: mixed(value) for key, value in items}
        return [mixed(value) for value in node] if isinstance(node, list) else node

    return json.dumps(mixed(json.loads(text)), ensure_ascii=False)


def with_units(unit: str) -> Changed:
    return on_text(lambda text, rng: text.replace('"mm"', f'"{unit}"', 1))


def toml_tables_shuffled(text: str, rng: Random) -> str:
    head, *tables = re.split(r"\n(?=\[\w)", text)
    rng.shuffle(tables)
    return "\n".join([head, *(table.rstrip("\n") for table in tables)]) + "\n"


def yaml_indented(text: str, rng: Random) -> str:
    return re.sub(r"^( +)", lambda match: match[1] * 2, text, flags=re.MULTILINE)


def _change(name: str, suits: str, apply: Changed, words: str = "(?!)",
            relative: float = 0.0) -> Change:  # fmt: skip
    binary = name.startswith("PLY") or apply is far_away
    return Change(
        name=name, suits=frozenset(suits.split()), apply=apply, words=words, relative=relative, makes_binary=binary
    )


_PLY_AND_OBJ = "ply obj"
CHANGES = (
    # encodings
    _change("byte-order mark", "text", on_bytes(lambda data, rng: b"\xef\xbb\xbf" + data)),
    _change("UTF-16", "text", on_bytes(lambda data, rng: data.decode().encode("utf-16")), "UTF-16"),
    _change("UTF-16 without a mark", "text", on_bytes(lambda data, rng: data.decode().encode("utf-16-le")), "UTF-16"),
    _change("Latin-1", "text", on_bytes(latin_1), "UTF-8"),
    _change("decomposed letters", "text", on_text(lambda text, rng: text.replace("ö", "o\u0308"))),
    _change("a NUL at the end", "text", on_bytes(lambda data, rng: data + b"\0"), "NUL|to its end|binary data"),
    _change("Ctrl-Z at the end", "text", on_bytes(lambda data, rng: data + b"\x1a"), _WHERE),
    # line ends and blanks
    _change("CR LF", "text", on_bytes(lambda data, rng: data.replace(b"\n", b"\r\n"))),
    _change("CR", "text", on_bytes(lambda data, rng: data.replace(b"\n", b"\r"))),
    _change("mixed line ends", "text", on_bytes(sprinkled)),
    _change("no end of the last line", "text", on_bytes(lambda data, rng: data.rstrip(b"\n"))),
    _change("empty lines at the end", "text", on_bytes(lambda data, rng: data + b"\n" * rng.randint(1, 50))),
    _change("blanks at the ends of lines", "text", on_bytes(lambda data, rng: data.replace(b"\n", b"  \n"))),
    _change("hard spaces", "text", on_text(lambda text, rng: text.replace(" ", "\u00a0")), _WHERE),
    _change("letters of another width", "text", on_text(lambda text, rng: text.translate(_WIDE)), _WHERE),
    # numbers
    _change("exponents", "text", numbers(lambda value: f"{value:.17e}"), relative=1e-14),
    _change("more zeros", "text", numbers(lambda value: f"{value!r}000" if "e" not in repr(value) else repr(value))),
    _change("eight digits", "text", numbers(lambda value: f"{value:.8g}" if value % 1 else repr(value)), relative=2e-7),
    _change("decimal commas", "text", decimal_commas, r"comma|\d,\d|values|numbers|cannot be (read|parsed)"),
    _change("numbers in quotes", "json toml", in_quotes, "found '|'.*' where"),
    _change("NaN", "json", on_text(lambda text, rng: _DECIMAL.sub("NaN", text, count=1)), "nan|NaN|finite"),
    # tables
    _change("semicolons", "table", separated(";")),
    _change("tabs", "table", separated("\t")),
    _change("commas", "table", separated(",")),
    _change("bars", "table", separated("|"), "column"),
    _change("semicolons and decimal commas", "table", separated(";", comma=True)),
    _change("commas and decimal commas", "table", separated(",", comma=True), "values|column|decimals"),
    _change("sep=", "table", on_text(lambda text, rng: f"sep={';' if ';' in text[:40] else ','}\n{text}")),
    _change("columns in another order", "table", on_text(columns_shuffled)),
    _change("rows in another order", "table", on_lines(rows_shuffled)),
    _change("cells in quotes", "table", on_text(quoted)),
    _change("points between thousands", "table", thousands(".", ",")),
    _change("commas between thousands", "table", thousands(",", ".")),
    _change("blanks between thousands", "table", thousands(" ", ","), "number"),
    _change("whole thousands", "table", on_text(whole_thousands), "may mean 1[0-9]{3} or 1"),
    _change("other names of columns", "table", on_text(renamed_column), "column"),
    _change("one column more", "table", on_text(extra_column)),
    _change("a unit in cells", "table", on_text(lambda text, rng: re.sub(r"(\d\.\d+)", r"\1 cc", text)), "number"),
    # meshes
    _change("PLY of another program", _PLY_AND_OBJ, as_ply()),
    _change("PLY in doubles", _PLY_AND_OBJ, as_ply(real="double")),
    _change("PLY, big-endian", _PLY_AND_OBJ, as_ply(order=">")),
    _change("PLY with coordinates in another order", _PLY_AND_OBJ, as_ply(names="zxy")),
    _change("PLY with quality", _PLY_AND_OBJ, as_ply(beside="q")),
    _change("PLY with faces first", _PLY_AND_OBJ, as_ply(faces_first=True), "face|order|element"),
    _change("PLY with another list", _PLY_AND_OBJ, as_ply(count="int", key="vertex_index")),
    _change("PLY with a comment on its end", "ply", on_bytes(
        lambda data, rng: data.replace(b" 1.0\n", b" 1.0\ncomment before the end_header comes\n", 1))),
    _change("comments behind numbers", "obj", on_text(
        lambda text, rng: re.sub(r"^((?:v|f) .*)$", r"\1 # no. 7", text, flags=re.MULTILINE))),
    _change("a count of 0", "stl", on_bytes(lambda data, rng: counted(data, 0))),
    _change("a count of another mesh", "stl", on_bytes(lambda data, rng: counted(data, 7))),
    _change("a count that is far too large", "stl", on_bytes(lambda data, rng: counted(data, 2**32 - 1))),
    _change("in inches, as it says", "obj", scaled(1 / 25.4, "Inches")),
    _change("in feet, as it says", "obj", scaled(1 / 304.8, "ft")),
    _change("OBJ in another order", _PLY_AND_OBJ, as_obj("{0}")),
    _change("OBJ with texture's and normals' numbers", "obj", as_obj("{0}/1/1")),
    _change("OBJ with normals alone", "obj", as_obj("{0}//1")),
    _change("OBJ counted back", "obj", as_obj("{back}")),
    _change("OBJ in groups", "obj", as_obj("{0}", group=40)),
    _change("OBJ with colours", "obj", as_obj("{0}", colours=True)),
    _change("OBJ inside out", "obj", as_obj("{0}", flipped=True), "inside out"),
    _change("in centimetres, as it says", "obj", scaled(0.1, "cm")),
    _change("in metres, as it says", "obj", scaled(0.001, "m")),
    _change("in centimetres, unsaid", "obj", scaled(0.1, None), "unit"),
    _change("in metres, unsaid", "obj", scaled(0.001, None), "unit"),
    _change("in inches, unsaid", "obj", scaled(1 / 25.4, None), "unit"),
    _change("in micrometres, unsaid", "obj", scaled(1000.0, None), "unit"),
    _change("far from its origin", _PLY_AND_OBJ, far_away, "steps of"),
    _change("another ending", "mesh", ending(".ply2"), "another file type"),
    _change("capital ending", "mesh", ending(None)),
    _change("the ending of another format", "mesh", ending_of_another, "file extension"),
    _change("a binary header that begins as text", "stl", on_bytes(solid_binary)),
    # photographs
    _change("progressive JPEG", "photograph", resaved("JPEG", progressive=True, **_FINE), relative=0.03),
    _change("JPEG in CMYK", "photograph", resaved("JPEG", "CMYK", "jpeg", **_FINE), relative=0.03),
    _change("PNG with transparency", "photograph", resaved("PNG", mode="RGBA"), relative=0.02),
    _change("TIFF in LZW", "photograph", resaved("TIFF", compression="tiff_lzw"), relative=0.03),
    _change("TIFF in JPEG", "photograph", resaved("TIFF", ending="tiff", compression="jpeg"), relative=0.05),
    _change("capital ending of a photograph", "photograph", resaved("JPEG", ending="JPG", **_FINE), relative=0.03),
    _change("BMP", "photograph", resaved("BMP"), "a BMP"),
    _change("a PNG called JPEG", "photograph", resaved("PNG", ending="jpg"), relative=0.02),
    *(_change(f"turned, by tag {tag}", "photograph", turned(tag), relative=0.02) for tag in range(2, 9)),
    # cameras
    *(_change(f"{name}, unsaid", "rig", cameras(factor), "they seem to be in|check units")
      for name, factor in (("metres", 1e-3), ("centimetres", 0.1), ("inches", 1 / 25.4), ("micrometres", 1e3))),
    _change("cameras under each other's name", "rig", cameras(exchanged=True), "or the two cameras' files"),
    # JSON, TOML, YAML, XML
    _change("one line", "json", dumped()),
    _change("escaped letters", "json", dumped(indent=4, ensure_ascii=True)),
    _change("keys in another order", "json", on_text(keys_shuffled)),
    _change("a comma too many", "json", on_text(lambda text, rng: re.sub(r"\]\s*\}", "],}", text, count=1)), "JSON"),
    _change("a comment", "json", on_text(lambda text, rng: "// made by hand\n" + text), "JSON"),
    _change("in centimetres", "json toml", with_units("cm"), "units|'cm'|mm"),
    _change("in metres", "json toml", with_units("m"), "units|'m'|mm"),
    _change("tables in another order", "toml", on_text(toml_tables_shuffled)),
    _change("indented", "toml", on_text(lambda text, rng: re.sub("^(?=[a-z])", "\t", text, flags=re.MULTILINE))),
    _change("blanks for underscores", "toml", on_text(lambda text, rng: text.replace("e_mm", "e mm")), "TOML"),
    _change("single quotes", "toml", on_text(lambda text, rng: text.replace('"', "'"))),
    _change("typographic quotes", "toml json", on_text(lambda text, rng: text.replace('"', "\u201c")), "TOML|JSON"),
    _change("deeper", "yaml", on_text(yaml_indented)),
    _change("a comment in XML", "xml", on_text(lambda text, rng: text.replace("<chunk ", "<!-- hand --><chunk ", 1))),
    _change("a doctype", "xml", on_text(lambda text, rng: text.replace("<doc", "<!DOCTYPE a><doc", 1)), "declaration"),
)  # fmt: skip
