"""Write docs/reference/commands.md from the commands' own words.

python -m tools.commands
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from typer.main import get_command

from mammometry.cli.main import app

PAGE = Path(__file__).resolve().parents[1] / "docs" / "reference" / "commands.md"
EVERYWHERE = {
    "--set": "`NAME=VALUE`: change a setting, such as `matching.window_px=11`; may be repeated",
    "--settings": "`FILE`: read settings from a TOML file",
    "--quiet": "print errors only",
    "--json": "print the answer as one JSON object",
    "--verbose": "log to standard error; `-vv` logs more",
    "--help": "show the command's help, with examples",
}
"""Options that nearly every command has, said once."""


def commands() -> Iterator[tuple[str, Any]]:
    """Name and command, groups before what they hold."""

    def walk(group: Any, before: str) -> Iterator[tuple[str, Any]]:
        for name, command in group.commands.items():
            yield f"{before}{name}", command
            if hasattr(command, "commands"):
                yield from walk(command, f"{before}{name} ")

    return walk(get_command(app), "")


def page() -> str:
    """Every command with its arguments and options."""
    lines = ["# Commands", "", "`make docs` makes this page from the commands' own help. Nearly every command has:", ""]
    lines += [f"- `{option}`: {words}" for option, words in EVERYWHERE.items()]
    for name, command in commands():
        lines += ["", f"{'###' if ' ' in name else '##'} {name}", "", *_paragraphs(command.help or "")]
        if hasattr(command, "commands"):
            continue
        rows = []
        for parameter in command.params:
            argument = parameter.param_type_name == "argument"
            spelled = parameter.metavar or parameter.name.upper() if argument else " ".join(parameter.opts[:1])
            if argument or parameter.opts[0] not in EVERYWHERE:
                rows.append(f"- `{spelled}`: {_one_line(parameter.help or '')}")
        if rows:
            lines += ["", *rows]
    return "\n".join(lines) + "\n"


def _paragraphs(text: str) -> list[str]:
    text = re.split(r"\n\s*Examples:", text.replace("\b", ""))[0].strip()
    return [_one_line(part) if part else "" for part in text.split("\n\n") for part in (part, "")][:-1]


def _one_line(text: str) -> str:
    return re.sub(r"\s+", " ", text).replace("<", "&lt;").strip()


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
