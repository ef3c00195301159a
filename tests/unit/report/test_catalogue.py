"""The catalogue of figures: a file with one decorated function is a picture of its stage, its report and its paper."""

import importlib
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import synthetic

from mammometry.base.errors import SettingsError
from mammometry.base.identity import Identity
from mammometry.base.registry import Registry
from mammometry.report import content, figures
from mammometry.report.documents import html
from mammometry.report.figures import catalogue, stage_results
from mammometry.report.first_page import first_page
from mammometry.report.pictures import ReportPicture, all_encoded
from mammometry.report.words import describe

ADDED = """
import numpy as np
from mammometry.report.figures.canvas import Caption, PanelSheet, encode
from mammometry.report.figures.catalogue import paper_figure, preview

@preview("stripes", stage="measure", place=9, photographs=False)
def stripes(result):
    rows = 8 * len(result.measurements)
    return encode(np.zeros((rows, 8, 3), dtype=np.uint8), Caption(title="Stripes", text="One band a breast."))

@preview("spot", stage="measure", place=5, photographs=True, per_breast=True)
def spot(result, measured):
    return encode(np.zeros((8, 8, 3), dtype=np.uint8), Caption(title="Spot", text=f"Of {measured.name}."))

@paper_figure(8)
def eighth(source):
    return PanelSheet(1, 1, (80, 60))
"""


@pytest.fixture
def _added(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    (tmp_path / "of_my_own.py").write_text(ADDED)
    for registry in (catalogue.PREVIEWS, catalogue.PAPER_FIGURES):
        monkeypatch.setattr(registry, "_entries", dict(registry._loaded()))
        monkeypatch.setattr(registry, "_is_loaded", False)  # as if nothing had been looked up before the file was there
    monkeypatch.setattr(figures, "__path__", [*figures.__path__, str(tmp_path)])
    name = f"{figures.__name__}.of_my_own"
    sys.modules.pop(name, None)
    importlib.invalidate_caches()
    yield
    sys.modules.pop(name, None)


@pytest.mark.slow
@pytest.mark.usefixtures("_added")
def test_a_file_with_one_decorated_function_is_drawn_and_shown() -> None:
    rig, both = synthetic.rig(), [synthetic.measurement("left"), synthetic.measurement("right")]
    drawn = stage_results.draw(synthetic.measured(rig, both, synthetic.ball(2)))
    assert list(drawn)[-3:] == ["spot-left", "spot-right", "stripes"]
    assert catalogue.shows_photographs("spot-left")
    assert not catalogue.shows_photographs("stripes")
    report = shown(all_encoded({"measure": drawn}))
    page = html.render(report, first_page(report, {}, None, named=True))
    titles = re.findall(r"<figcaption><b>(.*?)\.</b>", page)
    assert titles.count("Stripes") == 1
    assert titles.count("Spot") == 2


@pytest.mark.usefixtures("_added")
def test_a_figure_of_the_paper_is_one_decorated_function_too() -> None:
    assert catalogue.find_paper_figure(8)(None).figure is not None  # type: ignore[arg-type]
    with pytest.raises(SettingsError, match="'8'"):
        catalogue.find_paper_figure(9)


def test_pictures_keep_their_order_however_they_were_read() -> None:
    assert catalogue.in_order("surface", ["views", "dents", "range", "unknown"]) == [
        "range",
        "dents",
        "views",
        "unknown",
    ]
    assert [each.name for each in catalogue.previews_of("match")] == [
        "foreground",
        "rectified",
        "disparity",
        "confidence",
    ]


def test_a_registry_finds_the_modules_of_a_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "kinds_of_things"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "registry.py").write_text(
        "from mammometry.base.registry import Registry\nTHINGS = Registry('thing', package=__package__)\n"
    )
    (package / "one.py").write_text("from kinds_of_things.registry import THINGS\nTHINGS.add('one')(1)\n")
    monkeypatch.syspath_prepend(tmp_path)
    things: Registry[int] = importlib.import_module("kinds_of_things.registry").THINGS
    assert dict(things) == {"one": 1}


def shown(pictures: dict[str, dict[str, ReportPicture]]) -> content.ReportContent:
    measured = [synthetic.measurement("left"), synthetic.measurement("right")]
    return content.ReportContent(
        identity=Identity(name="case"),
        created="",
        subject=describe.SUBJECTS["torso"],
        world="The board in pose 00.",
        warnings=(),
        breasts=tuple(describe.breast_report(each) for each in measured),
        comparison=(),
        stages=(),
        timings=(),
        changed_settings=(),
        all_settings=(),
        versions=(),
        pictures=pictures,
    )
