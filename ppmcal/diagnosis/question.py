"""A linearised fit as an inference: which blocks of columns, next to geometry, are present."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal.calibration.fit import Problem, by_defining, prior_weights, to_prior
from ppmcal.diagnosis.at_sessions import Form, priors
from ppmcal.diagnosis.hypotheses import Hypothesis, Library
from ppmcal.diagnosis.library_columns import Products
from ppmcal.diagnosis.linear_system import System
from ppmcal.diagnosis.unknown_causes import (
    MOST_PLACES,
    UNKNOWN_FAMILY,
    UnknownCause,
    UnknownCauses,
)
from ppmcal.inference.blocks import Block
from ppmcal.inference.columns import JoinedColumns, MatrixColumns, UnitColumns
from ppmcal.inference.priors import (
    ALL_ALIKE,
    FAMILY,
    FIRST_READING,
    GOES_WITH,
    GROSS_ROW,
    MISREAD,
    NOISE_FREEDOM,
    OWN_NOISE_FREEDOM,
    PLAIN,
    SELDOM,
    SHAPES,
    UNKNOWN,
    WIDE,
)
from ppmcal.inference.question import Question
from ppmcal.linalg import Array, Bools, reciprocals
from ppmcal.model.effects.product import PRODUCT


@dataclass(frozen=True)
class WrongRows:
    """Outlying rows of a system: one row, or all of a file that may be of another machine."""

    rows: tuple[int, ...]
    label: str


Source = Hypothesis | UnknownCause | WrongRows
"""What a block represents."""


@dataclass(frozen=True, eq=False)
class LibrarySource:
    """A library's columns (T) over flat values (N m,), zero where not observed."""

    products: Products
    observed: Bools

    @property
    def count(self) -> int:
        """Number of columns."""
        return self.products.shape[0]

    def along(self, values: Array) -> Array:
        """Return the inner products (T, b) of all columns with values (n, b)."""
        return self.products.along(values.reshape(*self.observed.shape, -1)
                                   * self.observed[..., None])

    def some(self, which: Sequence[int]) -> Array:
        """Return the columns (n, k) with these indices."""
        values = self.products.some(which) * self.observed[..., None]
        return np.asarray(values.reshape(self.observed.size, -1))


@dataclass(frozen=True, eq=False)
class Asked:
    """A question, and what each of its blocks represents."""

    question: Question
    system: System
    sources: tuple[Source, ...]


def question(system: System, library: Library, unknown: UnknownCauses,
             added: Sequence[int] = ()) -> Asked:
    """Return the question of what the residuals of a fit contain besides geometry.

    ``added``: see :func:`at_nominal`.
    """
    observed = system.observed
    first = library.count + unknown.columns.count
    of_places, caught = places(system, unknown.zeros_of_joints, first + observed.size)
    columns = JoinedColumns((LibrarySource(library.products, observed), unknown.columns,
                             UnitColumns(observed.size), MatrixColumns(caught)))
    every: list[tuple[Block, Source]] = [*blocks(library, unknown.least),
                                         *unknown.blocks(library.count), *rows(system, first),
                                         *of_places,
                                         *files(system, first)]
    asked = Question(columns, *at_nominal(system, added), tuple(b for b, _ in every), observed,
                     system.apart, frozenset({ROW_FAMILY}), noise_freedom(system))
    return Asked(asked, system, tuple(source for _, source in every))


def at_nominal(system: System, added: Sequence[int] = ()) -> tuple[Array, Array]:
    """Return residuals (N m,) linearised back to the nominal machine, and its geometry (N m, c).

    The geometry is scaled by its prior root, so that tolerances are its prior whatever the fit
    found; held parameters that define the frames are included, since their errors shift all others
    together. ``added``: columns of the problem that belong to effects under test, which the
    system's Jacobian no longer contains.
    """
    problem, observed = system.problem, system.observed
    scale = system.jacobian_scale
    away = -to_prior(problem, system.state) / scale
    weight = prior_weights(problem, "prior") * scale
    prior = reciprocals(weight, float(WIDE))
    rest = [c for c in range(scale.size) if c not in set(added)]
    flat = system.jacobian.reshape(observed.size, -1) * observed.reshape(-1, 1)
    values = system.residual.reshape(-1) * observed.reshape(-1) + flat @ away[rest]
    return values, np.hstack([flat * prior[rest], _of_frames(problem, flat, scale, rest)])


