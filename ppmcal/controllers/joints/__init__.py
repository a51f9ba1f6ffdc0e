"""Tables of each joint's errors, for controllers that add them to its commands."""

from ppmcal.controllers import Controller

CONTROLLER = Controller(
    3, "LinuxCNC compensation files, one for each actuator.",
    use="ppmcal export joints {model} writes a table of corrections for each joint")
