"""A benchmark whose figure nobody reads is deleted: each module is named by a page, or imported by one that is."""

import re
from pathlib import Path


def test_every_benchmark_is_named(repository: Path) -> None:
    folder = repository / "benchmarks"
    modules = {
        path.relative_to(repository).with_suffix("").as_posix().replace("/", "."): path.read_text(encoding="utf-8")
        for path in folder.rglob("*.py")
        if path.name != "__init__.py"
    }
    pages = [repository / "README.md", *(repository / "docs").rglob("*.md")]
    named = set(re.findall(r"benchmarks(?:\.\w+)+", "\n".join(path.read_text(encoding="utf-8") for path in pages)))
    reached = modules.keys() & named
    while more := {
        name for name in modules.keys() - reached if any(f"{name} import" in modules[known] for known in reached)
    }:
        reached |= more
    assert modules.keys() == reached, sorted(modules.keys() - reached)
