"""Maslow, a router that four belts hold."""

from __future__ import annotations

from ppmcal.controllers import Controller, ImportOption

TYPE_CHECKING = False    # help needs the words alone
if TYPE_CHECKING:
    from ppmcal.model.mechanism import Mechanism


def _is_maslow(mechanism: Mechanism) -> bool:
    """Whether a machine is four ropes to one point in the plane."""
    from ppmcal.controllers.ropes import holds_a_point

    return holds_a_point(mechanism, ("x", "y"), 4) and len(mechanism.limbs) == 4


CONTROLLER = Controller(
    5, "anchors of a Maslow 4, as maslow.yaml has them.",
    "the log of a Maslow 4: CLBM lines and lists of belt lengths, or a CSV with bl, br, tr, tl; "
    "every run is a file of measurements.", title="Maslow", copies=True,
    options=(
        ImportOption(
            "width", "float | None", None, "Distance of a Maslow's lower anchors as you know it, "
            "mm", how={"metavar": "MM", "otherwise": "as keys brX ... in the log or --anchors "
                       "say, or as suits the readings"}),
        ImportOption(
            "height", "float | None", None, "Height of a Maslow's upper anchors above the lower "
            "ones, mm", how={"metavar": "MM", "otherwise": "likewise"}),
        ImportOption(
            "anchors", "Path_ | None", None, "A file of the machine that says about where the "
            "anchors are: {words}.", "a maslow.yaml with tlX, tlY, trX, trY and brX")),
    examples=(("import", "ppmcal import maslow maslow.log"),
              ("export", "ppmcal export maslow fitted-maslow")),
    use="ppmcal export maslow {model} writes the anchors' keys for maslow.yaml",
    drives=_is_maslow)
