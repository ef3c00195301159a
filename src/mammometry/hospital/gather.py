"""Gather the exported content of a finished session."""

from __future__ import annotations

import datetime
import hashlib
import json
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from mammometry.base.listing import visible
from mammometry.base.notices import words_of
from mammometry.hospital.exported import Absent, CoveredModel, CoveredModels, Exported, ExportedMesh, Quantity, Side
from mammometry.io.photographs.images import EXTENSIONS
from mammometry.job.stages import measure, surface
from mammometry.measure.volume.attribution import Attribution
from mammometry.measure.volume.difference import difference
from mammometry.report.content import Clinical, Signed
from mammometry.report.warnings import scan_warnings, session_warnings
from mammometry.report.words.anthropometry import quantities_of

if TYPE_CHECKING:
    from mammometry.api.job import Job
    from mammometry.geometry.mesh import TriangleMesh
    from mammometry.job.graph import Plan
    from mammometry.measure.boundary.breasts import NoBreast
    from mammometry.measure.shape.anthropometry import Dimensions
    from mammometry.measure.volume.measurement import VolumeMeasurement
    from mammometry.surface.texture.texture_atlas import Atlas

Part: TypeAlias = Literal["pdf", "models", "photographs"]
"""Parts that may be gathered in addition to the numbers."""
PARTS: tuple[Part, ...] = ("pdf", "models", "photographs")
_TITLES = {"left": "Left breast, closed", "right": "Right breast, closed", "model": "Model, closed"}
_WHOLE = "Whole surface"
_MTL, _JPEG = "model.mtl", "model.jpg"


def gather(
    job: Job,
    *,
    taken: datetime.date | None = None,
    clinical: Clinical | None = None,
    deidentify: bool = False,
    parts: Sequence[Part] = PARTS,
) -> Exported:
    """The exported content. Stale results are computed first.

    A scan has no photographs, and no report without names: its pictures show the skin.

    Args:
        job: an open session or scan.
        taken: day of a session or scan that gives none.
        clinical: a clinic's data on the visit. None: confirmations in the session's own boundaries.json count.
        deidentify: leave out names, dates, photographs and photographic colours.
        parts: in addition to the numbers.

    Raises:
        MammometryError: the content cannot be made.
    """
    import mammometry

    job.require_sides()
    plain = "pdf" in parts and not deidentify
    job.ensure("report" if plain else "measure")
    made = job.made_at("report" if plain else "measure")
    measured = tuple(job.measure().values())
    known = clinical or Clinical(confirmed=confirmed(job.inputs.attributions, measured))
    models = "models" in parts
    atlas = job.plan.value(surface.model) if models else None
    shown = "photographs" in parts and not deidentify
    of_photographs = bool(job.inputs.photographs)
    warned = (
        session_warnings(job.plan, job.settings.measure) if of_photographs else scan_warnings(job.plan, job.notices)
    )
    return Exported(
        subject="" if deidentify else job.identity.title,
        kind=job.inputs.subject_kind,
        taken=None if deidentify else job.date or taken,
        made=None if deidentify or made is None else datetime.datetime.fromisoformat(made),
        software=mammometry.__version__,
        source=_source(job, deidentify),
        quantities=tuple(quantity.rounded() for quantity in quantities(measured, job.plan)),
        absent=tuple(_absent(side) for side in job.plan.value(measure.absent) or ()),
        notices=warned,
        report_pdf=_report(job, clinical, deidentify) if plain or ("pdf" in parts and job.inputs.photographs) else None,
        models=tuple(_models(measured, job.surface().repaired.mesh if atlas is None else atlas.mesh)) if models else (),
        covered=None if atlas is None or deidentify else covered(atlas, measured),
        photographs=job.inputs.photographs if shown else {},
        photograph_files=_photograph_files(job) if shown and job.inputs.photographs else {},
        deidentified=deidentify,
        clinical=Clinical() if deidentify else known,
    )


def confirmed(attributions: Mapping[str, Attribution], measured: Sequence[VolumeMeasurement]) -> Signed | None:
    """The newest confirmation, if every measured boundary has a valid one."""
    signed = {
        measurement.name: attributions.get(measurement.name, Attribution()).confirmation for measurement in measured
    }
    holding = [
        confirmation
        for measurement in measured
        if (confirmation := signed[measurement.name]) is not None and confirmation.holds(measurement.boundary_world)
    ]
    if not measured or len(holding) < len(measured):
        return None
    newest = max(holding, key=lambda confirmation: confirmation.at)
    return Signed(by=newest.by, at=datetime.datetime.fromisoformat(newest.at))


def _document(job: Job) -> bytes:
    """The stored report."""
    from mammometry.report.documents.pdf import DOCUMENT

    return job.store.files(job.report_key)[DOCUMENT]


def _shapes(measured: Sequence[VolumeMeasurement], kind: str) -> str:
    """Digest of only the measured solids."""
    solids = [stl(measurement.closed) for measurement in measured]
    return hashlib.sha256(b"de-identified" + b"".join(solids) + kind.encode()).hexdigest()


def stl(mesh: TriangleMesh) -> bytes:
    """Return a mesh as a binary STL, in its own unit."""
    from trimesh import Trimesh
    from trimesh.exchange.stl import export_stl

    return bytes(export_stl(Trimesh(vertices=mesh.vertices, faces=mesh.faces, process=False)))


