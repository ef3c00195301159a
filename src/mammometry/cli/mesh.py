"""`measure MESH` and `import mesh`: meshes and scans of other devices."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mammometry.base.value import value
from mammometry.cli.common import SUBJECT_ID, Answer, Bars, Options, OutputOptions, command
from mammometry.measure.settings import POSTURES

if TYPE_CHECKING:
    from mammometry.api.results import Results


MESHES = (".ply", ".obj", ".stl", ".glb", ".usdz")
"""Suffixes of mesh files."""


def _mesh_option(*names: str, help: str, show_default: bool | str = False) -> Any:
    return typer.Option(*names, help=help, show_default=show_default, rich_help_panel="For a scanner's mesh")


_ALSO = (
    "Another scan of the same visit and posture, such as from below: it is merged with the first one. "
    "Several may be given."
)


@value
class MeshOptions:
    """Options of `measure` for meshes only."""

    units: Annotated[
        str | None,
        _mesh_option(
            help="Unit of the mesh: mm, cm, m, in or ft.", show_default="as the file states, or a torso's size shows"
        ),
    ] = None
    boundary: Annotated[Path | None, _mesh_option(help="A boundaries.json: closed curves on the mesh.")] = None
    landmarks: Annotated[
        Path | None, _mesh_option(help="A landmarks.json. Without --boundary they give the boundary.")
    ] = None
    out: Annotated[Path | None, _mesh_option(help="Folder for the results.", show_default="MESH-measured")] = None
    scale_sd: Annotated[
        float | None, _mesh_option(help="Relative standard uncertainty of the scale.", show_default="0.001")
    ] = None
    surface_sd: Annotated[
        float | None, _mesh_option(help="Standard uncertainty of the surface, mm.", show_default="0.1")
    ] = None
    subject: Annotated[str | None, _mesh_option(*SUBJECT_ID, help="Pseudonym of the patient, never a name.")] = None
    largest: Annotated[bool, _mesh_option("--largest", help="Measure only the largest piece.")] = False
    automatic: Annotated[
        bool, _mesh_option("--automatic", help="Find the boundaries of a torso along its creases.")
    ] = False
    head: Annotated[str | None, _mesh_option(help="The file's axis towards the head: y, -z etc.", show_default="y")] = (
        None
    )
    ahead: Annotated[
        str | None, _mesh_option(help="The axis straight ahead.", show_default="where an open mesh faces")
    ] = None
    posture: Annotated[str | None, _mesh_option(help="How the patient held herself: standing, leaning or lying.")] = (
        None
    )
    sides_checked: Annotated[
        bool, _mesh_option("--sides-checked", help="Left and right of the mesh were compared with the patient.")
    ] = False
    also: Annotated[list[Path] | None, _mesh_option("--also", help=_ALSO)] = None

    def given(self) -> str | None:
        """Name of the first option that was given, or None."""
        names = (name for name in self.__dataclass_fields__ if getattr(self, name) not in (None, False))
        option = next(names, None)
        return SUBJECT_ID[0] if option == "subject" else None if option is None else f"--{option.replace('_', '-')}"


def measure_mesh(
    mesh: Path, given: MeshOptions, back: Path | None, options: Options, assignments: Sequence[str]
) -> tuple[Results, list[str]]:
    """Measure another scanner's mesh. Returns its results and notes.

    Args:
        mesh: the file.
        given: options that describe it.
        back: file with the chest wall.
        options: of the command.
        assignments: of settings, in addition to the options'.

    Raises:
        typer.BadParameter: an option is invalid.
        MammometryError: the mesh cannot be measured.
    """
    from mammometry.api.job import folder_for, scan_files
    from mammometry.api.mesh import MeshJob
    from mammometry.io.meshes.measured import SCALE_STD, SURFACE_STD_MM, MeshFiles
    from mammometry.io.meshes.scans import MESH, confirm_sides, is_scan, read_scan
    from mammometry.io.outputs import require_apart

    if given.posture not in (None, *POSTURES):
        raise typer.BadParameter(f"--posture is {', '.join(POSTURES)}, found {given.posture!r}")
    for option, number in (("--scale-sd", given.scale_sd), ("--surface-sd", given.surface_sd)):
        if number is not None and not 0 <= number < float("inf"):
            raise typer.BadParameter(f"{option} is a standard uncertainty, 0 or more")
    boundary, landmarks, automatic = given.boundary, given.landmarks, given.automatic
    units, head, ahead, subject = given.units, given.head, given.ahead, given.subject
    scan = read_scan(mesh.parent) if mesh.name == MESH and is_scan(mesh.parent) else None
    if scan is not None:
        own = scan_files(mesh.parent, subject=subject)
        if given.units not in (None, own.units):
            raise typer.BadParameter(f"--units: this scan's folder is in {own.units}. Import the scanner's file again")
        if given.sides_checked:
            confirm_sides(mesh.parent)
        units, head, ahead, subject = units or own.units, head or own.head, ahead or own.ahead, own.subject
        if boundary is None:
            boundary, automatic = own.boundary, True
        landmarks = landmarks or own.landmarks
    if scan is not None and given.also:
        raise typer.BadParameter("--also: import the scans together: mammometry import mesh FIRST --also SECOND")
    files = MeshFiles(
        mesh=mesh,
        also=_further(given.also),
        units=units,
        boundary=boundary,
        landmarks=landmarks,
        back=back,
        automatic=automatic,
        head=head,
        ahead=ahead,
        largest=given.largest,
        scale_std=SCALE_STD if given.scale_sd is None else given.scale_sd,
        surface_std_mm=SURFACE_STD_MM if given.surface_sd is None else given.surface_sd,
        subject=named_subject(subject),
        posture=given.posture or "",
        sides_checked=given.sides_checked,
        scan=scan,
    )
    folder = given.out or folder_for(mesh)
    if given.out is not None and given.out.is_symlink():
        folder = given.out.resolve()  # a link that the user names is followed; one that came with the files is refused
    require_apart(folder, [options.file])
    with Bars(options.silent) as bars:
        with bars.task("read", "mesh"):
            job = MeshJob(files, folder, options.settings(*assignments), watch=bars.watch)
        keys = [product.key for product in job.plan.products()]
        bars.expect("measure", sum(state != "current" for state in job.store.states(keys)))
        results = job.run()
    surface_mm = job.settings.measure.surface_sigma_mm
    remarks = [f"Standard uncertainty: scale {100 * files.scale_std:g} %, surface {surface_mm:.3g} mm"]
    if scan is not None and given.boundary is None and boundary is not None:
        remarks += [
            f"Boundary {name}, from {boundary}: {about.origin or 'author unknown'}"
            for name, about in job.inputs.attributions.items()
        ]
    if scan is not None and given.landmarks is None and landmarks is not None:
        remarks.append(f"Landmarks, from {landmarks}: {', '.join(job.inputs.landmarks)}")
    return results, remarks


def _further(also: Sequence[Path] | None) -> tuple[Path, ...]:
    """Further scans as `--also` gives them."""
    from mammometry.io.meshes.merged import MOST_ALSO

    if len(also or ()) > MOST_ALSO:
        raise typer.BadParameter(f"--also may be given {MOST_ALSO} times, found {len(also or ())}")
    return tuple(also or ())


def named_subject(text: str | None) -> str | None:
    """A pseudonym as `--id` gives it."""
    from mammometry.base.identity import subject_id

    try:
        return None if text is None else subject_id(text)
    except ValueError as error:
        raise typer.BadParameter(f"--id: expected {error}") from None


app = typer.Typer(name="import", help="Import data of other devices: a scanner's mesh with its texture.")
_COMMAND = "import mesh"


@command(
    app,
    "mammometry import mesh scan.obj --scanner 'Vectra M5' --units mm --out anna",
    "mammometry import mesh front.ply --also below.ply --scanner iPhone --out anna",
    "mammometry measure anna/scan.ply --automatic",
)
def mesh(
    options: OutputOptions,
    file: Annotated[
        Path,
        typer.Argument(
            metavar="MESH", help="OBJ with its MTL and pictures in the same folder, or PLY, STL, GLB, USDZ."
        ),
    ],
    scanner: Annotated[str, typer.Option(help="Name of the device, such as 'Vectra M5'.", show_default=False)],
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder for the scan.", show_default=False)],
    units: Annotated[
        str | None,
        typer.Option(
            help="Unit of the file: mm, cm, m, in or ft.", show_default="as the file states, or its size shows"
        ),
    ] = None,
    head: Annotated[
        str, typer.Option(help="The file's axis towards the head: y, -z etc.", show_default="y, or z")
    ] = "",
    ahead: Annotated[str, typer.Option(help="The axis straight ahead.", show_default="where an open mesh faces")] = "",
    subject: Annotated[
        str | None, typer.Option(*SUBJECT_ID, help="Pseudonym of the patient, never a name.", show_default=False)
    ] = None,
    posture: Annotated[
        str, typer.Option(help="How the patient held herself: standing, leaning or lying.", show_default="not said")
    ] = "",
    sides_checked: Annotated[
        bool, typer.Option("--sides-checked", help="Left and right of the mesh were compared with the patient.")
    ] = False,
    without_texture: Annotated[
        bool, typer.Option("--without-texture", help="Import only the shape, without material file and pictures.")
    ] = False,
    also: Annotated[list[Path] | None, typer.Option("--also", help=_ALSO, show_default=False)] = None,
) -> Answer:
    """Import another scanner's mesh with its texture.

    Writes scan.ply (mm, with colours), scan.toml with the scanner's name and unit, and the OBJ with its material and
    pictures. The original file names are not kept, because they may contain a patient's name. Scans merged with --also
    become one scan.ply, whose vertices have the property source: 1 the first scan, 2 the second, 3 both.
    """
    from mammometry.base.notices import words_of
    from mammometry.io.meshes.scans import FILES, MESH, ScanFacts, import_scan, read_scan
    from mammometry.io.outputs import require_apart, require_free, write_outputs

    further = _further(also)
    require_apart(out, [file, *further])
    require_free(out, FILES, command=_COMMAND)
    about = ScanFacts(
        scanner=scanner, units="", head=head, ahead=ahead, subject=named_subject(subject), posture=posture,
        sides="checked" if sides_checked else "",
    )  # fmt: skip
    made = import_scan(file, about, units=units, texture=not without_texture, also=further)
    write_outputs(out, made, command=_COMMAND)
    pictures = sum(name.startswith("texture-") for name in made)
    sentence = f"{out / MESH}: with {pictures} pictures" if pictures else f"{out / MESH}: without pictures"
    taken = read_scan(out)
    notes = list(map(words_of, taken.notices))
    table: dict[str, Any] = {"folder": str(out), "mesh": str(out / MESH), "files": sorted(made), "notes": notes}
    table["notices"] = [notice.as_table() for notice in taken.notices]
    table |= {"merged_scans": [scan.as_table() for scan in taken.also]} if taken.also else {}
    return Answer(table, [sentence, *(f"note: {note}" for note in notes)])
