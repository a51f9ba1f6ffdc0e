"""What a machine and its data are: mechanism, parameters, limbs, effects, data sets."""
