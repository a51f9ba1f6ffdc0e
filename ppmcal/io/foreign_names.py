"""Headings of instruments and controllers that are as good as our own column names."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence

OTHERWISE: Mapping[str, str] = {
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
UNCERTAIN = re.compile(r"u\(?[xyz]\)?|(?:uncertainty|unc)[ .]?[xyz]|[xyz][ .]?(?:uncertainty|unc)|"
                       r"u ?mag|uncertainty")
GROUPED = re.compile(r"collection|group\d*")
"""Columns that are parts of a point's name, in their order."""
_NUMBERED = re.compile(r"group\d+")
UNIT_WORDS: Mapping[str, str] = {
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), "mm"),
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("in", "inch", "inches"), "in"),
    **dict.fromkeys(("um", "µm", "micron", "microns", "micrometer", "micrometers"), "um")}
_UNITS = re.compile(r"\b(?:length )?units?\s*[:=]\s*([a-zµ]+)", re.I)


def own_name(header: str, known: Collection[str]) -> tuple[str | None, str]:
    """Return our own name of a header without its unit, and where it is known from.

    ``group``, ``collection`` (parts of a point's name) and ``date`` (part of a time) are names
    besides those of measurement files. None where nobody knows the header.
    """
    if header in known or header.startswith("temperature_"):
        return header, "its name"
    low = " ".join(header.lower().replace("_", " ").split())
    same = next((k for k in known if k.lower() == header.lower()), None)
    if same:
        return same, "its name"
    if _NUMBERED.fullmatch(low):
        return low, "its place"
    if low in OTHERWISE:
        return OTHERWISE[low], "a usual heading"
    parts = [OTHERWISE.get(part.strip()) for part in low.split("::")]
    if len(parts) > 1 and set(parts) <= {"collection", "group", "pose"}:
        return "pose", "a usual heading"    # SpatialAnalyzer's Collection::Group::Target
    if found := COORDINATE.fullmatch(low):
        return found["axis"], "a usual heading"
    if (found := SIGMA.fullmatch(low)) and "sigma_x" in known:
        return f"sigma_{found['axis'] or found['short'] or found['first']}", "a usual heading"
    return None, ""


def is_target(header: str) -> bool:
    """Whether a heading says that a column names what was measured, not where."""
    return " ".join(header.lower().replace("_", " ").split()) in TARGETS


def unit_in(remarks: Sequence[str]) -> str | None:
    """Return the length unit that remarks such as ``Units: mm`` name, None unless just one."""
    named = {u for r in remarks for w in _UNITS.findall(r) if (u := UNIT_WORDS.get(w.lower()))}
    return named.pop() if len(named) == 1 else None


def why_not(header: str) -> str:
    """Return why a column is left alone, where there is more to say than that nobody knows it."""
    low = " ".join(header.lower().replace("_", " ").split())
    if UNCERTAIN.fullmatch(low):
        return "an uncertainty whose coverage (k = 1, k = 2?) is not told"
    return ""
