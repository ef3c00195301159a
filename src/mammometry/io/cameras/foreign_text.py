"""Read other programs' XML and YAML safely."""

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import yaml

from mammometry.base.parse import DEEPEST, parsing, read_text, require_sane, shown

_MOST_MIB = 16  # the cameras of a large project take a few MiB


def read_xml(path: Path, expected: str) -> ElementTree.Element:
    """Read the root of an XML file. Declarations are refused, because entities can expand to gigabytes.

    Raises:
        SessionError: it cannot be read or is not XML.
    """
    text = read_text(path, path.name, expected, most_mib=_MOST_MIB).lstrip()
    with parsing("a file that cannot be parsed", path.name, expected):
        if "<!" in text.replace("<!--", ""):
            raise ValueError("a declaration <!…>")
        try:
            return ElementTree.fromstring(text)
        except ElementTree.ParseError as error:
            raise ValueError(str(error)) from None


_INTEGER = re.compile(r"^[-+]?(?:0|[1-9][0-9]*)$")
_FLOAT = re.compile(
    r"^(?:[-+]?(?:[0-9]+\.[0-9]*|\.[0-9]+|[0-9]+(?=[eE]))(?:[eE][-+]?[0-9]+)?"
    r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$"
)


def yaml_value(text: str, subject: str, expected: str, tags: dict[str, Callable[[Any], Any]] | None = None) -> Any:
    """Parse YAML with unique keys, numbers within `parse.LARGEST`, and no aliases.

    Args:
        text: the YAML.
        subject: its name in messages.
        expected: what it should be, for messages.
        tags: tag → function that converts a mapping with this tag. Other objects are refused.

    Raises:
        SessionError: it is not valid YAML of this kind.
    """

    class Loader(_PlainLoader):
        pass

    for tag, make in (tags or {}).items():
        Loader.add_constructor(tag, partial(_construct, make))
    with parsing("a file that cannot be parsed", subject, expected):
        try:
            tree = yaml.load(text, Loader=Loader)
        except yaml.MarkedYAMLError as error:
            line = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
            raise ValueError(f"{line}{error.problem}") from None
        except yaml.YAMLError as error:
            raise ValueError(str(error)) from None
        require_sane(tree)
    return tree


def _construct(make: Callable[..., Any], loader: yaml.SafeLoader, node: yaml.MappingNode) -> Any:
    return make(loader.construct_mapping(node, deep=True))


class _PlainLoader(yaml.SafeLoader):
    """Loads safe values only. Reads ``1e-5`` as a number, as other programs write it."""

    _depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Refuse aliases: a few lines of them can expand to gigabytes."""
        if self.check_event(yaml.AliasEvent):
            raise ValueError("an alias *name")
        self._depth += 1
        if self._depth > DEEPEST:
            raise ValueError(f"nested more than {DEEPEST} deep")
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        """Refuse duplicate keys: PyYAML would keep the last one."""
        keys = [self.construct_object(key, deep=True) for key, _ in getattr(node, "value", ())]
        for place, key in enumerate(keys):
            if key in keys[:place]:
                raise ValueError(f"two values of {shown(key)}")
        table: dict[Any, Any] = super().construct_mapping(node, deep=deep)
        return table


# PyYAML's own patterns read 1e-5 as text, 1:30 as ninety and 010 as eight.
_PlainLoader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in pairs if tag.rpartition(":")[2] not in ("float", "int")]
    for first, pairs in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_PlainLoader.add_implicit_resolver("tag:yaml.org,2002:int", _INTEGER, list("-+0123456789"))
_PlainLoader.add_implicit_resolver("tag:yaml.org,2002:float", _FLOAT, list("-+0123456789."))
