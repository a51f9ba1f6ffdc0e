"""From measurements to parameters: the problem, its fit, and the validity of the fit."""
