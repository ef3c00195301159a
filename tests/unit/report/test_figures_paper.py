"""The paper's seven figures, drawn from two pairs that look at a ball."""

import io
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pypdf
import pytest
import synthetic
from PIL import Image

from mammometry.base.errors import SessionError
from mammometry.job.stages import calibrate, match, surface
from mammometry.report.figures.catalogue import PAPER_FIGURES
from mammometry.report.figures.paper import write_figure
from mammometry.settings import Settings


class MadePlan(dict[Any, Any]):
    """Products that are there already."""

    def value(self, definition: Any) -> Any:
        """The value of a product. None if it is not planned."""
        return self[definition]() if definition in self else None


def source(pairs: int = 2) -> Any:
    """What a figure asks of a session, already made."""

    def made(value: Any) -> Any:
        return lambda: value

    rig = synthetic.rig()
    names = [pair.name for pair in rig.pairs][:pairs]
    ranges = {name: image for name, image in synthetic.ranges(rig).items() if name in names}
    ball = synthetic.ball(4)
    disparities = synthetic.disparities(rig).items()
    made_products = {
        calibrate.cameras: made(SimpleNamespace(rig=rig)),
        match.disparity: {name: made(found) for name, found in disparities if name in names},
        surface.range_image: {name: made(image) for name, image in ranges.items()},
        surface.valid_patches: made(synthetic.valid(ranges)),
        surface.initial_surface: made(ball),
        surface.repaired: made(synthetic.repaired(ball)),
    }
    return MadePlan(made_products), SimpleNamespace(photographs=synthetic.photographs(rig)), Settings()


@pytest.mark.slow
@pytest.mark.parametrize(
    "number",
    [
        number if number in (1, 4) else pytest.param(number, marks=pytest.mark.slow)
        for number in map(int, PAPER_FIGURES)
    ],
)
def test_each_figure_is_a_page_with_text_as_text(number: int, tmp_path: Path) -> None:
    path = tmp_path / f"figure-{number}.pdf"
    write_figure(number, source(), path)
    (page,) = pypdf.PdfReader(path).pages
    words = page.extract_text()
    wanted = {1: "d_H", 2: "two", 3: "repaired surface", 4: "one", 5: "60°", 6: "front", 7: "front"}
    assert wanted[number] in words
    assert sorted(entry.name for entry in tmp_path.iterdir()) == [".mammometry.json", path.name]


@pytest.mark.slow
def test_pictures_have_300_dots_an_inch_and_show_something(tmp_path: Path) -> None:
    write_figure(7, source(), tmp_path / "figure.png")
    with Image.open(tmp_path / "figure.png") as image:
        assert round(image.info["dpi"][0]) == 300
        pixels = np.asarray(image.convert("L"))
    assert pixels.shape[1] > 2000
    assert (pixels < 200).mean() > 0.1  # three balls on white


@pytest.mark.parametrize("number", [3, 5])
def test_figures_that_compare_pairs_need_two(number: int, tmp_path: Path) -> None:
    with pytest.raises(SessionError, match="pair"):
        write_figure(number, source(pairs=1), tmp_path / "figure.pdf")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_vectors_come_out_the_same_each_time(tmp_path: Path) -> None:
    for name in ("a.svg", "b.svg"):
        write_figure(4, source(), tmp_path / name)
    first, second = ((tmp_path / name).read_text() for name in ("a.svg", "b.svg"))
    assert "<svg" in first
    assert len(first) == len(second)
    assert io.StringIO(first).readline() == io.StringIO(second).readline()


@pytest.mark.parametrize("ending", [".pdf", ".svg", pytest.param(".png", marks=pytest.mark.slow)])
def test_a_figure_carries_its_subject(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"figure{ending}"
    write_figure(4, source(), path, "P-1")
    if ending == ".pdf":
        assert (pypdf.PdfReader(path).metadata or {})["/Subject"] == "P-1"
    elif ending == ".svg":
        assert "<dc:description>P-1</dc:description>" in path.read_text()
    else:
        with Image.open(path) as picture:
            assert picture.info["Subject"] == "P-1"
