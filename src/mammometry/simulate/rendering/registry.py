"""Registry of renderers. A new one is one file in this folder and one line here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from mammometry.base.registry import Registry

if TYPE_CHECKING:
    from mammometry.geometry import Array, Camera, Float32
    from mammometry.simulate.rendering.sampling import Aperture
    from mammometry.simulate.rendering.scene import StudioScene
    from mammometry.simulate.rendering.skin import SkinReflectance

BUILT_IN = "built-in"
"""The renderer that needs no optional package."""


class Render(Protocol):
    """A function that renders a picture."""

    def __call__(
        self,
        scene: StudioScene,
        camera: Camera,
        skin: SkinReflectance,
        *,
        seed: int,
        aperture: Aperture,
        background: float,
    ) -> Float32[Array, "h w 3"]:
        """Radiance seen by a camera: linear RGB, full scale 1, without blur.

        Args:
            scene: lit scene, rig frame, mm.
            camera: camera in the rig's frame.
            skin: appearance of the subject.
            seed: seed of the mottling, the same for all cameras of a capture.
            aperture: aperture of the lens.
            background: radiance of the dark room.
        """
        ...


def _nothing_to_check() -> None:
    """Accept any installation."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Renderer:
    """A program that renders pictures."""

    render: Render
    require: Callable[[], None] = _nothing_to_check
    """Check that the renderer is installed. Raises a SettingsError that states what to install."""


RENDERERS: Registry[Renderer] = Registry(
    "renderer", modules=("mammometry.simulate.rendering.mitsuba_renderer", "mammometry.simulate.rendering.render")
)
"""Name on the command line → renderer."""


def add_renderer(name: str, *, require: Callable[[], None] = _nothing_to_check) -> Callable[[Render], Render]:
    """Decorate a function that renders a picture to register it."""

    def enter(render: Render) -> Render:
        RENDERERS.add(name)(Renderer(render=render, require=require))
        return render

    return enter
