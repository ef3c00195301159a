"""The commands `import …`: other devices' results in."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from mammometry.cli.common import Answer, OutputOptions, command

app = typer.Typer(name="import", help="Take over what other devices made: a scanner's mesh with its texture.")
_COMMAND = "import mesh"


class Units(StrEnum):
    """Units of mesh files."""

    mm = "mm"
    cm = "cm"
    m = "m"


@command(
    app,
    "mammometry import mesh scan.obj --scanner 'Vectra M5' --units mm --out anna",
    "mammometry measure anna/scan.ply --automatic",
)
def mesh(
    options: OutputOptions,
    file: Annotated[
        Path, typer.Argument(metavar="MESH", help="OBJ with MTL and pictures beside it, or PLY, STL, GLB.")
    ],
    scanner: Annotated[str, typer.Option(help="Name of the device, such as 'Vectra M5'.", show_default=False)],
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder for the scan.", show_default=False)],
    units: Annotated[
        Units | None, typer.Option(help="Unit of the file.", show_default="as the file states, else required")
    ] = None,
    head: Annotated[
        str, typer.Option(help="The file's axis towards the head: y, -z and so on.", show_default="y, or z")
    ] = "",
    ahead: Annotated[str, typer.Option(help="The axis straight ahead.", show_default="where an open mesh faces")] = "",
    subject: Annotated[
        str | None, typer.Option(help="Identifier of the subject, a pseudonym.", show_default=False)
    ] = None,
    posture: Annotated[
        str, typer.Option(help="How the patient held herself: standing, leaning or lying.", show_default="not said")
    ] = "",
    without_texture: Annotated[
        bool, typer.Option("--without-texture", help="Take the shape alone, without material file and pictures.")
    ] = False,
) -> Answer:
    """Take over another scanner's mesh with its texture.

    Writes scan.ply (mm, with colours), scan.toml with the scanner's name and unit, and the OBJ with its material and
    pictures. Their own names are not kept: they may hold a patient's name.
    """
    from mammometry.cli.mesh import named_subject
    from mammometry.io.meshes.scans import FILES, MESH, Scan, import_scan
    from mammometry.io.outputs import require_apart, require_free, write_outputs

    require_apart(out, [file])
    require_free(out, FILES, command=_COMMAND)
    about = Scan(scanner=scanner, units="", head=head, ahead=ahead, subject=named_subject(subject), posture=posture)
    made = import_scan(file, about, units=None if units is None else units.value, texture=not without_texture)
    write_outputs(out, made, command=_COMMAND)
    pictures = sum(name.startswith("texture-") for name in made)
    sentence = f"{out / MESH}: with {pictures} pictures" if pictures else f"{out / MESH}: without pictures"
    return Answer({"folder": str(out), "mesh": str(out / MESH), "files": sorted(made)}, [sentence])
