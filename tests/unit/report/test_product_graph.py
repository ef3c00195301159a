"""The drawing of a session's products shows what there is, what it is made from, and what is known of it."""

import re
from pathlib import Path
from xml.etree import ElementTree

from tests.unit.job.planned_sessions import inputs

from mammometry.job.graph import Plan
from mammometry.job.method import method
from mammometry.report.figures.product_graph import Known, product_graph
from mammometry.settings import Settings

SVG = "{http://www.w3.org/2000/svg}"


def drawn(kind: str, known: dict[str, Known]) -> ElementTree.Element:
    return ElementTree.fromstring(product_graph(Plan(method, inputs(kind), Settings(), None), known, "P-7"))


def names(drawing: ElementTree.Element) -> set[str]:
    """Names in the boxes, without how many there are of each."""
    boxes = (box.find(f"{SVG}text") for box in drawing.iter(f"{SVG}g"))
    return {re.sub(r" × \d+$", "", text.text or "") for text in boxes if text is not None}


def words(drawing: ElementTree.Element, name: str) -> list[str | None]:
    (box,) = (box for box in drawing.iter(f"{SVG}g") if any(text.text == name for text in box.iter(f"{SVG}text")))
    return [part.text for part in box]


def test_it_tells_what_a_product_is_made_from_its_state_and_its_time() -> None:
    known = {
        "match/disparity/front": Known(state="current", seconds=2.0),
        "match/disparity/floor": Known(state="stale", seconds=3.0),
        "surface/repaired": Known(state="current", seconds=10.0),
    }
    drawing = drawn("torso", known)
    title, *_, state = words(drawing, "disparity × 2")
    assert title.endswith(". Made from: rectified. In results/match/disparity/….")
    assert state == "stale, 5.0 s", "the worst of both, and the sum"
    assert words(drawing, "rectified × 2")[-1] == "not stored"
    assert words(drawing, "mesh")[-1] == "absent"
    assert drawing.findtext(f"{SVG}title") == "Results P-7"


def test_boxes_stand_apart_and_below_what_they_are_made_from() -> None:
    places = [
        (float(box.attrib["x"]), float(box.attrib["y"]))
        for group in drawn("torso", {}).iter(f"{SVG}g")
        if (box := group.find(f"{SVG}rect")) is not None
    ]
    assert len(places) == len(set(places)) > 25
    for x, y in places:
        assert all(abs(x - other_x) > 160 for other_x, other_y in places if other_y == y and other_x != x)


def test_the_picture_of_the_method_shows_the_products_there_are(repository: Path) -> None:
    """If not, draw it again with the command that stands beside it in docs/method.md."""
    there = ElementTree.fromstring((repository / "docs" / "img" / "products.svg").read_text(encoding="utf-8"))
    assert names(there) == names(drawn("torso", {})) - {"lens observation"}
