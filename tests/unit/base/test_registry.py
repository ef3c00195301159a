"""A registry: entries by name, and one clear sentence for a name that is unknown."""

import sys

import pytest

from mammometry.base.errors import SessionError, SettingsError
from mammometry.base.registry import Registry


def fruits() -> Registry[str]:
    registry: Registry[str] = Registry("fruit")
    for name in ("pear", "apple"):
        registry.add(name)(name.upper())
    return registry


def test_entries_are_found_by_name_in_alphabetical_order():
    registry = fruits()
    assert dict(registry) == {"apple": "APPLE", "pear": "PEAR"}
    assert list(registry) == ["apple", "pear"]
    assert registry.find("pear", "basket") == "PEAR"
    assert registry.name_of(registry["apple"]) == "apple"
    with pytest.raises(LookupError, match="PLUM"):
        registry.name_of("PLUM")


def test_an_unknown_name_lists_the_known_ones_and_the_nearest():
    with pytest.raises(SettingsError) as caught:
        fruits().find("aple", "basket")
    assert str(caught.value) == (
        "basket: found 'aple', expected one of 'apple', 'pear'. 'apple' is the most similar. Choose a known fruit."
    )
    with pytest.raises(SessionError, match=r"^basket: .*'apple', 'pear'"):
        fruits().find(None, "basket", error=SessionError, remedy="Name one")


def test_a_short_table_of_entries_can_be_added_to():
    versions = Registry("version", entries={"mesh": 1})
    versions.add("area")(2)
    assert dict(versions) == {"area": 2, "mesh": 1}


def test_a_name_is_given_once():
    with pytest.raises(ValueError, match="'pear'"):
        fruits().add("pear")("another")


def test_modules_are_imported_when_an_entry_is_looked_up(tmp_path, monkeypatch):
    (tmp_path / "late_plum.py").write_text("import __main__\n__main__.late_fruits.add('plum')('PLUM')\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    registry: Registry[str] = Registry("fruit", modules=("late_plum",))
    monkeypatch.setattr(sys.modules["__main__"], "late_fruits", registry, raising=False)
    assert "late_plum" not in sys.modules
    assert registry["plum"] == "PLUM"
