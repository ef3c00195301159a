"""Settings from TOML and from the command line: strict, and helpful about it."""

import ast
import hashlib
import json
import re
import tomllib
from collections.abc import Iterator
from contextlib import suppress
from importlib.resources import files
from pathlib import Path

import pytest

from mammometry.base.errors import SettingsError
from mammometry.settings import (
    RANGES,
    Settings,
    as_table,
    former_settings,
    key_table,
    names,
    paper_method,
    range_of,
)


def test_toml_round_trip() -> None:
    changed = Settings().overridden(["matching.window_px=11", "calibration.bundle.target_prior_mm=[1.0, 2, 0.5]"])
    assert Settings.from_toml(changed.to_toml()) == changed
    assert Settings.from_toml(Settings().to_toml()) == Settings()
    assert Settings.from_toml("") == Settings()


@pytest.mark.parametrize(
    ("assignment", "value"),
    [
        ("matching.window_px=11", 11.0),
        ("matching.window_px = 11.5", 11.5),
        ("matching.foreground.mode=all", "all"),
        ('matching.foreground.mode="all"', "all"),
        ("surface.dents.drop_seen_through=false", False),
        ("calibration.bundle.target_prior_mm=[1.0, 2, 0.5]", (1.0, 2.0, 0.5)),
    ],
)
def test_assignments(assignment: str, value: object) -> None:
    changed: object = Settings().overridden([assignment])
    for part in assignment.partition("=")[0].strip().split("."):
        changed = getattr(changed, part)
    assert changed == value
    assert type(changed) is type(value)


def test_later_assignments_win_and_the_rest_stays() -> None:
    changed = Settings().overridden(["matching.window_px=11", "surface.repair.rho=2.0", "matching.window_px=7"])
    assert changed.matching.window_px == 7
    assert changed.surface.repair.rho == 2.0
    assert changed.calibration == Settings().calibration
    assert Settings().matching.window_px != 7


@pytest.mark.parametrize(
    ("assignment", "said"),
    [
        ("matching.windw_px=11", r"matching\.windw_px: .*matching\.window_px"),
        ("window_px=11", r"matching\.window_px"),
        ("match.window_px=11", r"match: .*matching"),
        ("surface.rho=1", r"surface\.repair\.rho"),
        ("matching.window_px=wide", r"matching\.window_px: .*'wide'"),
        ("matching.window_px=true", r"matching\.window_px: found True"),
        ("surface.repair.rounds=2.5", r"surface\.repair\.rounds: found 2\.5"),
        ("matching.foreground.mode=none", r"'none', .*'auto' or 'all'"),
        ("surface.repair=3", r"surface\.repair: .*\b3\b"),
        ("surface.repair.rho.x=3", r"surface\.repair\.rho: "),
        ("matching.window_px", "assignment"),
        ("=3", "assignment"),
        ("calibration.check.refuse_mm=-1", r"calibration\.check\.refuse_mm: found -1, expected 0.001 to 10"),
        ("calibration.check.refuse_mm=0", r"calibration\.check\.refuse_mm: found 0, expected 0.001 to 10"),
        ("matching.window_px=-3", r"matching\.window_px: found -3, expected 3 to 51"),
        ("matching.window_px=nan", r"matching\.window_px: .*nan, .*3 to 51"),
        ("matching.window_px=1000", r"matching\.window_px: found 1000, expected 3 to 51"),
        ("surface.extract.cube_mm=100", r"cube_mm: .*100, .*0\.1 to 5, .*\b0\b"),
        ("calibration.bundle.target_prior_mm=[1, 1, 40]", r"found \[1, 1, 40\], expected 0\.001 to 10"),
        ("matching.window_px=0", r"found 0, expected 3 to 51"),
        ("surface.repair.reach_mm=5", r"reach_mm: .*\b5, .*4\.0, "),
        ("surface.texture=5", r"surface\.texture: found 5"),
        ("surface.texture.colour=5", r"surface\.texture\.colour: "),
        ("measure.wall=nope", r"'default', 'rounded-membrane', .*'membrane'"),
    ],
)
def test_mistakes_are_named(assignment: str, said: str) -> None:
    with pytest.raises(SettingsError, match=said) as caught:
        Settings().overridden([assignment])
    assert "\n" not in str(caught.value)


def test_files(tmp_path: Path) -> None:
    path = tmp_path / "my.toml"
    path.write_text("[matching]\nwindow_px = 11\n")
    assert Settings.load(path).matching.window_px == 11
    path.write_text("[matching\n")
    with pytest.raises(SettingsError, match=r"^.*my\.toml: .*TOML"):
        Settings.load(path)
    with pytest.raises(SettingsError, match="cannot"):
        Settings.load(tmp_path / "none.toml")


def test_an_older_settings_file_names_what_is_a_constant_now() -> None:
    """So do all numbers that `mammometry settings` wrote when there were 168."""
    former = files("mammometry").joinpath("former_settings.toml").read_text(encoding="utf-8")
    assert Settings.from_toml(former) == Settings()


def test_keys_of_stored_results_hold_what_they_held_when_there_were_168_settings() -> None:
    table = key_table(Settings())
    text = json.dumps(table, sort_keys=True)
    assert hashlib.sha256(text.encode()).hexdigest()[:16] == "1e68454a8839feab"
    parts = (table["surface"]["texture"], former_settings("surface", "texture"))
    assert parts[0] == parts[1] != {}


