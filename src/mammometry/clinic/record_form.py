"""Forms of records, which prevent two people from overwriting each other's changes.

A page's form contains the version of its record: a digest of each field as shown. When the form is submitted, it is
compared with the current record, under the lock for saving. If another person has saved in between and the two differ,
nothing is saved: `StaleRecord` is raised, and `web.access.guarded` answers with a page of both versions, field by
field. This applies to every form of the clinic.
"""

import hashlib
import json
from dataclasses import dataclass
from typing import Any, ClassVar, cast

from django import forms
from django.db.models import Model
from django.http import Http404, QueryDict

VERSION = "record_version"
"""Name of the hidden field with the digests."""
CHOICE = "choice-"
"""Prefix of the field with the choice for a record's field: `MINE`, `THEIRS` or `BOTH`."""
TO_CHOOSE = "to-choose"
"""Name of the hidden fields that list the fields with a choice."""
MINE, THEIRS, BOTH = "mine", "theirs", "both"
_DIGEST_CHARACTERS = 16  # 64 bits, so that different values practically never have the same digest
_Sent = tuple[str, ...]
"""A field's value as a browser sends it. Empty: nothing was entered."""


class StaleRecord(Exception):  # an answer like Http404, not an error
    """Another person has saved the record since the page was opened."""

    def __init__(self, form: "RecordForm") -> None:
        super().__init__("the record was changed meanwhile")
        self.form = form


@dataclass(frozen=True, slots=True)
class Difference:
    """A field that differs between a form and its record."""

    name: str
    label: str
    mine: str | None
    """Value as text. None: the form does not show this field, so there is no choice."""
    theirs: str
    proposed: str
    """`MINE` or `THEIRS`. Empty: both have changed the field, so the user must choose."""
    joinable: bool
    """Whether both texts can be kept, one below the other."""


class RecordForm(forms.ModelForm):  # type: ignore[type-arg]
    """A form of a new or existing record that refuses to overwrite another person's change.

    The existing record is read again and locked when the form is submitted. So a view runs in a transaction, and saves
    `instance` instead of the row that it passed.
    """

    watched: ClassVar[tuple[str, ...]] = ()
    """Fields that the form does not show but that saving replaces."""

    record_version = forms.CharField(required=False, widget=forms.HiddenInput)

    def __init__(self, data: Any = None, files: Any = None, *args: Any, **kwargs: Any) -> None:
        instance = kwargs.get("instance")
        known = instance is not None and not instance._state.adding
        if data is not None and instance is not None and known:
            kwargs["instance"] = _locked(instance)
        super().__init__(data, files, *args, **kwargs)
        self.differences: tuple[Difference, ...] = ()
        self._now = {name: self._as_now(name) for name in self._versioned}
        now = {name: _digest(sent) for name, sent in self._now.items()}
        now |= {name: _digest((str(getattr(self.instance, name)),)) for name in self.watched}
        self.version = json.dumps(now, sort_keys=True)
        """Current version of the record."""
        self.fields[VERSION].initial = self.version
        if self.is_bound and known:
            self._compare(now)

    @property
    def _versioned(self) -> list[str]:
        of_record = [name for name in self._meta.fields or () if name in self.fields]
        return [name for name in of_record if not isinstance(self.fields[name], forms.FileField)]

    def is_valid(self) -> bool:
        """Whether the form can be saved.

        Raises:
            StaleRecord: another person has saved the record, and the two differ.
        """
        if self.differences:
            raise StaleRecord(self)
        return super().is_valid()

    @property
    def kept(self) -> list[tuple[str, str]]:
        """Names and values of all submitted fields, which the page of both versions sends again."""
        own = {VERSION, TO_CHOOSE, "csrfmiddlewaretoken", "form_token"}
        names = [name for name in self._sent_back if name not in own and not name.startswith(CHOICE)]
        return [(name, str(value)) for name in names for value in self._sent_back.getlist(name)]

    @property
    def sent_files(self) -> list[str]:
        """Labels of the file fields, whose files no page can send again."""
        return [str(self[name].label) for name in self.fields if self.add_prefix(name) in self.files]

    @property
    def _sent_back(self) -> QueryDict:
        return cast(QueryDict, self.data)

    def _compare(self, now: dict[str, str]) -> None:
        shown = _read_version(self.data.get(VERSION, ""))
        to_answer = map(str, self._sent_back.getlist(TO_CHOOSE))
        unanswered = {name for name in to_answer if self.data.get(f"{CHOICE}{name}") not in (MINE, THEIRS, BOTH)}
        mine = {name: self._as_sent(name) for name in self._versioned}
        self._choose(mine)
        changed = {name for name, digest in now.items() if shown.get(name) != digest} | unanswered
        if not changed:
            return
        rows = []
        for name in self._versioned:
            if mine[name] == self._now[name]:
                continue
            by_me = shown.get(name) != _digest(mine[name])
            by_them = name in changed
            proposed = THEIRS if not by_me else MINE if not by_them else ""
            rows.append(self._difference(name, mine[name], proposed))
        for name in self.watched:
            if name in changed:
                value = getattr(self.instance, name)
                rows.append(
                    Difference(name, _label(self, name), None, str(getattr(value, "name", value)), THEIRS, False)
                )
        self.differences = tuple(rows)

    def _choose(self, mine: dict[str, _Sent]) -> None:
        """Apply the choices made on the page of both versions."""
        chosen = {name: self.data.get(f"{CHOICE}{name}") for name in self._versioned}
        if not {THEIRS, BOTH} & set(chosen.values()):
            return
        data = self._sent_back.copy()
        for name, choice in chosen.items():
            if choice == BOTH and self._is_joinable(name):
                mine[name] = ("\n".join((*self._now[name], *mine[name])),)
            elif choice == THEIRS:
                mine[name] = self._now[name]
            else:
                continue
            data.setlist(self.add_prefix(name), list(mine[name]))
        self.data = data

    def _difference(self, name: str, mine: _Sent, proposed: str) -> Difference:
        field = self.fields[name]
        label = str(self[name].label)
        joinable = self._is_joinable(name) and bool(mine) and bool(self._now[name])
        return Difference(name, label, _words(field, mine), _words(field, self._now[name]), proposed, joinable)

    def _is_joinable(self, name: str) -> bool:
        return isinstance(self.fields[name].widget, forms.Textarea)

    def _as_now(self, name: str) -> _Sent:
        field = self.fields[name]
        return _sent(field, self.get_initial_for_field(field, name))

    def _as_sent(self, name: str) -> _Sent:
        field = self.fields[name]
        raw = field.widget.value_from_datadict(self.data, self.files, self.add_prefix(name))
        try:
            value = field.to_python(raw)
        except forms.ValidationError:
            value = raw
        return _sent(field, value)


