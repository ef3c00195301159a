"""Codes by which measurements are named.

Codes of SNOMED CT and DICOM are those in PS3.16, as pydicom lists them. Everything else is in our own code system.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

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
"""The procedure. No code of SNOMED CT names it."""
WALL = Coded(value="wall", scheme=OWN_SCHEME, meaning="Wall behind the breast")
LOWER = Coded(value="lower-95", scheme=OWN_SCHEME, meaning="Lower limit of the 95 % interval")
UPPER = Coded(value="upper-95", scheme=OWN_SCHEME, meaning="Upper limit of the 95 % interval")
SIGMA = Coded(value="standard-uncertainty", scheme=OWN_SCHEME, meaning="Standard uncertainty")
NO_VOLUME = Coded(value="no-volume", scheme=OWN_SCHEME, meaning="Why there is no volume")


def own(code: str, meaning: str) -> Coded:
    """Return a concept of our own code system. DICOM allows 64 characters of meaning."""
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
    }
)
"""Code of a method in our system → what it is."""
NO_VOLUMES = MappingProxyType(
    {
        "none": "No breast on this side",
        "unclear": "It is unclear whether this is a breast",
        "refused": "The volume was refused",
    }
)
"""Code of a reason in our system → what it is."""
OPERATIONS: Mapping[str, Coded | None] = MappingProxyType(
    {
        "mastectomy": Coded(value="5884001", scheme="SCT", meaning="Mastectomy"),
        "conserving": None,  # a lumpectomy is one way among several
        "expander": None,
        "filling": None,
        "implant": Coded(value="302343007", scheme="SCT", meaning="Insertion of prosthesis for breast"),
        "flap": Coded(value="33496007", scheme="SCT", meaning="Reconstruction of breast"),
        "graft": None,
        "reduction": None,  # or a lift, which is no reduction
        "augmentation": Coded(value="22890008", scheme="SCT", meaning="Augmentation mammoplasty"),
        "other": None,
    }
)
"""Kind of operation → its concept. None: PS3.16 has none that says as much and no more."""