def _of_frames(problem: Problem, flat: Array, scale: Array, rest: Sequence[int]) -> Array:
    """Return the effects of errors in parameters that define the frames (N m, G), one sigma each.

    ``flat``: columns ``rest`` of the Jacobian, in units of ``scale``, those of parameters first.
    """
    machine, free = problem.mechanism, [c for c in rest if c < len(problem.free)]
    if not machine.defining:
        return flat[:, :0]
    moves = by_defining(machine, problem.datasets, [problem.free[c] for c in free])
    sigma = [machine.parameters[p].prior_sigma or float(WIDE) for p in machine.defining]
    return np.asarray(flat[:, :len(free)] / scale[free] @ moves * sigma)


def noise_freedom(system: System) -> float:
    """Return the effective degrees of freedom with which the noise of the files is known."""
    own = all(d.estimated for d in system.problem.datasets)
    return float(OWN_NOISE_FREEDOM if own else NOISE_FREEDOM)


BEGINS = "with each session"
"""A change of all joints with each session, required by that in the first session."""
BY_JOINT = ("dir", "vel")
"""Inputs that are separate for each joint."""
ROW_FAMILY = "row"
"""The family of outlying rows: a wrong point, a typo, a broken beam."""


FILE_FAMILY = "file"
"""The family of files that are outliers as a whole: of another machine, or meaningless."""
NO_CAUSES = (ROW_FAMILY, FILE_FAMILY)
"""Families that are not causes in the machine."""


def rows(system: System, first: int) -> Iterator[tuple[Block, WrongRows]]:
    """Yield an outlier block for each row; ``first``: number of its first column.

    If joint values alone are read several times at a stop, the first reading is off more often.
    """
    observed, settling = system.observed, first_readings(system)
    width = observed.shape[1]
    for n, seen in enumerate(observed):
        own = np.flatnonzero(seen)
        if own.size:
            prior = FIRST_READING if settling[n] else GROSS_ROW
            yield Block(f"row {n}", ROW_FAMILY,
                        tuple((first + n * width + own).tolist()),
                        float(np.log(float(prior)))), WrongRows((n,), f"row {n}")


def first_readings(system: System) -> Bools:
    """Return which rows are the first of several readings of joint values alone at a stop (N,)."""
    _, begin, place, count = np.unique(system.group, return_index=True, return_inverse=True,
                                       return_counts=True)
    place = place.reshape(-1)
    return np.asarray(system.blind & (count[place] > 1) & (begin[place] == np.arange(place.size)))


def places(system: System, zeros: Mapping[str, Array], first: int
           ) -> tuple[list[tuple[Block, Source]], Array]:
    """Return an outlier block for all rows of a stop, on redundant machines or for joint readings.

    A limb that was slack or caught at a stop was so in all its rows, by the same amount: one column
    for each joint. ``zeros``: column of each joint's zero (N, m). ``first``: number of the first
    column.

    Returns:
        The blocks, and their columns (N m, c).
    """
    held = system.blind | (system.problem.mechanism.surplus > 0)
    found: list[tuple[Block, Source]] = []
    columns = [np.zeros((system.observed.size, 0))]
    group, count = np.unique(system.group[held], return_counts=True)
    for place in group[count > 1][:MOST_PLACES]:
        mine = np.flatnonzero((system.group == place) & held)
        own = np.zeros((*system.observed.shape, len(zeros)))
        own[mine] = np.stack([unit[mine] for unit in zeros.values()], axis=-1)
        label = f"rows {mine[0]} to {mine[-1]}"
        found.append((Block(label, ROW_FAMILY, tuple(first + np.arange(len(zeros))),
                            float(np.log(float(GROSS_ROW)))), WrongRows(tuple(mine.tolist()),
                                                                        label)))
        columns.append(own.reshape(system.observed.size, -1))
        first += len(zeros)
    return found, np.hstack(columns)


