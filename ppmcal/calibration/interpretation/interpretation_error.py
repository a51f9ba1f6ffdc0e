"""The refusal of files that were read wrongly: what is wrong, and the lines that correct it."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ppmcal.errors import NoResult
from ppmcal.model.dataset import Dataset
from ppmcal.units import SI, Units

HINTS = {
    "other-machine": "Is this the right mechanism file? If the machine really is that far from "
                     "nominal, give larger tolerances, or --prior flat",
    "shuffled": "No sidecar entry can correct that: put the measurements back into the order of "
                "the joint values at their source, or leave those rows out",
    "home": "Measure where the platform stands at home's joint values, and correct the home pose "
            "and the offsets with it. Or give `offset` tolerances of that size: the fit finds "
            "offsets then",
    "assembly": "Write that place as the home pose, and the other `elbow` or `branch` of limbs "
                "whose joint values at home are not those",
    "zero": "Correct these joints' offsets, or give `offset` tolerances of that size: the fit "
            "finds offsets then",
    **{key.replace("_", "-"): f"Write into the sidecar: `{key}: unknown`"
       for key in ("frame", "target", "target_rotation")},
    "offset": "Write into the sidecar: `instrument: {offset: unknown}`"}
"""What only the user can correct, by kind of mistake."""
PLAIN = ("stale", "outside-limits")
"""Kinds that name their rows and are not another reading of them."""


PLAIN_WORD = re.compile(r"[A-Za-z_][\w ./*?-]*")
"""Words that YAML takes as they stand."""
NOISE = "times the noise"
"""In the place of a quantity: residuals over the noise, no length or angle."""


@dataclass(frozen=True)
class FileFault:
    """One way in which a file is not what it was read as.

    ``kind``: permuted, sign, unit, rotation, inverse, mirrored, exchanged, shifted, stale,
    outside-limits, joint, home, zero, assembly or radius; ``columns`` that it concerns; ``text``:
    in words; ``rows``: where not all of them, by number in the CSV.
    """

    kind: str
    columns: tuple[str, ...]
    text: str
    rows: tuple[int, ...] = ()


@dataclass(frozen=True)
class Interpretation:
    """A file that was read wrongly, and how it is to be read.

    Attributes:
        source: the CSV.
        mistakes: what is wrong in it; ``block``: the sidecar's ``read`` that corrects it, None
            where only the user can.
        quantity: of ``before`` and ``after``, the median misses, m or rad, that tell most; nan
            where nothing was compared.
        noise_after: what a short fit leaves, times the noise.
        headers: of the file -> those to write in their place, where a wrong unit stands in them:
            the sidecar has no say in these.
        sigma: entries of the sidecar's ``instrument.sigma`` that are in the columns' unit too.
        at: the joint that is to be the sidecar's ``instrument.at``; empty where that is right.
        alternatives: other mistakes that explain the file as well, and change no more of it;
            ``alternative_blocks``: as ``block``, where each of them has one of its own;
            ``alike``: what they have in common with the mistakes, in words.
        right: the data set read so, None where nothing was compared.
    """

    source: str
    mistakes: tuple[FileFault, ...]
    block: dict[str, object] | None = None
    quantity: str = NOISE
    before: float = np.nan
    after: float = np.nan
    noise_after: float = np.nan
    sigma: Mapping[str, float] = field(default_factory=dict)
    alternatives: tuple[tuple[FileFault, ...], ...] = ()
    right: Dataset | None = field(default=None, compare=False, repr=False)
    headers: Mapping[str, str] = field(default_factory=dict)
    at: str = ""
    alternative_blocks: tuple[dict[str, object], ...] = ()
    alike: str = ""

    @property
    def otherwise(self) -> str:
        """The alternatives in words, to be put behind those of the mistakes; empty without any."""
        others = "".join(", or: " + " and ".join(m.text for m in way) for way in self.alternatives)
        return f"{others}; {self.alike}" if self.alike else others


class InterpretationError(NoResult):
    """Measurements that are not of this machine as the files are read (exit code 3).

    ``found``: how they are to be read, by data set; empty where nothing explains them.
    ``units``: of the machine's file.
    """

    found: tuple[Interpretation, ...] = ()
    units: Units = SI

    @classmethod
    def of(cls, found: Sequence[Interpretation], units: Units) -> InterpretationError:
        """Return the refusal that names the mistakes and the lines that correct them."""
        several = len({m.source for m in found}) > 1
        # what all targets of a file share, each of them shows
        what = "; ".join(dict.fromkeys(
            f"{m.source}: " * several + interpretation_sentence(m, units) for m in found))
        error = cls(what, ", ".join(dict.fromkeys(m.source for m in found)), hint_of(found))
        error.found, error.units = tuple(found), units
        return error


def interpretation_sentence(found: Interpretation, units: Units) -> str:
    """Return what is wrong in a file, and the evidence."""
    factor, unit = units.factor(found.quantity), units.name(found.quantity)
    what = " and ".join(m.text for m in found.mistakes) + found.otherwise
    if np.isnan(found.after):
        return what
    if found.quantity == NOISE:
        return f"{what}: residuals fall from {found.before:.3g} to {found.after:.3g} {NOISE}"
    before = (f"read so, the median error drops from {found.before / factor:.3g} to"
              if np.isfinite(found.before) else
              # of another quantity before, where the encoder is at a joint of another sort
              "hardly a row had a pose; " * (not found.at) + "read so, the median error is")
    return (f"{what}: {before} {found.after / factor:.3g} {unit}, and a short fit leaves "
            f"{found.noise_after:.2g} times the noise")


_UNIT = re.compile(r"[^\s\[\]()]+(?=\s*[\])]\s*$)")


def with_unit(header: str, unit: str) -> str:
    """Return a header with another unit in its brackets.

    >>> with_unit("T1_x [mm]", "cm")
    'T1_x [cm]'
    """
    return _UNIT.sub(unit, header)


def headers_of(data: Dataset, columns: Sequence[str], unit: str) -> dict[str, str]:
    """Return the headers of columns in which another unit stands, and how to write each."""
    return {data.headed[c][0]: with_unit(data.headed[c][0], unit) for c in columns
            if c in data.headed}


def in_headers(headers: Mapping[str, str], source: str) -> str:
    """Return the headers to change in a file, as the end of a sentence; empty for none."""
    words = ", ".join(f"`{new}` for `{old}`" for old, new in headers.items())
    return f"in the header of {source} {words}" if words else ""


def lines_for(block: Mapping[str, object] | None, headers: Mapping[str, str]) -> str:
    """Return what the file of some of the rows is to have, in brackets behind them."""
    parts = [f"`read: {block_text(block)}` there"] if block else []
    return "; ".join([*parts, *filter(None, [in_headers(headers, "that file")])])


def with_line(data: Dataset, key: str, lines: Mapping[str, object]) -> dict[str, object]:
    """Return the sidecar's block ``read`` with more of one key, such as units: {payload: g}."""
    return {**data.read, key: {**data.read.get(key, {}), **lines}}


