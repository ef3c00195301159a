"""Commands that need no camera: demo, simulate, target."""

from __future__ import annotations

import json as json_module
import tempfile
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mammometry.base.errors import SettingsError
from mammometry.base.shell import command_line
from mammometry.cli.acceptance import DEMO_FOLDER, acceptance_demo
from mammometry.cli.common import Answer, Bars, Options, OutputOptions, command
from mammometry.cli.compile_cache import compiled_ahead
from mammometry.cli.photos import DEMO_FOLDER as WALK_FOLDER
from mammometry.cli.photos import photos_demo, simulated_walk
from mammometry.cli.stages import demo_answer, opened, volume_lines
from mammometry.simulate.recipe import SessionRecipe, parse_situation
from mammometry.simulate.rendering.film import Film

if TYPE_CHECKING:
    from mammometry.simulate.subjects.solid import SubjectSolid
    from mammometry.simulate.subjects.user_mesh import MeshFile


FOLDER = Path("demo-scan")
_COMMAND = "demo"
_SCANNER, _UNITS = "Virtual telephone", "mm"
_WOMAN, _SITUATION, _QUALITY, _SEED = "torso_2", "posture=standing", "telephone", 0
_EDGE_MM = 2.0  # of the woman's triangles, on the breasts


def scan_demo(folder: Path, options: Options) -> Answer:
    """Scan and measure a virtual standing woman, and compare with her volumes.

    Raises:
        MammometryError: the folder holds something else, or the scan cannot be measured.
    """
    from mammometry.api.job import open_session
    from mammometry.io.meshes.scans import FILES, is_scan, read_scan
    from mammometry.io.outputs import require_free, write_outputs

    chosen = options.settings()
    present = is_scan(folder)
    if not present or read_scan(folder).scanner != _SCANNER:
        require_free(folder, FILES, command=_COMMAND)
    begun = time.monotonic()
    with Bars(options.silent) as bars:
        with bars.task("simulate", "depth pictures") as progress:
            woman = _woman()
            progress(0.6)
            if not present:
                write_outputs(folder, _scanned(woman), command=_COMMAND)
        simulated = time.monotonic() - begun
        with bars.task("measure", "mesh"):
            job = open_session(folder, chosen, watch=bars.watch)
        results = job.run()
    measured = Answer({**results.as_table(), "scan": str(folder)}, volume_lines(results))
    return demo_answer(measured, woman.volumes_cc, begun=begun, simulated=simulated)


def _woman() -> SubjectSolid:
    from mammometry.simulate.disturbances.registry import disturbed
    from mammometry.simulate.recipe import parse_situation
    from mammometry.simulate.subjects.registry import make_subject

    reshape = partial(disturbed, stage="patient", situation=parse_situation(_SITUATION), seed=_SEED)
    return make_subject(_WOMAN, 0, edge_mm=_EDGE_MM, reshape=reshape)


def _scanned(woman: SubjectSolid) -> dict[str, bytes]:
    """Files of the scan's folder, as if a telephone's mesh were imported."""
    from mammometry.geometry.mesh_files.ply import write_ply
    from mammometry.io.meshes.scans import ScanFacts, import_scan
    from mammometry.simulate.scan import QUALITIES, scan

    made = scan(woman, QUALITIES[_QUALITY], _SEED)
    with tempfile.TemporaryDirectory(prefix="mammometry-") as place:
        path = Path(place) / "scan.ply"
        write_ply(path, made.mesh, made.ply_colours, comments=())
        return import_scan(path, ScanFacts(scanner=_SCANNER, units="", posture="standing"), units=_UNITS)


app = typer.Typer()
_DEMO = Path("demo-session")
_RECIPE, _FILM = SessionRecipe(), Film()
_DEMO_RECIPE = _RECIPE


