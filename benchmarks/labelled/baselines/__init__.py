"""Other methods, each in a file of its own: a function from a linear problem to names.

``METHODS`` is what `python -m labelled.run --methods` knows beside the tool itself. A method gets
residuals, inputs and candidate columns (:class:`labelled.linear.LinearProblem`) and a seed, and
returns names and the probability that something without a name is there.
"""

from __future__ import annotations

from collections.abc import Callable

from labelled.baselines import bic, gp, sindy, split
from labelled.linear import LinearProblem
from labelled.score import Name

Method = Callable[[LinearProblem, int], tuple[tuple[Name, ...], float]]
METHODS: dict[str, Method] = {"bic": bic.names, "sindy": sindy.names, "gp": gp.names,
                              "split": split.names}
