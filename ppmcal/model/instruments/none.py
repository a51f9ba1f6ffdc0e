"""No instrument: rows of joint values alone, for redundant machines."""

from ppmcal.model.instruments.kind import InstrumentKind, register

NONE = register(InstrumentKind(
    "none", lambda motion: (), frame_parts=lambda motion, between: (),
    target_parts=lambda motion, relative: (), opened=(), sigma=""))
