"""Grooves inside a breast's border, as a hand or a strap on it makes them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mammometry.base.errors import MeasureError
from mammometry.base.value import value

if TYPE_CHECKING:
    from mammometry.measure.boundary.boundary import BreastName

_LEAST_CM2 = 2.0
"""Area of grooves inside a border from which something lies on the breast, cm². Of 38 bare breasts (8 virtual women, 6
shared bodies, 3 hanging; 17 scans of a telephone, 3 clean) one has 1.2, the others none. Eight hands on virtual women
have 3.6 to 36."""


@value
class Overlap:
    """Grooves inside the border of one breast."""

    name: BreastName
    """The patient's "left" or "right"."""
    groove_cm2: float
    """Area of the skin that lies in a groove, well inside the border, cm²."""

    @property
    def is_covered(self) -> bool:
        """Whether something lies on the breast."""
        return self.groove_cm2 > _LEAST_CM2

    @property
    def refusal(self) -> MeasureError:
        """Why such a breast has no volume: what lies on it changes the volume by an unknown part."""
        return MeasureError(
            f"breast {self.name!r}",
            found=f"something on it, such as a hand, an arm or a strap: {self.groove_cm2:.0f} cm² of the skin inside "
            "its border is a groove",
            expected="a bare breast, which has no grooves",
            remedy="Capture it again, bare. If it is bare (a deep scar is also a groove): --set "
            "measure.bare_confirmed=true",
        )
