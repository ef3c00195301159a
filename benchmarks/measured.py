"""Compute the figures of the documentation, and write their tables.

    python -m benchmarks.measured                      all missing ones; some hours, resumable python -m
    benchmarks.measured plate dents-casts    only these python -m benchmarks.measured --minutes 6          what takes
    at most six minutes python -m benchmarks.measured --write              only write existing results into the pages

`measured.toml` says which commands make which table. Each result is kept in build/measured/COMMIT/NAME.json, where
COMMIT is the last one that changed the program or a benchmark; what is there is not made again. OUT in a command is a
folder of that commit's own. A page holds the table between ``<!-- measured: NAME -->`` and ``<!-- end -->``.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import json
import re
import shlex
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import mean, stdev
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
REGISTRY = Path(__file__).with_suffix(".toml")
_CHANGES_FIGURES = ("src", "benchmarks", ":!benchmarks/measured.py", ":!benchmarks/measured.toml")
_BLOCK = re.compile(r"<!-- measured: ([\w-]+) -->\n(.*?)<!-- end -->", re.DOTALL)


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One table of the documentation and its commands."""

    name: str
    commands: tuple[str, ...] = ()
    minutes: float = 0.0
    """Minutes of the commands on two quiet cores."""
    of: str = ""
    """Table whose output this one shows in another form, without own commands."""
    page: str = "docs/measured.md"
    form: str = "markdown"
    """Form of the output: a key of `FORMS`."""
    file: str = ""
    """File written by the commands, used as one more output."""
    needs: str = ""
    """Folder next to the repository that the commands need."""
    kept: str = ""
    """Commit or day of a table that was not made by this runner. Removed once it is."""


@dataclass(frozen=True, kw_only=True)
class Result:
    """Output of the commands, and version of the program."""

    commit: str
    day: str
    seconds: float
    outputs: tuple[str, ...]


def registry(path: Path = REGISTRY) -> dict[str, Entry]:
    """Name → entry, in the order of the file."""
    tables: Mapping[str, Mapping[str, Any]] = tomllib.loads(path.read_text(encoding="utf-8"))
    own = {
        name: tuple(table.get("commands", tables.get(table.get("of", ""), {}).get("commands", ())))
        for name, table in tables.items()
    }
    return {name: Entry(name=name, **{**table, "commands": own[name]}) for name, table in tables.items()}


def commit() -> str:
    """Last commit that changed the program or a benchmark.

    Raises:
        SystemExit: there are uncommitted changes.
    """
    changed = _git("status", "--porcelain", "--", *_CHANGES_FIGURES)
    if changed:
        raise SystemExit(f"A figure needs a commit that made it. Commit these first:\n{changed}")
    return _git("log", "-1", "--format=%h", "--abbrev=8", "--", *_CHANGES_FIGURES)


def make(entry: Entry, by: str, folder: Path) -> Result:
    """Run an entry's commands in sequence in the repository. Finished ones are not run again.

    Raises:
        subprocess.CalledProcessError: a command failed.
    """
    out, begun = folder / entry.name, folder / f"{entry.name}.begun.json"
    out.mkdir(parents=True, exist_ok=True)
    outputs, before_s = json.loads(begun.read_text(encoding="utf-8")) if begun.is_file() else ([], 0.0)
    started = time.monotonic() - before_s
    for command in entry.commands[len(outputs) :]:
        program, *arguments = shlex.split(command)
        words = [word.replace("OUT", str(out)) for word in arguments]
        begin = [sys.executable, "-m", "mammometry"] if program == "mammometry" else [sys.executable]
        done = subprocess.run([*begin, *words], cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
        outputs.append(done.stdout.replace(str(out), "OUT"))
        begun.write_text(json.dumps([outputs, time.monotonic() - started]), encoding="utf-8")
    if entry.file:
        outputs.append(Path(entry.file.replace("OUT", str(out))).read_text(encoding="utf-8"))
    day = time.strftime("%-d %B %Y", time.gmtime())
    return Result(commit=by, day=day, seconds=time.monotonic() - started, outputs=tuple(outputs))


def with_minus(text: str) -> str:
    """Negative numbers with a minus sign, as on the pages."""
    return re.sub(r"(?<=[ |])-(?=[\d.])", "−", text)


def markdown(outputs: Sequence[str]) -> str:
    """Tables and sentences as printed."""
    return with_minus("\n\n".join(output.strip() for output in outputs if output.strip()))


def from_first_table(outputs: Sequence[str]) -> str:
    """Tables and sentences, without progress output before them."""
    return markdown([output[max(output.find("| "), 0) :] for output in outputs])


def first_table(outputs: Sequence[str]) -> str:
    """Only the first table of each output, under one heading."""
    rows: list[str] = []
    for output in outputs:
        lines = output.splitlines()
        heads = [number for number, line in enumerate(lines) if line.startswith("| ---")]
        rest = lines[heads[0] + 1 : heads[1] - 1 if len(heads) > 1 else None]
        rows += [] if rows else lines[heads[0] - 1 : heads[0] + 1]
        rows += itertools.takewhile(lambda line: line.startswith("|"), rest)
    return with_minus("\n".join(rows))


def demo(outputs: Sequence[str]) -> str:
    """Volume and interval of the demo, with the truth."""
    answer = json.loads(outputs[-1])
    (name,) = answer["volumes_cc"]
    low, high = answer["intervals_cc"][name]
    return (
        "| true cc | measured cc | 95 % interval cc |\n| --- | --- | --- |\n"
        f"| {answer['true_volumes_cc'][name]:.1f} | {answer['volumes_cc'][name]:.1f} | {low:.1f} … {high:.1f} |"
    )


def casts(outputs: Sequence[str]) -> str:
    """Nine casts with their truth, and their agreement."""
    models = list(csv.DictReader(outputs[-1].splitlines()))
    lines = ["| cast | true cc | measured cc | error cc | error % | 95 % interval cc | holds |", "| --- " * 7 + "|"]
    errors_cc = []
    for model in models:
        true, measured, low, high = (float(model[key]) for key in ("reference_cc", "measured_cc", "low_cc", "high_cc"))
        errors_cc.append(measured - true)
        lines.append(
            f"| {model['model']} | {true:.1f} | {measured:.1f} | {measured - true:+.2f} | "
            f"{100 * (measured / true - 1):+.2f} | {low:.1f} … {high:.1f} | {'yes' if low <= true <= high else 'no'} |"
        )
    lines += ["", f"Mean error {mean(errors_cc):+.2f} cc, standard deviation {stdev(errors_cc):.2f} cc."]
    return with_minus("\n".join(lines))


def paper_depth(outputs: Sequence[str]) -> str:
    """Depth on a tilted plate, with the printed figure."""
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in outputs[0].splitlines() if "|" in line]
    worst = max(float(row[5]) for row in rows[2:])
    rms = max(float(row[3]) for row in rows[2:])
    return (
        "| depth on a tilted flat plate | printed | here |\n| --- | --- | --- |\n"
        f"| greatest error, mm | < 0.5 | {worst:.2f} |\n| RMS from the plane, worst pair, mm | | {rms:.3f} |"
    )


