"""The machine, drawn: a page with a scene that can be turned and moved, and needs nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from markupsafe import Markup

from ppmcal import __version__
from ppmcal.errors import BadInput
from ppmcal.io.results.scene import Scene
from ppmcal.report.html import template_text, whole_page
from ppmcal.report.machine_section import machine_css, machine_scripts, scene_html
from ppmcal.store.output import Output

GENERATOR = "ppmcal machine drawing"
"""What a page says of itself, so that a later one may replace it."""
HEAD = 600
"""Within so many characters a page says it."""
LONG = {"in": "inches"}
"""Units whose name alone is another word."""


def drawing_page(scene: Scene, source: str = "") -> str:
    """Return the page of a scene; ``source``: the file that it was made from."""
    return whole_page(
        "machine.html", scene=scene, generator=GENERATOR, version=__version__,
        source=source or scene.name, lead=_lead(scene), drawing=Markup(scene_html(scene)),
        css=Markup(template_text("machine_page.css") + machine_css()), scripts=machine_scripts())


def _check_target(path: Path, inputs: Sequence[str]) -> None:
    """Refuse a place where something other than an earlier drawing is."""
    head = f'content="{GENERATOR}"'
    try:
        if path.is_dir():
            raise BadInput("is a folder", str(path), "Name a file, such as machine.html")
        if path.exists() and any(Path(n).exists() and path.samefile(n) for n in inputs):
            raise BadInput("is an input of this run, and the drawing would replace it", str(path),
                           "Name another file for the drawing")
        if path.exists():
            with path.open(encoding="utf-8", errors="replace") as stream:
                head = stream.read(HEAD)
    except (OSError, ValueError) as error:
        raise BadInput(f"cannot be read ({getattr(error, 'strerror', None) or error})", str(path),
                       "Name another file for the drawing") from None
    if f'content="{GENERATOR}"' not in head:
        raise BadInput("already exists, and ppmcal did not draw it", str(path),
                       "Name another file for the drawing")


def write_drawing(path: Path, page: str, inputs: Sequence[str] = ()) -> None:
    """Write a page, whole or not at all; ``inputs``: files that are never replaced.

    Raises:
        BadInput: it cannot be written; a folder is there, an input, or a file that ppmcal did
            not draw.
    """
    _check_target(path, inputs)
    output = Output(path.parent, loose=True)
    output.add(path.name, page)
    output.write()


def _lead(scene: Scene) -> str:
    """Return what is to be seen."""
    kinds = ", ".join(dict.fromkeys(limb.kind for limb in scene.machines[0].limbs))
    unit = LONG.get(scene.units.length, scene.units.length)
    lead = (f"{len(scene.machines[0].limbs)} limbs {kinds}, lengths in {unit}, equal scale on all "
            "axes. Move the slider: does each joint go as it does on the machine?")
    return lead if scene.flat else f"{lead} Drag to turn."
