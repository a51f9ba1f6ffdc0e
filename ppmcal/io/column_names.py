"""What columns are called: our own names, and headings of recorders that are as good as those."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from difflib import get_close_matches

from ppmcal.errors import BadInput
from ppmcal.io.csv_dialect import is_float
from ppmcal.io.pose_fields import COORDINATES, CORRELATIONS, QUATERNION
from ppmcal.io.schema import did_you_mean
from ppmcal.model.dataset import WRENCH
from ppmcal.model.instruments import InstrumentKind, number_names
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note

ENVIRONMENT = ("temperature", "payload", "time", *WRENCH)
MISSPELT = 0.8
"""A name so like one of ours (difflib's ratio) is taken for a mistake in writing it."""
LABELS = ("pose", "session", "time")
"""Columns that may hold words: names, and times of a clock."""
OURS = ("q_", "to_q_", "dir_", "vel_", "cmd_", "sigma_", "u95_", "rho_", "temperature_",
        "leg_length_")
"""What columns of ours begin with: a name that does is meant to be one."""
_HEXAPOD = {"x1": "x", "y1": "y", "z1": "z", "phix1": "rx", "phiy1": "ry", "phiz1": "rz"}
_CAPTURE = {**{f"position_{a}": a for a in "xyz"},
            **{f"orientation_{a}": f"quat_{a}" for a in "xyzw"}}
HEADER_ALIASES: Mapping[str, str] = {
    **dict.fromkeys(("name", "point", "point name", "pointname", "point id", "pointid", "target",
                     "target name", "point number", "pt", "pt name", "id", "label"), "pose"),
    **dict.fromkeys(("timestamp", "time stamp", "datetime", "date time", "date/time",
                     "date and time", "time of measurement", "measurement time",
                     "measured at", "utc time"), "time"),
    "date": "date",
    **dict.fromkeys(("group", "group name", "point group"), "group"),
    **dict.fromkeys(("collection", "collection name"), "collection")}
"""Headings in small letters, with spaces for underscores, and our column."""
TARGETS = ("target", "target name")
"""Of what is measured: a pose's only point has that heading as well."""
COORDINATE = re.compile(
    r"(?:(?:actual|act|measured|meas|position|pos|point|coord)[ .]?)?(?P<axis>[xyz])"
    r"(?:[ .]?(?:coord|coordinate|position|pos|value|actual|act|measured|meas))?")
SIGMA = re.compile(r"(?:sigma|σ|std|stddev|std ?dev|stdev|standard deviation)[ .]?\(?"
                   r"(?P<axis>[xyz])\)?|s(?P<short>[xyz])|(?P<first>[xyz])[ .]?"
                   r"(?:sigma|std|stddev|std ?dev|stdev)")
U95 = re.compile(r"u95[ .]?\(?(?P<axis>r?[xyz])\)?|(?P<first>r?[xyz])[ .]?u95")
UNCERTAIN = re.compile(r"u\(?[xyz]\)?|(?:uncertainty|unc)[ .]?[xyz]|[xyz][ .]?(?:uncertainty|unc)|"
                       r"u ?mag|uncertainty")
GROUPED = re.compile(r"collection|group\d*")
"""Columns that are parts of a point's name, in their order."""
_NUMBERED = re.compile(r"group\d+")
UNIT_WORDS: Mapping[str, str] = {
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), "mm"),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetre", "centimetres"), "cm"),
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("in", "inch", "inches"), "in"),
    **dict.fromkeys(("um", "µm", "micron", "microns", "micrometer", "micrometers"), "um")}
_UNITS = re.compile(r"\b(?:length )?units?\s*[:=]\s*([a-zµ]+)", re.I)


def known_columns(mechanism: Mechanism, kind: InstrumentKind | None = None) -> list[str]:
    """Return every column name that a measurement file of this machine may have.

    ``kind``: of the instrument, where it is known: some have columns that others do not.
    """
    actuators = mechanism.actuators
    own = () if kind is None or kind.of_poses else kind.columns(mechanism.motion)
    out = ["pose", "session", *(f"q_{a}" for a in actuators), *COORDINATES, *QUATERNION,
           *number_names(), *own, *ENVIRONMENT, *(f"to_q_{a}" for a in actuators),
           *(f"dir_{a}" for a in (*actuators, "x", "y", "z")),
           *(f"vel_{a}" for a in actuators), *tension_columns(mechanism),
           *(f"cmd_{c}" for c in (*COORDINATES, *QUATERNION)),
           *(f"sigma_{c}" for c in (*COORDINATES, "position", "rotation", *number_names(), *own)),
           *(f"u95_{c}" for c in (*COORDINATES, "position", "rotation")), *CORRELATIONS]
    return list(dict.fromkeys(out))


