"""Marlin, firmware of printers."""

from ppmcal.controllers import Controller
from ppmcal.controllers.delta.options import delta_options, delta_words

CONTROLLER = Controller(
    8, "M665 and M666 of a linear delta, as Marlin takes them.",
    "the report of M503 that Marlin sends, or lines like it.", title="Marlin",
    options=tuple(o for o in delta_options("", "R of M665") if o.name != "mesh"),
    copies=True,
    use="ppmcal export marlin {model} --old {old} writes the lines M665 and M666: send them, and "
        "M500",
    named=delta_words("L", "H of M665 - X of M666", "R", "X of M665 + 210 deg"))
