"""Recorded columns that a machine's effects need, and those that rows lack."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ppmcal.linalg import finite_rows
from ppmcal.model.dataset import Environment
from ppmcal.model.effects import EffectParameter
from ppmcal.model.mechanism import Effect, Mechanism

NO_COLUMN = ("row", "touch")
"""Needs without a column: every row has its number (after the last one: none), and without touches
of a flat its shape has no effect."""
ORDER = "approach: sequence"
"""What rows lack if their order, or the joints' motion between them, is not known."""


def missing_columns(mechanism: Mechanism, rows: Environment) -> Sequence[str]:
    """Return the names of columns that the effects need and no row has."""
    out: list[str] = []
    for effect in mechanism.effects:
        on = [a for a, used in enumerate(effect.on) if used]
        needs = by_load(_needs(mechanism, effect), mechanism, rows)
        out += lacking(needs, [mechanism.actuators[a] for a in on], on, rows)
    return tuple(dict.fromkeys(out))


def by_load(needs: Sequence[str], mechanism: Mechanism, rows: Environment | None = None
            ) -> tuple[str, ...]:
    """Return what is needed, with the load instead of tensions if no row has these."""
    if mechanism.surplus or (rows is not None and rows.tension is not None):
        return tuple(needs)
    return tuple("load" if n == "tension" else n for n in needs)


def remembers(mechanism: Mechanism) -> bool:
    """Whether an effect depends on what happened before a row."""
    return any({"order", "past"} & set(_needs(mechanism, e)) for e in mechanism.effects)


def _needs(mechanism: Mechanism, effect: Effect) -> tuple[str, ...]:
    """Return the needs of an effect, with its parameters as they are."""
    return (*effect.kind.needs, *(n for s in effect.kind.parameters(mechanism.motion)
                                  if not _off(mechanism, effect, s) for n in s.needs))


def _off(mechanism: Mechanism, effect: Effect, spec: EffectParameter) -> bool:
    """Whether a parameter has its default permanently."""
    parameter = mechanism.parameters[effect.parameters[spec.name]]
    return parameter.value == spec.default and not parameter.free


def lacking(needs: Sequence[str], names: Sequence[str], on: Sequence[int],
            rows: Environment) -> list[str]:
    """Return which of the needed columns have no value at all."""
    out: list[str] = []
    for need in needs:
        if need in NO_COLUMN:
            continue
        if need == "order":
            direct = None if rows.history is None else rows.history.direct
            out += [ORDER for a in on if direct is None or not direct[a]][:1]
            continue
        if need in ("dir", "vel"):
            part = rows.approach if need == "dir" else rows.velocity
            out += [f"{need}_{n}" for n, a in zip(names, on, strict=True)
                    if not np.isfinite(part[:, a]).any()]
        elif need == "tension":
            out += [f"tension_{n}" for n, a in zip(names, on, strict=True)
                    if rows.tension is None or not np.isfinite(rows.tension[:, a]).any()]
        elif need in ("load", "wrench"):
            if not finite_rows(rows.wrench).any():
                out.append("payload")
        elif need == "past" and (rows.history is None or not rows.history.timed):
            out.append("time")
        elif need != "past" and not np.isfinite(getattr(rows, need)).any():
            out.append(need)
    return out