def tension_columns(mechanism: Mechanism) -> list[str]:
    """Return the columns of measured tensions, N: of each rope."""
    return [f"tension_{mechanism.actuators[limb.actuator]}" for limb in mechanism.limbs
            if limb.kind.pulls_only]


def check_columns(header: Sequence[str], mechanism: Mechanism, source: str,
                  kind: InstrumentKind | None = None) -> None:
    """Refuse a column that nobody knows, with the nearest match."""
    known = known_columns(mechanism, kind)
    for name in header:
        if name not in known and not name.startswith("temperature_"):
            raise BadInput(f"unknown column '{name}'", f"{source}: header",
                           f"Rename or remove it; the actuators are "
                           f"{', '.join(mechanism.actuators)}."
                           f"{did_you_mean(name, [k for k in known if k not in header])}")


def is_nobodys(name: str, known: Collection[str]) -> bool:
    """Whether a name without its unit is none of ``known`` columns, nor was perhaps meant to be."""
    return not (name in known or name.startswith(OURS)
                or get_close_matches(name, known, 1, MISSPELT))


def strangers(columns: Mapping[str, Sequence[str] | None], mechanism: Mechanism,
              known: Collection[str], source: str) -> tuple[list[str], list[Note]]:
    """Return the columns that nobody needs, and that they are left alone.

    ``columns``: name -> cells, where they are words; ``known``: names of our columns for the
    machine, and of what they are made of.

    Raises:
        BadInput: a column that was perhaps meant to be one of ours, or words where it has numbers.
    """
    strange = [h for h in columns if is_nobodys(h, known)]
    check_columns([h for h in columns if h not in known and h not in strange], mechanism, source)
    for name, cells in columns.items():
        if cells is not None and name not in (*strange, *LABELS):
            row = next((i for i, c in enumerate(cells) if c and not is_float(c)), 0)
            raise BadInput(f"'{cells[row]}' is not a number",
                           f"{source}: row {row + 1}, column {name}",
                           "Correct the cell, or leave it empty")
    if not strange:
        return [], []
    names, one = ", ".join(strange), len(strange) == 1
    ignore = ", ".join(n if n.isidentifier() else f'"{n}"' for n in strange)
    return strange, [Note(f"{source}: column{'s' * (not one)} {names}: not used, nobody knows "
                          f"{'it' if one else 'them'}. `read: {{ignore: [{ignore}]}}` in the "
                          "sidecar says that this is meant")]


class MissingColumns(BadInput):
    """Columns that a file must have and lacks.

    ``names``: ours for them; ``why``: who needs them, the end of the message.
    """

    names: tuple[str, ...] = ()
    why: str = ""

    @classmethod
    def of(cls, names: Sequence[str], why: str, where: str, hint: str) -> MissingColumns:
        """Return the refusal of a header without some columns."""
        error = cls(f"there is no column {', '.join(names)}{why}", where, hint)
        error.names, error.why = tuple(names), why
        return error


@contextmanager
def offering(strange: Sequence[str], mark: str = "") -> Iterator[None]:
    """Offer the columns of a file that nobody knows where one is missing that is needed.

    ``mark``: the target whose columns they would be, of several in one file.
    """
    try:
        yield
    except MissingColumns as error:
        if not strange:
            raise
        lower = {name.lower(): name for name in strange}
        left = [n for n in strange if n.lower() not in error.names]
        meant = {name: lower.get(name.lower()) or (left.pop(0) if left else strange[0])
                 for name in error.names}
        lines = ", ".join(f"{mark}_{name}: {header}" if mark and name in COORDINATES else
                          f"{name}: {header}" for name, header in meant.items())
        raise MissingColumns.of(
            error.names, error.why, error.where,
            f"Nobody knows {', '.join(strange)}: if that is what is missing, write into the "
            f"sidecar `read: {{columns: {{{lines}}}}}`, with the right names. Else: "
            f"{error.hint[:1].lower()}{error.hint[1:]}") from None


def ambiguous_directions(header: Sequence[str], mechanism: Mechanism, source: str) -> list[Note]:
    """Return what to say of directions that are a joint's and the platform's by their name.

    Raises:
        BadInput: not all joints have theirs, so that these may be the platform's.
    """
    joints = [f"dir_{a}" for a in mechanism.actuators]
    both = [f"dir_{c}" for c in "xyz" if f"dir_{c}" in joints and f"dir_{c}" in header]
    if not both:
        return []
    names = ", ".join(both)
    if not set(joints) <= set(header):
        own = both[0].removeprefix("dir_")
        raise BadInput(
            f"{names}: the platform's direction of approach, or that of the joint of this name?",
            f"{source}: header",
            f"Give the direction of every joint ({', '.join(joints)}); or, if it is the "
            f"platform's, call the actuator otherwise in the mechanism file, such as joint_{own}, "
            f"and write `read: {{columns: {{q_joint_{own}: q_{own}}}}}` into the sidecar")
    return [Note(f"{source}: {names} are taken for the directions of the joints called so, not "
                 "for the platform's.")]