def files(system: System, first: int) -> Iterator[tuple[Block, WrongRows]]:
    """Yield an outlier block for each of several files; ``first``: see :func:`rows`.

    Long files are omitted: if one is of another machine, earlier checks show it.
    """
    width = system.observed.shape[1]
    for d, data in enumerate(system.problem.datasets if len(system.problem.datasets) > 1 else ()):
        mine = np.flatnonzero(system.dataset == d)
        own = (mine[:, None] * width + np.arange(width))[system.observed[mine]]
        if mine.size > 1 and own.size <= MOST_PLACES:
            yield (Block(data.name, FILE_FAMILY, tuple((first + own).tolist()),
                         float(np.log(float(MISREAD)))),
                   WrongRows(tuple(mine.tolist()), f"{data.name} is of another machine"))


def blocks(library: Library, least: float = 0.0
           ) -> Iterator[tuple[Block, Hypothesis | UnknownCause]]:
    """Yield the library's hypotheses as blocks with their priors; ``least``: see :class:`Block`."""
    families: dict[str, dict[Form, list[Hypothesis]]] = defaultdict(lambda: defaultdict(list))
    yield from ((_block(h, h.family, log_prior, least), h) for h, log_prior in priors(
        [h for h in library.hypotheses if h.begins], _shares))
    for h in (h for h in library.hypotheses if not h.begins):
        families[_family(h)][h.on, h.shared].append(h)
    cut = {(_family(h), h.on) for h in library.hypotheses if h.sessions}
    firsts = {family: next(iter(forms.values()))[0] for family, forms in families.items()}
    alike = Counter(_sort(h) for h in firsts.values())
    each: dict[tuple[str, Form, bool], float] = {}
    for family, forms in families.items():
        top = float(np.log(_prior(firsts[family]) / alike[_sort(firsts[family])]))
        share = _shares(list(forms))
        for form, own in forms.items():
            among = Counter(h.scanned for h in own if not h.sessions)
            for scanned, count in among.items():
                part = 1.0 if len(among) == 1 else (
                    1.0 - float(PLAIN) if scanned else float(PLAIN))
                each[family, form, scanned] = top + float(np.log(share[form] * part / count))
            for h in own:
                goes = float(GOES_WITH) if h.sessions else 1.0 - float(GOES_WITH)
                one = (family, h.on) in cut and h.shared and not h.scanned
                block = _block(h, family, each[family, form, h.scanned]
                               + one * float(np.log(goes)), least)
                yield block, h
                if h.effect is not None and _one_sign(h) and not (h.scanned or h.requires):
                    yield _opposite(block)
    for h in library.misread:
        right = replace(h, misread="", follows="")
        log_prior = each[right.family, (h.on, h.shared), h.scanned] + float(np.log(float(MISREAD)))
        yield _block(h, h.family, log_prior - h.choices, least), h


def _one_sign(h: Hypothesis) -> bool:
    """Whether physics fixes the sign of all coefficients of an effect."""
    low, high = _range(h)
    return min(low) >= 0.0 or max(high) <= 0.0


def _opposite(block: Block) -> tuple[Block, UnknownCause]:
    """Return an effect with the sign that physics forbids, which is an unknown cause."""
    name = f"{block.name} of the opposite sign"
    low, high = (tuple(-end for end in ends.tolist()) for ends in reversed(block.ends))
    own = len(block.columns) - len(block.starts)
    log_prior = block.log_prior + float(np.log(float(MISREAD)))
    cause = UnknownCause(name, len(block.columns), (), float(np.exp(log_prior)) / float(UNKNOWN))
    return replace(block, name=name, family=UNKNOWN_FAMILY, form=name, group="", where="", gives="",
                   log_prior=log_prior, low=low[:own], high=high[:own]), cause


