"""Names in all scripts on paper: read back from the PDF, and compared with another program's drawing."""

import io
import random
import shutil
import subprocess
import unicodedata
from pathlib import Path

import numpy as np
import pypdf
import pytest
from bidi import get_display
from PIL import Image, ImageDraw, ImageFont, features
from scipy import ndimage

from mammometry.base.errors import SettingsError
from mammometry.base.letters import isolated
from mammometry.report.content import Fact
from mammometry.report.documents import paper
from mammometry.report.documents.letters import shaping
from mammometry.report.documents.letters.direction import is_right_to_left, levels, reordered
from mammometry.report.documents.letters.lines import in_order, pieces
from mammometry.study.tables import TextTable

NAMES = {
    "Kanji": "山田 花子",
    "Kanji with a variant": "渡邉\U000e0100 髙橋 﨑",
    "Kana and Latin": "ヤマダ・ハナコ (Yamada)",
    "Chinese": "陳大文 王小明",
    "Hangul": "김민지",
    "Devanagari": "क्षितिज शर्मा",
    "Bengali": "অনির্বাণ",
    "Tamil": "ஸ்ரீனிவாசன்",
    "Thai": "สมชาย ชื่อ",
    "Cyrillic": "Їжакевич Ґанна",
    "Cyrillic outside DejaVu": "Ԩԩᲀ Ꙁꙁ",
    "Georgian": "ქეთევან",
    "Ethiopic": "አበበ ቢቂላ",
    "Vietnamese": "Nguyễn Thị Hương",
    "marks of their own": "Zoe\u0308\u0301x",
    "beyond 16 bits": "𠮷野 😀",
}
RIGHT_TO_LEFT = {
    "Arabic": "محمد عبد الله",
    "Persian with a non-joiner": "فاطمه نیک‌پور",
    "Hebrew": "נועה כהן",
    "vowels": "مُحَمَّد",
}
WITH_LATIN = "محمد عبد الله (Dr. Smith) 123"


def lines_of(document: bytes) -> list[str]:
    return [line for page in pypdf.PdfReader(io.BytesIO(document)).pages for line in page.extract_text().split("\n")]


def printed(words: str, *, size: float = 17.0, bold: bool = True) -> bytes:
    return paper.document("Report", "subject", lambda width: [paper.text(words, size=size, bold=bold)])


def composed(words: str) -> str:
    return unicodedata.normalize("NFC", words)


@pytest.mark.requirement("R-NAME-1")
@pytest.mark.parametrize("name", [*NAMES.values(), *RIGHT_TO_LEFT.values()], ids=[*NAMES, *RIGHT_TO_LEFT])
@pytest.mark.parametrize("bold", [True, False])
def test_a_name_is_read_back_from_the_document(name: str, bold: bool) -> None:
    assert composed(name) in lines_of(printed(name, bold=bold))


def test_right_to_left_beside_latin_letters_and_numbers() -> None:
    """A reader of our own eyes: from left to right the number, Latin in brackets, then the name from its end."""
    (line,) = [line for line in lines_of(printed(WITH_LATIN)) if "Smith" in line]
    assert line.split() == ["123", "(Dr.", "Smith)", "محمد", "عبد", "الله"]


@pytest.mark.skipif(shutil.which("pdftotext") is None, reason="pdftotext is not installed")
def test_another_reader_reads_the_same(tmp_path: Path) -> None:
    # Poppler turns the letters of a code round where it runs from right to left: vowels before their consonants.
    names = [*NAMES.values(), *(name for script, name in RIGHT_TO_LEFT.items() if script != "vowels")]
    file = tmp_path / "names.pdf"
    file.write_bytes(paper.document("Report", "", lambda width: [paper.text(name, size=12) for name in names]))
    read = subprocess.run(["pdftotext", "-layout", file, "-"], check=True, capture_output=True, text=True).stdout
    for name in names:
        assert composed(name) in read.replace("\u202a", "").replace("\u202b", "").replace("\u202c", "")


def test_every_place_of_a_document_prints_them() -> None:
    arabic, kanji = RIGHT_TO_LEFT["Arabic"], NAMES["Kanji"]
    table = TextTable(title="", columns=("a", arabic), rows=((kanji, "1"), (arabic, "2")))
    document = paper.document(
        arabic, kanji, lambda width: [*paper.facts([Fact("By", kanji), Fact("By", arabic)]), paper.table(table, width)]
    )
    read = lines_of(document)
    assert sum(arabic in line for line in read) == 4  # fact, heading, cell, foot of the page
    assert f"By: {kanji}" in read
    assert f"By: {arabic}" in read
    info = pypdf.PdfReader(io.BytesIO(document)).metadata
    assert info is not None
    assert info.title == f"{arabic}: mammometry"
    assert info.subject == kanji


def test_only_what_is_used_is_embedded_and_many_letters_are() -> None:
    """A font of a PDF has 256 codes: more letters take several. DejaVu alone stays as it was."""
    many = "".join(map(chr, range(0x4E00, 0x4E00 + 600)))
    document = printed(many, size=9)
    assert many in "".join(lines_of(document))
    assert len(document) < 250_000  # of 33 MB
    assert b"Shaped" not in printed("Müller, Ängström ± σ² − 5°")


def test_the_same_names_give_the_same_bytes() -> None:
    first = printed(WITH_LATIN + NAMES["Kanji"])
    printed(NAMES["Hangul"])
    assert printed(WITH_LATIN + NAMES["Kanji"]) == first


