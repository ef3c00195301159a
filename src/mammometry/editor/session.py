"""Drawing on a session or scan: its surface, and changed or confirmed items."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np

from mammometry.base.errors import MammometryError, SessionError, StorageError
from mammometry.base.machine.cores import one_blas_thread
from mammometry.editor.drawing import DrawingBoard, Handle, LiveVolume, drawing_board, handle_indices
from mammometry.editor.messages import Finish, Measure, Point, Save, Sketch
from mammometry.geometry import Array, Float64
from mammometry.io.drawn import BREASTS, DrawnBoundaries, origin_words, read_boundaries, read_landmarks
from mammometry.io.drawn_changes import Entry, Item, ItemChange, change_drawn, drawn_entries, drawn_entry, entry_digest
from mammometry.job.stages import measure
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.landmarks.landmarks import LANDMARKS
from mammometry.measure.trunk.body import rig_frame
from mammometry.measure.volume.attribution import curve_digest
from mammometry.measure.volume.measurement import VolumeMeasurement

if TYPE_CHECKING:
    from mammometry.api.job import Job

_LOG = logging.getLogger(__name__)
DRAWN, EDITED = "drawn by hand", "edited by hand"
_AUTOMATIC: Entry = {"method": "the automatic boundary"}
_FARTHEST_MM = 10_000.0  # from the surface: detects a wrong unit and prevents overflows
_LASTING = ("method", "author", "drawn")


class DrawingSession:
    """Drawing on a session or a scan. Its methods may be called from several threads."""

    def __init__(self, job: Job, subject: str | None = None) -> None:
        """Prepare the surface for drawing.

        Args:
            job: an open session or scan; its surface is computed if it is not current.
            subject: identifier of the subject, if it has one. Drawn files of another subject are refused.

        Raises:
            MammometryError: the surface cannot be computed, or the subject has no boundaries.
        """
        self.kind = job.inputs.subject_kind
        if not BREASTS[self.kind]:
            remedy = "Correct [subject] kind"
            expected = "a model or a torso, which have boundaries"
            raise SessionError("session.toml", found="an open surface", expected=expected, remedy=remedy)
        surface = job.surface().repaired
        self.job = job
        self.folder = job.folder
        self.subject = subject
        frame = rig_frame(job.rig, job.inputs.mounting)
        pool = ThreadPoolExecutor(1)  # the page is opened in parallel
        self._board = pool.submit(drawing_board, surface, frame, job.settings.measure)
        pool.shutdown(wait=False)
        self.low, self.high = surface.mesh.vertices.min(axis=0), surface.mesh.vertices.max(axis=0)
        self._automatic: dict[str, Boundary] | None = None
        self._remark = ""
        self._curves: dict[str, Float64[Array, "n 3"]] = {}
        self._origins: dict[str, Entry] = {}
        self._lock = Lock()

    @property
    def board(self) -> DrawingBoard:
        """The simplified surface. Waits until it is ready."""
        return self._board.result()

    def measured(self) -> dict[str, VolumeMeasurement]:
        """Breast → measurement with the drawing at opening. Empty if not current."""
        return {measured.name: measured for measured in self.job.plan.current(measure.measurements) or ()}

    def _proposed(self) -> dict[str, Any]:
        """Landmark → position proposed by the measurement. Empty if not current."""
        return {
            mark.name: mark.points_world.tolist()
            for mark in self.job.plan.current(measure.landmarks) or ()
            if mark.proposed and mark.probability >= self.job.settings.measure.nipple.least_probability
        }

    def state(self) -> dict[str, Any]:
        """State of the page as JSON: exact curves, their origin, and digests for saving.

        Raises:
            SessionError: a drawn file is invalid.
        """
        with self._lock:
            entries = drawn_entries(self.folder, self.kind, self.subject)
            marks = read_landmarks(self.folder, self.kind, self.subject)
            boundaries = self._boundaries(entries)
        proposed = self._proposed()
        for name, measurement in self.measured().items():
            boundaries[name]["measured"] = _as_json(_measured_live(measurement)) | {
                "of": curve_digest(measurement.boundary_world)
            }
        return {
            "breasts": list(BREASTS[self.kind]),
            "landmarks": [{"name": mark.name, "title": mark.title, "kind": mark.kind} for mark in LANDMARKS[self.kind]],
            "boundaries": boundaries,
            "places": {
                mark.name: {
                    "base": entry_digest(entries.get(("landmarks", mark.name))),
                    "points": marks[mark.name].tolist() if mark.name in marks else [],
                    "how": origin_words(entries.get(("landmarks", mark.name), {})),
                    "proposed": proposed.get(mark.name, []),
                }
                for mark in LANDMARKS[self.kind]
            },
            "remark": self._remark,
        }

    def live(self, sent: Measure) -> dict[str, Any]:
        """Volumes of the curves on the page, exact for curves that were already measured."""
        with self._lock:
            curves = {str(name): self._curve(name, sketch) for name, sketch in sent.boundaries.items()}
            known = {
                name: _measured_live(measurement)
                for name, measurement in self.measured().items()
                if name in curves and curve_digest(curves[name]) == curve_digest(measurement.boundary_world)
            }
            wanted = curves.keys() - known.keys()
            live = self.board.measure(curves, self._automatic, wanted) if wanted else {}
        return {name: _as_json(volume) for name, volume in (known | live).items()}

    def save(self, sent: Save) -> tuple[Path, ...]:
        """Save changes. Nothing else in the session changes.

        Raises:
            LateError: the same item was changed by someone else.
            MeasureError: the measurement would refuse the curve, for example because it crosses itself.
            SessionError: the message or a file is invalid.
            StorageError: the session cannot be written to.
        """
        moment = datetime.now(UTC)
        changes: dict[Item, ItemChange] = {}
        with self._lock:
            for name, change in sent.boundaries.items():
                entry = None if change.sketch is None else self._drawn(name, change.sketch, sent.author, moment)
                if entry is None:
                    _known(name, BREASTS[self.kind])
                changes["boundaries", name] = ItemChange(entry=entry, base=change.base)
            kinds = {mark.name: mark.kind for mark in LANDMARKS[self.kind]}
            for mark, place in sent.landmarks.items():
                _known(mark, kinds)
                entry = None
                if place.points is not None:
                    points = self._near(mark, place.points)
                    _count(mark, len(points), line=kinds[mark] == "line")
                    entry = drawn_entry(points, method="picked by hand", author=sent.author, moment=moment)
                changes["landmarks", mark] = ItemChange(entry=entry, base=place.base)
            return change_drawn(self.folder, self.kind, changes, subject=self.subject)

    def finish(self, sent: Finish) -> None:
        """Record that all boundaries were checked and are right.

        Raises:
            LateError: a boundary was changed by someone else.
            MeasureError: a curve crosses itself.
            SessionError: a boundary is not the one on the page, or was not checked.
            StorageError: the session cannot be written to.
        """
        with self._lock:
            entries = drawn_entries(self.folder, self.kind, self.subject)
            curves = self._shown(read_boundaries(self.folder, self.kind, self.subject))
            if {name: curve_digest(curve) for name, curve in curves.items()} != sent.curves:
                remedy = "Reload the page and check them"
                expected = "the curves in the session"
                raise SessionError(
                    "the boundaries", found="different curves from those on the page", expected=expected, remedy=remedy
                )
            moment = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
            changes: dict[Item, ItemChange] = {}
            for name, digest in sent.curves.items():
                self.board.check(name, curves[name])
                entry = entries.get(("boundaries", name))
                seen = {"confirmed": {"by": sent.author, "at": moment, "curve": digest}}
                changes["boundaries", name] = ItemChange(
                    entry={**(entry or {"automatic": True}), **seen}, base=entry_digest(entry)
                )
            change_drawn(self.folder, self.kind, changes, subject=self.subject)
            try:
                self.job.render_report()
            except StorageError as error:  # another run is in progress: the next one renders the report
                _LOG.warning("the report does not show the confirmation yet: %s", error)

    # --- curves ---

    def _boundaries(self, entries: Mapping[Item, Entry]) -> dict[str, dict[str, Any]]:
        drawn = read_boundaries(self.folder, self.kind, self.subject)
        curves = self._shown(drawn)
        states: dict[str, dict[str, Any]] = {}
        for name in BREASTS[self.kind]:
            entry = entries.get(("boundaries", name))
            if name in curves:
                states[name] = self._boundary_state(name, curves[name], entry, drawn)
            else:
                states[name] = {"base": entry_digest(entry), "how": "to be found automatically"}
        return states

    def _shown(self, drawn: DrawnBoundaries) -> dict[str, Float64[Array, "n 3"]]:
        """Breast → its boundary: the given one, otherwise the automatic one, if any."""
        curves = dict(drawn.curves)
        if not drawn.curves or drawn.automatic:
            names = drawn.automatic if drawn.curves else BREASTS[self.kind]
            curves |= {name: edge.points_world for name, edge in self._found().items() if name in names}
        return curves

    def _found(self) -> dict[str, Boundary]:
        """Automatic boundaries. Empty if they cannot be found. The page shows the reason."""
        if self._automatic is None:
            plan, given = self.job.plan, self.job.inputs.boundaries
            try:
                with one_blas_thread():
                    sides = plan.value(measure.sides)
                    boundaries = plan[measure.boundaries]() if sides is None else sides.boundaries
                automatic: dict[str, Boundary] = {
                    boundary.name: boundary for boundary in boundaries if boundary.name not in given
                }
                self._remark = ""
            except StorageError as error:  # another run may be in progress, but not for long
                self._remark = f"No automatic boundary: {error}"
                return {}
            except MammometryError as error:
                self._remark = f"No automatic boundary: {error}"
                automatic = {}
            self._automatic = automatic
        return self._automatic

    def _boundary_state(
        self, name: str, curve: Float64[Array, "n 3"], entry: Entry | None, drawn: DrawnBoundaries
    ) -> dict[str, Any]:
        digest = curve_digest(curve)
        automatic = name not in drawn.curves
        self._curves[digest] = curve
        if automatic or entry is None:
            self._origins[digest] = _AUTOMATIC
        else:
            self._origins[digest] = {key: entry[key] for key in (*_LASTING, "earlier") if key in entry}
        attribution = drawn.attributions.get(name)
        confirmation = None if attribution is None else attribution.confirmation
        how = (None if attribution is None else attribution.origin) or ("automatic" if automatic else "given")
        return {
            "base": entry_digest(entry),
            "of": digest,
            "curve": curve.tolist(),
            "handles": [{"point": curve[k].tolist(), "at": int(k)} for k in handle_indices(curve)],
            "automatic": automatic,
            "how": how,
            "confirmed": None
            if confirmation is None
            else {"by": confirmation.by, "at": confirmation.at, "holds": confirmation.holds(curve)},
        }

    def _curve(self, name: str, sketch: Sketch) -> Float64[Array, "n 3"]:
        """The exact curve of a sketch."""
        _known(name, BREASTS[self.kind])
        places = self._near(name, [handle.point for handle in sketch.handles])
        if sketch.of is None:
            return self.board.laid(places)
        if sketch.of not in self._curves:  # the page was loaded from another process or before a measurement
            self._boundaries(drawn_entries(self.folder, self.kind, self.subject))
        origin = self._curves.get(sketch.of)
        if origin is None or any(handle.at is not None and handle.at >= len(origin) for handle in sketch.handles):
            raise SessionError(
                f"boundary {name}",
                found="a change of a curve that is unknown to this server",
                expected="a change of a curve that the page has loaded",
                remedy="Load the page again",
            )
        handles = [Handle(point_world=at, at=sent.at) for at, sent in zip(places, sketch.handles, strict=True)]
        return self.board.edited(origin, handles)

    def _drawn(self, name: str, sketch: Sketch, author: str, moment: datetime) -> Entry:
        curve = self._curve(name, sketch)
        self.board.check(name, curve)
        origin = self._origins.get(sketch.of or "")
        kept = origin is not None and any(handle.at is not None for handle in sketch.handles)
        earlier: tuple[Entry, ...] = ()
        if kept and origin is not None:
            own = {key: origin[key] for key in _LASTING if key in origin} or {"method": "a given curve"}
            earlier = (*origin.get("earlier", ()), own)
        method = EDITED if kept else DRAWN
        return drawn_entry(curve, method=method, author=author, earlier=earlier, moment=moment)

    def _near(self, name: str, points: Iterable[Point]) -> Float64[Array, "n 3"]:
        places = np.array(list(points), dtype=np.float64)
        away = np.maximum(self.low - places, places - self.high).max()
        if away > _FARTHEST_MM:
            remedy = "Draw it again"
            expected = f"one on it, at most {_FARTHEST_MM / 1000:.0f} m away"
            raise SessionError(
                name, found=f"a point {away / 1000:.3g} m away from the surface", expected=expected, remedy=remedy
            )
        return places


def _known(name: str, names: Iterable[str]) -> None:
    allowed = list(names)
    if name not in allowed:
        raise SessionError(name, found="an unknown name", expected=f"one of {', '.join(allowed)}", remedy="Rename it")


def _count(name: str, count: int, *, line: bool) -> None:
    if (line and count < 2) or (not line and count != 1):
        remedy = "Draw it again"
        expected = "two or more along the line" if line else "one point"
        raise SessionError(name, found=f"{count} point{'' if count == 1 else 's'}", expected=expected, remedy=remedy)


def _measured_live(measurement: VolumeMeasurement) -> LiveVolume:
    return LiveVolume(
        curve_world=measurement.boundary_world,
        volume_cc=measurement.volume_cc,
        interval_cc=measurement.interval_cc,
        problem=None,
        preliminary=False,
    )


def _as_json(live: LiveVolume) -> dict[str, Any]:
    return {
        "curve": np.round(live.curve_world, 3).tolist(),
        "volumeCc": live.volume_cc,
        "intervalCc": live.interval_cc,
        "problem": live.problem,
        "crossings": np.round(live.crossings_world, 3).tolist(),
        "preliminary": live.preliminary,
    }
