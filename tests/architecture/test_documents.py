"""What README, documentation and examples say exists; nothing in the repository names a machine or its folders."""

import re
import subprocess
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

import mammometry
from mammometry.settings import Settings, names

_COMMAND = re.compile(r"^\s*\$?\s*(?:\.venv/bin/)?mammometry\s+([a-z][a-z-]*)((?:\s+\S+)*)\s*$")
_INLINE = re.compile(r"`mammometry ([a-z][a-z-]*)((?: [^`\s]+)*)`")
_SETTING = re.compile(r"`((?:calibration|matching|surface|measure|compare)\.[a-z_.]+)(?:=[^`]*)?`")
_LINK = re.compile(r"(?:\]\(|src=\")(?!https?://|#)([^)#\"]+)(?:#[^)]*)?[)\"]")


def commands() -> dict[str, set[str]]:
    """Command, or group and command → its options, as the command line has them."""
    from mammometry.cli.main import app

    def walk(group: Any, before: str) -> Iterator[tuple[str, Any]]:
        for name, command in group.commands.items():
            if hasattr(command, "commands"):
                yield from walk(command, f"{before}{name} ")
            else:
                yield f"{before}{name}", command

    flat = dict(walk(get_command(app), ""))
    return {
        name: {
            option
            for parameter in command.params
            for option in (*parameter.opts, *parameter.secondary_opts)
            if option.startswith("-")
        }
        | {"--help"}
        for name, command in flat.items()
    }


def documents(repository: Path) -> list[Path]:
    return [repository / "README.md", repository / "CONTRIBUTING.md", *sorted((repository / "docs").rglob("*.md"))]


def tracked(repository: Path) -> list[Path]:
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=repository, capture_output=True, text=True, check=False, timeout=30
    )
    if listed.returncode:
        pytest.skip("not a git checkout")
    return [repository / name for name in listed.stdout.split("\0") if name and (repository / name).is_file()]


def test_every_command_in_the_documents_exists_with_its_options(repository: Path) -> None:
    known = commands()
    wrong, seen = [], 0
    for path in documents(repository):
        text = path.read_text(encoding="utf-8")
        mentioned = _INLINE.findall(text)
        for block in re.findall(r"```(?:console|sh|bash)\n(.*?)```", text, flags=re.DOTALL):
            mentioned += [match.groups() for line in block.splitlines() if (match := _COMMAND.match(line))]
        for command, rest in mentioned:
            seen += 1
            while rest.strip() and any(name.startswith(f"{command} ") for name in known):
                word, _, rest = rest.strip().partition(" ")
                command = f"{command} {word}"
            if not rest.strip() and any(name.startswith(f"{command} ") for name in known):
                continue  # a group, as a whole
            options = {word.partition("=")[0] for word in rest.split() if word.startswith("-")}
            if command not in known or not options <= known[command]:
                wrong.append(f"{path.name}: mammometry {command}{rest}")
    assert seen > 10
    assert wrong == []


def test_every_setting_in_the_documents_exists(repository: Path) -> None:
    known = set(names(Settings()))
    parts = {name.rsplit(".", depth)[0] for name in known for depth in range(1, name.count(".") + 1)}
    mentioned = {
        (path.name, name)
        for path in documents(repository)
        for name in _SETTING.findall(path.read_text(encoding="utf-8"))
    }
    modules = {
        ".".join(path.relative_to(repository / "src" / "mammometry").with_suffix("").parts).removesuffix(".__init__")
        for path in (repository / "src" / "mammometry").rglob("*.py")
    }
    assert {(where, name) for where, name in mentioned if name not in known | parts | modules} == set()
    assert any(name in known for _, name in mentioned)


def test_links_between_documents_lead_somewhere(repository: Path) -> None:
    dead = [
        f"{path.name}: {target}"
        for path in documents(repository)
        for target in _LINK.findall(path.read_text(encoding="utf-8"))
        if not (path.parent / target.strip()).exists()
    ]
    assert dead == []


