"""RepRapFirmware, firmware of printers."""

from ppmcal.controllers import Controller
from ppmcal.controllers.delta.options import delta_options, delta_words

CONTROLLER = Controller(
    2, "M665 and M666 of a linear delta.", "config.g of RepRapFirmware.", title="RepRapFirmware",
    options=delta_options("RepRapFirmware's heightmap.csv", "R of M665"),
    copies=True,
    use="ppmcal export reprap {model} --old {old} --write puts M665 and M666 into it, and keeps "
        "the old one beside",
    named=delta_words("L", "H of M665 + X of M666", "R", "X of M665 + 210 deg"))
