"""One date of a comparison: a session of photographs, or the scan of another device."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mammometry.api.job import open_session
from mammometry.base.errors import SessionError
from mammometry.base.identity import Identity
from mammometry.base.notices import Notice
from mammometry.geometry.arrays import Array, Float64
from mammometry.io.meshes.scans import is_scan
from mammometry.io.results.store import Store, Watch
from mammometry.job.graph import Plan
from mammometry.job.inputs import FinishedSurface, Inputs
from mammometry.job.stages import calibrate, measure, surface
from mammometry.settings import Settings

if TYPE_CHECKING:
    from mammometry.geometry.camera import Rig


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Dated:
    """A measured torso at one date."""

    path: Path
    """Its folder."""
    date: datetime.date | None
    """None where its folder gives none."""
    posture: str
    """``standing``, ``leaning`` or ``lying``. Empty: nobody said."""
    identity: Identity
    brought: tuple[Path, ...]
    """Files and folders in it that are not ours."""
    inputs: Inputs
    settings: Settings
    store: Store
    plan: Plan
    """Its products, those of the measurement at least."""
    finished: Callable[[], FinishedSurface]
    """Gives the surface with its colours."""
    rig: Callable[[], Rig]
    """Gives the cameras, or a scan's viewer."""
    ensure: Callable[[], object]
    """Measures it where its results are not current."""
    page_digest: Callable[[bool], str]
    """Digest of all that its report shows; given True, without names."""

    @property
    def results(self) -> Path:
        """The folder of its results."""
        return self.store.folder

    @property
    def pictures(self) -> frozenset[str]:
        """Digests of its photographs, or of its mesh."""
        names = [f"capture/{camera}" for camera in self.inputs.photographs] or ["mesh"]
        return frozenset(self.inputs.digests[name] for name in names)

    @property
    def has_own_scale(self) -> bool:
        """Whether its scale comes from a target that it brought."""
        return "target" in self.inputs.digests and self.inputs.cameras is None

    def frame(self) -> Float64[Array, "3 3"]:
        """Rows: the patient's left, the head, straight ahead. World frame."""
        from mammometry.report.figures.shading import front_of

        return front_of(self.rig(), self.plan.value(measure.body))


def open_dated(path: Path | str, settings: Settings, watch: Watch) -> Dated:
    """Open a session's or an imported scan's folder.

    Raises:
        SessionError: the folder is not as documented.
        MeasureError: a scan's mesh is no surface to be measured.
    """
    folder = Path(path)
    return _scan(folder, settings, watch) if is_scan(folder) else _session(folder, settings, watch)


def check_posture(before: Dated, after: Dated) -> None:
    """Refuse dates of two postures.

    Raises:
        SessionError: names both folders and postures.
    """
    if before.posture and after.posture and before.posture != after.posture:
        raise SessionError(
            f"{before.path}, {after.path}",
            found=f"the patient {before.posture} at one date and {after.posture} at the other",
            expected="one posture, since volumes of different ones are not to be compared",
            remedy="Compare dates of one posture, or add --set compare.other_posture=true",
        )


def posture_warnings(before: Dated, after: Dated) -> Iterator[Notice]:
    """Yield a warning where the postures differ, or one alone is known."""
    if before.posture != after.posture:
        earlier, later = (posture or "in a posture that was not given" for posture in (before.posture, after.posture))
        yield Notice(code="postures-differ", values={"before": earlier, "after": later})


def measured_keys(path: Path | str, settings: Settings) -> tuple[str, ...]:
    """Digests of the products that a folder's measurement has with these settings.

    Raises:
        SessionError: the folder is not as documented.
    """
    folder = Path(path)
    if not is_scan(folder):
        return tuple(key.digest for key in open_session(folder, settings).keys("measure"))
    from mammometry.api.scan_folders import open_scan

    return tuple(product.key.digest for product in open_scan(folder, settings).plan.products())


def _session(folder: Path, settings: Settings, watch: Watch) -> Dated:
    job = open_session(folder, settings, watch=watch)
    return Dated(
        path=job.session.path,
        date=job.session.manifest.date,
        posture=job.session.manifest.subject.patient_posture,
        identity=job.identity,
        brought=tuple(job.session.brought),
        inputs=job.inputs,
        settings=job.settings,
        store=job.store,
        plan=job.plan,
        finished=job.plan[surface.mesh],
        rig=lambda: job.plan[calibrate.cameras]().rig,
        ensure=lambda: job.ensure("measure", drawn=False),
        page_digest=lambda deidentify: job.page_digest(deidentify=deidentify),
    )


def _scan(folder: Path, settings: Settings, watch: Watch) -> Dated:
    from mammometry.api.scan_folders import open_scan

    job = open_scan(folder, settings, watch=watch)
    job.require_sides()
    return Dated(
        path=folder,
        date=None,
        posture=job.posture,
        identity=job.identity,
        brought=(job.files.mesh,),
        inputs=job.inputs,
        settings=job.settings,
        store=job.store,
        plan=job.plan,
        finished=lambda: job.finished,
        rig=lambda: job.rig,
        ensure=lambda: job.run(report=False),
        page_digest=lambda deidentify: job.page_digest(deidentify=deidentify),
    )