def test_every_page_is_in_the_navigation(repository: Path) -> None:
    navigation = (repository / "zensical.toml").read_text(encoding="utf-8")
    pages = [path.relative_to(repository / "docs").as_posix() for path in (repository / "docs").rglob("*.md")]
    assert [page for page in pages if page not in navigation] == []


def test_every_decision_is_listed(repository: Path) -> None:
    index = (repository / "docs" / "decisions" / "index.md").read_text(encoding="utf-8")
    pages = sorted((repository / "docs" / "decisions").glob("[0-9]*.md"))
    assert [page.name for page in pages if page.name not in index] == []
    assert [int(page.name[:4]) for page in pages] == list(range(1, len(pages) + 1))


def test_settings_and_result_fields_are_in_the_reference() -> None:
    from tools.fields import RESULTS, SETTINGS, results_page, settings_page

    assert SETTINGS.read_text(encoding="utf-8") == settings_page(), "run python -m tools.fields"
    assert RESULTS.read_text(encoding="utf-8") == results_page(), "run python -m tools.fields"


def test_the_session_page_shows_a_manifest_that_is_read(repository: Path) -> None:
    from mammometry.calibration.targets.table import target_from_table
    from mammometry.io.manifest import parse_manifest

    page = (repository / "docs" / "session-folder.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"```toml\n(.*?)```", page, flags=re.DOTALL)
    manifest = parse_manifest(shown)
    assert manifest.target is not None
    assert target_from_table(manifest.target).kind == "charuco"


def test_every_command_is_in_the_reference() -> None:
    from tools.commands import PAGE, page

    assert PAGE.read_text(encoding="utf-8") == page(), "run python -m tools.commands"
    known = commands()
    groups = {name.rpartition(" ")[0] for name in known} - {""}
    assert set(re.findall(r"^###? (.+)$", page(), re.MULTILINE)) == known.keys() | groups


def test_one_source_of_the_version(repository: Path) -> None:
    with (repository / "pyproject.toml").open("rb") as file:
        project = tomllib.load(file)
    assert "version" in project["project"]["dynamic"]
    assert re.fullmatch(r"\d+\.\d+\.\d+", mammometry.__version__)
    citation = (repository / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {mammometry.__version__}\n" in citation


def test_nothing_committed_names_a_machine(repository: Path) -> None:
    """Absolute paths and addresses of one machine do not belong into a repository."""
    home = re.compile(r"(?<![\w./~-])/(?:home|root|Users|work|mnt|tmp/[a-z]+/)[/\w]")
    found = [
        f"{path.relative_to(repository)}: {match.group()}"
        for path in tracked(repository)
        if path.suffix in {".py", ".md", ".toml", ".txt", ".yml", ".yaml", ".cfg", ".j2", ".css", ""}
        and path.stat().st_size < 1e6
        for match in home.finditer(path.read_text(encoding="utf-8", errors="replace"))
    ]
    assert found == []


def test_the_map_of_the_source_names_the_folders_that_exist(repository: Path) -> None:
    text = (repository / "CONTRIBUTING.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"^src/mammometry/\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)
    places: set[str] = set()
    for line in shown.splitlines():
        if first := re.match(r"(  )?([a-z_]+)(/|\.py) ", line):
            inside = bool(first[1])
            room = f"src/mammometry/{first[2]}" if inside else first[2]
            places.add(f"{room}{first[3]}")
            line = line[first.end() :]
        if inside:
            places |= {f"{room}/**/{name}/" for name in re.findall(r"(?<![\w`])([a-z_]+)/", line)}
    assert [place for place in places if not any(repository.glob(place.rstrip("/")))] == []
    packages = {path.parent for path in (repository / "src" / "mammometry").glob("*/__init__.py")}
    named = {place for place in places if "*" not in place}
    assert {f"{package.relative_to(repository).as_posix()}/" for package in packages} - named == set()
    inner = {path.parent for path in (repository / "src" / "mammometry").glob("*/*/__init__.py")}
    assert {
        f"{package.parent.relative_to(repository).as_posix()}/**/{package.name}/" for package in inner
    } - places == set()
