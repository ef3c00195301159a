"""The page of an observer study: it stands alone and says what the study found."""

import json

import numpy as np
import pytest
from tests.unit.measure.solids import dome

from mammometry.report.documents.study_pages import observers_files, observers_names
from mammometry.report.figures.canvas import caption_of
from mammometry.study.observers import DrawnSurface, ObservedCurve, observer_study


def drawing(observer: str, repeat: int, radius_mm: float, cc: float) -> ObservedCurve:
    t = 2 * np.pi * np.arange(90) / 90
    curve = np.stack([radius_mm * np.cos(t), radius_mm * np.sin(t), 0 * t + (60**2 - radius_mm**2) ** 0.5], axis=1)
    return ObservedCurve(
        breast="a<b>, left", observer=observer, repeat=str(repeat), volume_cc=cc, base_cm2=90.0, lateral_up_mm=curve
    )


@pytest.mark.slow
def test_the_page_says_what_was_found() -> None:
    drawings = [
        drawing("anna", 1, 50.0, 99.0),
        drawing("anna", 2, 50.0, 101.0),
        drawing("ben", 1, 54.0, 108.0),
        drawing("ben", 2, 54.0, 112.0),
    ]
    surface = DrawnSurface(
        name="a<b>",
        mesh=dome(),
        frame=np.eye(3),
        curves=tuple((each.observer, each.lateral_up_mm) for each in drawings),
    )
    written = observers_files("Anna and Ben", [surface], drawings, observer_study(drawings))
    assert set(written) == set(observers_names(1))
    page = written["report.html"].decode()
    for said in ("2.24", "7.25", "20.1", "a&lt;b&gt;", "lateral", "4 curves around 1 breast by 2 persons"):
        assert said in page, said  # √5 cc and √52.5 cc by hand; MDC 1.96 √2 · 7.25
    assert page.count("data:image/") == 3
    assert "http://" not in page
    assert "<script" not in page
    assert "intraclass" in page
    numbers = json.loads(written["observers.json"])
    assert numbers["icc_between"] is None
    apart_mm = np.hypot(54 - 50, np.sqrt(60**2 - 50**2) - np.sqrt(60**2 - 54**2))  # circles on a ball of 60 mm
    assert abs(numbers["apart_between_mm"]["medial"]["mean_mm"] - apart_mm) < 0.05
    for name, content in written.items():
        if name.endswith(".png"):
            assert caption_of(content).text
