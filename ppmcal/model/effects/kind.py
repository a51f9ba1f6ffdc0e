"""What an effect kind is: parameters, the columns it needs, what it adds, and its traits.

An effect knows slot and column names only; limbs know no effect, and the sum knows neither.
Whatever else the program asks of a kind (how a search scans it, what to draw it against, what
tells it apart) is a trait with a default here: no other place knows a kind by its name.
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
"""In the place of a kind: an error of slots, which is not an effect but the machine itself."""
SORTS = {"turning": ("joints that turn", "rotary actuators"), "ropes": ("ropes", "ropes")}
"""Of kinds that act on some sorts of joints only: what they are, and what to name."""


@dataclass(frozen=True)
class ScanRange:
    """What a scan of constants may know of the data.

    ``stroke``: the longest of the joints, m or rad; ``poses``: number of different ones;
    ``rows``: numbers of the rows in the campaign, in order; ``load``: the largest on an actuator,
    N or N m; ``size``, ``near``: largest and smallest distance of two joint centres of a body, m;
    ``moves``: of the joints from row to row, m or rad, the shortest first; ``step``, ``duration``:
    median time from row to row, and of the whole, s; ``speed``: median speed of the joints at the
    trigger, m/s or rad/s; ``joints``: what they measure, ``length``, ``angle`` or both.
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

    ``quantity``: ``length``, ``angle``, ``joint`` (whichever the actuator has), ``load``
    (its force in N or moment in N m), or a quotient such as ``joint/load``; ``1`` is a
    pure number. ``default`` None: the file must give it. ``low``, ``high``: the range in which
    it has a meaning, SI. ``usual``: the range in which machines have it, SI, or, with
    ``of_stroke``, in parts of the joint's stroke, with ``per_stroke``, of its inverse: a value
    outside is not named as this effect (``why``: where the range is from). ``size``: a change that
    counts, SI. ``constant``: never fitted. ``reciprocal``: the effect is linear in its
    inverse, in which a fit takes its steps. ``scan``: the values that a search tries, SI, of a
    parameter in which the effect is not linear; a plan has to be given it. ``stroke_end``:
    ``low`` or ``high``, for a constant that is that end of the stroke where the file leaves it
    open (nan). ``component``: of the wrench, ``fx`` ... ``mz``, without which the parameter does
    nothing; of several, as ``fx fz``, one is enough. ``optional``: at its default, which is 0, the
    kind is a plain one. A search tries that first, and one such parameter at a time; a plan leaves
    it there, and so does a file. ``needs``: further columns that it depends on where it is not at
    its default. ``scaling``: the effect nearly scales with it: at each value of its scan the
    effect, over that value, is a column, whose coefficient is the parameter. ``unless``: the kind
    of effect that is the same; where the model has one, a search leaves this at its default.
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
        """Whether what the effect adds is not this value times its derivative."""
        return self.scan is not None

    def usual_scale(self, stroke: float) -> float:
        """Return what ``usual`` is multiplied with to be in SI; ``stroke``: the longest."""
        return stroke if self.of_stroke else 1.0 / stroke if self.per_stroke else 1.0


STROKE = "ISO 230-2: errors of a drive are small parts of its stroke"


@dataclass(frozen=True)
class Terms:
    """What an effect adds: the shift (N rows), and its derivative by each parameter."""

    shift: Shift
    by: Mapping[str, Shift]


Evaluate = Callable[[Setting, Bools, Mapping[str, float]], Terms]
Spread = Callable[[Setting, Bools, Mapping[str, float]], Sequence[Shift]]
"""As an evaluation: the shifts of independent errors, one standard deviation each."""


class Unsettled(Protocol):
    """By how much an effect is another one for what was before the first row."""

    def __call__(self, setting: Setting, on: Bools, values: Mapping[str, float], /,
                 start: float = 1.0) -> Array:
        """Return it for a start between -1 and 1 (N, k), unit of u."""


