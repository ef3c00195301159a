"""Grooves inside a breast's border, caused by a hand or a strap on it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mammometry.base.errors import MeasureError
from mammometry.base.value import value

if TYPE_CHECKING:
    from mammometry.measure.boundary.boundary import BreastName

_LEAST_CM2 = 2.0
"""Area of grooves inside a border that indicates an object on the breast, cm². One of 38 bare breasts (8 virtual
women, 6 shared bodies, 3 hanging; 17 scans of a telephone, 3 clean) has 1.2, the others none. Eight hands on virtual
women have 3.6 to 36."""


@value
class Overlap:
    """Grooves inside the border of one breast."""

    name: BreastName
    """The patient's ``left`` or ``right``."""
    groove_cm2: float
    """Area of grooves well inside the border, cm²."""

    @property
    def is_covered(self) -> bool:
        """Whether there is an object on the breast."""
        return self.groove_cm2 > _LEAST_CM2

    @property
    def refusal(self) -> MeasureError:
        """Error for such a breast: the object changes its volume by an unknown amount."""
        return MeasureError(
            f"breast {self.name!r}",
            found=f"something on it, such as a hand, an arm or a strap: {self.groove_cm2:.0f} cm² of the skin inside "
            "its border is a groove",
            expected="a bare breast, which has no grooves",
            remedy="Capture it again, bare. If it is bare (a deep scar is also a groove): --set "
            "measure.bare_confirmed=true",
        )
