"""Photographs on disk as the mapping that detection takes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from mammometry.base.photograph import Photograph
from mammometry.io.photographs.images import read_photograph


class Files(Mapping[tuple[str, str], Photograph]):
    """Photographs by pose and camera, read when they are looked up, as a session's are."""

    def __init__(self, paths: Mapping[tuple[str, str], Path]) -> None:
        self.paths = dict(paths)

    def __getitem__(self, key: tuple[str, str]) -> Photograph:
        path = self.paths[key]
        return read_photograph(path, f"{path.parent.name}/{path.name}")

    def __iter__(self) -> Iterator[tuple[str, str]]:
        return iter(self.paths)

    def __len__(self) -> int:
        return len(self.paths)
