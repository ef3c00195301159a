"""Figures of the documentation: every table has its commands and its commit, and the runner writes what it made."""

import re
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from benchmarks import measured

ENTRIES = measured.registry()


def test_every_table_stands_in_its_page_with_its_commands_and_its_commit(repository: Path) -> None:
    assert len(ENTRIES) > 20
    for page in {entry.page for entry in ENTRIES.values()}:
        blocks = measured.blocks((repository / page).read_text(encoding="utf-8"))
        assert blocks.keys() == {name for name, entry in ENTRIES.items() if entry.page == page}
        for name, text in blocks.items():
            shown = re.findall(r"^\$ (.+)$", text, re.MULTILINE)
            assert tuple(shown) == ENTRIES[name].commands, name
            if ENTRIES[name].kept == "never":
                assert "By commit" not in text
                continue
            (commit,) = re.findall(r"^\*By commit ([0-9a-f]{8}), \d+ \w+ \d{4}\.\*$", text, re.MULTILINE)
            assert ENTRIES[name].kept in ("", commit), name
            assert "| --- |" in text, name


def test_what_was_made_replaces_the_table_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page, registry = tmp_path / "page.md", tmp_path / "measured.toml"
    page.write_text("# A\n\n<!-- measured: a -->\nold\n<!-- end -->\n\nb\n\n<!-- measured: b -->\nold\n<!-- end -->\n")
    registry.write_text('[a]\ncommands = ["x"]\nkept = "1"\n\n[b]\ncommands = ["y"]\nkept = "2"\n')
    monkeypatch.setattr(measured, "ROOT", tmp_path)
    monkeypatch.setattr(measured, "REGISTRY", registry)
    entry = measured.Entry(name="a", commands=("x --out OUT",), minutes=1, page="page.md")
    other = measured.Entry(name="b", commands=("y",), minutes=1, page="page.md", kept="2")
    result = measured.Result(commit="12345678", day="1 May 2026", seconds=2.0, outputs=("| t |\n| --- |\n| 1 |\n",))
    measured.write({"a": entry, "b": other}, {"a": result})
    made = "```console\n$ x --out OUT\n```\n\n| t |\n| --- |\n| 1 |\n\n*By commit 12345678, 1 May 2026.*\n"
    assert measured.blocks(page.read_text()) == {"a": made, "b": "old\n"}
    assert registry.read_text() == '[a]\ncommands = ["x"]\n\n[b]\ncommands = ["y"]\nkept = "2"\n'


def test_what_is_there_is_not_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []

    def make(entry: measured.Entry, by: str, folder: Path) -> measured.Result:
        made.append(entry.name)
        (folder / entry.name).mkdir(parents=True)
        return measured.Result(commit=by, day="1 May 2026", seconds=1.0, outputs=("| t |",))

    monkeypatch.setattr(measured, "ROOT", tmp_path)
    monkeypatch.setattr(measured, "commit", lambda: "12345678")
    monkeypatch.setattr(measured, "make", make)
    monkeypatch.setattr(measured, "write", lambda entries, results: None)
    monkeypatch.setattr("sys.argv", ["measured", "plate", "casts"])
    measured.main()
    measured.main()
    assert made == ["plate", "casts"]


def test_what_a_benchmark_prints_while_it_runs_is_left_out() -> None:
    printed = "9200 left 193, right -1\n| a | b |\n| --- | --- |\n| 1 | -2 |\n\nin words\n"
    assert measured.from_first_table((printed,)) == "| a | b |\n| --- | --- |\n| 1 | −2 |\n\nin words"


def test_nine_casts_become_a_table() -> None:
    table = "model,reference_cc,measured_cc,low_cc,high_cc\na,100.0,101.0,99.0,103.0\nb,200.0,199.0,199.5,199.8\n"
    assert measured.casts(("{}", table)).splitlines()[1:] == [
        "| --- | --- | --- | --- | --- | --- | --- |",
        "| a | 100.0 | 101.0 | +1.00 | +1.00 | 99.0 … 103.0 | yes |",
        "| b | 200.0 | 199.0 | −1.00 | −0.50 | 199.5 … 199.8 | no |",
        "",
        "Mean error +0.00 cc, standard deviation 1.41 cc.",
    ]


def test_commands_that_ended_are_not_run_again(tmp_path: Path) -> None:
    entry = measured.Entry(
        name="a", commands=("python -c 'print(1)'", f"python -c 'print(len(open(\"{tmp_path}/there\").read()))'")
    )
    with pytest.raises(subprocess.CalledProcessError):
        measured.make(entry, "12345678", tmp_path)
    (tmp_path / "there").write_text("four")
    again = measured.make(replace(entry, commands=("python -c 'print(2)'", *entry.commands[1:])), "12345678", tmp_path)
    assert again.outputs == ("1\n", "4\n")