@command(
    app,
    "mammometry demo",
    "mammometry demo /tmp/demo --json",
    "mammometry demo --scan",
    "mammometry demo --photos",
    "mammometry demo --acceptance",
)
def demo(
    options: Options,
    folder: Annotated[
        Path | None,
        typer.Argument(
            metavar="[FOLDER]",
            help="Folder for the virtual session, scan, walk or test.",
            show_default=f"{_DEMO}, {FOLDER}, {WALK_FOLDER} or {DEMO_FOLDER}",
        ),
    ] = None,
    scan: Annotated[
        bool, typer.Option("--scan", help="Scan a virtual standing woman with a virtual telephone, and measure that.")
    ] = False,
    photos: Annotated[
        bool,
        typer.Option("--photos", help="Photograph a virtual standing woman with a virtual telephone, and measure her."),
    ] = False,
    acceptance: Annotated[
        bool, typer.Option("--acceptance", help="Test a virtual device with virtual artefacts of known size.")
    ] = False,
) -> Answer:
    """Simulate, photograph and measure a plaster breast, and compare with its volume."""
    from mammometry.simulate.session import true_volumes_cc

    if scan + photos + acceptance > 1:
        raise typer.BadParameter("--scan, --photos and --acceptance are three demos: give one of them")
    if acceptance:
        return acceptance_demo(folder or DEMO_FOLDER, options)
    if photos:
        return photos_demo(folder or WALK_FOLDER, options)
    if scan:
        chosen = folder or FOLDER
        return scan_demo(chosen, options)
    options.settings()  # a wrong name shows at once, not after a minute
    folder = folder or _DEMO
    begun = time.monotonic()
    with Bars(options.silent) as bars, compiled_ahead():
        if not _is_demo(folder):
            from mammometry.simulate.session import write_session

            with bars.task("simulate", "photographs") as progress:
                truth = dict(write_session(folder, _DEMO_RECIPE, progress=progress).true_volumes_cc)
        else:  # made again from its recipe: truth/ is for "mammometry evaluate" alone
            truth = true_volumes_cc(_DEMO_RECIPE)
        simulated = time.monotonic() - begun
        results = opened(folder, options, bars).run()
    measured = Answer({**results.as_table(), "session": str(folder)}, volume_lines(results)[1:])
    return demo_answer(measured, truth, begun=begun, simulated=simulated, cast=True)


