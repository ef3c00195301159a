"""Convert photographs taken with one telephone and a printed board to a session.

::

    from mammometry.api.photos import prepare_walk

    prepare_walk(Path("photos"), Path("anna"))
    print(mm.open_session("anna").run().volumes_cc)
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import get_args

import numpy as np
from PIL import Image

from mammometry.api.walk_pictures import usable_pictures, walk_files, walk_video
from mammometry.base.errors import SessionError
from mammometry.base.listing import visible
from mammometry.base.machine.cores import map_in_threads
from mammometry.base.new_folder import require_new, whole_folder
from mammometry.base.parse import read_text, toml_table
from mammometry.base.photograph import Photograph
from mammometry.base.progress import Progress, no_progress
from mammometry.calibration.targets.board import Board
from mammometry.calibration.targets.card_field import FIELD_MIDDLE
from mammometry.calibration.targets.kinds.charuco import CharucoTarget
from mammometry.calibration.targets.table import target_from_table
from mammometry.calibration.targets.target import Target
from mammometry.geometry import Array, Bool, Camera, Rig
from mammometry.io.cameras.own import cameras_table
from mammometry.io.looked_up import digest_of, file_digest
from mammometry.io.outputs import require_apart
from mammometry.io.write import disk_errors
from mammometry.measure.trunk.body import Mounting, camera_up
from mammometry.walk.bank_card import find_card, has_field
from mammometry.walk.held_lens import with_held_lens
from mammometry.walk.inputs import LeftOut
from mammometry.walk.pairs import choose_pairs, require_upright
from mammometry.walk.print_size import PRINT_STD, sized
from mammometry.walk.region import TELEPHONE_BOARD, Region, region_above
from mammometry.walk.stations import TELEPHONE, stations_of

BOARD = "board.toml"
WALK = "walk.json"
_VERSION = 6  # raised when the same photographs give a different session
_ANOTHER = "a session of other photographs, another board.toml, --posture or --id, or of another version"
_NOT_IN_A_PAIR = LeftOut(code="not-in-a-pair", found="not in a pair")
_MARGIN_PX = 32  # margin around the region in the image, for matching windows at its edge


@dataclass(frozen=True, slots=True, kw_only=True)
class PreparedWalk:
    """Facts about a walk's photographs, stored in walk.json of its session."""

    source: str
    """Digest of the photographs and the board's description."""
    pictures: int
    """Photographs in the folder, or frames chosen from the video."""
    used: Sequence[str]
    """Numbers (`walk_files`) of the photographs that are in pairs."""
    left_out: Mapping[str, LeftOut]
    """Number of a photograph → why it is not used."""
    board_rms_px: float
    """RMS reprojection error of the board's corners, pixels."""
    board_bow_mm: float
    """Height of the board's bow, mm."""
    focal_px: float
    """Focal length of the telephone, pixels."""
    scale_std: float
    """Relative standard uncertainty of all lengths."""
    point_std_mm: float
    """Standard uncertainty of a reconstructed point due to the telephone's poses and lens, mm."""
    card_scale: float | None = None
    """True length on the print, measured with a bank card, relative to the stated length. None: no card."""
    times: Mapping[str, str] = field(default_factory=dict)
    """Number of a frame → its time in the video ("12.4 s"). Empty for photographs."""

    def names(self, folder: Path) -> Mapping[str, str]:
        """Number of a picture → name of its file in the given folder, or its time in the video.

        Raises:
            SessionError: the folder has no photographs.
        """
        return self.times or {number: path.name for number, path in walk_files(folder).items()}


