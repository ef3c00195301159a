"""Acceptance test of a device, from its folder to its results.

::

    from mammometry.api.acceptance import run_acceptance

    outcome = run_acceptance(Path("test-2026-11"))
    print(outcome.decision, outcome.worst)
"""

from __future__ import annotations

import datetime
import json
from pathlib import Path

from mammometry.api.job import open_session
from mammometry.base.errors import MeasureError, SessionError
from mammometry.base.listing import visible
from mammometry.base.parse import json_value, numbers, parsing, read_text
from mammometry.base.progress import Progress, no_progress
from mammometry.geometry.mesh import TriangleMesh
from mammometry.io.acceptance_file import RESULTS, position_files, read_test
from mammometry.io.meshes.foreign import read_foreign
from mammometry.io.meshes.scans import MESH, is_scan
from mammometry.report.documents.acceptance_page import DOCUMENT, PAGE, acceptance_page_files, picture_names
from mammometry.settings import Settings
from mammometry.study.acceptance.artefacts import KINDS, POSITIONS, AcceptanceTest, Cast, Kind
from mammometry.study.acceptance.evaluate import Outcome, PositionResult, evaluate_mesh, evaluate_volume, severity
from mammometry.study.acceptance.patches import PatchError
from mammometry.study.acceptance.tables import (
    FORMAT,
    PastTest,
    acceptance_csv,
    acceptance_json,
    as_past,
    history_csv,
)

__all__ = ["acceptance_files", "acceptance_inputs", "run_acceptance"]
NUMBERS = "acceptance.json"
FILES = (PAGE, DOCUMENT, NUMBERS, "acceptance.csv", "history.csv", *picture_names())
"""Files that a folder of results may contain."""


def acceptance_inputs(folder: Path) -> tuple[AcceptanceTest, dict[Kind, dict[str, Path]]]:
    """The test's description, and its files: artefact → position → mesh, scan or session.

    Raises:
        SessionError: the folder is not as documented, or holds no measurement of an artefact that it describes.
    """
    test = read_test(folder)
    files = {kind: position_files(folder, kind) for kind in KINDS}
    for kind in KINDS:
        if files[kind] and kind not in test.artefacts:
            raise SessionError(
                str(folder / kind), found=f"{len(files[kind])} measurements", expected=f"a table [{kind}] for them",
                remedy="Describe the artefact in acceptance.toml, or remove the folder",
            )  # fmt: skip
    if not any(files.values()):
        places = " or ".join(f"{kind}/1.ply" for kind in test.artefacts)
        raise SessionError(
            str(folder), found="no measurements", expected=f"a mesh, scan or session per position, such as {places}",
            remedy="Measure the artefacts at the positions of the protocol",
        )  # fmt: skip
    return test, files


def run_acceptance(folder: Path, settings: Settings | None = None, *, progress: Progress = no_progress) -> Outcome:
    """Evaluate all measurements of an acceptance test.

    Args:
        folder: a folder made by `mammometry acceptance new`, with the measurements.
        settings: settings for sessions of photographs; None for the recommended ones.
        progress: called with the fraction of the measurements that are done.

    Raises:
        SessionError: the folder is not as documented.
        MeasureError: an artefact is not in its mesh.
        MammometryError: a mesh or session cannot be read or measured.
    """
    test, files = acceptance_inputs(folder)
    places = [(kind, name, path) for kind, named in files.items() for name, path in named.items()]
    results = []
    for done, (kind, name, path) in enumerate(places):
        progress(done / len(places))
        results.append(_evaluated(path, kind, name, test, settings))
    return Outcome(test=test, results=tuple(results))


def _evaluated(path: Path, kind: Kind, name: str, test: AcceptanceTest, settings: Settings | None) -> PositionResult:
    artefact = test.artefacts[kind]
    try:
        if isinstance(artefact, Cast) and path.is_dir() and not is_scan(path):
            return evaluate_volume(_model_cc(path, settings), name, artefact, test.limits)
        return evaluate_mesh(_surface(path, test.units, settings), kind, name, artefact, test.limits)
    except PatchError as error:
        words = next(place.words for place in POSITIONS[kind] if place.name == name)
        raise MeasureError(
            str(path), found=str(error), expected=f"the artefact of [{kind}] at position {name} ({words})",
            remedy="Check the values in acceptance.toml, the unit of the mesh, and that the artefact is well seen",
        ) from None  # fmt: skip


def _surface(path: Path, units: str, settings: Settings | None) -> TriangleMesh:
    if not path.is_dir():
        return read_foreign(path, units or None).mesh
    if is_scan(path):
        return read_foreign(path / MESH, "mm").mesh
    repaired = open_session(path, settings).surface().repaired
    return repaired.mesh.submesh(repaired.mesh.faces_within(repaired.claimed))  # only measured and repaired skin


def _model_cc(session: Path, settings: Settings | None) -> float:
    """Volume of the cast that a session photographed, cc."""
    volumes = open_session(session, settings).run(report=False).volumes_cc
    if set(volumes) != {"model"}:
        raise PatchError(f"volumes of {', '.join(volumes) or 'nothing'}, not of one model")
    return volumes["model"]


def acceptance_files(folder: Path, outcome: Outcome) -> dict[str, bytes]:
    """The results' files: name → content.

    Args:
        folder: folder of the test. Earlier tests of the same device are searched for in the folders next to it.
        outcome: outcome of the test.
    """
    history = [*past_tests(folder, outcome.test.device), as_past(outcome)]
    history.sort(key=lambda past: past.date)
    return {
        NUMBERS: (json.dumps(acceptance_json(outcome), indent=1, ensure_ascii=False) + "\n").encode(),
        "acceptance.csv": acceptance_csv(outcome),
        "history.csv": history_csv(outcome.test.device, history),
        **acceptance_page_files(outcome, history),
    }


def past_tests(folder: Path, device: str) -> list[PastTest]:
    """Earlier tests of a device, from the results in the folders next to this test's. Others are skipped."""
    own = folder.resolve()
    return device_tests(own.parent, device, without=own.name)


def device_tests(folder: Path, device: str, *, without: str = "") -> list[PastTest]:
    """Tests of a device in the subfolders of a folder, the oldest first.

    Results of other devices and versions, and the subfolder `without`, are skipped.
    """
    found = []
    for other in visible(folder):
        path = other / RESULTS / NUMBERS
        if other.name == without or not path.is_file():
            continue
        try:
            past = read_past(path, device)
        except SessionError:
            continue  # not the results of a test, or those of another version
        if past is not None:
            found.append(past)
    return sorted(found, key=lambda past: past.date)


def read_past(path: Path, device: str) -> PastTest | None:
    """Read the results of an earlier test. None of another device.

    Raises:
        SessionError: they are not results of a test in this format.
    """
    expected = "results of `mammometry acceptance run`"
    table = json_value(read_text(path, str(path), expected, most_mib=16), str(path), expected)
    with parsing("wrong content", str(path), expected):
        if table["format"] != FORMAT:
            raise ValueError(f"format {table['format']}, not {FORMAT}")
        if table["device"] != device:
            return None
        worst: dict[str, tuple[float, float, float]] = {}
        for one in table["findings"]:
            name = f"{one['artefact']}/{one['quantity']}"
            error, expanded, limit = numbers([one["error"], one["expanded_uncertainty"], one["limit"]], 3).tolist()
            one_error = (error, expanded, limit)
            worst[name] = min(worst.get(name, one_error), one_error, key=lambda values: severity(*values))
        return PastTest(date=datetime.date.fromisoformat(table["date"]), decision=str(table["decision"]), worst=worst)