def paper_table(outputs: Sequence[str]) -> str:
    """Table 1: nine models and the agreement of the methods, as printed and here."""
    from benchmarks.paper import table_1

    return with_minus(table_1(outputs[-1]))


_COUNTED = 6  # last lines of a benchmark that counts: its sums


def lines(outputs: Sequence[str]) -> str:
    """The last lines ``what: figures`` of each output as rows."""
    rows = [line.partition(": ") for output in outputs for line in output.splitlines()[-_COUNTED:] if ": " in line]
    return "\n".join(["| what | found |", "| --- | --- |", *(f"| {what} | {found} |" for what, _, found in rows)])


FORMS: Mapping[str, Callable[[Sequence[str]], str]] = {
    "markdown": markdown,
    "from-first-table": from_first_table,
    "first-table": first_table,
    "lines": lines,
    "demo": demo,
    "casts": casts,
    "paper-depth": paper_depth,
    "paper-table": paper_table,
}


def block(entry: Entry, result: Result) -> str:
    """Text between the markers."""
    commands = "\n".join(f"$ {command}" for command in entry.commands)
    table = FORMS[entry.form](result.outputs)
    return f"```console\n{commands}\n```\n\n{table}\n\n*By commit {result.commit}, {result.day}.*\n"


def write(entries: Mapping[str, Entry], results: Mapping[str, Result]) -> None:
    """Write the tables of all results into their pages, and remove their `kept` marks."""
    for page in {entry.page for entry in entries.values()}:
        path = ROOT / page
        before = path.read_text(encoding="utf-8")

        def table(match: re.Match[str]) -> str:
            name = match[1]
            result = results.get(entries[name].of or name)
            inside = block(entries[name], result) if result else match[2]
            return f"<!-- measured: {name} -->\n{inside}<!-- end -->"

        after = _BLOCK.sub(table, before)
        if after != before:
            path.write_text(after, encoding="utf-8")
    registered = REGISTRY.read_text(encoding="utf-8")
    for name in (entry.name for entry in entries.values() if (entry.of or entry.name) in results):
        registered = re.sub(rf"(^\[{name}\]\n(?:[^\[\n].*\n)*?)kept = .*\n", r"\1", registered, flags=re.MULTILINE)
    REGISTRY.write_text(registered, encoding="utf-8")


def blocks(text: str) -> dict[str, str]:
    """Name → text between its markers on a page."""
    return dict(_BLOCK.findall(text))


def main() -> None:
    """Make missing tables, then write the pages."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="tables to make; without names all")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="leave out what takes longer")
    parser.add_argument("--write", action="store_true", help="run nothing, write the pages from what is there")
    arguments = parser.parse_args()
    entries = registry()
    if unknown := set(arguments.names) - entries.keys():
        parser.error(f"no table is named {', '.join(sorted(unknown))}; there are {', '.join(entries)}")
    by = commit()
    folder = ROOT / "build" / "measured" / by
    results, failed = {}, []
    for name, entry in entries.items():
        if entry.of:
            continue
        path = folder / f"{name}.json"
        if path.is_file():
            results[name] = Result(**json.loads(path.read_text(encoding="utf-8")))
            continue
        chosen = name in arguments.names if arguments.names else entry.minutes <= arguments.minutes
        if arguments.write or not chosen:
            continue
        if entry.needs and not (ROOT / entry.needs).is_dir():
            print(f"{name}: left out, {entry.needs} is not there")
            continue
        print(f"{name}: about {entry.minutes:g} minutes", flush=True)
        try:
            results[name] = make(entry, by, folder)
        except subprocess.CalledProcessError as error:
            failed.append(f"{name}: {shlex.join(error.cmd)} ended with {error.returncode}")
            continue
        path.write_text(json.dumps(asdict(results[name]), indent=1), encoding="utf-8")
        write(entries, results)
    write(entries, results)
    if failed:
        raise SystemExit("\n".join(failed))


def _git(*arguments: str) -> str:
    return subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()


if __name__ == "__main__":
    main()
