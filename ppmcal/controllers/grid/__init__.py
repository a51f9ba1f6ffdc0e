"""Tables of poses, for controllers that are told where to go."""

from ppmcal.controllers import Controller

CONTROLLER = Controller(
    4, "a table of wanted poses, their corrected commands and joint values.",
    examples=(("export", "ppmcal export grid identified --poses targets.csv"),))
