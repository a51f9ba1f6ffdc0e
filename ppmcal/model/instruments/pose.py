"""Whole poses: a laser tracker with a sensor for six freedoms, motion capture, a camera."""

from ppmcal.model.instruments.kind import InstrumentKind, register

POSE = register(InstrumentKind("pose", lambda motion: motion.measured_parts, sees_rotation=True))
