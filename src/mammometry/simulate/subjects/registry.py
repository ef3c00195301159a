"""Registry of virtual subjects by family. A new family is one file in this folder and one line here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

from mammometry.base.errors import UnknownWordError
from mammometry.base.registry import Registry

if TYPE_CHECKING:
    from mammometry.simulate.subjects.solid import SubjectSolid
    from mammometry.simulate.subjects.user_mesh import MeshFile


@dataclass(frozen=True, slots=True, kw_only=True)
class SubjectRequest:
    """The user's choice of a subject."""

    name: str
    """Name on the command line: ``plaster_5``, or the path of a mesh."""
    seed: int
    """Seed of a random shape."""
    edge_mm: float
    """Approximate longest edge."""
    mesh_file: MeshFile | None = None
    """How to read a mesh file. None for a built-in subject."""
    reshape: Callable[[Any], Any] | None = None
    """Change of a random shape before the subject is made: an operation. Only torsos can be reshaped."""


MakeSubject: TypeAlias = "Callable[[SubjectRequest], SubjectSolid]"
"""Function that makes a subject. A ValueError means that the name is invalid, such as ``plaster_12``."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SubjectFamily:
    """Subjects that are made by one function."""

    make: MakeSubject
    has: Callable[[str], bool]
    """Whether a name belongs to this family."""
    choices: str
    """Names of its subjects, for messages."""
    has_patients: bool = False
    """Whether its subjects can be reshaped."""


SUBJECTS: Registry[SubjectFamily] = Registry(
    "virtual subject",
    modules=(
        "mammometry.simulate.subjects.artefacts",
        "mammometry.simulate.subjects.plaster",
        "mammometry.simulate.subjects.shapes",
        "mammometry.simulate.subjects.torso",
        "mammometry.simulate.subjects.user_mesh",
        "mammometry.simulate.subjects.woman",
    ),
)
"""Name of a family → its subjects."""


def add_subject(
    family: str, *, has: Callable[[str], bool] | None = None, choices: str | None = None, has_patients: bool = False
) -> Callable[[MakeSubject], MakeSubject]:
    """Decorate a function that makes subjects to register it as a family.

    Args:
        family: name of the family.
        has: whether a name belongs to the family. None: only the family's own name does.
        choices: names of its subjects, for messages. None: the family's name.
        has_patients: whether its subjects can be reshaped.
    """

    def enter(make: MakeSubject) -> MakeSubject:
        SUBJECTS.add(family)(
            SubjectFamily(
                make=make,
                has=has or (lambda name: name == family),
                choices=choices or family,
                has_patients=has_patients,
            )
        )
        return make

    return enter


def numbered(family: str) -> Callable[[str], bool]:
    """Test for names such as ``torso`` and ``torso_2``."""
    return lambda name: name.partition("_")[0] == family


def make_subject(
    name: str,
    seed: int,
    *,
    edge_mm: float = 0.7,
    mesh_file: MeshFile | None = None,
    reshape: Callable[[Any], Any] | None = None,
) -> SubjectSolid:
    """Make a subject by name.

    Args:
        name: name of a subject in one of the families of `SUBJECTS`, or the path of a mesh.
        seed: seed of a random shape.
        edge_mm: approximate longest edge.
        mesh_file: how to read a mesh. Its unit has no default.
        reshape: changes a torso's random shape before it is made.

    Raises:
        ValueError: the name is unknown, or the subject cannot be reshaped.
        SessionError: the mesh is unusable, or its unit is not given.
    """
    for family in SUBJECTS.values():
        if family.has(name):
            wanted = SubjectRequest(name=name, seed=seed, edge_mm=edge_mm, mesh_file=mesh_file, reshape=reshape)
            if reshape is not None and not family.has_patients:
                raise UnknownWordError("only torsos have postures and patients' disturbances", f"subject {name!r}")
            return family.make(wanted)
    choices = ", ".join(family.choices for family in SUBJECTS.values())
    raise UnknownWordError(f"subjects are {choices}", f"{name!r}")