def _locked(instance: Model) -> Model:
    """The current record, locked until the transaction ends.

    Raises:
        Http404: it no longer exists.
    """
    row = type(instance)._base_manager.select_for_update().filter(pk=instance.pk).first()
    if row is None:
        raise Http404
    return row


def _sent(field: forms.Field, value: Any) -> _Sent:
    """A value as a browser sends it, with uniform line endings and without surrounding spaces."""
    value = field.prepare_value(value)
    if isinstance(value, list | tuple):
        return tuple(sorted(map(str, value)))
    if isinstance(field.widget, forms.CheckboxInput):
        return ("on",) if value else ()
    if not isinstance(field.widget, forms.widgets.ChoiceWidget) and value is not None:
        value = field.widget.format_value(value)
    text = "" if value is None else str(value).replace("\r\n", "\n").strip()
    return (text,) if text else ()


def _words(field: forms.Field, sent: _Sent) -> str:
    """A submitted value as text for a page."""
    if isinstance(field.widget, forms.CheckboxInput):
        return "yes" if sent else "no"
    choices = {str(value): str(label) for value, label in getattr(field, "choices", ())}
    words = ", ".join(choices.get(text, text) for text in sent)
    return words.replace("T", " ") if isinstance(field, forms.DateTimeField) else words


def _label(form: RecordForm, name: str) -> str:
    model = form._meta.model
    assert model is not None
    words = str(model._meta.get_field(name).verbose_name)
    return words[:1].upper() + words[1:]


def _digest(sent: _Sent) -> str:
    return hashlib.sha256(json.dumps(sent).encode()).hexdigest()[:_DIGEST_CHARACTERS]


def _read_version(text: str) -> dict[str, str]:
    """Name of a field → digest of its shown value. Empty if the page sent no version."""
    try:
        read = json.loads(text)
    except ValueError:
        return {}
    return {str(name): str(digest) for name, digest in read.items()} if isinstance(read, dict) else {}