def prepare_walk(
    folder: Path,
    out: Path,
    *,
    posture: str = "standing",
    subject: str | None = None,
    scratch: Path | None = None,
    progress: Progress = no_progress,
) -> PreparedWalk:
    """Write a session of a walk: camera positions, pairs, and the photographs cropped to the body.

    Photographs are stored by number and without EXIF data: a file's name may be a patient's. An existing session of the
    same photographs is kept unchanged.

    Args:
        folder: the photographs or one video, and ``board.toml`` if the board was measured or is another one.
        out: the session's folder: new, empty, or a session of these photographs.
        posture: posture of the patient.
        subject: pseudonym of the patient.
        scratch: folder for temporary frames of a video. None: the system's folder for temporary files.
        progress: called with the fraction of the photographs that were searched for the board.

    Raises:
        SessionError: no photographs, photographs and a video, a ``board.toml`` that is not as documented, or other
            content in `out`.
        BoardSizeError: the size in ``board.toml`` is impossible, or a bank card contradicts it.
        CalibrationError: too few photographs are usable, or the cameras' positions cannot be found from them.
        ImageError: the video cannot be read.
    """
    require_apart(out, [folder])
    earlier = read_walk(out)
    if earlier is None:
        require_new(out)
    board = folder / BOARD
    video = walk_video(folder)
    inputs = [*walk_files(folder).values()] if video is None else [video]
    contents = [file_digest(path) for path in (*inputs, *([board] if board.is_file() else []))]
    source = digest_of([_VERSION, posture, subject, contents])
    if earlier is not None:
        if earlier.source == source:
            return earlier
        require_new(out, found=_ANOTHER)
    target = read_board(folder)
    with usable_pictures(folder, target, progress, scratch) as pictures:
        stations, left_out = pictures.placed()
        stations.require_distance()
        card = None
        if isinstance(target, CharucoTarget) and has_field(target):
            card = find_card(stations.rig.cameras, pictures.photographs, target, stations.plane_mm(FIELD_MIDDLE))
            if card is not None:
                target = sized(target, card)
                resized = stations_of(replace(stations.calibration.observations, target=target))
                stations = with_held_lens(resized, stations.held, stations.rig.cameras)
        region = region_above(target)
        board_middle = target.points_target.mean(axis=0)
        require_upright(tuple(stations.rig.cameras.values()), region.middle_world, board_middle)
        pairs = choose_pairs(_seeing(stations.rig, region), region.middle_world)
        in_pairs = sorted({name for pair in pairs.values() for name in pair})
        rig = Rig(
            name="telephone",
            cameras={name: stations.rig.cameras[name] for name in in_pairs},
            pair_names=pairs,
            target_middle_world=region.middle_world,
        )
        camera = stations.calibration.rig.cameras[TELEPHONE]
        walk = PreparedWalk(
            source=source,
            pictures=len(pictures.names),
            used=tuple(in_pairs),
            left_out={**left_out, **{name: _NOT_IN_A_PAIR for name in stations.rig.cameras if name not in in_pairs}},
            board_rms_px=round(float(stations.calibration.rms_px), 4),
            board_bow_mm=round(stations.bow_mm, 3),
            focal_px=round(float(camera.matrix[0, 0]), 2),
            scale_std=target.scale_std or PRINT_STD,
            point_std_mm=round(stations.point_std_mm(rig, region), 4),
            card_scale=None if card is None else round(card.scale, 5),
            times={} if video is None else pictures.names,
        )
        with disk_errors(out), whole_folder(out) as fresh:
            _write(fresh, walk, rig, target, pictures.photographs, posture, subject)
    return walk


def read_walk(session: Path) -> PreparedWalk | None:
    """Facts about the photographs of a session made by `prepare_walk`. None for other folders."""
    try:
        table = json.loads((session / WALK).read_text(encoding="utf-8"))
        left_out = {name: LeftOut(**why) for name, why in table["left_out"].items()}
        return PreparedWalk(**{**table, "used": tuple(table["used"]), "left_out": left_out})
    except (OSError, ValueError, TypeError, KeyError):
        return None


def read_board(folder: Path) -> Target:
    """The board of a walk: that of board.toml, else the one drawn by ``target --telephone``.

    Raises:
        SessionError: ``board.toml`` is not as documented, or has another name.
    """
    path = folder / BOARD
    if not path.is_file():
        _require_well_named(folder)
        return target_from_table(TELEPHONE_BOARD)
    table = toml_table(read_text(path, str(path), "TOML", most_mib=1), str(path), "a board as [target] of session.toml")
    try:
        board = target_from_table(table.get("target", table))
        if isinstance(board, Board):
            board.sheet()  # refuses an unknown dictionary
    except SessionError as error:
        remedy = f"Correct {BOARD} next to the photographs; `mammometry target board.pdf --telephone` prints an example"
        raise SessionError(
            f"{path}: {error.subject}", found=error.found, expected=error.expected, remedy=remedy
        ) from None
    return board


def _require_well_named(folder: Path) -> None:
    """Refuse a description of the board under another name, such as board.toml.txt, which would not be read."""
    named = [path.name for path in visible(folder) if ".toml" in path.name.casefold() and path.is_file()]
    if named:
        raise SessionError(
            str(folder / named[0]),
            found="a description of the board under another name",
            expected=BOARD,
            remedy=f"Rename it to {BOARD}, or remove it if the board was not measured",
        )


