"""Forms of the clinic's pages as a browser sends them back, with what they carry unseen."""

from html.parser import HTMLParser
from typing import Any

from django.test import Client

Fields = dict[str, list[str]]


class _Forms(HTMLParser):
    """Each form of a page: its address and its fields."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[tuple[str, Fields]] = []
        self._select = self._text = ""
        self._first: str | None = None
        self._inside = False
        self.feed(page)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        at = {name: value or "" for name, value in attributes}
        name = at.get("name", "")
        if tag == "form":
            self.found.append((at.get("action", ""), {}))
            self._inside = True
        elif not self._inside:
            return
        elif tag == "input" and name and "disabled" not in at:
            if at.get("type") not in ("checkbox", "radio") or "checked" in at:
                self._add(name, at.get("value", "on" if at.get("type") == "checkbox" else ""))
        elif tag == "select":
            self._select, self._first = name, None
        elif tag == "option" and self._select:
            self._first = at.get("value", "") if self._first is None else self._first
            if "selected" in at:
                self._add(self._select, at.get("value", ""))
                self._first = None
                self._select = ""
        elif tag == "textarea" and name:
            self._text = name
            self._add(name, "")

    def handle_endtag(self, tag: str) -> None:
        if tag == "select" and self._select:
            self._add(self._select, self._first or "")
            self._select = ""
        elif tag == "textarea" and self._text:
            values = self.found[-1][1][self._text]
            values[-1] = values[-1].replace("\r\n", "\n").removeprefix("\n").replace("\n", "\r\n")
            self._text = ""
        elif tag == "form":
            self._inside = False

    def handle_data(self, data: str) -> None:
        if self._text:
            self.found[-1][1][self._text][-1] += data

    def _add(self, name: str, value: str) -> None:
        self.found[-1][1].setdefault(name, []).append(value)


def fields_of(page: str, action: str = "") -> Fields:
    """Fields of the form with this address; of the first one to its own page, where none is given."""
    forms = _Forms(page).found
    return next(fields for address, fields in forms if address == action)


def filled(client: Client, page: str, action: str = "", **values: Any) -> dict[str, Any]:
    """What a browser would send of a page's form, with some fields filled in otherwise. None: not ticked."""
    answer = client.get(page)
    assert answer.status_code == 200, answer.status_code
    fields: dict[str, Any] = {**fields_of(answer.content.decode(), action), **values}
    fields.pop("described_by", None)
    return {name: value for name, value in fields.items() if value is not None}


def refused(answer: Any) -> dict[str, str]:
    """Fields of a form that was not taken, with what is wrong; those of the whole form are under "__all__"."""
    return {field: " ".join(map(str, errors)) for field, errors in answer.context["form"].errors.items()}
