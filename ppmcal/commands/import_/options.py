"""What ``ppmcal import`` takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ppmcal.commands.spec import Arguments, Command, Path_, argument, option
from ppmcal.controllers import IMPORTS, about, examples, imported, own

MESHES = ", or ".join(one.meshes for one in own().values() if one.meshes)
RADIUS, *RADII = (one.radius for one in own().values() if one.radius)


def _names() -> str:
    known = own()
    return ", or ".join(f"{name}: {known[name].title}" if name in known and known[name].title
                        else name for name in imported()) + "."


def _about() -> str:
    formats = " ".join(f"{{form}} {one}" for one in about(IMPORTS))
    return (f"{formats} Writes machine.yaml (the printer as it was meant to be), saved.yaml (as a "
            "calibration left it), and heights, distances and mesh_NAME as .csv and .yaml where "
            "there are any.")


@dataclass(frozen=True)
class ImportArguments(Arguments):
    """The configuration, and what is known of the printer besides."""

    form: str = argument("FORMAT", _names, complete="ppmcal.controllers:imported")
    file: Path_ = argument("FILE", "The configuration.")
    rods: str | float | Sequence[str | float] = option(
        (), "Length of the rods as you measured it, mm; and rods as drawn, one length for all, or "
        "one for each tower  [default: shared, or single where they differ]. Repeat to give both.",
        metavar="MM|fixed|shared|single", kind="str")
    mesh: Path_ | Sequence[Path_] = option(
        (), f"A probed bed, as touches with their direction of travel: {MESHES}. Repeatable.",
        metavar="NAME|FILE", kind="str")
    scale: str = option(
        "printed", "What measured distances are: those of a printed part, which shrinks; true; or "
        "all off by a factor that nothing is known of.", choices=("printed", "known", "unknown"),
        shown=True)
    radius: float | None = option(
        None, f"{RADIUS} ({', '.join(RADII)}) as you measured it, mm: from the joints at a tower "
        "to those at the effector, seen from above", metavar="MM", otherwise="as the file has it")


COMMAND = Command(
    "import", ImportArguments,
    about=("Turn a controller's configuration {file} into a machine and its measurements.",
           _about),
    examples=examples("import"), out="imported", result="ImportResult",
    python="import_config", raises="BadInput: another format, or anything wrong in the files.")
