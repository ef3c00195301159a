"""Tests assert codes and values: only tests of the texts themselves read their wording."""

import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parents[1]
WORDS = re.compile(r"(?<![\w/.-])[A-Za-z][a-z’']+,? (?:[a-z]+,? )*[a-z][a-z’']+(?![\w/-])")
SENTENCE = re.compile(r"(?:[A-Za-z][a-z’']*,? ){3}[a-z]+")
COMMANDS = re.compile(r"\bmammometry(?: [a-z-]+){1,2}|<[^<>]*>?|\b(?:camera|pair|pose|row|column) [\w-]+")
SUBJECT = re.compile(r"^\^?[^:]*: (?=\.\*|$)")
"""An error's subject, at the beginning of a pattern."""
SEARCHES = {"startswith", "endswith", "count", "search", "match", "fullmatch", "findall", "index", "find"}
TEXTS = {
    "unit/report/test_anthropometry_words.py",
    "unit/report/test_attribution.py",
    "unit/report/test_content.py",
    "unit/base/test_errors.py",
    "unit/report/test_change_words.py",
    "unit/report/test_notices.py",
}
"""Tests whose subject is a catalogue's wording, or how a sentence is made."""
MOST = 147
"""Comparisons with wording that remain. The number may only shrink."""
NAMES = {"says", "said", "words", "word", "message", "sentence", "wording", "text", "wrong", "why", "reason", "remark"}
"""Parameters of tests that hold words to compare."""


def is_wording(text: str) -> bool:
    """Whether a text has several words in a row, other than commands and tags."""
    return WORDS.search(COMMANDS.sub("", SUBJECT.sub("", text.replace("\\", "")))) is not None


def wordings(node: ast.AST) -> list[str]:
    """Texts of several words in an expression, other than keys."""
    keys = {id(part) for key in ast.walk(node) if isinstance(key, ast.Subscript) for part in ast.walk(key.slice)}
    texts = [part.value for part in ast.walk(node) if isinstance(part, ast.Constant) and id(part) not in keys]
    return [text for text in texts if isinstance(text, str) and is_wording(text)]


def assertions(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and words of each comparison with wording in a test."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            for keyword in node.keywords:
                if keyword.arg == "match":
                    yield from ((node.lineno, words) for words in wordings(keyword.value))
            if isinstance(node.func, ast.Attribute) and node.func.attr == "parametrize" and len(node.args) > 1:
                names = [
                    name.strip()
                    for text in ast.walk(node.args[0])
                    if isinstance(text, ast.Constant)
                    for name in str(text.value).split(",")
                ]
                if NAMES & set(names):
                    yield from ((node.lineno, words) for words in wordings(node.args[1]))
        elif isinstance(node, ast.Assert):
            found = (words for part in compared(node.test) for words in wordings(part))
            yield from ((node.lineno, words) for words in found)


def compared(test: ast.expr) -> Iterator[ast.AST]:
    """Parts of an assertion that are compared with a text."""
    for node in ast.walk(test):
        if isinstance(node, ast.Compare):
            sides = [side for side in (node.left, *node.comparators) if not isinstance(side, ast.Call)]
            searched = isinstance(node.ops[0], ast.In | ast.NotIn)
            yield from (side for side in sides if searched or any(SENTENCE.search(words) for words in wordings(side)))
        elif isinstance(node, ast.comprehension):
            yield node.iter
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in SEARCHES:
            yield from node.args


def wording(folder: Path) -> Iterator[str]:
    """All comparisons with wording in tests whose subject is not the texts themselves."""
    for path in sorted(folder.rglob("*.py")):
        name = path.relative_to(folder).as_posix()
        if not name.startswith("architecture/") and name not in TEXTS:
            tree = ast.parse(path.read_text(encoding="utf-8"))
            compared_words = list(assertions(tree))
            if not compared_words:
                continue
            given = [part.value for part in ast.walk(tree) if isinstance(part, ast.Constant)]
            counts = Counter(words for _, words in compared_words)
            for line, words in compared_words:
                if sum(words in str(text) for text in given) <= counts[words]:  # else the test itself wrote the words
                    yield f"tests/{name}:{line}: {words!r}"


@pytest.mark.parametrize(
    "line",
    [
        "with pytest.raises(SessionError, match='a file that is damaged'): pass",
        "assert 'Take them out' in str(error)",
        "assert 'no answer' not in page",
        "assert any('no answer' in line for line in lines)",
        "assert all(part in page for part in ('no answer', 'x'))",
        "assert sentence.startswith('Nobody has')",
        "assert line == 'Volumes of different postures are not to be compared.'",
        "@pytest.mark.parametrize(('read', 'said'), [(1, 'an empty file')])\ndef test(read, said): pass",
    ],
)
def test_wording_is_seen(line: str) -> None:
    assert list(assertions(ast.parse(line)))


@pytest.mark.parametrize(
    "line",
    [
        "with pytest.raises(SessionError, match=r'^left.jpg: .*30 × 20 pixels'): pass",
        "assert error.subject == 'camera front_left'",
        "assert 'camera front_left' in str(error)",
        "assert 'mammometry edit' in page",
        "assert '<td class=\"number\">12.5 cc' in page",
    ],
)
def test_codes_and_values_may_be_compared(line: str) -> None:
    assert not list(assertions(ast.parse(line)))


def test_tests_compare_codes_and_values() -> None:
    found = list(wording(TESTS))
    assert len(found) <= MOST, "\n".join(found)


if __name__ == "__main__":
    for each_place in wording(TESTS):
        print(each_place)  # noqa: T201
