"""One bit is flipped at a byte of a file: `mammometry verify` finds it, or says that it does not check the file."""

import json
import random
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from small_products import NAMES, make

from mammometry.api.sources import sources
from mammometry.base.errors import MammometryError
from mammometry.batch.record import BatchRow, Measured, SessionRecord, write_record
from mammometry.cli import main
from mammometry.io.outputs import write_output, write_outputs
from mammometry.io.results.store import Store
from mammometry.io.results.verify import verify
from mammometry.io.sealed import sealed, unsealed
from mammometry.settings import Settings

_WHOLE = 1 << 14  # bytes of a file of which each is tried; of longer ones, so many chosen by chance
_ROW = BatchRow(
    session="a",
    subject="P-1",
    date=None,
    measured=(Measured(name="model", volume_cc=426.25, interval_cc=(400.5, 450)),),
    made_at=None,
    seconds=12.5,
    peak_memory_mb=None,
    megapixels=3.2,
    page="report/report.html",
)


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """A folder of results of every kind: of stages, commands, a refusal and a batch."""
    results = tmp_path / "session" / "results"
    results.mkdir(parents=True)
    store = Store(results, subject="Ä-1")
    with store.taken():
        for name in NAMES:
            make(store, name)
    write_outputs(results / "refused", {"refused.html": b"<p>why", "surface.png": b"png"}, command="run")
    write_outputs(results / "deidentified", {"report.html": b"<p>", "report.pdf": b"%PDF"}, command="report")
    write_output(results / "products.svg", b"<svg/>", command="graph")
    write_output(results.parent / "cameras.json", b"{}", command="import-cameras")
    record = SessionRecord(key="ab" * 32, files={"session.toml": (1, 2), "s3": (3, "tag")}, row=_ROW)
    write_record(results.parent, record)
    return results.parent


def flips(path: Path, *, most: int, chance: random.Random) -> Iterator[int]:
    """Flip a bit of each byte, or of so many bytes, one after another; the file is left as it was."""
    data = path.read_bytes()
    places = range(len(data)) if len(data) <= most else sorted(chance.sample(range(len(data)), most))
    for place in places:
        spoilt = bytearray(data)
        spoilt[place] ^= 1 << chance.randrange(8)
        path.write_bytes(spoilt)
        yield place
    path.write_bytes(data)


def files_of(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file() and not path.name.startswith(".lock"))


@pytest.mark.slow
@pytest.mark.parametrize("most", [12, pytest.param(_WHOLE, marks=pytest.mark.slow)])
@pytest.mark.requirement("R-LOSS-9")
def test_every_byte_of_the_results_is_checked(session: Path, most: int) -> None:
    results, chance, tried, found = session / "results", random.Random(5), Counter[str](), Counter[str]()
    whole = verify(results, session)
    assert not whole.damaged
    assert not whole.unrecorded
    assert not whole.without_digest
    for path in files_of(session):
        name = path.relative_to(results if path.is_relative_to(results) else session).as_posix()
        for _ in flips(path, most=most, chance=chance):
            tried[name] += 1
            found[name] += name in {damage.file for damage in verify(results, session).damaged}
    print(f"{sum(found.values())} of {sum(tried.values())} flipped bits found, in {len(tried)} files")  # noqa: T201
    assert found == tried
    assert {"surface/provenance.json", "batch.json", "refused/.mammometry.json", "cameras.json"} <= set(tried)
    assert not verify(results, session).damaged


@pytest.mark.slow
@pytest.mark.parametrize("most", [pytest.param(1, id="draw"), pytest.param(24, marks=pytest.mark.slow, id="more")])
@pytest.mark.requirement("R-LOSS-9")
def test_every_file_of_a_session_is_checked_or_named(tiny_finished: Path, tiny_settings: Path, most: int) -> None:
    """The photographs and drawings too: they are compared with what the results were made from."""
    (tiny_finished / "notes.txt").write_text("mine")
    settings, chance = Settings.load(tiny_settings), random.Random(8)
    tried, found = Counter[str](), Counter[str]()
    paths = files_of(tiny_finished)
    if most == 1:  # of each folder the longest and the shortest file
        by_folder = {path.parent: sorted((p for p in paths if p.parent == path.parent), key=_size) for path in paths}
        paths = [path for files in by_folder.values() for path in {files[0], files[-1]}]
    for path in paths:
        name = path.relative_to(tiny_finished).as_posix()
        for _ in flips(path, most=most, chance=chance):
            tried[name] += 1
            found[name] += _is_found(tiny_finished, name, settings)
    print(f"{sum(found.values())} of {sum(tried.values())} flipped bits found, in {len(tried)} files")  # noqa: T201
    assert {"calibration/", "capture/"} <= {f"{name.partition('/')[0]}/" for name in tried}
    now = sources(tiny_finished, settings, frozenset())
    assert now.not_compared == ("notes.txt", "truth/ (7 files)")
    unseen = {name: tried[name] - found[name] for name in tried if found[name] < tried[name]}
    assert set(unseen) <= {"session.toml"}  # compared by its values: a comment changes none


def _size(path: Path) -> int:
    return path.stat().st_size


def _is_found(session: Path, name: str, settings: Settings) -> bool:
    findings = verify(session / "results", session)
    if name in {f"results/{damage.file}" for damage in findings.damaged} | {damage.file for damage in findings.damaged}:
        return True
    if name.removeprefix("results/") in findings.unrecorded:
        return True  # named as not checked
    try:
        now = sources(session, settings, frozenset(findings.outputs))
    except MammometryError:
        return True
    stem = name.rpartition(".")[0]
    return bool(
        {stem, name} & {*now.changed.inputs, *now.changed.absent}
        or {name, name.partition("/")[0] + "/"} & {line.partition(" ")[0] for line in now.not_compared}
        or (name == "session.toml" and now.changed.words)
    )


@pytest.mark.requirement("R-LOSS-9")
def test_a_record_of_1_0_0_counts_and_is_said_to_be_old(session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    results, path = session / "results", session / "results" / "surface" / "provenance.json"
    table, has_digest = unsealed(path.read_bytes())
    assert has_digest
    path.write_text(json.dumps(table, indent=1))  # as 1.0.0 wrote it
    findings = verify(results, session)
    assert (findings.damaged, findings.without_digest) == ((), ("surface/provenance.json",))
    assert main.run(["verify", str(results)]) == 0
    assert "its times are not checked" in capsys.readouterr().out
    table["products"]["mesh"]["settings"]["cube_mm"] = 0.4  # which the key does not hold
    path.write_text(json.dumps(table, indent=1))
    assert [damage.product for damage in verify(results).damaged] == ["mesh"]


@pytest.mark.parametrize("cut", [b"}\n", b' "digest"', b"digest", b'"\n}\n'])
def test_a_record_whose_digest_was_spoilt_does_not_pass_for_an_old_one(cut: bytes) -> None:
    data = sealed({"format": 1, "files": {"a": 1}})
    assert unsealed(data) == ({"format": 1, "files": {"a": 1}}, True)
    for place in (data.rindex(cut), data.rindex(cut) + 1):
        for bit in range(8):
            spoilt = bytearray(data)
            spoilt[place] ^= 1 << bit
            with pytest.raises(ValueError, match=r"."):
                unsealed(bytes(spoilt))
