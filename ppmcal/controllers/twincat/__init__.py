"""TwinCAT, controller of machines and robots."""

from ppmcal.controllers import Controller

CONTROLLER = Controller(
    9, "parameters of TwinCAT's 3D-Delta Type 1 (TF5112) for a rotary delta.", title="TwinCAT")
