"""Commands `acceptance new` and `acceptance run`: test a device with artefacts of known size."""

from __future__ import annotations

import datetime
import tempfile
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import typer

from mammometry.base.shell import command_line
from mammometry.cli.common import Answer, Bars, Options, OutputOptions, command

app = typer.Typer(name="acceptance", help="Test a device with a sphere, a bar, a plane or a cast of known size.")
REJECT, UNDECIDED = 14, 15
"""Exit codes: an error is beyond its limit; nothing is, but not all is shown to be within."""
_CODES = MappingProxyType({"accept": 0, "reject": REJECT, "undecided": UNDECIDED})
_RUN, _NEW, _DEMO = "acceptance run", "acceptance new", "demo"
DEMO_FOLDER = Path("demo-acceptance")
_DEMO_SEED = 1  # of the virtual device's noise


@command(
    app,
    "mammometry acceptance new test-2026-11 --device 'Rig, room 3' --person ab",
    name="new",
)
def new(
    options: OutputOptions,
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of the test.", show_default=False)],
    device: Annotated[str, typer.Option(help="Name of the device, the same in every test.")] = "",
    person: Annotated[str, typer.Option(help="Who tests: initials or a function.")] = "",
) -> Answer:
    """Prepare a test: its description to fill in, a page with the positions, and a folder per artefact.

    Measure the artefacts at the positions of protocol.html. Put a mesh, a scan or a session per position into the
    artefact's folder, named after the position's number.
    """
    from mammometry.io.acceptance_file import DESCRIPTION, template
    from mammometry.io.outputs import require_free, write_outputs
    from mammometry.report.documents.acceptance_page import PROTOCOL, protocol_page
    from mammometry.study.acceptance.artefacts import KINDS

    require_free(folder, [DESCRIPTION, PROTOCOL], command=_NEW)
    with Bars(options.silent) as bars, bars.task("acceptance", "protocol"):
        files = {
            DESCRIPTION: template(device, person, datetime.date.today()),
            PROTOCOL: protocol_page(device),
        }
    write_outputs(folder, files, command=_NEW)
    for kind in KINDS:
        (folder / kind).mkdir(exist_ok=True)
    table: dict[str, Any] = {"folder": str(folder), "files": sorted(files), "artefacts": list(KINDS)}
    next_command = command_line("mammometry", *_RUN.split(), folder)
    lines: list[Any] = [
        f"{folder / DESCRIPTION}: fill in your artefacts.",
        f"{folder / PROTOCOL}: measure them at these positions.",
        f"Then: {next_command}",
    ]
    return Answer(table, lines)


@command(
    app,
    "mammometry acceptance run test-2026-11",
    "mammometry acceptance run test-2026-11 --json",
    name="run",
)
def run(
    options: Options,
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of the test.", show_default=False)],
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Folder for the results.", show_default="FOLDER/results")
    ] = None,
) -> Answer:
    """Evaluate the measured artefacts, and decide by ISO 14253-1 whether the device is accepted.

    After VDI/VDE 2634-3 and ISO 10360-13. Meshes and scans of any device, and sessions of the rig. The exit code is 14
    if an error is beyond its limit, and 15 if the uncertainty or missing positions leave it undecided.
    """
    from mammometry.io.acceptance_file import RESULTS

    return _evaluated(folder, out or folder / RESULTS, options)


def _evaluated(folder: Path, place: Path, options: Options) -> Answer:
    from mammometry.api.acceptance import FILES, acceptance_files, acceptance_inputs, run_acceptance
    from mammometry.io.acceptance_file import DESCRIPTION
    from mammometry.io.outputs import require_apart, require_free, write_outputs
    from mammometry.report.documents.acceptance_page import PAGE
    from mammometry.study.acceptance.tables import acceptance_json, summary

    chosen = options.settings()
    _, files = acceptance_inputs(folder)
    measured = [path for named in files.values() for path in named.values()]
    require_apart(place, [folder / DESCRIPTION, options.file, *measured])
    require_free(place, FILES, command=_RUN)
    with Bars(options.silent) as bars:
        with bars.task("acceptance", "artefacts") as progress:
            outcome = run_acceptance(folder, chosen, progress=progress)
        with bars.task("report", "results"):
            write_outputs(place, acceptance_files(folder, outcome), command=_RUN)
    table = {"results": str(place), **acceptance_json(outcome)}
    return Answer(table, [*summary(outcome), f"Page: {place / PAGE}"], exit_code=_CODES[outcome.decision])


def acceptance_demo(folder: Path, options: Options) -> Answer:
    """Draw artefacts as a virtual device with known errors measures them, and test the device.

    Raises:
        MammometryError: the folder holds something else.
    """
    import numpy as np

    from mammometry.api.acceptance import NUMBERS
    from mammometry.geometry.mesh_files.ply import write_ply
    from mammometry.io.acceptance_file import DESCRIPTION, RESULTS, read_test
    from mammometry.io.outputs import require_free, write_outputs
    from mammometry.simulate.artefacts import DEMO_DEVICE, DEMO_ERRORS, measured_mesh
    from mammometry.simulate.subjects.artefacts import artefact_mesh
    from mammometry.study.acceptance.artefacts import POSITIONS

    options.settings()
    require_free(folder, [DESCRIPTION], command=_DEMO)
    require_free(folder / RESULTS, [NUMBERS], command=_RUN)
    write_outputs(folder, {DESCRIPTION: DEMO_DEVICE.encode()}, command=_DEMO)
    artefacts = read_test(folder).artefacts
    rng = np.random.default_rng(_DEMO_SEED)
    with Bars(options.silent) as bars, bars.task("simulate", "artefacts") as progress:
        for number, (kind, artefact) in enumerate(artefacts.items()):
            meshes: dict[str, bytes] = {}
            for place in POSITIONS[kind]:
                mesh = measured_mesh(artefact_mesh(artefact, place), DEMO_ERRORS, rng)
                with tempfile.TemporaryDirectory(prefix="mammometry-") as temporary:
                    path = Path(temporary) / "mesh.ply"
                    write_ply(path, mesh, {}, comments=("units: mm",))
                    meshes[f"{place.name}.ply"] = path.read_bytes()
            write_outputs(folder / kind, meshes, command=_DEMO)
            progress((number + 1) / len(artefacts))
    answer = _evaluated(folder, folder / RESULTS, options)
    put_in = (
        f"Errors put in: scale {100 * DEMO_ERRORS.scale:+g} %, noise {DEMO_ERRORS.noise_mm:g} mm, waves of "
        f"{DEMO_ERRORS.shared_mm:g} mm."
    )
    return Answer({**answer.table, "scale_put_in": DEMO_ERRORS.scale}, [*answer.lines, put_in], exit_code=0)
