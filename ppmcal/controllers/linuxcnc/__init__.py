"""LinuxCNC, controller of machine tools."""

from __future__ import annotations

from ppmcal.controllers import Controller

TYPE_CHECKING = False    # help needs the words alone
if TYPE_CHECKING:
    from ppmcal.model.mechanism import Mechanism


def is_hexapod(mechanism: Mechanism) -> bool:
    """Whether a machine has six driven struts, each with its own actuator, in space."""
    from ppmcal.controllers.linuxcnc.hal import STRUTS
    from ppmcal.model.limbs.spatial import UPS

    limbs = mechanism.limbs
    return (mechanism.motion.turns_freely and len({limb.actuator for limb in limbs}) == STRUTS
            and [limb.kind.name for limb in limbs] == [UPS.name] * STRUTS)


CONTROLLER = Controller(
    1, "HAL pins of genhexkins for a hexapod, of pentakins for a pentapod.", drives=is_hexapod,
    use="ppmcal export linuxcnc {model} writes the pins of genhexkins, where LinuxCNC drives the "
        "machine")
