"""How well a diagnosis predicts what its fits were not made from, in sentences."""

from __future__ import annotations

from ppmcal.diagnosis.left_out_schemes import SESSION
from ppmcal.diagnosis.result import LeftOutBlocks
from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.diagnosis_parts import HeldOutGap
from ppmcal.io.results.validation import prediction
from ppmcal.wording import known, percent


def gap_closed(record: DiagnosisRecord) -> str:
    """Return how much of the gap is closed on held-out poses, empty where that is unknown."""
    gap = record.gap
    before, after = known(gap.before), known(gap.after)
    if before is None or after is None:
        return ""
    if not record.effects and abs(before - after) < 1e-9:
        return f"On {left_out_poses(gap)}, residuals are {_ratio(before)} times the noise."
    text = (f"On {left_out_poses(gap)} (though used to choose the names), residuals "
            f"{'drop' if after <= before else 'rise'} from {_ratio(before)} to {_ratio(after)} "
            "times the noise")
    closed = known(gap.closed)
    if closed is None:
        return f"{text}; nothing exceeded the noise before."
    return f"{text}: {percent(closed)} of the excess error is explained{_interval(gap)}."


def predicted(record: DiagnosisRecord) -> str:
    """Return how rows left out are predicted, empty where geometry is all that is likely."""
    told = [b for b in record.predictive if b.gain_sigma > 0.0]
    if not told:
        return ""
    first, least = told[0], min(told, key=lambda b: b.gain)
    text = (f"Cross-validation error, {_portion(first.by)} left out at a time: "
            f"{_ratio(first.averaged.error)} times the noise with all likely effects, "
            f"{_ratio(first.geometry.error)} with geometry alone; log score {_gain(first)}")
    return text + (f", by {least.by} {_gain(least)}" if least is not first else "") + "."


def left_out_error(record: DiagnosisRecord) -> str:
    """Return how well rows are predicted that were left out, empty where that is not known."""
    now, then = known(record.gap.after), known(record.gap.before)
    where = f"error on {left_out_poses(record.gap)}"
    if record.predictive:
        found = record.predictive[0]
        now, then = known(found.averaged.error), known(found.geometry.error)
        where = f"cross-validation error ({_portion(found.by)} left out at a time)"
    if now is None:
        return ""
    alone = "" if then is None or then == now else f", {_ratio(then)} with geometry alone"
    return f"{where} {_ratio(now)} times the noise{alone}"


def another_day(record: DiagnosisRecord) -> list[str]:
    """Return how each session is predicted from the others, or that none shows what is named."""
    if record.effects and not record.validation:
        return ["No second session here shows whether this holds on another day: measure one "
                "(ppmcal validate)."]
    return [f"From the other sessions, {prediction(day)}"
            for day in record.validation]


def _portion(by: str) -> str:
    return f"one {by}" if by in ("pose", SESSION) else f"a third of the rows by {by}"


def _gain(found: LeftOutBlocks) -> str:
    return f"{found.gain:+.1f} +- {found.gain_sigma:.1f}"


def left_out_poses(gap: HeldOutGap) -> str:
    """Return ``16 poses kept out of the fits``: those that sizes were not fitted to.

    What is named, or learned, was chosen with their help, so they are not called unseen.
    """
    return f"{gap.poses or ''} poses kept out of the fits".strip()


def learned_gap(record: DiagnosisRecord) -> str:
    """Return what held-out poses say of all that was learned, empty where nothing was."""
    if not record.learned:
        return ""
    gap = record.learned[0].gap
    before, after, closed = (known(v) for v in (gap.before, gap.after, gap.closed))
    if before is None or after is None:
        return ""
    tail = "" if closed is None else f": {percent(closed)} of the excess error is explained"
    return (f"With what was learned, residuals on {left_out_poses(gap)} (though used to choose "
            f"what is kept) go from {_ratio(before)} to {_ratio(after)} times the noise"
            f"{tail}{_interval(gap)}.")


def unconfirmed(record: DiagnosisRecord) -> str:
    """Return that what was left out of the fits does not bear the effects out."""
    return ("Sessions left out of the fits in turn do not bear the effects out."
            if record.validation else "The held-out poses alone do not prove the improvement.")


def _interval(gap: HeldOutGap) -> str:
    ends = [end for v in gap.interval or () if (end := known(v)) is not None]
    return (f" (95 % interval: {percent(ends[0])} to {percent(ends[1])})" if len(ends) == 2
            else "")


def _ratio(value: float) -> str:
    """Return three digits: ``0.940``, ``3.10``, ``21.9``."""
    return f"{value:#.3g}".rstrip(".")
