"""Full poses: a laser tracker with a 6-DOF sensor, motion capture, a camera."""

from ppmcal.model.instruments.kind import InstrumentKind, register

POSE = register(InstrumentKind("pose", lambda motion: motion.measured_parts, sees_rotation=True))
