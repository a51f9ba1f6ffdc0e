"""The machine and its data: mechanism, parameters, limbs, effects, data sets."""
