"""Codes, identifiers and texts for DICOM and FHIR."""

import hashlib
import re
import unicodedata
import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, TypeAlias

from mammometry.base.errors import MammometryError, SettingsError
from mammometry.base.letters import UNREADABLE, name_fault

OWN_SCHEME = "99MAMMOMETRY"
"""Designator in DICOM. PS3.16, 8.2: private schemes begin with 99."""
OWN_SYSTEM = "urn:mammometry:measurements"
"""Our code system in FHIR."""
SCT_SYSTEM = "http://snomed.info/sct"
UCUM_SYSTEM = "http://unitsofmeasure.org"


@dataclass(frozen=True, slots=True, kw_only=True)
class Coded:
    """One coded concept."""

    value: str
    scheme: str
    """DICOM's designator: SCT, DCM, UCUM or ours."""
    meaning: str


VOLUME = Coded(value="118565006", scheme="SCT", meaning="Volume")
AREA = Coded(value="42798000", scheme="SCT", meaning="Area")
LENGTH = Coded(value="410668003", scheme="SCT", meaning="Length")
BREAST = Coded(value="76752008", scheme="SCT", meaning="Breast")
METHOD = Coded(value="370129005", scheme="SCT", meaning="Measurement Method")
SIDES = MappingProxyType(
    {
        "left": Coded(value="7771000", scheme="SCT", meaning="Left"),
        "right": Coded(value="24028007", scheme="SCT", meaning="Right"),
    }
)
SITES = MappingProxyType(
    {
        "left": Coded(value="80248007", scheme="SCT", meaning="Left breast structure"),
        "right": Coded(value="73056007", scheme="SCT", meaning="Right breast structure"),
    }
)
CONCLUSIONS = Coded(value="121076", scheme="DCM", meaning="Conclusions")
CONCLUSION = Coded(value="121077", scheme="DCM", meaning="Conclusion")
PERSON = Coded(value="121008", scheme="DCM", meaning="Person Observer Name")
UNITS = MappingProxyType(
    {
        "cm3": Coded(value="cm3", scheme="UCUM", meaning="cubic centimeter"),
        "cm2": Coded(value="cm2", scheme="UCUM", meaning="square centimeter"),
        "mm": Coded(value="mm", scheme="UCUM", meaning="millimeter"),
    }
)
KINDS = MappingProxyType({"cm3": VOLUME, "cm2": AREA, "mm": LENGTH})
"""Unit → what SNOMED CT calls a quantity of that unit."""
PHOTOGRAMMETRY = Coded(value="stereophotogrammetry", scheme=OWN_SCHEME, meaning="Stereophotogrammetry of the breasts")
"""The procedure, which has no code in SNOMED CT."""
WALL = Coded(value="wall", scheme=OWN_SCHEME, meaning="Wall behind the breast")
LOWER = Coded(value="lower-95", scheme=OWN_SCHEME, meaning="Lower limit of the 95 % interval")
UPPER = Coded(value="upper-95", scheme=OWN_SCHEME, meaning="Upper limit of the 95 % interval")
SIGMA = Coded(value="standard-uncertainty", scheme=OWN_SCHEME, meaning="Standard uncertainty")
NO_VOLUME = Coded(value="no-volume", scheme=OWN_SCHEME, meaning="Why there is no volume")


def own(code: str, meaning: str) -> Coded:
    """Return a concept of our own code system. DICOM allows 64 characters for the meaning."""
    return Coded(value=code, scheme=OWN_SCHEME, meaning=meaning[:64])


METHODS = MappingProxyType(
    {
        "closed-mesh": "Volume of a closed mesh, divergence theorem",
        "level-cut": "Closed mesh cut at the level of the nipple",
        "mesh-area": "Area of a mesh",
        "plane-distance": "Greatest distance from the boundary's best plane",
        "extent": "Straight distance between the outermost points of the boundary",
        "straight": "Straight distance between two landmarks",
        "along-skin": "Distance along the skin between two landmarks",
        "height": "Difference in height",
        "difference": "Left volume less right volume; shared errors cancel",
    }
)
"""Code of a method in our system → its meaning."""
_BASE_WIDTH = "From the breast's medial to its lateral landmark"
DEFINITIONS = MappingProxyType(
    {
        "base_width_straight": f"{_BASE_WIDTH}: straight, as measured by callipers",
        "base_width_along_skin": f"{_BASE_WIDTH}: along the skin",
        "boundary_width": "Extent of the whole boundary from side to side, straight. Not the base width",
        "boundary_height": "Extent of the whole boundary from its lowest to its highest point, straight",
    }
)
"""Code of a quantity that could be confused with another → its definition."""
NO_VOLUMES = MappingProxyType(
    {
        "none": "No breast on this side",
        "unclear": "It is unclear whether this is a breast",
        "refused": "The volume was refused",
    }
)
"""Code of a reason in our system → its meaning."""
OPERATIONS: Mapping[str, Coded | None] = MappingProxyType(
    {
        "mastectomy": Coded(value="5884001", scheme="SCT", meaning="Mastectomy"),
        "conserving": None,  # a lumpectomy is one of several kinds
        "expander": None,
        "filling": None,
        "implant": Coded(value="302343007", scheme="SCT", meaning="Insertion of prosthesis for breast"),
        "flap": Coded(value="33496007", scheme="SCT", meaning="Reconstruction of breast"),
        "graft": None,
        "reduction": None,  # or a lift, which is not a reduction
        "augmentation": Coded(value="22890008", scheme="SCT", meaning="Augmentation mammoplasty"),
        "other": None,
    }
)
"""Kind of operation → its concept. None: PS3.16 has no equivalent one."""


