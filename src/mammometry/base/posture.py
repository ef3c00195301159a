"""How the patient held herself. Volumes of different postures are not to be compared."""

from __future__ import annotations

from typing import Literal, TypeAlias, get_args

Posture: TypeAlias = Literal["leaning", "standing", "lying"]
"""As a clinic's visit names them."""
POSTURES: tuple[Posture, ...] = get_args(Posture)
NOT_TO_BE_COMPARED = "Volumes of different postures are not to be compared"
