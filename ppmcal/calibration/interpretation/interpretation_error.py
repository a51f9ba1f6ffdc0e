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
    "targets": "No sidecar entry can correct that: exchange the two targets in those rows, or "
               "leave the rows out",
    "machine-unit": "Correct `units: {length: ...}` in the mechanism file; or, if that is right, "
                    "the unit of length in every sidecar, which is then wrong by the same factor",
    "home": "Measure where the platform stands at home's joint values, and correct the home pose "
            "and the offsets with it. Or give `offset` tolerances of that size: the fit finds "
            "offsets then",
    "assembly": "Write that place as the home pose, and the other `elbow` or `branch` of limbs "
                "whose joint values at home are not those",
    "zero": "Correct these joints' offsets, or give `offset` tolerances of that size: the fit "
            "finds offsets then",
    **{key.replace("_", "-"): f"Write into the sidecar: `{key}: unknown`"
       for key in ("frame", "target", "target_rotation")},
    "point": "Write into the sidecar: `instrument: {point: unknown}`",
    "offset": "Write into the sidecar: `instrument: {offset: unknown}`"}
"""What only the user can correct, by kind of mistake."""
PLAIN = ("stale", "outside-limits")
"""Kinds of mistake that name rows and are not corrected by another reading."""


PLAIN_WORD = re.compile(r"[A-Za-z_][\w ./*?-]*")
"""Strings that YAML takes without quotes."""
NOISE = "times the noise"
"""In place of a quantity: residuals over the noise, not a length or angle."""


@dataclass(frozen=True)
class FileFault:
    """One respect in which a file differs from how it was read.

    ``columns`` of a ``target`` is its name, of several in one file.
    ``kind``: permuted, sign, unit, rotation, inverse, mirrored, exchanged, shifted, stale,
    outside-limits, joint, home, zero, assembly or radius; ``columns`` affected; ``text``:
    in words; ``rows``: by number in the CSV, if not all of them.
    """

    kind: str
    columns: tuple[str, ...]
    text: str
    rows: tuple[int, ...] = ()


@dataclass(frozen=True)
class Interpretation:
    """A file that was read wrongly, and how it should be read.

    Attributes:
        source: the CSV.
        mistakes: what is wrong in it; ``block``: the sidecar's ``read`` that corrects it, None
            if only the user can.
        quantity: of ``before`` and ``after``, the median errors, m or rad, that show it best; nan
            if nothing was compared.
        noise_after: residuals of a short fit, times the noise.
        headers: headers of the file with a wrong unit -> their replacements, because a unit in a
            header overrides the sidecar.
        sigma: entries of the sidecar's ``instrument.sigma`` that are in the columns' unit too.
        at: the joint for the sidecar's ``instrument.at``; empty if that is right.
        alternatives: other mistakes that explain the file as well with as few changes;
            ``alternative_blocks``: like ``block``, for those that have their own;
            ``alike``: their relation to the mistakes, in words.
        right: the data set read that way, None if nothing was compared.
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
        """The alternatives in words, to follow those of the mistakes; empty without any."""
        others = "".join(", or: " + " and ".join(m.text for m in way) for way in self.alternatives)
        return f"{others}; {self.alike}" if self.alike else others


class InterpretationError(NoResult):
    """Measurements that, as the files are read, are not of this machine (exit code 3).

    ``found``: how they should be read, by data set; empty if nothing explains them.
    ``units``: of the machine's file.
    """

    found: tuple[Interpretation, ...] = ()
    units: Units = SI

    @classmethod
    def of(cls, found: Sequence[Interpretation], units: Units) -> InterpretationError:
        """Return the refusal that names the mistakes and the lines that correct them."""
        told = by_sentence(found, units)
        files = [", ".join(sources_of(own)) for own in told.values()]
        what = "; ".join(f"{of}: " * (len(set(files)) > 1) + sentence
                         for of, sentence in zip(files, told, strict=True))
        error = cls(what, ", ".join(sources_of(found)), hint_of(found))
        error.found, error.units = tuple(found), units
        return error


def by_sentence(found: Sequence[Interpretation], units: Units) -> dict[str, list[Interpretation]]:
    """Return each sentence on what is wrong, with the files and targets of which it is true.

    A mistake of all files, or of all targets of one, shows in each of them.
    """
    out: dict[str, list[Interpretation]] = {}
    for m in found:
        out.setdefault(interpretation_sentence(m, units), []).append(m)
    return out


def sources_of(found: Sequence[Interpretation]) -> list[str]:
    """Return the files that are read wrongly, each once."""
    return list(dict.fromkeys(m.source for m in found))


def interpretation_sentence(found: Interpretation, units: Units) -> str:
    """Return what is wrong in a file, with the evidence."""
    factor, unit = units.factor(found.quantity), units.name(found.quantity)
    what = " and ".join(m.text for m in found.mistakes) + found.otherwise
    if np.isnan(found.after):
        return what
    if found.quantity == NOISE:
        return f"{what}: residuals fall from {found.before:.3g} to {found.after:.3g} {NOISE}"
    before = (f"read so, the median error drops from {found.before / factor:.3g} to"
              if np.isfinite(found.before) else
              # the error before is of another quantity if the encoder is at another kind of joint
              "hardly any row had a pose; " * (not found.at) + "read so, the median error is")
    return (f"{what}: {before} {found.after / factor:.3g} {unit}, and a short fit leaves "
            f"{found.noise_after:.2g} times the noise")


def unit_words(unit: str) -> str:
    """Return a unit as written after ``in``."""
    return "inches" if unit == "in" else unit


_UNIT = re.compile(r"[^\s\[\]()]+(?=\s*[\])]\s*$)")


def with_unit(header: str, unit: str) -> str:
    """Return a header with another unit in its brackets.

    >>> with_unit("T1_x [mm]", "cm")
    'T1_x [cm]'
    """
    return _UNIT.sub(unit, header)


def headers_of(data: Dataset, columns: Sequence[str], unit: str) -> dict[str, str]:
    """Return the headers of columns that contain another unit, and their replacements."""
    return {data.headed[c][0]: with_unit(data.headed[c][0], unit) for c in columns
            if c in data.headed}


def in_headers(headers: Mapping[str, str], source: str) -> str:
    """Return the headers to change in a file, as the end of a sentence; empty for none."""
    words = ", ".join(f"`{new}` for `{old}`" for old, new in headers.items())
    return f"in the header of {source} {words}" if words else ""


def lines_for(block: Mapping[str, object] | None, headers: Mapping[str, str]) -> str:
    """Return the lines needed for the file of some of the rows, in brackets after them."""
    parts = [f"`read: {block_text(block)}` there"] if block else []
    return "; ".join([*parts, *filter(None, [in_headers(headers, "that file")])])


def with_line(data: Dataset, key: str, lines: Mapping[str, object]) -> dict[str, object]:
    """Return the sidecar's block ``read`` with entries added to a key, as units: {payload: g}."""
    return {**data.read, key: {**data.read.get(key, {}), **lines}}


