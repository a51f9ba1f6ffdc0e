"""Product: an effect whose size varies with a recorded column, as backlash with temperature."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ppmcal.errors import BadInput, unknown
from ppmcal.linalg import Array, Bools
from ppmcal.model.effects.backlash import BACKLASH
from ppmcal.model.effects.kind import (
    EffectKind,
    EffectParameter,
    FromFile,
    Terms,
    Worked,
    effect_kinds,
    register,
)
from ppmcal.model.effects.lag import LAG
from ppmcal.model.effects.setting import Setting, total
from ppmcal.model.motions import OWN, Motion
from ppmcal.units import Units


@dataclass(frozen=True)
class Factor:
    """A column with which the size of an effect may vary.

    ``need``: of the kind; ``per``: its unit, empty for a pure number; ``value``: (setting,
    constants) -> factor of the rows (N, 1) or (N, k); ``further``: constants.
    """

    need: tuple[str, ...]
    per: str
    value: Callable[[Setting, Mapping[str, float]], Array]
    further: tuple[EffectParameter, ...] = ()


def _along(setting: Setting, values: Mapping[str, float]) -> Array:
    """Return each joint's position in its stroke, -1 to 1 from ``low`` to ``high`` (N, k)."""
    low = np.where(np.isnan(values["low"]), setting.stroke[:, 0], values["low"])
    high = np.where(np.isnan(values["high"]), setting.stroke[:, 1], values["high"])
    return np.asarray((2.0 * setting.travel - low - high) / (high - low))


FACTORS = {
    "temperature": Factor(("temperature",), "K", lambda at, _: at.temperature[:, None]),
    "travel": Factor((), "", _along, tuple(
        EffectParameter(n, "joint", np.nan, constant=True, stroke_end=n) for n in ("low", "high"))),
}


def product(kind: EffectKind, column: str) -> EffectKind:
    """Return the kind with the effect of ``kind``, of a size that varies with a column.

    The zero of the column is a convention, so the size at zero has separate parameters: without
    them results would depend on it (Nelder, J. R. Stat. Soc. A 140 (1977) 48, marginality).

    ``kind``: of single actuators, linear in its parameters; ``column``: of :data:`FACTORS`.
    """
    factor = FACTORS[column]
    own = {s.name for s in factor.further}

    def evaluate(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
        growing = {n: v for n, v in values.items() if n not in own and not n.endswith(AT_ZERO)}
        more = kind.evaluate(setting, on, growing)
        plain = kind.evaluate(setting, on, {n: values[n + AT_ZERO] for n in growing})
        rows = np.broadcast_to(factor.value(setting, values), setting.travel.shape)
        return Terms(total([plain.shift, setting.scaled(more.shift, rows)]),
                     {**{n: setting.scaled(s, rows) for n, s in more.by.items()},
                      **{n + AT_ZERO: s for n, s in plain.by.items()}})

    def parameters(motion: Motion) -> tuple[EffectParameter, ...]:
        plain = kind.parameters(motion)
        return (*(_of(s, factor.per) for s in plain),
                *(replace(s, name=s.name + AT_ZERO, default=0.0, unless=kind.name) for s in plain),
                *factor.further)

    return EffectKind(
        "product", f"({kind.equation}), its size s_0 + s {EQUATIONS[column]}", kind.source,
        parameters,
        (*kind.needs, *factor.need), evaluate, joints=kind.joints, exists_in=kind.exists_in,
        uses_load=kind.uses_load, follows=kind.input,
        remedy=f"measure the same poses at several values of the {column}, from both sides",
        from_file=FILE, written=lambda units: {"of": [kind.name, column]},
        contains=(kind.name,), title=f"{kind.label} x {column}")


EQUATIONS = {"temperature": "(T - 20 C)", "travel": "(where u is in its stroke, -1 to 1)"}
AT_ZERO = "_0"
SEEN = 10.0
"""Typical range of a column, in its units, for the limits of sizes: K by which a hall warms up."""


def _of(spec: EffectParameter, per: str) -> EffectParameter:
    """Return a parameter of the product: per unit of the column, of either sign."""
    above, _, below = spec.quantity.partition("/")
    quantity = spec.quantity if not per else f"{above}/{below}.{per}" if below else f"{above}/{per}"
    most = max(map(abs, spec.usual)) / (SEEN if per else 1.0)
    return replace(spec, quantity=quantity, low=-np.inf, high=np.inf, usual=(-most, most))


def _made(entries: Mapping[str, object], units: Units, joint: str) -> EffectKind:
    """Return the product named in a file.

    Raises:
        BadInput: no `of`, or a kind or column that cannot form a product.
    """
    of = entries.get("of")
    if not isinstance(of, list) or len(of) != 2:
        raise BadInput("a product needs a kind and a column", "of",
                       "Write `of: [backlash, temperature]`")
    name, column = map(str, of)
    if column not in FACTORS:
        raise unknown("column of a product", column, FACTORS, "of[2]")
    if name not in effect_kinds():
        raise unknown("effect", name, effect_kinds(), "of[1]")
    kind = effect_kinds()[name]
    if not _linear(kind):
        raise BadInput(f"{name} cannot form a product", "of[1]", "Choose one of " + ", ".join(
            n for n, k in effect_kinds().items() if _linear(k)))
    return product(kind, column)


def _linear(kind: EffectKind) -> bool:
    """Whether a kind acts on single actuators and is linear in all its parameters."""
    return kind.per_actuator and not kind.from_file and all(
        not (s.nonlinear or s.constant or s.reciprocal)
        for m in OWN if kind.exists_in(m) for s in kind.parameters(m))


FILE = FromFile(("of",), _made)
TRIED = tuple(product(kind, column) for kind, column in (
    (BACKLASH, "temperature"), (BACKLASH, "travel"), (LAG, "temperature")))
"""Products that a search tries: warming grease, a screw worn in its middle. Each one tried makes
all others harder to name."""

PRODUCT = register(replace(
    TRIED[0], title="", variants=lambda motion: TRIED,
    worked=Worked({"width": 2e-6, "width_0": 4e-6},
                  {"approach": -1.0, "temperature": 5.0, "travel": 0.3}, -7e-6)))
