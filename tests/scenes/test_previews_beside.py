"""Previews drawn by a second process are those that are drawn here, and so is what goes wrong with them."""

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
import pytest

from mammometry.api import previews
from mammometry.api.job import Job, open_session
from mammometry.base.child_process import CallError, ChildProcess
from mammometry.base.errors import StorageError
from mammometry.job.stages import calibrate
from mammometry.report import gather
from mammometry.report.words import stage_facts
from mammometry.settings import Settings


@pytest.fixture
def drawn(tiny_finished: Path) -> dict[Path, bytes]:
    """The pictures of the finished session; its own are removed."""
    found = {path: path.read_bytes() for path in sorted((tiny_finished / "results").glob("*/*.png"))}
    assert len({path.parent for path in found}) == 4
    for path in found:
        path.unlink()
    return found


@pytest.fixture
def job(tiny_finished: Path, drawn: dict[Path, bytes], tiny_settings: Path, monkeypatch: pytest.MonkeyPatch) -> Job:
    """Its job, as on a machine of two cores, whatever the size of its photographs."""
    monkeypatch.setattr(previews, "_LEAST_MEGAPIXELS", 0.0)
    monkeypatch.setattr(previews, "available_cores", lambda: 2)
    return open_session(tiny_finished, Settings.load(tiny_settings))


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Last argument of each call of the second process."""
    made: list[Any] = []
    before = ChildProcess.call

    def call(self: ChildProcess, function: Callable[..., Any], *arguments: Any) -> Any:
        made.append(arguments[-1] if arguments else None)
        return before(self, function, *arguments)

    monkeypatch.setattr(ChildProcess, "call", call)
    return made


@pytest.mark.slow
def test_the_second_process_draws_the_same_bytes(
    job: Job, drawn: dict[Path, bytes], calls: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    def here(*_: object) -> None:
        raise AssertionError("drawn here")

    monkeypatch.setattr(stage_facts, "drawn", here)
    job.ensure("measure")
    assert {path: path.read_bytes() for path in drawn} == drawn
    assert calls == [None, "calibrate", "match", "surface", "measure"]
    assert sorted(job.store.made) == [f"{stage}/previews" for stage in ("calibrate", "match", "measure", "surface")]


@pytest.mark.slow
def test_one_core_draws_here(
    job: Job, drawn: dict[Path, bytes], calls: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(previews, "available_cores", lambda: 1)
    job.ensure("match")
    assert not calls
    there = [path for path in drawn if path.parent.name in ("calibrate", "match")]
    assert {path: path.read_bytes() for path in there} == {path: drawn[path] for path in there}


@pytest.mark.slow
def test_what_it_cannot_draw_is_drawn_here(
    job: Job, drawn: dict[Path, bytes], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def call(*_: object) -> None:
        raise CallError("no memory there")

    monkeypatch.setattr(ChildProcess, "call", call)
    caplog.set_level(logging.WARNING, logger="mammometry")
    job.ensure("match")
    there = [path for path in drawn if path.parent.name in ("calibrate", "match")]
    assert {path: path.read_bytes() for path in there} == {path: drawn[path] for path in there}
    assert "the previews of match are drawn here: no memory there" in caplog.text


@pytest.mark.slow
def test_what_hinders_their_writing_is_said_by_the_run(job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise StorageError("results", found="a full disk", expected="room", remedy="Make room")

    monkeypatch.setattr(job.store, "write_folder", full)
    with pytest.raises(StorageError, match=r"found a full disk, expected room\. Make room"):
        job.ensure("match")


@pytest.mark.slow
def test_what_the_report_says_of_a_stage_is_the_same_with_its_pictures_and_without(job: Job) -> None:
    plan, inputs = job.plan, job.inputs
    _, matched = stage_facts.drawn("match", plan, inputs)
    assert isinstance(matched, stage_facts.MatchingFacts)
    alone = stage_facts.matching_facts(plan, plan[calibrate.cameras]().rig)
    assert (matched.quality, matched.shares) == (alone.quality, alone.shares)
    assert matched.quality.keys() == matched.shares.keys() == job.session.pair_names.keys()
    _, surfaced = stage_facts.drawn("surface", plan, inputs)
    assert surfaced == stage_facts.surface_facts(plan)


def test_ctrl_c_ends_both_and_leaves_nothing_half_written(job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(job.plan, "ensure", interrupted)
    before = {process.pid for process in psutil.Process().children()}
    with pytest.raises(KeyboardInterrupt):
        job.ensure("match")
    assert {process.pid for process in psutil.Process().children()} <= before
    assert not list(job.session.results.glob(".writing-*"))


@pytest.mark.slow
def test_the_scene_that_is_made_meanwhile_is_what_the_report_would_make(
    job: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a finished session nothing else of the report differs: pages are compared by their scenes."""
    scenes: list[str | None] = []
    before = gather.gather

    def noted(*arguments: Any, **named: Any) -> Any:
        said = before(*arguments, **named)
        scenes.append(said.scene)
        return said

    monkeypatch.setattr(gather, "gather", noted)
    with monkeypatch.context() as while_drawn:
        while_drawn.setattr(previews.PreviewTasks, "waiting", property(lambda _: True))
        job.report()
    (job.session.results / "report" / "provenance.json").unlink()
    again = open_session(job.session.path, job.settings)
    again.report()
    meanwhile, alone = scenes
    assert meanwhile is not None
    assert meanwhile == alone
