"""Worlds of bodies: machines in MuJoCo, which shares neither code nor equations with the package.

Limbs are rigid bodies on joints, loops are closed by forces, weight is weight, a drive is a motor
with an encoder and whatever is behind it. No closure, no Jacobian and no model of an effect is
written here: what a machine does under load follows from its masses, springs and friction alone.
Only the file formats are the package's.
"""