@pytest.mark.skipif(shutil.which("pdftoppm") is None, reason="pdftoppm is not installed")
@pytest.mark.skipif(not features.check("raqm"), reason="Pillow has no Raqm")
@pytest.mark.parametrize("name", ["Kanji", "Devanagari", "Arabic", "vowels", "Tamil", "Hebrew"])
def test_letters_look_as_another_program_draws_them(name: str, tmp_path: Path) -> None:
    """Raqm, FriBidi and FreeType order, join and draw the same name of the same font."""
    words = {**NAMES, **RIGHT_TO_LEFT}[name]
    (tmp_path / "a.pdf").write_bytes(printed(words, size=40, bold=False))
    subprocess.run(["pdftoppm", "-r", "144", "-gray", "-singlefile", tmp_path / "a.pdf", tmp_path / "a"], check=True)
    ours = ink(np.asarray(Image.open(tmp_path / "a.pgm"))[:-80] < 128)  # without the foot
    theirs = Image.new("L", (1600, 400), 255)
    font = ImageFont.truetype(shaping._font_file(words.replace(" ", "")), 80, layout_engine=ImageFont.Layout.RAQM)
    font.set_variation_by_axes([400, *(100 for axis in font.get_variation_axes()[1:])])
    direction = "rtl" if name in RIGHT_TO_LEFT else "ltr"
    left = 20.0
    words_drawn = reversed(words.split()) if direction == "rtl" else words.split()
    for word in words_drawn:  # blanks are DejaVu's
        ImageDraw.Draw(theirs).text((left, 100), word, font=font, fill=0, direction=direction, language="en")
        left += font.getlength(word, direction=direction, language="en") + blank(direction, font)
    reference = ink(np.asarray(theirs) < 128)
    assert abs(ours.shape[0] - reference.shape[0]) <= 3
    assert abs(ours.shape[1] - reference.shape[1]) <= 0.01 * reference.shape[1] + 3
    height, width = (min(pair) for pair in zip(ours.shape, reference.shape, strict=True))
    ours, reference = ours[:height, :width], reference[:height, :width]
    # rasters and hinting differ by two pixels of 80 at the edges
    grown, theirs_grown = (ndimage.binary_dilation(picture, iterations=3) for picture in (ours, reference))
    assert (ours & theirs_grown).sum() > 0.97 * ours.sum()
    assert (reference & grown).sum() > 0.97 * reference.sum()


def blank(direction: str, font: ImageFont.FreeTypeFont) -> float:
    """Width of our blank: between words from right to left it is the first font's, else DejaVu's."""
    return 80 * (0.26 if direction == "rtl" else 0.318)


def ink(picture: np.ndarray) -> np.ndarray:
    rows, columns = np.nonzero(picture.any(axis=1))[0], np.nonzero(picture.any(axis=0))[0]
    return picture[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def test_long_text_stays_inside_the_page_and_its_lines_in_order() -> None:
    words = ["عرض", "الثدي", "الأيسر", "أكبر", "من", "الأيمن", "بمقدار", "وتبقى", "بلا", "تغيير"] * 6
    read = [line.split() for line in lines_of(printed(" ".join(words), size=9.5)) if "عرض" in line]
    assert len(read) > 2
    assert [word for line in read for word in line] == words
    kanji = "山田花子" * 60
    read_kanji = [line for line in lines_of(printed(kanji, size=9.5)) if "山" in line]
    assert len(read_kanji) > 2
    assert "".join(read_kanji) == kanji


def test_a_letter_that_no_font_has_is_refused_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shaping, "_files_of_machine", tuple)
    with pytest.raises(SettingsError) as refused:
        printed("Anna \ua840\U00012000")
    assert refused.value.found == "U+A840 PHAGS-PA LETTER KA, U+12000 CUNEIFORM SIGN A"


def test_a_font_of_this_machine_is_taken_where_ours_lack_a_letter(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shaping, "_files", lambda: (shaping._dejavu(False),))
    monkeypatch.setattr(shaping, "_files_of_machine", lambda: (shaping._folder("manimgx_fonts_cjk") / shaping._CJK,))
    assert NAMES["Kanji"] in lines_of(printed(NAMES["Kanji"]))


def test_a_name_in_a_sentence_turns_no_date() -> None:
    """What stands after the name stays there, as an isolate of Unicode keeps it."""
    signed = f"Signed: {isolated(RIGHT_TO_LEFT['Arabic'])}, 24 May"
    shown = in_order(pieces(signed, "DejaVu", is_bold=False))
    assert [piece.text for piece in (shown[0], shown[-1])] == ["Signed: ", ", 24 May"]
    assert isolated("Dr. Müller") == "Dr. Müller"


def test_order_of_letters_is_that_of_another_implementation() -> None:
    draw = random.Random(57)
    letters = "abc אבג عمر 123 ٤٥ .,:+-%$() []!? \u0301\u064b é٫/ 山"
    for _ in range(1500):
        parts = ["".join(draw.choice(letters) for _ in range(draw.randint(0, 9))) for _ in range(3)]
        line = f"{parts[0]}\u2068{parts[1]}\u2069{parts[2]}" if draw.random() < 0.5 else "".join(parts)
        base = int(is_right_to_left(line))
        ours = "".join(reordered(line, levels(line, base))).replace("\u2068", "").replace("\u2069", "")
        theirs = get_display(line, base_dir="LR"[base]).replace("\u2068", "").replace("\u2069", "")
        assert ours == theirs, ascii(line)
