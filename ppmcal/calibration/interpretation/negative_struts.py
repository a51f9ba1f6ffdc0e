"""Struts of negative length: only the square of a length is seen, so that a fit takes any sign.

It would end with an offset of twice the length, and send the machine astray.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ppmcal.calibration.interpretation.mistakes import Mistake, with_line
from ppmcal.kinematics.inverse import home_state
from ppmcal.linalg import Bools
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Limb, Mechanism

NEAR = 0.5
"""A joint whose middle is within this part of the opposite of its home value is negative."""


def _is_strut(limb: Limb) -> bool:
    """Whether a limb's actuator is its length, of which only the square is seen."""
    return limb.kind.actuator == "length" and not any(s.is_bar for s in limb.kind.slots)


def _negative(data: Dataset, mechanism: Mechanism) -> Bools:
    """Return which joints (k,) are struts with a length of the other sign than at home."""
    out = np.zeros(len(mechanism.actuators), dtype=bool)
    if data.commanded is not None:
        return out
    home = home_state(mechanism).q
    for limb in mechanism.limbs:
        i = limb.actuator
        known = data.q[np.isfinite(data.q[:, i]), i]
        out[i] = bool(_is_strut(limb) and known.size and home[i] != 0.0 and abs(
            float(np.median(known)) + home[i]) < NEAR * abs(home[i]))
    return out


def rows_with_negative_struts(data: Dataset, mechanism: Mechanism) -> Bools:
    """Return the rows (N,) with a strut's length of the other sign than at home: mistyped ones.

    The pose is as with the right sign, so that no residual shows it; what follows the travel would.
    """
    home, out = home_state(mechanism).q, np.zeros(len(data), dtype=bool)
    if data.commanded is not None:
        return out
    for limb in mechanism.limbs:
        if _is_strut(limb):
            out |= data.q[:, limb.actuator] * home[limb.actuator] < 0.0
    return out


def negative_struts(data: Dataset, mechanism: Mechanism) -> tuple[Mistake, ...]:
    """Return the joint columns that have the other sign, as one mistake."""
    names = tuple(f"q_{a}" for a, n in zip(mechanism.actuators, _negative(data, mechanism),
                                           strict=True) if n)
    if not names:
        return ()
    has = "has" if len(names) == 1 else "have"
    return (Mistake("sign", names, f"{', '.join(names)} {has} the other sign: lengths of struts, "
                    "which are not negative at home"),)


def with_positive_struts(data: Dataset, mechanism: Mechanism) -> Dataset:
    """Return the data with those columns turned, as their sidecar should say."""
    turned = _negative(data, mechanism)
    if not turned.any():
        return data
    lines = {f"q_{a}": -data.read.get("signs", {}).get(f"q_{a}", 1)
             for a, n in zip(mechanism.actuators, turned, strict=True) if n}
    return replace(data, q=np.where(turned, -data.q, data.q), whole=None, place=None,
                   read=with_line(data, "signs", lines))
