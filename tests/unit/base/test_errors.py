"""Errors keep what they say on their way through a pool of processes."""

import copy
import pickle
import re
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import pytest

from mammometry.base import errors
from mammometry.base.errors import (
    BusyError,
    CrossingError,
    MammometryError,
    MeasureError,
    NotOfferedError,
    SessionError,
    UnknownWordError,
)

KINDS = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, MammometryError)]


def refused() -> None:
    raise CrossingError("left", found="a knot", expected="a curve", remedy="Draw", mesh_remedy="Scan")


@pytest.mark.parametrize("kind", KINDS)
def test_a_copy_says_the_same(kind: type[MammometryError]) -> None:
    error = kind("left", found="a knot", expected="a curve", remedy="Draw it again")
    error.page = Path("refused.html")
    for again in (pickle.loads(pickle.dumps(error)), copy.copy(error)):
        assert type(again) is kind
        assert (str(again), again.args, vars(again)) == (str(error), error.args, vars(error))


def test_a_refusal_comes_back_from_a_pool_of_processes() -> None:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool, pytest.raises(MeasureError) as raised:
        pool.submit(refused).result()
    assert raised.value.of_mesh().remedy == "Scan"


def test_every_kind_of_error_has_a_code_of_its_own() -> None:
    codes = [kind.code for kind in KINDS]
    assert len(set(codes)) == len(codes)
    assert all(re.fullmatch(r"[a-z]+(-[a-z]+)*", code) for code in codes)


def test_a_broken_rule_keeps_what_was_found() -> None:
    error = pickle.loads(pickle.dumps(UnknownWordError("skins are pale", "green")))
    assert (error.rule, error.found, str(error)) == ("skins are pale", "green", "skins are pale, found green")


def test_kinds_of_1_0_stay_where_a_class_became_several() -> None:
    assert BusyError.kind == "StorageError"
    assert NotOfferedError.kind == "ArchiveError"
    assert SessionError.kind == "SessionError"
