"""Size and time of a document with a name in each script: `python -m benchmarks.speed.letters`."""

import time

from mammometry.report.documents import paper

NAMES = {
    "Latin": "Anna Moser",
    "Cyrillic": "Їжакевич Ґанна",
    "Kanji": "山田 花子",
    "Arabic": "محمد عبد الله",
    "Devanagari": "क्षितिज शर्मा",
}
_REPEATS = 20


def _document(name: str) -> bytes:
    return paper.document("Report", "", lambda width: [paper.text(name, size=17, bold=True), paper.text(name, size=9)])


def main() -> None:
    """Print a table."""
    print("| name | first document, ms | each further one, ms | size, kB |\n| --- | --- | --- | --- |")
    _document("A")
    for script, name in NAMES.items():
        start = time.perf_counter()
        size = len(_document(name))
        first = time.perf_counter()
        for _ in range(_REPEATS):
            _document(name)
        each = (time.perf_counter() - first) / _REPEATS
        print(f"| {script} | {1e3 * (first - start):.0f} | {1e3 * each:.0f} | {size / 1e3:.0f} |")


if __name__ == "__main__":
    main()