@command(
    app,
    "mammometry simulate OUT",
    "mammometry simulate OUT --subject plaster_3 --rig reference:front,floor --scale 0.5 --seed 1",
    "mammometry simulate OUT --subject torso_2 --disturb removed=right,rail",
    "mammometry simulate OUT --clinic 16 --difficulty 2",
    "mammometry simulate OUT --subject scan.ply --units mm --rig rig.toml",
    "mammometry run OUT",
    "mammometry simulate OUT --telephone --subject torso_4 --disturb breath=0.3",
    "mammometry photos OUT/photos",
)
def simulate(
    options: OutputOptions,
    out: Annotated[Path, typer.Argument(metavar="OUT", help="New folder for the session.", show_default=False)],
    rig: Annotated[
        str, typer.Option(help="reference, or a TOML file of a rig. Some of its pairs: reference:front,floor.")
    ] = _RECIPE.rig,
    subject: Annotated[
        str | None,
        typer.Option(
            help="plaster, plaster_1 … plaster_9, plaster_60cc, torso, torso_1 …, woman, woman_1 … (also "
            "leaning-woman, woman-wide, leaning-woman-wide), head, figure, sphere, cylinder, plate, test-sphere_1 …, "
            "test-bar_1 …, test-plane_1 …, or a PLY, OBJ or STL file.",
            show_default=f"{_RECIPE.subject}, or torso_2 with --telephone",
        ),
    ] = None,
    units: Annotated[
        str | None, typer.Option(metavar="mm|cm|m|in|ft", help="Unit of the subject's mesh file.", show_default=False)
    ] = None,
    subject_scale: Annotated[
        float | None,
        typer.Option(help="Millimetres per unit of the mesh file, instead of --units.", show_default=False),
    ] = None,
    subject_turn: Annotated[
        str,
        typer.Option(metavar="X,Y,Z", help="Rotation of the mesh, degrees. Then y is up and z points to the front."),
    ] = "0,0,0",
    scale: Annotated[
        float | None,
        typer.Option(
            help="Image size as a share of the rig's full size. Least for the reference rig: 0.12.",
            min=0.02,
            max=2.0,
            show_default=f"{_RECIPE.scale}, or 0.4 with --telephone",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of everything random.", min=0)] = _RECIPE.seed,
    poses: Annotated[
        int,
        typer.Option(
            help="Number of poses of the calibration target. Least for the reference rig: 6; 8 below scale "
            "0.2; 10 below 0.15.",
            min=1,
        ),
    ] = _RECIPE.poses,
    target: Annotated[
        str, typer.Option(help="charuco, chessboard, circles, circles-asymmetric, dotted-cylinder or frame.")
    ] = "charuco",
    skin: Annotated[
        str | None,
        typer.Option(
            help="plaster, plain, speckled, skin, dark-skin, pale-skin or sweat.",
            show_default="plaster, or skin with --telephone",
        ),
    ] = None,
    contrast: Annotated[
        float | None,
        typer.Option(help="Contrast of the skin's texture. 0.005 is nearly none.", show_default="the skin's"),
    ] = None,
    hair: Annotated[float, typer.Option(help="Hairs per cm².")] = 0.0,
    background: Annotated[str, typer.Option(help="dark or clutter.")] = "dark",
    f_number: Annotated[
        float | None, typer.Option(help="F-number of the lenses.", show_default="all depths sharp")
    ] = None,
    focus_mm: Annotated[
        float | None,
        typer.Option(help="Distance that is sharp, with --f-number.", show_default="the middle of the rig"),
    ] = None,
    vignetting: Annotated[float, typer.Option(help="Loss of light in the corners, 0 to 1.")] = _FILM.vignetting,
    noise: Annotated[float, typer.Option(help="Noise relative to a usual sensor. 0 is nearly none.")] = 1.0,
    jpeg_quality: Annotated[int, typer.Option(help="Quality of the JPEG files, 1 to 100.")] = _FILM.jpeg_quality,
    image_format: Annotated[str, typer.Option("--format", help="jpg, png, or tif (16 bits per channel).")] = "jpg",
    renderer: Annotated[str, typer.Option(help="built-in, or mitsuba (needs the extra sim).")] = "built-in",
    disturb: Annotated[
        str,
        typer.Option(
            metavar="NAME[=SIZE],…",
            help="What disturbs the capture: rail,drift=0.02,removed=right.",
            show_default=False,
        ),
    ] = "",
    telephone: Annotated[
        bool,
        typer.Option(
            "--telephone",
            help="Photographs by one telephone instead of a rig. --subject is a torso; the options of rigs, "
            "targets and lenses are not used.",
        ),
    ] = False,
    clinic: Annotated[
        int | None, typer.Option(help="Choose a torso and all disturbances by this seed.", min=0, show_default=False)
    ] = None,
    difficulty: Annotated[
        int, typer.Option(help="With --clinic: 0 draws only the patient, 3 the most disturbances.", min=0, max=3)
    ] = 1,
) -> Answer:
    """Render a session of a virtual rig, or a walk with a telephone. The truth is written to OUT/truth."""
    from mammometry.simulate.disturbances.draw import draw
    from mammometry.simulate.disturbances.registry import check
    from mammometry.simulate.rendering.skin import make_skin
    from mammometry.simulate.rigs.targets import make_target
    from mammometry.simulate.session import write_session
    from mammometry.simulate.studio import Studio, refusing
    from mammometry.simulate.walk import WalkRecipe

    begun = time.monotonic()
    refused = partial(
        refusing,
        SettingsError,
        expected="options that can be rendered",
        remedy="Correct the option; --help names the choices",
    )
    if telephone:
        if clinic is not None or rig != _RECIPE.rig:
            raise typer.BadParameter("--telephone has no rig: leave out --rig and --clinic")
        plain = WalkRecipe()
        with refused():
            walk = WalkRecipe(
                subject=subject or plain.subject,
                seed=seed,
                scale=scale or plain.scale,
                skin=make_skin(skin or "skin", contrast=contrast),
                film=plain.film.with_noise(noise),
                situation=parse_situation(disturb),
            )
        return simulated_walk(out, walk, options)
    scale = scale or _RECIPE.scale
    if rig.partition(":")[0] == _RECIPE.rig:
        _require_calibratable(scale, poses)
    mesh_file = _mesh_file(subject or _RECIPE.subject, units, subject_scale, subject_turn)
    with refused():
        if clinic is not None:
            if subject is not None or seed != _RECIPE.seed:
                raise typer.BadParameter("--clinic chooses subject and seed. Give either it, or --subject and --seed")
            subject, seed, disturb = "torso", clinic, f"{draw(clinic, difficulty)},{disturb}"
        situation = parse_situation(disturb)
        check(situation)
        lens = replace(_FILM, f_number=f_number, focus_mm=focus_mm, vignetting=vignetting, jpeg_quality=jpeg_quality)
        studio = Studio(
            target=make_target(target),
            skin=make_skin(skin or "plaster", contrast=contrast, hair_per_cm2=hair),
            film=lens.with_noise(noise),
            background=background,
            renderer=renderer,
            image_format=image_format,
        )
    recipe = SessionRecipe(
        rig=rig, subject=subject or _RECIPE.subject, scale=scale, seed=seed, poses=poses, mesh_file=mesh_file,
        situation=situation,
    )  # fmt: skip
    with Bars(options.silent) as bars, bars.task("simulate", "photographs") as progress:
        made = write_session(out, recipe, studio, progress=progress)
    true_cc = {name: round(value, 3) for name, value in made.true_volumes_cc.items()}
    table = {"session": str(out), "true_volumes_cc": true_cc, "seconds": round(time.monotonic() - begun, 3)}
    volumes = ", ".join(f"{name} {value:.1f} cc" for name, value in true_cc.items())
    volume = f"true volume {volumes}" if volumes else "no true volume, because the mesh is not closed"
    return Answer(
        table, [f"{out}: {len(made.rig.cameras)} cameras, {volume}", f"Then: {command_line('mammometry', 'run', out)}"]
    )


@command(
    app,
    "mammometry target board.pdf",
    "mammometry target board.pdf --page A4 --squares 10x7 --square-mm 18 --marker-mm 13",
    "mammometry target board.pdf --session SESSION",
    "mammometry target board.pdf --telephone",
    "mammometry target speckles.pdf --speckle --page A4",
)
def target(
    options: OutputOptions,
    out: Annotated[Path, typer.Argument(metavar="OUT.pdf", help="The PDF to write.", show_default=False)],
    session: Annotated[
        Path | None, typer.Option(help="Draw the target of this session instead.", show_default=False)
    ] = None,
    squares: Annotated[str, typer.Option(metavar="COLUMNSxROWS", help="Squares of the ChArUco board.")] = "14x10",
    square_mm: Annotated[float, typer.Option(help="Side of a square, mm.")] = 25.0,
    marker_mm: Annotated[float, typer.Option(help="Side of a marker, mm. 0 draws a plain chessboard.")] = 18.0,
    dictionary: Annotated[str, typer.Option(help="Marker dictionary, as OpenCV names it.")] = "DICT_5X5_250",
    page: Annotated[str, typer.Option(help="A4, A3, A2, A1, A0, letter, tabloid, or fit (as large as needed).")] = "A3",
    telephone: Annotated[
        bool, typer.Option("--telephone", help="Draw the board that a patient wears for `mammometry photos`, on A4.")
    ] = False,
    speckle: Annotated[
        bool, typer.Option("--speckle", help="Draw a sheet of speckles for the plane of `mammometry acceptance`.")
    ] = False,
) -> Answer:
    """Draw a calibration board as a PDF to print at true scale. Check the ruler on the print."""
    from mammometry.api.photos import board_pdf
    from mammometry.calibration.targets.pdf import speckle_pdf, target_pdf
    from mammometry.calibration.targets.table import target_from_table
    from mammometry.io.meshes.measured import session_with_photographs
    from mammometry.io.outputs import require_apart, require_free, write_output
    from mammometry.walk.region import TELEPHONE_BOARD

    if out.suffix.lower() != ".pdf":
        raise typer.BadParameter(f"OUT ends with .pdf, found {out.name}: only a PDF has a true scale")
    require_free(out.parent, [out.name], command="target")
    if speckle:
        if session is not None or telephone:
            raise typer.BadParameter("--speckle draws no board: leave out --session and --telephone")
        write_output(out, speckle_pdf(page=page), command="target")
        return Answer({"file": str(out)}, [f"{out}: print it at 100 %, and glue it on glass or aluminium."])
    table: dict[str, Any] = {"kind": "charuco" if marker_mm else "chessboard", "square_mm": square_mm}
    table["squares"] = _columns_and_rows(squares)
    if marker_mm:
        table |= {"marker_mm": marker_mm, "dictionary": dictionary}
    if telephone:
        if session is not None:
            raise typer.BadParameter("--telephone draws one board for all patients: leave out --session")
        table = dict(TELEPHONE_BOARD)
    if session is not None:
        # Drawn in its nominal size: the measured size is that of an earlier print.
        measured = ("edge_mm", "edge_std_mm", "flatness_mm")
        opened_session = session_with_photographs(session)
        require_apart(out, opened_session.brought)
        described = opened_session.manifest.target or {}
        table = {key: value for key, value in described.items() if key not in measured}
    content = board_pdf() if telephone else target_pdf(target_from_table(table), page=page)
    write_output(out, content, command="target")
    lines = [f"{name} = {json_module.dumps(value)}" for name, value in table.items()]
    described_in = "board.toml next to the photographs" if telephone else "session.toml"
    return Answer(
        {"file": str(out), "target": table},
        [f"{out}: print it at 100 %, measure its ruler, and describe it in {described_in}:", "", "[target]", *lines],
    )


_LEAST_POSES = ((0.2, 6), (0.15, 8), (0.12, 10))
"""Scale of the reference rig, and the poses needed from there on; with fewer, too few views have enough corners.
Measured with plaster_3: 6 poses at 0.2 (seeds 1, 2) and 8 at 0.15 (seeds 1, 2, 3, 5, 6) calibrate. At 0.12 6 and 8 do
not, 10 do for some seeds only, and 12 did for the one that was tried."""


def _require_calibratable(scale: float, poses: int) -> None:
    least = next((count for share, count in _LEAST_POSES if scale >= share), None)
    if least is None:
        raise typer.BadParameter(
            f"--scale is {_LEAST_POSES[-1][0]} or more for the reference rig, found {scale:g}: it cannot be calibrated "
            "from smaller pictures"
        )
    if poses < least:
        raise typer.BadParameter(
            f"--poses is {least} or more for the reference rig at scale {scale:g}, found {poses}: fewer do not "
            "calibrate it"
        )


def _mesh_file(subject: str, units: str | None, mm_per_unit: float | None, turn: str) -> MeshFile | None:
    """Options for reading the subject's mesh file, None for a subject that is not a file."""
    from mammometry.base.units import MM_PER_UNIT, UNIT_NAMES, unit_named
    from mammometry.simulate.subjects.user_mesh import MeshFile, names_a_mesh

    if not names_a_mesh(subject):
        if units or mm_per_unit or turn != "0,0,0":
            raise typer.BadParameter(
                f"--units, --subject-scale and --subject-turn are for a mesh file, found subject {subject!r}"
            )
        return None
    if units and mm_per_unit:
        raise typer.BadParameter("--units and --subject-scale mean the same. Give one of them")
    unit = unit_named(units) if units else None
    if units and unit is None:
        raise typer.BadParameter(f"--units is {UNIT_NAMES}, found {units!r}")
    try:
        x, y, z = (float(angle) for angle in turn.split(","))
    except ValueError:
        raise typer.BadParameter(f"--subject-turn is written as 90,0,0, found {turn!r}") from None
    return MeshFile(mm_per_unit=MM_PER_UNIT[unit] if unit else mm_per_unit, turn_deg=(x, y, z))


def _columns_and_rows(text: str) -> list[int]:
    columns, x, rows = text.lower().partition("x")
    if not (x and columns.isdecimal() and rows.isdecimal()):
        raise typer.BadParameter(f"--squares is written as 14x10, found {text!r}")
    return [int(columns), int(rows)]


def _is_demo(folder: Path) -> bool:
    """Whether the folder holds the demo's session already, which is then resumed."""
    try:
        return _DEMO_RECIPE.line in (folder / "session.toml").read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return False
