"""Positions of one point: a laser tracker with a reflector."""

from ppmcal.model.instruments.kind import FRAME, HOMING, TARGET, InstrumentKind, register

POSITION = register(InstrumentKind(
    "position", lambda motion: tuple(range(motion.axes)), opened=(FRAME, TARGET, HOMING)))
