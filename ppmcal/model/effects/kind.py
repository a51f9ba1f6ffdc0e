"""Effect kinds: parameters, required columns, contributions, and traits.

An effect refers only to slot and column names; limbs do not refer to effects, and the sum refers
to neither. Everything else that the program needs of a kind (how a search scans it, what to plot it
against, how to distinguish it) is a trait with a default here: no other place uses kinds by name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.linalg import Array, Bools
from ppmcal.model.effects.inputs import BY_NEED, TRAVEL, EffectInput
from ppmcal.model.effects.setting import Setting, Shift, total
from ppmcal.model.motions import OWN, Motion, motions
from ppmcal.model.registry import Registry
from ppmcal.units import Units

GEOMETRY = "geometry"
"""Used in place of a kind for an error of slots, which is not an effect but the machine itself."""
SORTS = {"turning": ("joints that turn", "rotary actuators"), "ropes": ("ropes", "ropes")}
"""For kinds that act only on some sorts of joints: the sort in words, and what to name."""


@dataclass(frozen=True)
class ScanRange:
    """Summary of the data for a scan of constants.

    ``stroke``: the longest of the joints, m or rad; ``poses``: number of different ones;
    ``rows``: numbers of the rows in the campaign, in order; ``load``: the largest on an actuator,
    N or N m; ``size``, ``near``: largest and smallest distance of two joint centres of a body, m;
    ``moves``: of the joints from row to row, m or rad, the shortest first; ``step``, ``duration``:
    median time from row to row, and total time, s; ``speed``: median speed of the joints at the
    trigger, m/s or rad/s; ``joints``: their quantities, ``length``, ``angle`` or both.
    """

    stroke: float
    poses: int
    rows: tuple[float, ...] = ()
    load: float = 0.0
    size: float = 0.0
    near: float = 0.0
    moves: tuple[float, ...] = ()
    step: float = 60.0
    duration: float = 3600.0
    speed: float = 0.01
    joints: frozenset[str] = frozenset()


@dataclass(frozen=True)
class EffectParameter:
    """One number of an effect.

    ``quantity``: ``length``, ``angle``, ``joint`` (either, as the actuator's), ``load`` (its force
    in N or moment in N m), or a quotient such as ``joint/load``; ``1`` is a pure number.
    ``default`` None: the file must give it. ``low``, ``high``: the meaningful range, SI.
    ``usual``: the range found in machines, SI, or as a fraction of the joint's stroke with
    ``of_stroke``, of its inverse with ``per_stroke``: a value outside is not named as this effect
    (``why``: source of the range). ``size``: a significant change, SI. ``constant``: never fitted.
    ``reciprocal``: the effect is linear in its inverse, in which a fit takes its steps. ``scan``:
    the values that a search tries, SI, for a parameter in which the effect is nonlinear; a plan
    requires a value for it. ``stroke_end``: ``low`` or ``high``, for a constant that defaults to
    that end of the stroke if the file leaves it open (nan). ``component``: of the wrench, ``fx``
    ... ``mz``, without which the parameter has no effect; of several, as in ``fx fz``, one is
    enough. ``optional``: at its default of 0 the kind is the plain one. A search tries that first,
    and one such parameter at a time; plans and files keep the default. ``needs``: further columns
    that it depends on unless at its default. ``scaling``: the effect nearly scales with it: at
    each value of its scan, the effect divided by that value is a column, whose coefficient is the
    parameter. ``unless``: an equivalent kind of effect; if the model has it, a search leaves this
    at its default.
    """

    name: str
    quantity: str
    default: float | None = 0.0
    low: float = -np.inf
    high: float = np.inf
    usual: tuple[float, float] = (-np.inf, np.inf)
    of_stroke: bool = False
    per_stroke: bool = False
    why: str = ""
    size: float = 1e-5
    constant: bool = False
    reciprocal: bool = False
    scan: Callable[[ScanRange], Sequence[float]] | None = None
    stroke_end: str = ""
    component: str = ""
    optional: bool = False
    needs: tuple[str, ...] = ()
    scaling: bool = False
    unless: str = ""

    @property
    def nonlinear(self) -> bool:
        """Whether the effect is nonlinear in this parameter."""
        return self.scan is not None

    def usual_scale(self, stroke: float) -> float:
        """Return the factor that brings ``usual`` to SI; ``stroke``: the longest."""
        return stroke if self.of_stroke else 1.0 / stroke if self.per_stroke else 1.0


STROKE = "ISO 230-2: errors of a drive are small parts of its stroke"


@dataclass(frozen=True)
class Terms:
    """Contribution of an effect: the shift (N rows), and its derivative by each parameter."""

    shift: Shift
    by: Mapping[str, Shift]


Evaluate = Callable[[Setting, Bools, Mapping[str, float]], Terms]
Spread = Callable[[Setting, Bools, Mapping[str, float]], Sequence[Shift]]
"""Like an evaluation: the shifts of independent errors, one standard deviation each."""


class Unsettled(Protocol):
    """How much an effect differs because of the unknown state before the first row."""

    def __call__(self, setting: Setting, on: Bools, values: Mapping[str, float], /,
                 start: float = 1.0) -> Array:
        """Return the difference for a start between -1 and 1 (N, k), unit of u."""


@dataclass(frozen=True, eq=False)
class KnownRange:
    """The range in which an effect is known: its input from ``low`` to ``high``, SI.

    ``quantity``: of the input, ``deg C`` for temperatures; ``zero``: the value in files that is 0
    in SI; ``value``: setting -> the input of each joint (N, k), or of the machine (N,).
    """

    input: str
    quantity: str
    low: float
    high: float
    zero: float
    value: Callable[[Setting], Array]

    def outside(self, setting: Setting, on: Bools) -> tuple[Array, Bools]:
        """Return the relevant inputs (N, j), and which of them are outside."""
        x = self.value(setting)
        x = x[:, None] if x.ndim == 1 else x[:, on]
        return x, (x < self.low) | (x > self.high)


@dataclass(frozen=True)
class Derived:
    """A figure derived from parameters that is easier to interpret than these.

    With a name ending in ``_mid_stroke``, it and its companions refer to the middle of the stroke.

    ``quantity``: like that of a parameter; ``value``: (parameter -> value, middle of the measured
    stroke, m or rad) -> figure, SI.
    """

    name: str
    quantity: str
    value: Callable[[Mapping[str, float], float], float]


@dataclass(frozen=True)
class Reversal:
    """An effect that reverses with the direction of approach, so that its sign has a meaning.

    An encoder on the motor side of the compliance or play moves on while the joint lags; one on the
    load side moves with the joint and lags itself. Both designs exist.

    ``what``: the cause, ``play`` or ``wind-up``; ``ahead``: parameter -> value -> how far the joint
    leads its reading after an upward move; only the sign counts.
    """

    what: str
    ahead: Callable[[Mapping[str, float]], float]

    def side(self, values: Mapping[str, float]) -> str:
        """Return whether the joint ``leads`` or ``lags`` its reading; empty: neither."""
        ahead = self.ahead(values)
        return "leads" if ahead > 0.0 else "lags" if ahead < 0.0 else ""


@dataclass(frozen=True)
class FromFile:
    """A kind that is built from entries of a file besides kind, joints and parameters.

    ``entries``: their names; ``make``: (entry -> value as in the file, units of the file,
    ``length`` or ``angle`` of the joints) -> the kind. It raises BadInput, with the entry's name
    as the place.
    """

    entries: tuple[str, ...]
    make: Callable[[Mapping[str, object], Units, str], EffectKind]


def chosen_by(entry: str, default: str, kinds: Callable[[], Mapping[str, EffectKind]],
              wrong: str, hint: str) -> FromFile:
    """Return a file entry that selects between kinds by a word.

    ``entry``: its name; ``default``: the word if the file leaves it out; ``kinds``: returns word
    -> kind; ``wrong``, ``hint``: message and hint for any other word, which replaces {}.
    """
    def made(entries: Mapping[str, object], units: Units, joint: str) -> EffectKind:
        word, known = entries.get(entry, default), kinds()
        if word not in tuple(known):
            raise BadInput(wrong.format(word), entry, hint)
        return known[str(word)]

    return FromFile((entry,), made)


@dataclass(frozen=True)
class EffectKind:
    """One kind of effect.

    Attributes:
        name: as in the file.
        equation: its contribution, one line.
        source: standard or paper.
        parameters: motion -> its parameters.
        needs: columns: ``dir``, ``vel``, ``temperature``, ``load``, ``wrench``, ``time``; ``row``;
            ``tension``: measured, or determined by the load;
            ``touch``: of a flat; ``order``: of the rows, in which joints moved straight from one to
            the next; ``past``: the rows' times, throughout the file.
        evaluate: (setting, on (k,), parameter -> value) -> :class:`Terms`.
        per_actuator: whether it belongs to single actuators; otherwise to the whole machine.
        joints: ``any``, or one of :data:`SORTS`: the actuators it can act on.
        opposed: whether it acts on joints that pull while the others hold: as many as there are
            surplus closure equations.
        exists_in: motion -> whether machines of that motion can have it.
        uses_load: whether the shift depends on the pose, directly or through the actuators' load.
        gives: values -> deflection of its actuators per unit of a small load (joint/load), for a
            kind that determines how redundant limbs share the load.
        worked: a case with numbers: (parameters, setting changes, expected); see tests.
        derived: figures derived from the parameters, reported with them.
        follows: what its residuals are plotted against; None: the first column that it needs, or
            the travel.
        remedy: what to measure or record to distinguish it from similar effects.
        period: name of the parameter that is a period of the travel.
        onset: name of the parameter that is the row at which it starts, until the next of its kind.
        instrument: whether it acts in the instrument, so that it is not sent to a controller.
        same_as: slots of the actuators' limbs with which, if free, it coincides.
        by_sign: whether it depends only on the load's sign, which a plan must not leave open.
        under_weight: whether it is an alternative if no load was recorded, by its effect under a
            constant weight.
        doubt: columns whose unit is doubted if its size is implausible; empty: those it needs.
        one_by_one: its parameters are separate causes: a search tries each alone.
        carried: the load on the platform, replacing the known one: (setting, values) -> weight
            (N, 3) and wrench (N, 6). It has no terms itself, but acts through kinds that depend on
            the load, and is tried once one of them is in the model.
        from_file: for a kind built from file entries.
        written: for such a kind: units of the file -> its entries.
        variants: motion -> the kinds that a search tries in its place; None: itself.
        contains: for a product, the kind whose size varies with a column.
        seldom: whether machines rarely have it.
        known: the ranges of its inputs outside which it is unknown; none: known everywhere.
        spread: its uncertainty beyond that of its parameters, if any.
        unsettled: how much du differs because of the unknown state before the first row:
            (setting, on, values, start) -> (N, k), unit of u; start: that state, -1 to 1; the
            default of 1 gives the maximum. None: no memory.
        reversal: what its sign says about the encoder's position, if anything.
        nuisance: whether it is an error of the measurement reference: a search never names it, but
            reports it as an alternative to what it explains equally well.
        title: its usual name; empty: ``name``. Variants of one kind are distinguished by it.
        height: for such a kind, the parameter that is a rope anchor's height above the plane: a
            controller may have it among its anchor coordinates.
        body: if not of single actuators, the body it belongs to: ``base`` or ``platform``; empty:
            none.
        of_target: data set name -> the kind for one of several targets on the platform; None:
            its effect is the same for all. ``target``: that name, for such a kind.
    """

    name: str
    equation: str
    source: str
    parameters: Callable[[Motion], tuple[EffectParameter, ...]]
    needs: tuple[str, ...]
    evaluate: Evaluate
    per_actuator: bool = True
    joints: str = "any"
    opposed: bool = False
    exists_in: Callable[[Motion], bool] = lambda motion: True
    uses_load: bool = False
    gives: Callable[[Mapping[str, float]], float] | None = None
    worked: Worked | None = None
    derived: tuple[Derived, ...] = ()
    follows: EffectInput | None = None
    remedy: str = ""
    period: str = ""
    onset: str = ""
    instrument: bool = False
    same_as: tuple[str, ...] = ()
    by_sign: bool = False
    under_weight: bool = False
    doubt: str = ""
    one_by_one: bool = False
    carried: Callable[[Setting, Mapping[str, float]], tuple[Array, Array]] | None = None
    from_file: FromFile | None = None
    written: Callable[[Units], Mapping[str, object]] | None = None
    variants: Callable[[Motion], Sequence[EffectKind]] | None = None
    contains: tuple[str, ...] = ()
    seldom: bool = False
    known: tuple[KnownRange, ...] = ()
    spread: Spread | None = None
    unsettled: Unsettled | None = None
    title: str = ""
    body: str = ""
    reversal: Reversal | None = None
    nuisance: bool = False
    height: str = ""
    of_target: Callable[[str], EffectKind] | None = None
    target: str = ""

    def __post_init__(self) -> None:
        """Reject a reserved name, an unknown column or a period without a scan (ValueError)."""
        if self.name == GEOMETRY:
            raise ValueError(f"effect '{GEOMETRY}' is an error of slots already")
        mine = [m for m in OWN if self.exists_in(m)]
        asked = {n for m in mine for s in self.parameters(m) for n in s.needs}
        strange = [n for n in (*self.needs, *sorted(asked)) if n not in BY_NEED]
        if strange:
            raise ValueError(f"effect '{self.name}' needs {', '.join(strange)}; "
                             f"columns are {', '.join(BY_NEED)}")
        if self.period and any(self.period not in [s.name for s in self.parameters(m) if s.scan]
                               for m in mine):
            raise ValueError(f"effect '{self.name}': the period '{self.period}' is not a "
                             "parameter with a scan")

    @property
    def label(self) -> str:
        """Its usual name."""
        return self.title or self.name

    @property
    def input(self) -> EffectInput:
        """What its residuals are plotted against."""
        return self.follows or (BY_NEED[self.needs[0]] if self.needs else TRAVEL)

    @property
    def motions(self) -> list[Motion]:
        """The motions in which it exists."""
        return [m for m in motions().values() if self.exists_in(m)]

    @property
    def refused(self) -> str:
        """The message for motions in which it does not exist."""
        *others, last = map(str, self.motions)
        names = f"{', '.join(others)} and {last}" if others else last
        return f"{self.name} exists only in {names} motion"

    def stroke_ends(self, motion: Motion) -> tuple[str, ...]:
        """Return the names of the constants for the stroke's ends, low and high, if any."""
        ends = {s.stroke_end: s.name for s in self.parameters(motion)}
        return tuple(ends[e] for e in ("low", "high") if e in ends)


