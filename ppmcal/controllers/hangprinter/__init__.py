"""Hangprinter, a printer on lines, with RepRapFirmware."""

from __future__ import annotations

from ppmcal.controllers import Controller, ImportOption

TYPE_CHECKING = False    # help needs the words alone
if TYPE_CHECKING:
    from ppmcal.model.mechanism import Mechanism


def _is_hangprinter(mechanism: Mechanism) -> bool:
    """Whether a machine is four or five ropes to a head that stays level."""
    from ppmcal.controllers.ropes import holds_a_point

    return holds_a_point(mechanism, ("x", "y", "z"), 4) and len(mechanism.limbs) <= 5


CONTROLLER = Controller(
    6, "M669 of a Hangprinter.",
    "samples of a Hangprinter's auto-calibration: JSON lines with motor_samples (degrees) and "
    "real_xyz, or arrays such as motor_pos_samp, xyz_of_samp or samp (line positions, mm) as its "
    "scripts have them.",
    title="Hangprinter", options=(
        ImportOption("anchors", "Path_ | None", None, "A file of the machine that says about where "
                     "the anchors are: {words}.",
                     "a config.g with M669 and M666 of a Hangprinter, which has its spools too"),),
    examples=(("import", "ppmcal import hangprinter samples.jsonl"),),
    use="ppmcal export hangprinter {model} writes its anchors as M669 for config.g",
    drives=_is_hangprinter)
