"""The demo of scans: a virtual woman of known volume, scanned and measured."""

from __future__ import annotations

import tempfile
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mammometry.cli.common import Answer, Bars, Options
from mammometry.cli.stages import volume_lines

if TYPE_CHECKING:
    from mammometry.simulate.subjects.solid import Solid

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
    from mammometry.api.scans import open_scan
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
            job = open_scan(folder, chosen, watch=bars.watch)
        results = job.run()
    table = results.as_table()
    table["seconds"] = round(time.monotonic() - begun, 3)
    table["stage_seconds"] = {"simulate": round(simulated, 3), **table["stage_seconds"]}
    truth = woman.volumes_cc
    table |= {"scan": str(folder), "true_volumes_cc": {name: round(value, 3) for name, value in truth.items()}}
    lines: list[Any] = []
    for name, true_cc in truth.items():
        found = results.volumes_cc.get(name)
        result = "not measured" if found is None else f"measured {found:.0f} cc"
        off = "" if found is None else f" ({100 * (found / true_cc - 1):+.0f} %)"
        lines.append(f"{name}: {result}, true {true_cc:.0f} cc{off}")
    return Answer(table, [*lines, *volume_lines(results)])


def _woman() -> Solid:
    from mammometry.simulate.disturbances.registry import disturbed
    from mammometry.simulate.recipe import parse_situation
    from mammometry.simulate.subjects.registry import make_subject

    reshape = partial(disturbed, stage="patient", situation=parse_situation(_SITUATION), seed=_SEED)
    return make_subject(_WOMAN, 0, edge_mm=_EDGE_MM, reshape=reshape)


def _scanned(woman: Solid) -> dict[str, bytes]:
    """Files of the scan's folder, as if a telephone's mesh were imported."""
    from mammometry.io.meshes.own_ply import write_ply
    from mammometry.io.meshes.scans import Scan, import_scan
    from mammometry.simulate.scanning.scan import QUALITIES, scan

    made = scan(woman, QUALITIES[_QUALITY], _SEED)
    with tempfile.TemporaryDirectory(prefix="mammometry-") as place:
        path = Path(place) / "scan.ply"
        write_ply(path, made.mesh, made.ply_colours, comments=())
        return import_scan(path, Scan(scanner=_SCANNER, units="", posture="standing"), units=_UNITS)