@dataclass(frozen=True)
class Worked:
    """A worked case: one actuator or pose coordinate, plain numbers.

    ``setting``: field -> number for a single row, ``travel_before`` ... of the row before it, at
    time 0; ``values``: the parameters;
    ``result``: the change of u of the actuator, of the first changed slot, of the first
    pose coordinate, of a measured 1 m or of the wrench, SI.
    """

    values: Mapping[str, float]
    setting: Mapping[str, float]
    result: float


def no_terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Return empty terms, for a kind that acts through others, see ``EffectKind.carried``."""
    return Terms(Shift(), {name: Shift() for name in values})


def fixed_list(*parameters: EffectParameter) -> Callable[[Motion], tuple[EffectParameter, ...]]:
    """Return the same parameters for every motion."""
    return lambda motion: parameters


def linear(values: Mapping[str, float], by: Mapping[str, Shift]) -> Terms:
    """Return the terms of an effect that is linear in the parameters named in ``by``."""
    return Terms(total([s.times(values[p]) for p, s in by.items() if values[p] != 0.0]), by)


_REGISTRY: Registry[EffectKind] = Registry("effect", "ppmcal.effects")
register, effect_kinds = _REGISTRY.register, _REGISTRY.kinds


def find_effect(name: str, where: str = "") -> EffectKind:
    """Return the kind called ``name``, like :meth:`Registry.find`; functions pickle by name."""
    return _REGISTRY.find(name, where)