def _prior(h: Hypothesis) -> float:
    """Return the prior that one of the families of a sort is present."""
    if h.anonymous:
        return float(UNKNOWN) * SHAPES.value
    seldom = h.effect is not None and h.effect.seldom
    return float(FAMILY) * (float(SELDOM) if seldom else 1.0) * (
        float(GOES_WITH) if h.effect and h.kind == PRODUCT.name else 1.0)


def _sort(h: Hypothesis) -> object:
    """Return the sort of families that share a prior: similar slots, parts of a kind, products."""
    if h.effect is None:
        return (h.sort, h.anonymous)
    if h.part:
        return h.called
    if h.effect.target:
        return (h.kind, "one of several targets")
    return (h.kind, h.effect.contains) if h.kind == PRODUCT.name else _family(h)


def _block(h: Hypothesis, family: str, log_prior: float, least: float) -> Block:
    low, high = _range(h)
    gives = _place(h.kind, h.on) if h.shared and not h.sessions else ""
    needs = _place(*h.requires) if h.requires else ""
    if h.begins and not h.shared:
        gives, needs = ("", f"{h.kind} {BEGINS}") if h.beside else (f"{h.kind} {BEGINS}", "")
    return Block(h.label, family, (*h.columns, *(c for c, _ in h.starts)), log_prior,
                 low=low, high=high, group=_group(h, family),
                 starts=tuple(of for _, of in h.starts), least=least,
                 where="" if h.anonymous or h.misread else " ".join(h.on),
                 subject=" ".join(h.on) if h.anonymous else "",
                 # a dependent effect is proportional to one size, not to several different ones
                 gives=gives, needs=needs, ratio=h.ratio,
                 reads=_inputs(h), way=f"{h.misread} {h.follows}".rstrip())


def _inputs(h: Hypothesis) -> frozenset[str]:
    """Return the recorded inputs that an effect uses, those of joints by joint."""
    needs = h.effect.needs if h.effect else ()
    return frozenset(f"{name} {joint}" for name in needs
                     for joint in ((h.on or ("",)) if name in BY_JOINT else ("",)))


def _group(h: Hypothesis, family: str) -> str:
    """Return the group of similar hypotheses that often occur together.

    Events of a kind, frozen slots of a sort, joints with the same effect each on its own; whatever
    is set up again with one session often is with every session.
    """
    if h.slot:
        return f"{h.kind} {h.sort}"
    if h.begins and (not h.shared or not h.on):
        return "" if h.beside else f"{family} {BEGINS}"
    if h.effect is not None and h.effect.onset:
        return f"{family} on {' '.join(h.on)} {h.shared}"
    by = " by session" if h.sessions else ""
    return f"{family} of a joint{by}" if len(h.on) == 1 and not h.misread else ""


def _place(kind: str, on: Sequence[str]) -> str:
    return f"{kind} on {' '.join(on)}"


def _family(h: Hypothesis) -> str:
    if h.anonymous:
        return UNKNOWN_FAMILY
    return h.family


def _shares(forms: Sequence[Form]) -> dict[Form, float]:
    """Return the prior of each set of actuators, given that its family is present."""
    several = [f for f in forms if len(f[0]) > 1]
    single = [f for f in forms if len(f[0]) <= 1]
    every = float(ALL_ALIKE) if several and single else 1.0
    return {f: (every / len(several) if f in several else
                (1.0 - every if several else 1.0) / len(single)) for f in forms}


def _range(h: Hypothesis) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the bounds of its coefficients: the physical and usual ranges intersected."""
    free = ((-np.inf, np.inf),) * h.size
    ends = np.array([tuple(zip(h.low, h.high, strict=True)), h.usual or free])
    return tuple(ends[..., 0].max(axis=0).tolist()), tuple(ends[..., 1].min(axis=0).tolist())
