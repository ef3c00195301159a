"""Every form of the clinic that changes a record refuses stale ones, and each carries its token."""

import ast
import re
from pathlib import Path

from tests.architecture.test_imports import nodes, syntax

CLINIC = "src/mammometry/clinic"
BASE = "record_form.py"
FACTORIES = {"modelform_factory", "modelformset_factory", "inlineformset_factory", "fields_for_model"}
_FORM = re.compile(r"<form\b[^>]*>.*?</form>", re.DOTALL)
_SENDS = re.compile(r'<form\b[^>]*(method="post"|\bdata-post\b)')
WITHOUT = ("account_logout", "job-cancel")
"""Forms that make nothing: a second one changes nothing more."""


def test_every_form_of_a_record_is_a_record_form(repository: Path) -> None:
    found = []
    for path in sorted((repository / CLINIC).rglob("*.py")):
        tree = syntax(path)
        names = {node.attr if isinstance(node, ast.Attribute) else node.id for node in nodes(tree)
                 if isinstance(node, ast.Attribute | ast.Name)}  # fmt: skip
        if names & {"ModelForm", "BaseModelForm", *FACTORIES}:
            found.append(path.name)
    assert found == [BASE]


def test_no_record_form_goes_without_the_comparison(repository: Path) -> None:
    """`is_valid` is where a stale form is found, so no form may have its own."""
    for path in sorted((repository / CLINIC).rglob("*.py")):
        for node in nodes(syntax(path)):
            if isinstance(node, ast.ClassDef) and path.name != BASE:
                own = {each.name for each in node.body if isinstance(each, ast.FunctionDef)}
                assert not own & {"is_valid", "_compare", "full_clean"}, f"{path.name}: {node.name}"


def test_every_form_that_changes_something_carries_a_token(repository: Path) -> None:
    templates = sorted((repository / CLINIC / "templates" / "clinic").glob("*.html"))
    forms = [(path.name, form) for path in templates for form in _FORM.findall(path.read_text(encoding="utf-8"))]
    sending = [(name, form) for name, form in forms if _SENDS.match(form)]
    assert len(sending) > 25
    for name, form in sending:
        carried = "{% form_token %}" in form or 'include "clinic/form_fields.html"' in form
        assert carried or any(f"'{where}'" in form for where in WITHOUT), f"{name}: {form[:120]}"
    assert "{% form_token %}" in (repository / CLINIC / "templates/clinic/form_fields.html").read_text()
