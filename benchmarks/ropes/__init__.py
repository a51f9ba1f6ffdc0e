"""Machines that limbs hold more often than they have freedoms, simulated in plain NumPy.

Nothing here uses the program's kinematics, effects or statics: a campaign is what a rig would say.
"""
