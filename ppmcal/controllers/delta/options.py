"""What ``import`` asks of a delta printer besides its configuration."""

from __future__ import annotations

from ppmcal.controllers import ImportOption

TYPE_CHECKING = False    # help needs the words alone
if TYPE_CHECKING:
    from collections.abc import Callable

    from ppmcal.model.mechanism import Mechanism


def delta_words(rod: str, endstop: str, radius: str, angle: str
                ) -> Callable[[Mechanism], str]:
    """Return what makes the sentence on a firmware's own names of a linear delta's parameters."""
    def named(mechanism: Mechanism) -> str:
        if "delta_radius" not in mechanism.names:
            return ""
        own = next((n for n in ("rod", "a.length") if n in mechanism.names), "")
        parts = [("delta_radius", radius), (own, rod), ("a.base.point.angle", angle)]
        told = ", ".join(f"{name} is {words}" for name, words in parts if name and name != words)
        return (f"In the printer's own numbers {told}, and a.offset is {endstop} + sqrt({rod}^2 - "
                f"{radius}^2); b and c alike")

    return named


def delta_options(meshes: str, radius: str) -> tuple[ImportOption, ...]:
    """Return the options of a firmware.

    Args:
        meshes: what it calls a probed bed.
        radius: what it calls the delta's radius.
    """
    return (
        ImportOption(
            "rods", "str | float | Sequence[str | float]", (),
            "Length of the rods as you measured it, mm; and rods as drawn, one length for all, or "
            "one for each tower  [default: shared, or single where they differ]. Repeat to give "
            "both.", how={"metavar": "MM|fixed|shared|single", "kind": "str"}),
        ImportOption(
            "mesh", "Path_ | Sequence[Path_]", (), "A probed bed, as touches with their direction "
            "of travel: {words}. Repeatable.", meshes,
            {"metavar": "NAME|FILE", "kind": "str"}),
        ImportOption(
            "scale", "str", "printed", "What measured distances are: those of a printed part, "
            "which shrinks; true; or all off by a factor that nothing is known of.",
            how={"choices": ("printed", "known", "unknown"), "shown": True}),
        ImportOption(
            "effector", "str | None", None, "Import six rods instead of three, so that the "
            "effector can tilt: from the nozzle to the line between the two joints of a pair, seen "
            "from above, and between these joints, mm. Then it is said what heights of the probe "
            "tell of the nozzle's, and what touches of the nozzle itself would.",
            how={"metavar": "RADIUS,SPACING", "otherwise": "the effector stays level"}),
        ImportOption(
            "radius", "float | None", None, "{words}, as you measured it, mm: from the joints at a "
            "tower to those at the effector, seen from above", radius,
            {"metavar": "MM", "otherwise": "as the file has it"}))
