"""Where a machine stands: closure, inverse and forward kinematics, what effects do to them."""