def block_text(block: object) -> str:
    """Return the sidecar's block ``read`` in one line of YAML, quoted only where it must be."""
    if isinstance(block, Mapping):
        return f"{{{', '.join(f'{block_text(k)}: {block_text(v)}' for k, v in block.items())}}}"
    if isinstance(block, list | tuple):
        return f"[{', '.join(map(block_text, block))}]"
    if isinstance(block, str) and not PLAIN_WORD.fullmatch(block):
        return json.dumps(block, ensure_ascii=False)
    return block if isinstance(block, str) else json.dumps(block)


def hint_of(found: Sequence[Interpretation]) -> str:
    """Return the lines to write into the sidecars, or what else to do."""
    every = [x for m in found for x in m.mistakes]
    hints = dict.fromkeys(HINTS[x.kind] for x in every if x.kind in HINTS)
    if hints:
        return ". ".join(hints)
    blocks: dict[str, list[str]] = {}
    headers = "; and ".join(dict.fromkeys(in_headers(m.headers, m.source) for m in found
                                          if m.headers))
    for m in found:
        if m.block or m.at:
            blocks.setdefault(_sidecar_lines(m), []).append(m.source)
    if headers and not blocks:
        return f"Write {headers}: the sidecar has no say where a unit stands in the header"
    if not blocks:
        if any(x.rows and x.kind not in PLAIN for x in every):
            return ("Put those rows into a file of their own whose sidecar says so, or leave them "
                    "out")
        beyond = [c for x in every if x.kind == "outside-limits" for c in x.columns]
        return ("Correct the mechanism file" if not beyond else
                f"Correct the zero of {', '.join(beyond)}: its offset in the mechanism file, or "
                "the column; or the limits, if they are wrong")
    mirrored = any(x.kind == "mirrored" for x in every)
    named = len({m.source for m in found}) > 1    # which file is meant must be said then
    # several of one file are what each of its targets would take: one of them is to be written
    between = "; into the " if named or len(blocks) == 1 else ", or instead into the "
    place = {b: f"sidecar{'s' * (len(own) > 1)} of {' and '.join(own)}" if named else "sidecar"
             for b, own in blocks.items()}
    return "Write into the " + between.join(
        f"{place[b]}: {b}" for b in blocks) + f"; and {headers}" * bool(headers) + (
        ". Or correct the mechanism file, if it has the mirror image" if mirrored else "")


def _sidecar_lines(found: Interpretation) -> str:
    """Return the lines for the sidecar of one file, with why its sigma is among them."""
    lines = [f"`read: {block_text(found.block)}`"] if found.block else []
    lines += [f"`instrument: {{at: {found.at}}}`"] if found.at else []
    instead = "".join(f", or instead `read: {block_text(other)}`"
                      for other in found.alternative_blocks)
    if not found.sigma:
        return " and ".join(lines) + instead
    # digits without an exponent: every reader of YAML takes them for a number
    sigma = ", ".join(f"{k}: {np.format_float_positional(v, trim='-')}"
                      for k, v in found.sigma.items())
    return (f"{' and '.join(lines)} and, as sigma is in the unit of the columns too, "
            f"`instrument: {{sigma: {{{sigma}}}}}`{instead}")