_NAMESPACE = uuid.UUID("6d616d6d-6f6d-5574-8279-646963006f6d")  # random; never change it


def identifier(*parts: str) -> str:
    """Return a UUID derived from a text."""
    return str(_uuid(parts))


def uid(*parts: str) -> str:
    """Return a DICOM UID derived from a text, under 2.25, the root for UUIDs (PS3.5, B.2)."""
    return f"2.25.{_uuid(parts).int}"


def _uuid(parts: tuple[str, ...]) -> uuid.UUID:
    return uuid.uuid5(_NAMESPACE, hashlib.sha256("\0".join(parts).encode()).hexdigest())


Representation: TypeAlias = Literal["AE", "LO", "PN", "SH", "UI", "UT"]
"""Application's title, long string, person's name, short string, unique identifier, unlimited text."""
_LONGEST: Mapping[Representation, int] = {"AE": 16, "LO": 64, "PN": 64, "SH": 16, "UI": 64}
"""Characters; of a name, in each of its groups."""
_MOST_GROUPS, _MOST_PARTS = 3, 5  # separators of a name: = between groups, ^ between their parts
_UID = re.compile(r"(0|[1-9][0-9]*)(\.(0|[1-9][0-9]*))*", re.ASCII)
_LINES = "\t\n\f\r"  # control characters of a text of several lines
_ALLOWED: Mapping[Representation, str] = {
    "AE": "1 to 16 letters of ASCII without backslash",
    "LO": "at most 64 letters, no backslash and no invisible character",
    "PN": "at most 64 letters in each of at most 3 groups (=) of at most 5 parts (^), no backslash and no invisible "
    "character",
    "SH": "at most 16 letters, no backslash and no invisible character",
    "UI": "numbers with points between them, at most 64 letters, such as 1.2.840.113619",
    "UT": "text without control characters",
}


def text_fault(text: str, representation: Representation) -> tuple[str, str] | None:
    """Return the fault of a text, and what is allowed. None if it is allowed.

    Args:
        text: of one field. Empty text is allowed, except for an application's title.
        representation: of that field.
    """
    fault = _fault(text, representation)
    return None if fault is None else (fault, _ALLOWED[representation])


def require_text(
    text: str,
    representation: Representation,
    field: str,
    *,
    remedy: str = "Correct it",
    refusal: type[MammometryError] = SettingsError,
) -> str:
    """Return the text if DICOM allows it in this field.

    Raises:
        MammometryError: `refusal`; DICOM does not allow it.
    """
    if (fault := text_fault(text, representation)) is not None:
        found, allowed = fault
        raise refusal(field, found=found, expected=allowed, remedy=remedy)
    return text


def _fault(text: str, representation: Representation) -> str | None:
    if representation == "UT":
        return _fault_of_lines(text)
    if (fault := name_fault(text)) is not None:
        return fault
    if "\\" in text:
        return f"a backslash at position {text.index(chr(92)) + 1}"
    if representation == "AE" and not (text.strip() and text.isascii()):
        return "non-ASCII letters" if text.strip() else "no title"
    if representation == "UI" and text and not _UID.fullmatch(text):
        return "not a unique identifier"
    groups = text.split("=") if representation == "PN" else [text]
    if len(groups) > _MOST_GROUPS:
        return f"{len(groups)} groups"
    if (parts := max(group.count("^") + 1 for group in groups)) > _MOST_PARTS and representation == "PN":
        return f"{parts} parts in a group"
    longest = max(map(len, groups))
    return f"{longest} letters" if longest > _LONGEST[representation] else None


def _fault_of_lines(text: str) -> str | None:
    for place, letter in enumerate(text, 1):
        category = unicodedata.category(letter)
        if category == "Cs" or letter == UNREADABLE:
            return f"a byte at position {place} that is not valid UTF-8"
        if category in ("Cc", "Zl", "Zp") and letter not in _LINES:
            return f"a control character at position {place}"
    return None
