"""RepRapFirmware, firmware of printers."""

from ppmcal.controllers import Controller

CONTROLLER = Controller(
    2, "M665 and M666 of a linear delta.", "config.g of RepRapFirmware.", title="RepRapFirmware",
    meshes="RepRapFirmware's heightmap.csv", radius="R of M665",
    use="ppmcal export reprap {model} --old {old} writes the lines M665 and M666: paste them into "
        "{old}")