RENAMED = {
    "matching.agreement_px": "DIRECTIONS_APART_PX",
    "measure.breast.reach_mm": "FARTHEST_BORDER_MM",
    "measure.breast.fewest_mm": "MIN_PROMINENCE_MM",
    "measure.breast.plain_mm": "SURE_PROMINENCE_MM",
    "measure.nipple.tip_mm": "LEAST_TIP_MM",
    "measure.layer.fewest": "FEWEST_LAYERS",
    "measure.layer.mean_mm": "MEAN_LAYER_MM",
    "measure.nipple.areola_sigma_mm": "ALONE_SIGMA_MM",
    "measure.nipple.apex_tip_sigma_mm": "ALONE_SIGMA_MM",
    "measure.layer.u95_mm": "LAYER_U95_MM",
    "measure.layer.measured_u95_mm": "MEASURED_LAYER_U95_MM",
    "measure.layer.missing_u95_mm": "MISSING_LAYER_U95_MM",
}
"""Former setting → its constant, where that is not called after it."""
ASSIGNED = re.compile(r"^_?([A-Z]\w*)(?:: [\w\[\], .]+)? = ([-\d.(][^#\n]*)", re.MULTILINE)
"""A constant of a module: its name and its value."""
NO_CONSTANTS = {
    "surface.repair.k_ext", "surface.repair.k_int", "measure.wall_u95_mm", "measure.base_rim.seed", "compare.doubt_deg",
    "surface.repair.repaired_reach_mm", "measure.nipple.apex_probability", "measure.nipple.apex_sigma_mm",
    "surface.stillness.correct", "matching.start_span_px", "calibration.quality.expected_refuse_mm",
    "calibration.quality.residual_good_mm",
}  # fmt: skip
"""Elastic moduli, which are 1, what follows each wall's base now, a seed, what nothing asks any more, what
changed since with the version of what is made with it, a choice that nobody had, and what another constant implies."""


def test_constants_that_were_settings_have_the_values_that_keys_hold(repository: Path) -> None:
    package = repository / "src" / "mammometry"
    constants: dict[tuple[str, str], list[object]] = {}
    for path in package.rglob("*.py"):
        stage = path.relative_to(package).parts[0]
        for name, value in re.findall(
            r"^_?([A-Z]\w*)(?:: [\w\[\], .]+)? = ([-\d.(][^#\n]*)", path.read_text("utf-8"), re.M
        ):
            with suppress(ValueError, SyntaxError):
                constants.setdefault((stage, name), []).append(ast.literal_eval(value))

    def wrong(table: dict[str, object], *path: str) -> Iterator[str]:
        for name, value in table.items():
            dotted = ".".join((*path, name))
            if isinstance(value, dict):
                yield from wrong(value, *path, name)
            elif dotted not in NO_CONSTANTS:
                stage = "measure" if path[0] == "compare" else path[0]
                known = constants.get((stage, RENAMED.get(dotted, name.upper())), [])
                if (tuple(value) if isinstance(value, list) else value) not in known:
                    yield f"{dotted} = {value}, found {known}"

    former = files("mammometry").joinpath("former_settings.toml").read_text(encoding="utf-8")
    assert list(wrong(tomllib.loads(former))) == []


def test_every_setting_has_a_name_and_a_place_in_the_table() -> None:
    table = as_table(Settings())
    for name in names(Settings()):
        value: object = table
        for part in name.split("."):
            assert isinstance(value, dict)
            value = value[part]
        assert not isinstance(value, dict)


def test_a_file_with_a_mark_of_utf_8_is_read(tmp_path: Path) -> None:
    (tmp_path / "my.toml").write_bytes(b"\xef\xbb\xbf[matching]\nwindow_px = 11\n")
    assert Settings.load(tmp_path / "my.toml").matching.window_px == 11


def test_the_papers_method_names_known_settings_each_with_its_section() -> None:
    text = paper_method()
    lines = [line for line in text.splitlines() if " = " in line and not line.startswith("#")]
    assert len(lines) >= 12
    for line in lines:
        assert re.search(r"  # 2\.[1-6](\.[1-3])?[,:]", line), f"without a section of the paper: {line}"
    method = Settings.from_toml(text)  # an unknown name would be refused
    assert method.matching.vertical == "free"
    assert method.calibration.bundle.model == "paper"
    assert method.surface.decompose.epsilon_mm == 0.5
    dents, mended = method.surface.dents, method.surface.repair
    assert (dents.rule, dents.angle_deg, dents.neighbourhood_mm) == ("patch", 60, 5)
    assert (mended.target, mended.fade_mm, mended.taper_mm) == ("closest", 0, 0)
    assert method.measure == Settings().measure, "the paper does not say how its wall is made"


def test_every_number_has_a_range_that_holds_its_default() -> None:
    """And every range belongs to a setting."""
    table, used = as_table(Settings()), set[str]()
    for name in names(Settings()):
        value: object = table
        for part in name.split("."):
            value = value[part]  # type: ignore[index]
        numbers = [one for one in (value if isinstance(value, tuple) else (value,)) if not isinstance(one, (bool, str))]
        if not numbers:
            continue
        least, most = range_of(name) or pytest.fail(f"{name}: no range")
        used |= {name, f"{name.rpartition('.')[0]}.*"}
        assert all(least <= one <= most for one in numbers) or (name, value) == ("surface.extract.cube_mm", 0.0)
        for one in (least, most):
            text = f"[{one}, {one}, {one}]" if isinstance(value, tuple) else f"{one}"
            with suppress(SettingsError):  # two limits of one group may contradict each other
                assert Settings().overridden([f"{name}={text}"]) != Settings() or one == value
    assert set(RANGES) <= used