def covered(atlas: Atlas, measured: Sequence[VolumeMeasurement]) -> CoveredModels:
    """Texture the surface and the closed breasts with photographs."""
    from mammometry.geometry.mesh import TriangleMesh
    from mammometry.io.meshes.own import material, obj_text
    from mammometry.surface.texture.texture_atlas import jpeg_of, transferred

    made = [CoveredModel(name="surface", title=_WHOLE, side="", obj=obj_text(atlas, _MTL).encode())]
    for measurement in measured:
        skin, wall = np.split(measurement.closed.faces, [measurement.skin_faces])
        on_skin = transferred(atlas, TriangleMesh(vertices=measurement.closed.vertices, faces=skin))
        obj = obj_text(on_skin, _MTL, wall=wall)
        made.append(
            CoveredModel(
                name=measurement.name, title=_TITLES[measurement.name], side=measurement.name, obj=obj.encode()
            )
        )
    return CoveredModels(models=tuple(made), mtl=material(_JPEG).encode(), jpeg=jpeg_of(atlas))


def _source(job: Job, deidentify: bool) -> str:
    """Digest of photographs or mesh, and patient. De-identified: of the measured solids only."""
    if deidentify:
        return _shapes(tuple(job.measure().values()), str(job.inputs.subject_kind))
    if not job.inputs.photographs:
        return hashlib.sha256(json.dumps([job.identity.subject, job.inputs.digests["mesh"]]).encode()).hexdigest()
    shots = {name: job.inputs.digests[name] for name in job.inputs.digests if name.startswith("capture/")}
    about = [job.session.manifest.subject.id, str(job.session.manifest.date or ""), sorted(shots.items())]
    return hashlib.sha256(json.dumps(about).encode()).hexdigest()


def _report(job: Job, clinical: Clinical | None, deidentify: bool) -> bytes:
    if not deidentify:
        return _document(job) if clinical is None else job.rendered(clinical).pdf
    with tempfile.TemporaryDirectory(prefix="mammometry-") as folder:
        from mammometry.report.documents.pdf import DOCUMENT
        from mammometry.report.privacy import Privacy

        return (job.share(Path(folder), Privacy(deidentify=True, geometry_only=True)).parent / DOCUMENT).read_bytes()


def quantities(measured: Sequence[VolumeMeasurement], plan: Plan) -> tuple[Quantity, ...]:
    """All measured numbers, with the names used in every export."""
    sizes = plan.value(measure.dimensions)
    beside = () if sizes is None else quantities_of(sizes)
    return (*_volumes(measured, sizes), *_difference(measured), *(Quantity(**quantity) for quantity in beside))


def _volumes(measured: Sequence[VolumeMeasurement], sizes: Dimensions | None) -> Iterator[Quantity]:
    projection_sigmas = {} if sizes is None else {shape.name: shape.projection_sigma_mm for shape in sizes.shapes}
    for measurement in measured:
        side: Side = measurement.name
        rim: dict[str, Any] = {
            "boundary": measurement.boundary_method,
            "boundary_remarks": measurement.boundary_remarks,
        }
        about = rim | {"wall": measurement.wall_kind, "wall_definition": measurement.wall_definition}
        yield Quantity(
            code="volume", title="Volume", side=side, value=measurement.volume_cc, unit="cm3",
            interval_95=measurement.interval_cc, note=measurement.interval_note, method="closed-mesh", **about,
        )  # fmt: skip
        for meaning in measurement.definitions:
            yield Quantity(
                code=f"volume_{meaning.meaning.replace(' ', '_')}", title=f"Volume: {meaning.meaning}", side=side,
                value=meaning.volume_cc, unit="cm3", interval_95=meaning.interval_cc, note=meaning.sentence,
                method="closed-mesh", **about,
            )  # fmt: skip
        yield Quantity(
            code="projection", title="Projection", side=side, value=measurement.projection_mm, unit="mm",
            sigma=projection_sigmas.get(measurement.name), method="plane-distance", **rim,
        )  # fmt: skip
        for code, title, value in (
            ("skin_area", "Skin within the boundary", measurement.area_cm2),
            ("base_area", "Base area", measurement.base_area_cm2),
        ):
            yield Quantity(code=code, title=title, side=side, value=value, unit="cm2", method="mesh-area", **about)


def _difference(measured: Sequence[VolumeMeasurement]) -> Iterator[Quantity]:
    sides = {measurement.name: measurement for measurement in measured}
    if {"left", "right"} <= sides.keys():
        apart = difference(sides["left"], sides["right"], "sides")
        yield Quantity(
            code="volume_left_less_right", title="Volume, left minus right", side="", value=apart.difference_cc,
            unit="cm3", interval_95=apart.difference_interval_cc, note=apart.note, method="difference",
        )  # fmt: skip


def _absent(side: NoBreast) -> Absent:
    kind: Literal["none", "unclear", "refused"] = "refused" if side.refused else "unclear" if side.unclear else "none"
    return Absent(side="left" if side.name == "left" else "right", why=words_of(side.reason), kind=kind)


def _models(measured: Sequence[VolumeMeasurement], surface: TriangleMesh) -> Iterator[ExportedMesh]:
    for measurement in measured:
        yield ExportedMesh(
            name=measurement.name, title=_TITLES[measurement.name], side=measurement.name, stl=stl(measurement.closed)
        )
    yield ExportedMesh(name="surface", title=_WHOLE, side="", stl=stl(surface))


def _photograph_files(job: Job) -> dict[str, Path]:
    files = visible(job.session.path / "capture")
    by_camera = {path.stem: path for path in files if path.suffix.lower() in EXTENSIONS}
    return {camera: by_camera[camera] for camera in job.inputs.photographs if camera in by_camera}
