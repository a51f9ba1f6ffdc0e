"""Log odds of the blocks of a batch, or of several batches."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ppmcal.inference.blocks import Batch
from ppmcal.inference.evidence import BatchOdds, odds_of_some
from ppmcal.inference.given import Conditioned
from ppmcal.linalg import Array


def odds(given: Conditioned, batch: Batch) -> Array:
    """Return the log odds of each block of a batch at each root and size (B, G, S)."""
    return BatchOdds.of(given, batch).between(np.arange(len(batch.which)))


def odds_of_all(given: Conditioned, some: Sequence[Batch], count: int) -> Array:
    """Return the log odds (count,) of each block of several batches."""
    return odds_of_some([BatchOdds.of(given, batch) for batch in some], np.ones(count, dtype=bool))
