"""LinuxCNC, controller of machine tools."""

from ppmcal.controllers import Controller

CONTROLLER = Controller(1, "HAL pins of genhexkins for a hexapod.")