def block_text(block: object) -> str:
    """Return the sidecar's block ``read`` as one line of YAML, quoted only where necessary."""
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
    marks = dict.fromkeys(c for x in every if x.kind == "target" for c in x.columns)
    hints = dict.fromkeys(HINTS[x.kind] for x in every
                          if x.kind in HINTS and not (x.kind == "target" and x.columns))
    if marks:
        lines = ", ".join(f"{mark}: unknown" for mark in marks)
        hints[f"Write into the sidecar, among its `targets`: `{lines}`"] = None
    if hints:
        return ". ".join(hints)
    blocks: dict[str, list[str]] = {}
    headers = "; and ".join(dict.fromkeys(in_headers(m.headers, m.source) for m in found
                                          if m.headers))
    for m in found:
        if m.block or m.at:
            blocks.setdefault(_sidecar_lines(m), []).append(m.source)
    if headers and not blocks:
        return f"Write {headers}: a unit in the header overrides the sidecar"
    if not blocks:
        if any(x.rows and x.kind not in PLAIN for x in every):
            return ("Put those rows into a file of their own whose sidecar says so, or leave them "
                    "out")
        beyond = [c for x in every if x.kind == "outside-limits" for c in x.columns]
        return ("Correct the mechanism file" if not beyond else
                f"Correct the zero of {', '.join(beyond)}: its offset in the mechanism file, or "
                "the column; or the limits, if they are wrong")
    mirrored = any(x.kind == "mirrored" for x in every)
    named = len(sources_of(found)) > 1    # the file meant must be named then
    # several blocks for one file are alternatives from its targets: only one is to be written
    between = "; into the " if named or len(blocks) == 1 else ", or instead into the "
    place = {b: f"sidecar{'s' * (len(own) > 1)} of {' and '.join(own)}" if named else "sidecar"
             for b, own in blocks.items()}
    return "Write into the " + between.join(
        f"{place[b]}: {b}" for b in blocks) + f"; and {headers}" * bool(headers) + (
        ". Or correct the mechanism file, if it has the mirror image" if mirrored else "")


def _sidecar_lines(found: Interpretation) -> str:
    """Return the lines for the sidecar of one file, with the reason for its sigma among them."""
    lines = [f"`read: {block_text(found.block)}`"] if found.block else []
    lines += [f"`instrument: {{at: {found.at}}}`"] if found.at else []
    instead = "".join(f", or instead `read: {block_text(other)}`"
                      for other in found.alternative_blocks)
    if not found.sigma:
        return " and ".join(lines) + instead
    # digits without an exponent: every reader of YAML takes them for a number
    sigma = ", ".join(f"{k}: {np.format_float_positional(v, trim='-')}"
                      for k, v in found.sigma.items())
    return (f"{' and '.join(lines)} and, as sigma is in the same unit as the columns, "
            f"`instrument: {{sigma: {{{sigma}}}}}`{instead}")
