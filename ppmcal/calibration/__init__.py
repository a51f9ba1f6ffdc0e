"""From measurements to parameters: the problem, its fit, what the fit is worth."""
