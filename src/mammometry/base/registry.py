"""Registry of named variants, each of which is added by the module that defines it."""

from __future__ import annotations

import difflib
import importlib
import pkgutil
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Generic, TypeVar

from mammometry.base.errors import MammometryError, SettingsError

T = TypeVar("T")


class Registry(Mapping[str, T], Generic[T]):
    """Variants of one kind by name, in alphabetical order.

        TARGETS: Registry[type[Target]] = Registry("calibration target", modules=("mammometry.….charuco",))

        @TARGETS.add("charuco")
        class CharucoTarget(Target): ...

    The modules are imported at the first look-up. So a registry takes no time at start-up, and a module that adds an
    entry can import the registry.

    Args:
        what: what one entry is, for messages ("calibration target").
        modules: modules that add the entries.
        package: package whose modules may all add entries, without being listed.
        entries: initial entries, if they are short.
    """

    def __init__(
        self,
        what: str,
        *,
        modules: tuple[str, ...] = (),
        package: str = "",
        entries: Mapping[str, T] = MappingProxyType({}),
    ) -> None:
        self.what = what
        self._modules = modules
        self._package = package
        self._entries: dict[str, T] = dict(entries)
        self._is_loaded = False

    def add(self, name: str) -> Callable[[T], T]:
        """Decorate a class or function to register it as `name`.

        Raises:
            ValueError: the name is taken.
        """

        def enter(entry: T) -> T:
            if name in self._entries:
                raise ValueError(f"there is already a {self.what} {name!r}")
            self._entries[name] = entry
            return entry

        return enter

    def find(self, name: object, subject: str, *, error: type[MammometryError] = SettingsError, remedy: str = "") -> T:
        """Find an entry by its name.

        Args:
            name: as the user wrote it. None: not given.
            subject: subject of the message, such as ``[target] kind``.
            error: class of the error for an unknown name.
            remedy: what to do about an unknown name. The message suggests the most similar name first.

        Raises:
            MammometryError: of class `error`, for an unknown name. The message lists the known names.
        """
        if isinstance(name, str) and name in self:
            return self[name]
        near = difflib.get_close_matches(str(name), list(self), n=1)
        advice = [f"{near[0]!r} is the most similar"] if near else []
        raise error(
            subject,
            found="nothing" if name is None else repr(name),
            expected=f"one of {', '.join(map(repr, self))}",
            remedy=". ".join([*advice, remedy or f"Choose a known {self.what}"]),
        )

    def name_of(self, entry: T) -> str:
        """Return the name of an entry.

        Raises:
            LookupError: it is not in the registry.
        """
        for name, known in self._loaded().items():
            if known is entry:
                return name
        raise LookupError(f"{entry!r} is not a registered {self.what}")

    def __getitem__(self, name: str) -> T:
        return self._loaded()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(sorted(self._loaded()))

    def __len__(self) -> int:
        return len(self._loaded())

    def _loaded(self) -> dict[str, T]:
        if not self._is_loaded:
            for module in (*self._modules, *self._in_package()):
                importlib.import_module(module)
            self._is_loaded = True
        return self._entries

    def _in_package(self) -> Iterator[str]:
        if self._package:
            folders = importlib.import_module(self._package).__path__
            yield from (module.name for module in pkgutil.iter_modules(folders, f"{self._package}."))