@dataclass(frozen=True, eq=False)
class KnownRange:
    """Where an effect is known: its input from ``low`` to ``high``, SI.

    ``quantity``: of the input, ``deg C`` for temperatures; ``zero``: what files call SI's 0;
    ``value``: setting -> the input of each joint (N, k), or of the machine (N,).
    """

    input: str
    quantity: str
    low: float
    high: float
    zero: float
    value: Callable[[Setting], Array]

    def outside(self, setting: Setting, on: Bools) -> tuple[Array, Bools]:
        """Return the inputs that matter (N, j), and which of them are outside."""
        x = self.value(setting)
        x = x[:, None] if x.ndim == 1 else x[:, on]
        return x, (x < self.low) | (x > self.high)


@dataclass(frozen=True)
class Derived:
    """A figure that says more to people than the parameters that it follows from.

    A name that ends in ``_mid_stroke`` says that it, and those beside it, are taken there.

    ``quantity``: as that of a parameter; ``value``: (parameter -> value, middle of the measured
    stroke, m or rad) -> figure, SI.
    """

    name: str
    quantity: str
    value: Callable[[Mapping[str, float], float], float]


@dataclass(frozen=True)
class Reversal:
    """An effect that changes sides with the direction of approach, by which its sign says more.

    An encoder before what gives way (on the motor) reads on while the joint stays behind; one
    behind it is dragged along by the joint and stays behind itself. Both are machines.

    ``what``: gives way, ``play`` or ``wind-up``; ``ahead``: parameter -> value -> how far the
    joint is ahead of its reading after a move up, as far as its sign goes.
    """

    what: str
    ahead: Callable[[Mapping[str, float]], float]

    def side(self, values: Mapping[str, float]) -> str:
        """Return ``leads`` or ``lags``, what the joint does to its reading; empty: neither."""
        ahead = self.ahead(values)
        return "leads" if ahead > 0.0 else "lags" if ahead < 0.0 else ""


@dataclass(frozen=True)
class FromFile:
    """A kind that is made of what a file says beside kind, joints and parameters.

    ``entries``: their names; ``make``: (entry -> value as in the file, units of the file,
    ``length`` or ``angle`` of the joints) -> the kind. It raises BadInput, with the entry's name
    as the place.
    """

    entries: tuple[str, ...]
    make: Callable[[Mapping[str, object], Units, str], EffectKind]


