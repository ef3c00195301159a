"""No sentence decides what the program does: callers decide by type, code or value."""

import ast
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest
from tests.architecture.test_imports import PACKAGE, modules, nodes, syntax

PARTS = {"found", "expected", "remedy"}
"""Parts of an error."""
SHOWN = {"title", "label", "sentence", "caption", "subtitle", "heading"}
"""Fields of other values that hold words for a reader."""
METHODS = {
    "startswith",
    "endswith",
    "split",
    "rsplit",
    "partition",
    "rpartition",
    "removeprefix",
    "removesuffix",
    "find",
}
BEGINS = {"startswith", "endswith"}
MATCHES = {"match", "search", "fullmatch"}
SEARCHES = {f"re.{name}" for name in MATCHES}
MESSAGES = {"error", "warning", "notice", "note", "sentence", "remark", "message"}
FORMATS = {
    "base/notices/words.py: sentence.startswith(begin)",  # sentences that version 1.0 stored
    "io/results/codecs.py: words.removesuffix('to be confirmed by eye')",  # likewise
    "simulate/rigs/rig_file.py: first['msg'].removeprefix('Value error, ')",  # pydantic writes it before our own words
    "capture/sessions.py: first['msg'].removeprefix('Value error, ')",
    "calibration/targets/table.py: error.errors()[0]['msg'].removeprefix('Input should be ')",  # likewise
    "report/documents/letters/shaping.py: unicodedata.name(letter, '').startswith('VARIATION SELECTOR')",
    "io/results/codecs.py: why == _OF_PARTNER",  # likewise
    "io/results/codecs.py: _BY_BREASTS in members['how']",  # likewise
    "io/meshes/foreign.py: units.endswith(_BY_SIZE)",  # scan.toml holds the unit and its source as one text
    "measure/volume/uncertainty.py: AXIS in terms",  # names of an interval's terms are their titles
    "measure/volume/difference.py: name == AXIS",
    "study/observers_tables.py: region != WHOLE",  # names of regions likewise
    "clinic/maintenance/rows.py: config.label not in _LEFT_OUT",  # Django's name of an application
    "clinic/maintenance/rows.py: model._meta.label != 'auth.Permission'",  # and of a table
    "report/documents/rendering.py: fact.label == known.label",  # both written by `posture_fact`
    "measure/change.py: earlier_one.title != later.title",  # stored lengths have no other mark of their definition
    "io/write.py: 'requested and' in str(error)",  # NumPy's error of a full disk has neither type nor number
}
"""Text that others or version 1.0 wrote, which has no code."""


def is_words(text: str) -> bool:
    """Whether a text is more than one word, as sentences are and names and codes are not."""
    words = text.split()
    return len(words) > 1 and all(word.strip(".,:;()'").replace("-", "").replace("'", "").isalpha() for word in words)


def named_words(trees: Iterable[ast.Module]) -> set[str]:
    """Names of constants that hold words."""
    return {
        target.id
        for tree in trees
        for node in tree.body
        if isinstance(node, ast.Assign) and any(is_words(text) for text in constants(node.value))
        for target in node.targets
        if isinstance(target, ast.Name)
    }


def known_words(tree: ast.Module, everywhere: set[str]) -> set[str]:
    """Such names that a module defines or imports."""
    imported = {name.name for node in nodes(tree) if isinstance(node, ast.ImportFrom) for name in node.names}
    return named_words([tree]) | (imported & everywhere)


def constants(node: ast.expr) -> list[str]:
    """Texts that stand in a constant or a tuple of them."""
    parts = node.elts if isinstance(node, ast.Tuple) else [node]
    return [part.value for part in parts if isinstance(part, ast.Constant) and isinstance(part.value, str)]


def is_message(node: ast.expr) -> bool:
    """Whether an expression is an error's or a notice's text."""
    if isinstance(node, ast.Attribute):
        return node.attr in PARTS
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "str" and node.args:
        node = node.args[0]
        return isinstance(node, ast.Name) and node.id in MESSAGES
    return isinstance(node, ast.Name) and node.id in MESSAGES - {"error", "message"}


def decisions(tree: ast.Module, words: set[str]) -> Iterator[str]:
    """Comparisons of texts that people read, as source."""

    def says(node: ast.expr) -> bool:
        return any(map(is_words, constants(node))) or (isinstance(node, ast.Name) and node.id in words)

    for node in nodes(tree):
        if isinstance(node, ast.Compare):
            if any(isinstance(side, ast.Attribute) and side.attr in SHOWN for side in (node.left, *node.comparators)):
                yield ast.unparse(node)
                continue
            sides, within = [node.left, *node.comparators], isinstance(node.ops[0], ast.In | ast.NotIn)
            literal = any(constants(side) or says(side) for side in sides)
            searched = within and says(node.left) and not isinstance(node.comparators[0], ast.Tuple | ast.Set)
            same = isinstance(node.ops[0], ast.Eq | ast.NotEq) and any(map(says, sides))
            if searched or same or (literal and any(map(is_message, sides))):
                yield ast.unparse(node)
        elif (
            isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in METHODS | MATCHES
        ):
            text = isinstance(node.func.value, ast.Constant)
            shown = isinstance(node.func.value, ast.Attribute) and node.func.value.attr in SHOWN
            searched = ast.unparse(node.func) in SEARCHES and any(map(is_message, node.args[1:2]))
            if searched or (shown and node.func.attr in BEGINS):
                yield ast.unparse(node)
                continue
            looked_for = node.func.attr != "split" and any(map(says, node.args[:1]))
            lines = any(not separator.strip() for separator in constants(node.args[0])) if node.args else True
            if not text and not lines and (looked_for or is_message(node.func.value)):
                yield ast.unparse(node)


def test_no_sentence_decides(repository: Path) -> None:
    trees = {path: syntax(path) for path in modules(repository)}
    words = named_words(trees.values())
    found = {
        f"{path.relative_to(repository / PACKAGE).as_posix()}: {decision}"
        for path, tree in trees.items()
        for decision in decisions(tree, known_words(tree, words))
    }
    assert found == FORMATS


@pytest.mark.parametrize(
    "line",
    [
        "'another run in progress' in error.found",
        "error.found == 'nothing'",
        "sentence.startswith('Nobody has confirmed')",
        "str(error).partition(', found ')",
        "_BUSY in event.failed",
        "note.endswith('to be confirmed')",
        'reason != "its partner\'s silhouette is not known"',
        "table.title.startswith(TITLES[kind])",
        "place.title == 'Administration'",
        "re.search('in progress', error.found)",
        "re.match('no tar', str(error))",
    ],
)
def test_such_a_decision_is_seen(line: str) -> None:
    assert list(decisions(ast.parse(line), {"_BUSY"}))


def test_no_template_decides_by_a_sentence(repository: Path) -> None:
    """Nor do pages: their conditions compare codes and states."""
    compared = re.compile(rf"{{% *(?:el)?if [^%]*\.(?:{'|'.join(sorted(SHOWN | PARTS | {'message'}))}) *(?:==|!=| in )")
    assert compared.search("{% if step.title == other.title %}")
    pages = [path for path in (repository / PACKAGE).rglob("templates/**/*") if path.suffix in (".html", ".j2", ".txt")]
    assert len(pages) > 50
    assert [path.name for path in pages if compared.search(path.read_text(encoding="utf-8"))] == []


def test_codes_and_types_may_decide() -> None:
    allowed = "event.code == BusyError.code or notice.code in CODES or name.startswith('report/') or text.split(',')"
    assert not list(decisions(ast.parse(allowed), set()))
