"""Write docs/reference/commands.md from the commands' own help.

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
"""Options that nearly every command has, listed once."""


def commands() -> Iterator[tuple[str, Any]]:
    """Name and command, a group before its commands."""

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
                rows.append(f"- `{spelled}`: {_one_line(parameter.help or '')}{_default(parameter)}")
        if rows:
            lines += ["", *rows]
        if examples := _examples(command):
            lines += ["", "```console", *(f"$ {line}" for line in examples), "```"]
    return "\n".join(lines) + "\n"


def _default(parameter: Any) -> str:
    """The default in words. Empty for an option that is simply off or not given."""
    value = getattr(parameter, "show_default", None)
    value = value if isinstance(value, str) else parameter.default
    if callable(value) or value is None or value is False or value in ((), [], ""):
        return ""
    if value is True:
        return f" On by default; `{parameter.secondary_opts[0]}` turns it off." if parameter.secondary_opts else ""
    return f" Default: `{getattr(value, 'value', value)}`."


def _examples(command: Any) -> list[str]:
    """Command lines of the help's examples."""
    _, _, examples = (command.help or "").replace("\b", "").partition("Examples:")
    examples += (command.epilog or "").replace("\b", "").partition("Examples:")[2]
    return [line.strip().removeprefix("$ ") for line in examples.splitlines() if "mammometry " in line]


def _paragraphs(text: str) -> list[str]:
    text = re.split(r"\n\s*Examples:", text.replace("\b", ""))[0].strip()
    return [_one_line(part) if part else "" for part in text.split("\n\n") for part in (part, "")][:-1]


def _one_line(text: str) -> str:
    return re.sub(r"\s+", " ", text).replace("<", "&lt;").strip()


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