def board_pdf(page: str = "A4") -> bytes:
    """PDF of the telephone's board at true scale, with its field for a bank card.

    Args:
        page: paper size, as for `target_pdf`.

    Raises:
        SessionError: the board does not fit the page.
    """
    from mammometry.calibration.targets.pdf import target_pdf

    return target_pdf(target_from_table(TELEPHONE_BOARD), page=page, card_field=True)


def mounting_by_board(rig: Rig) -> Mounting:
    """How the telephone was held, from the board, whose text is upright.

    Args:
        rig: the photographs' cameras, in the board's frame (y down).
    """

    def upright(mounting: Mounting) -> float:
        return -sum(float(camera_up(camera, mounting)[1]) for camera in rig.cameras.values())

    return max(get_args(Mounting), key=upright)


def _seeing(rig: Rig, region: Region) -> Rig:
    """The cameras that see the body's region."""
    cameras = {name: camera for name, camera in rig.cameras.items() if region.mask(camera).any()}
    return replace(rig, cameras=cameras)


def _write(
    out: Path,
    walk: PreparedWalk,
    rig: Rig,
    target: Target,
    photographs: Mapping[str, Photograph],
    posture: str,
    subject: str | None,
) -> None:
    capture, masks = out / "capture", out / "masks"
    region = region_above(target)
    capture.mkdir()
    masks.mkdir()

    def written(camera: Camera) -> Camera:
        mask = region.mask(camera)
        rows, columns = _box(mask)
        pixels = np.ascontiguousarray(photographs[camera.name].pixels[rows, columns])
        if pixels.dtype == np.uint16:  # 8 bits per colour, as from telephones
            pixels = (pixels >> 8).astype(np.uint8)
        Image.fromarray(pixels).save(capture / f"{camera.name}.png", compress_level=1)
        Image.fromarray(mask[rows, columns]).save(masks / f"{camera.name}.png")
        return _cropped(camera, rows, columns)

    cameras = dict(zip(rig.cameras, map_in_threads(written, list(rig.cameras.values())), strict=True))
    texts = {
        "cameras.json": json.dumps(cameras_table(cameras), indent=1),
        "session.toml": _manifest(walk, rig, target, posture, subject),
        WALK: json.dumps(asdict(walk), indent=1),
    }
    for name, text in texts.items():
        (out / name).write_text(text + "\n", encoding="utf-8")


def _box(mask: Bool[Array, "h w"]) -> tuple[slice, slice]:
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    return (
        slice(max(0, int(rows[0]) - _MARGIN_PX), int(rows[-1]) + 1 + _MARGIN_PX),
        slice(max(0, int(columns[0]) - _MARGIN_PX), int(columns[-1]) + 1 + _MARGIN_PX),
    )


def _cropped(camera: Camera, rows: slice, columns: slice) -> Camera:
    """The camera of a cropped image."""
    width, height = camera.size_wh
    matrix = camera.matrix.copy()
    matrix[0, 2] -= columns.start
    matrix[1, 2] -= rows.start
    size_wh = (min(columns.stop, width) - columns.start, min(rows.stop, height) - rows.start)
    return replace(camera, matrix=matrix, size_wh=size_wh)


def _manifest(walk: PreparedWalk, rig: Rig, target: Target, posture: str, subject: str | None) -> str:
    pairs = "\n".join(
        f'    {{ name = "{name}", left = "{left}", right = "{right}" }},'
        for name, (left, right) in rig.pair_names.items()
    )
    named = "" if subject is None else f"id = {json.dumps(subject)}\n"
    mounting = mounting_by_board(rig)
    held = "" if mounting == "upright" else f'mounting = "{mounting}"\n'
    region, points = region_above(target), target.points_target[:, :2]
    corners, board = (
        [[round(float(x), 3) for x in corner] for corner in box]
        for box in ((region.low_world, region.high_world), (points.min(axis=0), points.max(axis=0)))
    )
    return (
        "# Made by `mammometry photos` from photographs with one telephone and a printed board.\n"
        'format = 1\nunits = "mm"\n\n'
        f'[rig]\nname = "telephone"\n{held}pairs = [\n{pairs}\n]\n\n'
        f'[subject]\nkind = "torso"\n{named}posture = "{posture}"\n\n'
        f"[walk]\nregion_mm = {corners}\nboard_mm = {board}\n"
        f"scale_std = {walk.scale_std:.4g}\npoint_std_mm = {walk.point_std_mm:.3g}"
        + ("" if walk.card_scale is None else f"\ncard_scale = {walk.card_scale:.5g}")
    )
