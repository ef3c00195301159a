"""All breasts of one subject, from their boundaries to their volumes with intervals."""

from __future__ import annotations

from collections.abc import Sequence

from mammometry.base.progress import Progress, no_progress
from mammometry.geometry.camera import Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.settings import MeasureSettings
from mammometry.measure.trunk.thorax import seen_skin
from mammometry.measure.volume import boundary_jitter, volume
from mammometry.measure.volume.uncertainty import EarlierErrors
from mammometry.measure.volume.unseen_space import Bound
from mammometry.measure.volume.volume import VolumeMeasurement
from mammometry.measure.wall import chest_wall
from mammometry.surface.repair import RepairedSurface


def measure_volumes(
    boundaries: Sequence[Boundary],
    surface: RepairedSurface,
    settings: MeasureSettings = MeasureSettings(),
    *,
    rig: Rig | None = None,
    back: TriangleMesh | None = None,
    views: Sequence[Bound] = (),
    earlier: EarlierErrors = EarlierErrors(),
    progress: Progress = no_progress,
) -> tuple[VolumeMeasurement, ...]:
    """Close every breast with every wall that fits it, the wanted one first, and measure it.

    Args:
        boundaries: one a breast.
        surface: the closed, repaired mesh, world frame, mm.
        settings: the wall, and what is not known of it.
        rig: the cameras, as for `chest_wall.fit`.
        back: the wall as it was measured by itself, mm, world frame.
        views: what the views say of where the subject is not (`room.bounds`), for the interval.
        earlier: the calibration's own errors, for the interval.
        progress: told the fraction done.

    Raises:
        MeasureError: the wanted wall does not fit, or skin and wall do not make a closed solid.
    """
    measured = []
    skin = None if all(boundary.name == "model" for boundary in boundaries) else seen_skin(surface)
    for number, boundary in enumerate(boundaries):
        wall, *others = chest_wall.fit_all(
            boundary, surface, settings, boundaries=boundaries, rig=rig, back=back, skin=skin
        )
        std_cc = None
        if boundary.name != "model":
            std_cc = boundary_jitter.boundary_std_cc(
                boundary, wall, surface, settings, boundaries=boundaries, rig=rig, back=back, skin=skin
            )
        measured.append(
            volume.measure(
                boundary,
                wall,
                settings,
                alternatives=others,
                surface=surface,
                views=views,
                earlier=earlier,
                boundary_std_cc=std_cc,
            )
        )
        progress((number + 1) / len(boundaries))
    return tuple(measured)
