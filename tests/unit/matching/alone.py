"""The foreground of one photograph alone, by its brightness and colour and by seeds that are given."""

from collections.abc import Sequence

import numpy as np

from mammometry.base.photograph import Photograph
from mammometry.matching.foreground.foreground import Foreground, blocks_of, estimate_foreground, subject_blocks
from mammometry.matching.foreground.seeded_segmentation import DepthSeeds
from mammometry.matching.settings import ForegroundSettings


def subject(
    photograph: Photograph, settings: ForegroundSettings = ForegroundSettings(), seeds: Sequence[DepthSeeds] = ()
) -> np.ndarray | None:
    """Its blocks."""
    return subject_blocks(photograph.name, blocks_of(photograph), settings, seeds)


def foreground(
    photograph: Photograph,
    camera: str,
    settings: ForegroundSettings = ForegroundSettings(),
    *,
    seeds: Sequence[DepthSeeds] = (),
) -> Foreground:
    """Its foreground; everything where nothing parts the subject from the rest."""
    return estimate_foreground(photograph, camera, settings, subject=subject(photograph, settings, seeds))
