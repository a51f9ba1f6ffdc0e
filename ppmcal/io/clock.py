"""Times as recorders write them: seconds, epochs, times of day, dates in any usual order.

A time that could be read in two ways is refused: 03/04/2026 is in March or in April. Where one
date of a column has a number above 12, that tells the order of all.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta, timezone, tzinfo

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.linalg import Array

DAY = 86400.0
ORDERS = ("day-first", "month-first")
EPOCHS = {"": 1.0, "milli": 1e3, "micro": 1e6, "nano": 1e9}
EPOCH = (9e8, 5e9)
"""Seconds since 1970 of the years 1998 to 2128: no other counter of seconds runs so long."""
MONTHS = {m: i for i, m in enumerate(("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep",
                                      "oct", "nov", "dec"), 1)}
_TIME = (r"(?P<hour>\d{1,2}):(?P<minute>\d{2})(?::(?P<second>\d{2})(?:[.,:](?P<part>\d{1,9}))?)?"
         r"(?:\s*(?P<half>[AaPp]\.?[Mm]\.?))?(?:\s*(?P<zone>Z|UTC|GMT|[+-]\d{2}(?::?\d{2})?))?\s*")
_DATES = (
    r"(?P<y>\d{4})[-/.](?P<m>\d{1,2})[-/.](?P<d>\d{1,2})",
    r"(?P<d>\d{1,2})\.(?P<m>\d{1,2})\.(?P<y>\d{4})",
    r"(?P<a>\d{1,2})[-/](?P<b>\d{1,2})[-/](?P<y>\d{4})",
    r"(?P<d>\d{1,2})[- ](?P<name>[A-Za-z]{3})[a-z]*\.?[- ,]+(?P<y>\d{4})",
    r"(?P<name>[A-Za-z]{3})[a-z]*\.? (?P<d>\d{1,2}),? (?P<y>\d{4})")
_FORMS = [re.compile(_TIME), *(re.compile(rf"{d}(?:[T ,]+|\s*;\s*){_TIME}") for d in _DATES)]
_COMPACT = re.compile(r"(\d{4})(\d{2})(\d{2})T(\d{2})(\d{2})(\d{2})(.*)")
FORM = "Write s, or times such as 10:03:07.25 or 2026-03-04T10:03:07.25+01:00"


@dataclass(frozen=True, eq=False)
class Clock:
    """The times of N rows.

    Attributes:
        seconds: (N,) s since midnight or since 1970, or of a counter; nan where empty.
        words: how they were understood.
        dated: whether the day is known.
        zoned: whether the zone is: then they are of UTC.
        counter: whether they count from a moment that nobody knows.
    """

    seconds: Array
    words: str
    dated: bool = False
    zoned: bool = False
    counter: bool = False

    @property
    def first(self) -> float:
        """The earliest time, 0 where there is none."""
        known = self.seconds[np.isfinite(self.seconds)]
        return float(known.min()) if known.size else 0.0

    def name(self, seconds: float) -> str:
        """Return a time as people write it."""
        if self.counter:
            return f"{seconds:g} s"
        moment = datetime(1970, 1, 1) + timedelta(seconds=seconds)
        form = "%Y-%m-%d %H:%M:%S" if self.dated else "%H:%M:%S"
        return moment.strftime(form) + f".{moment.microsecond // 1000:03d}" + (
            " UTC" if self.zoned else "")


def clock_of_numbers(values: Array, place: str, unit: float | None = None) -> Clock:
    """Return the clock of a column of numbers (N,).

    Args:
        values: as they stand.
        place: what messages call the column.
        unit: s in one of them, None where nobody says: then s, or parts of them since 1970.

    Raises:
        BadInput: some rows count since 1970, others do not.
    """
    with np.errstate(invalid="ignore"):
        known = values[np.isfinite(values)]
        for name, parts in EPOCHS.items():
            scale = 1.0 / parts if unit is None else unit
            inside = (known * scale > EPOCH[0]) & (known * scale < EPOCH[1])
            if known.size and inside.all():
                return Clock(values * scale, f"{name}seconds since 1970", True, True)
            if inside.any():
                raise BadInput("some times are seconds since 1970, others are not", place,
                               "Correct the rows, or export them with one clock")
            if unit is not None:
                break
    scale = 1.0 if unit is None else unit
    return Clock(values * scale, "seconds" if scale == 1.0 else f"numbers of {scale:g} s",
                 counter=True)


def clock_of_words(cells: Sequence[str], place: Callable[[int], str], dates: str | None = None,
                   zone: str | None = None) -> Clock:
    """Return the clock of a column of N words.

    Args:
        cells: as they stand; an empty one is nan.
        place: what messages call a row, from 0.
        dates: order of day and month where both are numbers, one of :data:`ORDERS`.
        zone: of the times that name none: ``UTC``, ``+02:00``, ``Europe/Berlin``.

    Raises:
        BadInput: a cell that is not a time, two kinds of times in one column, or a date whose day
            and month could be exchanged.
    """
    found: list[tuple[int, re.Match[str]]] = []
    usual = _FORMS[0]
    for i, cell in enumerate(cells):
        text = _COMPACT.sub(r"\1-\2-\3T\4:\5:\6\7", cell.strip())
        if text.lower() in ("", "nan"):
            continue
        match = usual.fullmatch(text) or next((m for f in _FORMS if (m := f.fullmatch(text))), None)
        if match is None:
            raise BadInput(f"'{cell.strip()[:40]}' is not a time", place(i), FORM)
        usual = match.re
        found.append((i, match))
    if not found:
        raise BadInput("no row has a time", place(0), "Fill the column in")
    _refuse_mixed(found, place)
    dated, own = "y" in found[0][1].re.groupindex, found[0][1]["zone"] is not None
    order = _order(found, place, dates) if dated else ""
    zone_ = None if own or not dated or zone is None else _zone(zone, place(found[0][0]))
    seconds = np.full(len(cells), np.nan)
    for i, match in found:
        seconds[i] = _seconds(match, order, zone_, place(i))
    words = "dates and times" if dated else "times of day"
    words += f", {order.replace('-', ' ')}" if order else ""
    words += ", with their zone" if own else f", zone {zone}" if zone_ else ", zone not said"
    out = Clock(seconds, words, dated, own or zone_ is not None)
    return out if dated else replace(out, seconds=_over_midnight(seconds))


def _refuse_mixed(found: Sequence[tuple[int, re.Match[str]]], place: Callable[[int], str]) -> None:
    first = found[0][1]
    for i, match in found:
        for what, differ in (
                ("a date", ("y" in match.re.groupindex) != ("y" in first.re.groupindex)),
                ("a zone", (match["zone"] is None) != (first["zone"] is None))):
            if differ:
                raise BadInput(f"'{match.string}' and '{first.string}' are not alike: only one has "
                               f"{what}", place(i), "Export all rows in one form")


def _order(found: Sequence[tuple[int, re.Match[str]]], place: Callable[[int], str],
           dates: str | None) -> str:
    """Return the order of day and month, empty where it is plain."""
    open_ = [(i, m) for i, m in found if "a" in m.re.groupindex]
    if not open_:
        return ""
    told = {}
    for i, m in open_:
        for order, day, month in ((ORDERS[0], "a", "b"), (ORDERS[1], "b", "a")):
            if int(m[day]) > 12 >= int(m[month]):
                told[order] = (i, m.string)
    if len(told) == 2 or (dates and told and dates not in told):
        i, text = told[next(o for o in ORDERS if o in told and o != dates)]
        raise BadInput(f"the day and month of '{text}' stand in another order than "
                       + (f"`dates: {dates}` says" if dates else "in other rows"), place(i),
                       "Export all dates in one form, such as 2026-03-04")
    order = dates or next(iter(told), "")
    if not order:
        i, m = open_[0]
        raise BadInput(f"'{m.string}' could be day {int(m['a'])} of month {int(m['b'])} or day "
                       f"{int(m['b'])} of month {int(m['a'])}", place(i), "Write `read: {dates: "
                       "day-first}` (or month-first) into the sidecar")
    return order


def _seconds(match: re.Match[str], order: str, zone: tzinfo | None, place: str) -> float:
    """Return one time, s since midnight or since 1970."""
    part = match.groupdict()
    hour = int(part["hour"])
    half = (part["half"] or "").lower()[:1]
    if half and not 1 <= hour <= 12:
        raise BadInput(f"'{match.string}' has an hour that does not go with am or pm", place, FORM)
    hour = hour % 12 + (12 if half == "p" else 0) if half else hour
    second = float(f"{part['second'] or 0}.{part['part'] or 0}")
    if hour > 23 or int(part["minute"]) > 59 or second >= 61.0:
        raise BadInput(f"'{match.string}' is not a time of day", place, FORM)
    of_day = 3600.0 * hour + 60.0 * int(part["minute"]) + second
    shift = 0.0 if part["zone"] is None else _offset(part["zone"])
    if part.get("y") is None:
        return of_day - shift
    a, b = ("a", "b") if order == ORDERS[0] else ("b", "a")
    named = MONTHS.get((part.get("name") or "").lower(), 0)
    month = named or int(part.get("m") or part.get(b) or 0)
    try:
        day = datetime(int(part["y"]), month, int(part.get("d") or part.get(a) or 0))
    except ValueError:
        raise BadInput(f"'{match.string}' has a date that does not exist", place, FORM) from None
    since = (day - datetime(1970, 1, 1)).total_seconds() + of_day
    return since - (shift if zone is None else _local(day, of_day, zone, match.string, place))


def _offset(zone: str) -> float:
    """Return how far a zone is ahead of UTC, s."""
    digits = re.sub(r"\D", "", zone)
    away = 3600.0 * int(digits[:2] or 0) + 60.0 * int(digits[2:] or 0)
    return -away if zone.startswith("-") else away


def _local(day: datetime, of_day: float, zone: tzinfo, text: str, place: str) -> float:
    """Return how far a zone was ahead of UTC at a local time, s."""
    moment = (day + timedelta(seconds=of_day)).replace(tzinfo=zone)
    away, other = (moment.replace(fold=f).utcoffset() for f in (0, 1))
    assert away is not None and other is not None
    if away != other:
        raise BadInput(f"at '{text}' the clocks were put forward or back, so the time is "
                       "ambiguous", place, "Export the times in UTC")
    return away.total_seconds()


def _zone(name: str, place: str) -> tzinfo:
    """Return a zone by its name."""
    from zoneinfo import ZoneInfo

    if name.upper() in ("UTC", "GMT", "Z"):
        return UTC
    if re.fullmatch(r"[+-]\d{2}(:?\d{2})?", name) and abs(_offset(name)) < DAY:
        return timezone(timedelta(seconds=_offset(name)))
    try:
        return ZoneInfo(name)
    except (KeyError, ValueError, OSError):
        raise BadInput(f"unknown zone '{name}'", place,
                       "Write `zone: UTC`, +02:00, or a name such as Europe/Berlin") from None


def _over_midnight(of_day: Array) -> Array:
    """Return times of day (N,) of a run of under 12 hours, whichever order its rows are in.

    Where the longest stretch of a day without any row is not that about midnight, the run went on
    past it: what is after it is of the next day.
    """
    known = of_day[np.isfinite(of_day)]
    steps = np.diff(known)
    if np.all(steps >= 0.0) or np.all(steps <= 0.0):
        return of_day
    known = np.unique(known)
    gaps = np.diff(known)
    widest = int(np.argmax(gaps))
    if gaps[widest] < 0.5 * DAY:
        return of_day
    return np.where(of_day <= known[widest], of_day + DAY, of_day)


def on_clock_of(log: Clock, points: Clock, log_source: str, source: str) -> Array:
    """Return the times (M,) of points on the clock of a log, s.

    Raises:
        BadInput: the two cannot be compared.
    """
    if log.counter != points.counter or (not log.counter and log.zoned != points.zoned):
        what = ("one counts seconds from a moment of its own, the other is a clock"
                if log.counter != points.counter else "only one of the two states its zone")
        raise BadInput(f"its times ({points.words}) cannot be compared with those of {log_source} "
                       f"({log.words}): {what}", source,
                       "Give what the points' clock is ahead by, --clock-offset S, or have it "
                       "found: --clock-offset find" if log.counter != points.counter else
                       "Write `read: {zone: +02:00}` (or UTC, Europe/Berlin) into the sidecar")
    if log.counter or (log.dated and points.dated):
        return points.seconds
    known = log.seconds[np.isfinite(log.seconds)]
    middle = float(np.median(known)) if known.size else 0.0
    # on the day that brings each nearest to the log
    return np.asarray(points.seconds + DAY * np.round((middle - points.seconds) / DAY))


def is_time(cell: str) -> bool:
    """Whether a word is a time of day, or a date with one."""
    return ":" in cell and any(f.fullmatch(cell.strip()) for f in _FORMS)
