"""Previews of a stage: PNG pictures by name.

Each has its caption inside (`canvas.caption_of`). The names are those of the files in ``results/<stage>/``. The report
shows the same pictures.
"""

from mammometry.job.graph import Plan
from mammometry.job.inputs import Inputs
from mammometry.job.products import Stage
from mammometry.report.figures.catalogue import previews_of
from mammometry.report.figures.stage_results import MeasureResult, StageResult, stage_result
from mammometry.surface.texture.texture import TexturedMesh


def draw(result: StageResult) -> dict[str, bytes]:
    """Draw every preview of a stage's result: name → PNG. An open surface has nothing measured to show."""
    measurements = result.measurements if isinstance(result, MeasureResult) else ()
    pictures: dict[str, bytes | None] = {}
    for preview in previews_of(result.stage):
        if preview.per_breast:
            for measured in measurements:
                pictures[f"{preview.name}-{measured.name}"] = preview.draw(result, measured)
        else:
            pictures[preview.name] = preview.draw(result)
    return {name: png for name, png in pictures.items() if png is not None}


def draw_stage(stage: Stage, plan: Plan, inputs: Inputs, textured: TexturedMesh | None = None) -> dict[str, bytes]:
    """Draw every preview of a session's stage. Arguments as for `stage_result`."""
    return draw(stage_result(stage, plan, inputs, textured))
