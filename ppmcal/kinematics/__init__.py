"""Poses of a machine: closure, inverse and forward kinematics, and the influence of effects."""
