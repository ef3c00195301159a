"""How long one comparison of two measured sessions takes, and the first drawing page of the later one.

    python -m benchmarks.speed.dates BEFORE AFTER [settings.toml]

Both are measured first where they are not. The page is written to a folder that is removed again. CPU seconds are those
of all threads; they differ less than seconds do on a machine that has other work.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path

from mammometry.api.dates import compare
from mammometry.api.job import open_session
from mammometry.editor.page import EditorPage
from mammometry.settings import Settings


def main() -> None:
    """Time one comparison."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("settings", type=Path, nargs="?")
    given = parser.parse_args()
    settings = Settings() if given.settings is None else Settings.from_toml(given.settings.read_text(encoding="utf-8"))
    for path in (given.before, given.after):
        open_session(path, settings).ensure("measure")
    with tempfile.TemporaryDirectory() as folder:
        begun, cpu = time.monotonic(), time.process_time()
        compared = compare(given.before, given.after, settings, out=Path(folder) / "compare")
        print(f"{time.monotonic() - begun:.1f} s, {time.process_time() - cpu:.1f} CPU s")
    begun, cpu = time.monotonic(), time.process_time()
    page = EditorPage(open_session(given.after, settings), author="A")
    size = len(json.dumps(page.drawing()))
    assert len(page.drawing_session.board.surface.mesh.faces)  # a volume can follow from here on
    print(
        f"drawing page of {size / 1e6:.1f} MB: {time.monotonic() - begun:.1f} s, {time.process_time() - cpu:.1f} CPU s"
    )
    for name, breast in compared.table["breasts"].items():
        print(name, breast["change_cc"], breast["change_interval_cc"])


if __name__ == "__main__":
    main()
