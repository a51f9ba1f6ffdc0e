"""MuJoCo's models of bodies and joints (MJCF)."""

from ppmcal.controllers import Controller

CONTROLLER = Controller(
    7, "a MuJoCo model (MJCF) of bodies, joints, closed loops and actuators.", title="MuJoCo",
    unread="its loops are constraints of points, which say nothing of limbs, drives or home",
    examples=(("export", "ppmcal export mjcf identified"),))