def recorders_names(header: Sequence[str], mechanism: Mechanism, source: str
                    ) -> tuple[Mapping[str, str], list[Note]]:
    """Return the header of a known recorder -> our own names, and what was concluded.

    ``x1,y1,z1,phix1,phiy1,phiz1`` with joint names ([LIN]'s hexapods), and
    ``leg_length_1.., position_x.., orientation_x..w`` (motion capture of a Stewart platform);
    ``leg_length_i`` belongs to the i-th actuator.
    """
    names, findings, actuators = dict[str, str](), list[Note](), mechanism.actuators
    if set(_HEXAPOD) <= set(header):
        names = dict(_HEXAPOD)
        own = set(known_columns(mechanism))
        joints = [c for c in header if c not in names and (c in actuators or (
            c not in own and not c.startswith("temperature_")))]
        if not set(actuators) <= set(joints) and len(joints) == len(actuators):
            findings.append(Note(f"{source}: header: the joint columns {', '.join(joints)} are "
                                 f"taken in order for the actuators {', '.join(actuators)}."))
            names.update({c: f"q_{a}" for c, a in zip(joints, actuators, strict=True)})
        else:
            names.update({c: f"q_{c}" for c in joints if c in actuators})
    elif "leg_length_1" in header:
        names = {c: own for c, own in _CAPTURE.items() if c in header}
        count = sum(c.startswith("leg_length_") for c in header)
        if count != len(actuators):
            raise BadInput(f"there are {count} leg_length columns, but the mechanism has "
                           f"{len(actuators)} actuators", f"{source}: header",
                           "Give one column for each actuator, leg_length_1 first")
        names.update({f"leg_length_{i + 1}": f"q_{a}" for i, a in enumerate(actuators)})
    renamed = [names.get(c, c) for c in header]
    for i, name in enumerate(renamed if names else ()):
        if name in renamed[:i]:
            raise BadInput(f"the columns '{header[renamed.index(name)]}' and "
                           f"'{header[i]}' both mean {name}", f"{source}: header",
                           "Remove one of them")
    return names, findings


def plain_heading(header: str) -> str:
    """Return a heading in small letters with single spaces, by which usual ones are known."""
    return " ".join(header.lower().replace("_", " ").split())


def own_name(header: str, known: Collection[str]) -> tuple[str | None, str]:
    """Return our own name of a header without its unit, and where it is known from.

    ``group``, ``collection`` (parts of a point's name) and ``date`` (part of a time) are names
    besides those of measurement files. None where nobody knows the header.
    """
    if header in known or header.startswith("temperature_"):
        return header, "its name"
    low = plain_heading(header)
    same = next((k for k in known if k.lower() == header.lower()), None)
    if same:
        return same, "its name"
    if _NUMBERED.fullmatch(low):
        return low, "its place"
    if low in HEADER_ALIASES:
        return HEADER_ALIASES[low], "a usual heading"
    parts = [HEADER_ALIASES.get(part.strip()) for part in low.split("::")]
    if len(parts) > 1 and set(parts) <= {"collection", "group", "pose"}:
        return "pose", "a usual heading"    # SpatialAnalyzer's Collection::Group::Target
    if found := COORDINATE.fullmatch(low):
        return found["axis"], "a usual heading"
    if (found := SIGMA.fullmatch(low)) and "sigma_x" in known:
        return f"sigma_{found['axis'] or found['short'] or found['first']}", "a usual heading"
    if (found := U95.fullmatch(low)) and "u95_x" in known:
        return f"u95_{found['axis'] or found['first']}", "a usual heading"
    return None, ""


def is_target(header: str) -> bool:
    """Whether a heading says that a column names what was measured, not where."""
    return plain_heading(header) in TARGETS


def unit_in(remarks: Sequence[str]) -> str | None:
    """Return the length unit that remarks such as ``Units: mm`` name, None unless just one."""
    named = {u for r in remarks for w in _UNITS.findall(r) if (u := UNIT_WORDS.get(w.lower()))}
    return named.pop() if len(named) == 1 else None


def reason_ignored(header: str) -> str:
    """Return why a column is left alone, where there is more to say than that nobody knows it."""
    if UNCERTAIN.fullmatch(plain_heading(header)):
        return "an uncertainty whose coverage (k = 1, k = 2?) is not told"
    return ""