def chosen_by(entry: str, default: str, kinds: Callable[[], Mapping[str, EffectKind]],
              wrong: str, hint: str) -> FromFile:
    """Return how a file chooses between kinds by a word.

    ``entry``: its name; ``default``: the word of a file that leaves it out; ``kinds``: gives word
    -> kind; ``wrong``, ``hint``: what is said of another word, which stands in the place of {}.
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
        equation: what it adds, one line.
        source: standard or paper.
        parameters: motion -> its parameters.
        needs: columns: ``dir``, ``vel``, ``temperature``, ``load``, ``wrench``, ``time``; ``row``;
            ``tension``: measured, or the load where that says it;
            ``touch``: of a flat; ``order``: of the rows, in which joints went straight from one to
            the next; ``past``: the rows' times, in all of the file.
        evaluate: (setting, on (k,), parameter -> value) -> :class:`Terms`.
        per_actuator: whether it belongs to single actuators; else to the whole machine.
        joints: ``any``, or one of :data:`SORTS`: which actuators it can act on.
        opposed: whether it acts on joints that pull while the others hold: as many as there are
            equations beyond the platform's freedoms.
        exists_in: motion -> whether machines of that motion can have it.
        uses_load: whether the shift depends on the pose, through the actuators' load or itself.
        gives: values -> how far its actuators give way per unit of a small load (joint/load), of a
            kind by which surplus limbs share what they carry.
        worked: a case with numbers: (parameters, setting changes, expected); see tests.
        derived: figures that follow from the parameters, told beside them.
        follows: what its residuals are plotted against; None: the first column that it needs, or
            the travel.
        remedy: what to measure or record that tells it from what looks alike.
        period: name of the parameter that is a period of the travel.
        onset: name of the parameter that is the row from which on it holds, until the next of its
            kind.
        instrument: whether it acts in the instrument: it is not sent to a controller.
        same_as: slots of the actuators' limbs with which, where they are free, it is one.
        by_sign: whether it knows but the load's sign, which a plan must not leave open.
        under_weight: whether it is an alternative where no load was recorded, by what a constant
            weight would make it do.
        doubt: columns whose unit is doubted where its size is none of a machine; empty: those
            that it needs.
        one_by_one: its parameters are causes of their own: a search tries each alone.
        carried: what the platform carries in place of what is known: (setting, values) -> weight
            (N, 3) and wrench (N, 6). Its own terms are none; it acts through the kinds that
            depend on the load, and is tried once one of them is in the model.
        from_file: of a kind that is only made of what a file says.
        written: of a kind that was made so: units of the file -> its entries.
        variants: motion -> the kinds that a search tries in its place; None: itself.
        contains: of a product, the kind whose size goes with a column.
        seldom: whether machines seldom have it.
        known: the ranges of its inputs beyond which nothing is known of it; none: everywhere.
        spread: what it is uncertain by beside its parameters, if anything.
        unsettled: by how much du is another one since nobody knows what was before the first row:
            (setting, on, values, start) -> (N, k), unit of u; start -1 to 1, what was; at 1, the
            default, it is the most that may be. None: the first row is like any other.
        reversal: what its sign says of where the encoder sits, if anything.
        nuisance: whether it is of what the machine is measured against: a search names it for
            nothing, and tells it as an alternative to what it explains as well.
        title: what people call it; empty: its name. Kinds made of one are distinguished by it.
        height: the parameter by which a rope's anchor is above the plane, of a kind that says so: a
            controller may have it among its anchors' coordinates.
        body: where one that is not of single actuators sits: ``base`` or ``platform``; empty: on
            no body of its own.
        of_target: data set's name -> the kind for one of several targets on the platform; None:
            what it does is the same to all. ``target``: of such a kind that name.
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
        """Refuse a name, column or period that means something else, or nothing (ValueError)."""
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
        """What people call it."""
        return self.title or self.name

    @property
    def input(self) -> EffectInput:
        """What its residuals are plotted against."""
        return self.follows or (BY_NEED[self.needs[0]] if self.needs else TRAVEL)

    @property
    def motions(self) -> list[Motion]:
        """Those in which it exists."""
        return [m for m in motions().values() if self.exists_in(m)]

    @property
    def refused(self) -> str:
        """Why it is refused where it does not exist."""
        *others, last = map(str, self.motions)
        names = f"{', '.join(others)} and {last}" if others else last
        return f"{self.name} exists only in {names} motion"

    def stroke_ends(self, motion: Motion) -> tuple[str, ...]:
        """Return the names of the constants that are the stroke's ends, low and high; or none."""
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
    """Return nothing: what a kind adds that acts through others, see ``EffectKind.carried``."""
    return Terms(Shift(), {name: Shift() for name in values})


def fixed_list(*parameters: EffectParameter) -> Callable[[Motion], tuple[EffectParameter, ...]]:
    """Return the same parameters for every motion."""
    return lambda motion: parameters


def linear(values: Mapping[str, float], by: Mapping[str, Shift]) -> Terms:
    """Return the terms of an effect that is linear in the parameters ``by`` names."""
    return Terms(total([s.times(values[p]) for p, s in by.items() if values[p] != 0.0]), by)


_REGISTRY: Registry[EffectKind] = Registry("effect", "ppmcal.effects")
register, effect_kinds = _REGISTRY.register, _REGISTRY.kinds


def find_effect(name: str, where: str = "") -> EffectKind:
    """Return the kind called ``name``, as :meth:`Registry.find`; functions pickle by name."""
    return _REGISTRY.find(name, where)
