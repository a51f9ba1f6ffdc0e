"""Klipper, firmware of printers."""

from ppmcal.controllers import Controller
from ppmcal.controllers.delta.options import delta_options, delta_words

CONTROLLER = Controller(
    0, "lines for the printer.cfg of a delta, linear or rotary.",
    "printer.cfg of a delta printer, with the heights and distances that DELTA_CALIBRATE saved in "
    "it, and its meshes; or of a rotary delta.", options=delta_options(
        "the name of a mesh that Klipper saved, a log of its touches", "delta_radius"),
    copies=True, examples=(
        ("export", "ppmcal export klipper fitted-printer --old printer.cfg --write"),
        ("import", "ppmcal import klipper printer.cfg")),
    use="ppmcal export klipper {model} --old {old} --write puts the new numbers into it, "
        "and keeps the old one beside: restart",
    named=delta_words("arm_length", "position_endstop", "delta_radius", "angle of stepper_a"))
