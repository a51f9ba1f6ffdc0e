"""The entry ``plot_data`` of diagnosis.json: what the pictures of a diagnosis show.

Every part has its unit beside it. Numbers have six digits, enough for a picture.
"""

from __future__ import annotations

import numpy as np

from ppmcal.diagnosis.plot_data import ActuatorError, PlotData, Ranked, SelectionStep
from ppmcal.diagnosis.residual_series import Series
from ppmcal.io.results.codec import Part, Shown, Text, Whole
from ppmcal.linalg import Array
from ppmcal.units import Units


class PlottedActuator(Part):
    """Rms of one joint's error without and with the effects, and what noise gives, in ``unit``."""

    name: Text = ""
    unit: Text = ""
    rms_before: Shown | None = None
    rms_after: Shown | None = None
    noise: Shown | None = None

    @classmethod
    def of(cls, a: ActuatorError, units: Units) -> PlottedActuator:
        """Return one joint's errors in file units."""
        f = units.factor(a.quantity)
        return cls(name=a.name, unit=units.name(a.quantity), rms_before=_number(a.before / f),
                   rms_after=_number(a.after / f), noise=_number(a.noise / f))


class PlottedSeries(Part):
    """Mean errors in bins of one input, with half of their 95 % intervals.

    ``effect`` is an index into the diagnosis's effects. The errors are of the joints ``on`` or,
    where there are none, of the measured ``coordinate``, in ``unit``; ``x`` and ``period`` are in
    ``input_unit``; ``names`` are those of classes.
    """

    effect: Whole | None = None
    role: Text = ""
    on: tuple[Text, ...] = ()
    coordinate: Text = ""
    input: Text = ""
    which: Text = ""
    input_unit: Text = ""
    unit: Text = ""
    period: Shown | None = None
    x: tuple[Shown | None, ...] = ()
    names: tuple[Text, ...] = ()
    count: tuple[Whole, ...] = ()
    before: tuple[Shown | None, ...] = ()
    before_95: tuple[Shown | None, ...] = ()
    after: tuple[Shown | None, ...] = ()
    after_95: tuple[Shown | None, ...] = ()

    @classmethod
    def of(cls, s: Series, units: Units) -> PlottedSeries:
        """Return a series in file units."""
        bins, f = s.bins, units.factor(s.quantity)
        per = units.factor(s.input_quantity) if s.input_quantity not in ("", "deg C") else 1.0
        return cls(effect=s.effect, role=s.role, on=s.on, coordinate=s.coordinate, input=s.input,
                   which=s.which,
                   input_unit=units.name(s.input_quantity) if s.input_quantity else "",
                   unit=units.name(s.quantity),
                   period=_number(s.period / per) if s.period else None, x=_rounded(bins.x / per),
                   names=bins.names, count=tuple(bins.count.tolist()),
                   before=_rounded(bins.before / f), before_95=_rounded(bins.before_half / f),
                   after=_rounded(bins.after / f), after_95=_rounded(bins.after_half / f))


class PlottedHypothesis(Part):
    """A hypothesis by strength of evidence: log10 of its p-value, and of that alone.

    ``form``: ``one value`` or ``one each`` where it acts on several actuators.
    """

    kind: Text = ""
    on: tuple[Text, ...] = ()
    form: Text = ""
    log10_p: Shown | None = None
    log10_p_alone: Shown | None = None
    status: Text = ""

    @classmethod
    def of(cls, r: Ranked) -> PlottedHypothesis:
        """Return a ranked hypothesis."""
        return cls(kind=r.kind, on=r.on, form=r.form, log10_p=_number(r.log_p / np.log(10.0)),
                   log10_p_alone=_number(r.log_p_alone / np.log(10.0)), status=r.status)


class PlottedStep(Part):
    """One model, from the machine as given to the last effect: rms over the noise."""

    what: Text = ""
    kind: Text = ""
    on: tuple[Text, ...] = ()
    rms_ratio: Shown | None = None

    @classmethod
    def of(cls, s: SelectionStep) -> PlottedStep:
        """Return a step of the selection."""
        return cls(what=s.what, kind=s.kind, on=s.on, rms_ratio=_number(s.ratio))


class DiagnosisPlots(Part):
    """What all pictures show; ``left_out_rows``: rows in them that the fit has left out."""

    actuators: tuple[PlottedActuator, ...] = ()
    series: tuple[PlottedSeries, ...] = ()
    ranking: tuple[PlottedHypothesis, ...] = ()
    steps: tuple[PlottedStep, ...] = ()
    left_out_rows: Whole = 0

    @classmethod
    def of(cls, data: PlotData, units: Units) -> DiagnosisPlots:
        """Return plot data in file units."""
        return cls(actuators=tuple(PlottedActuator.of(a, units) for a in data.actuators),
                   series=tuple(PlottedSeries.of(s, units) for s in data.series),
                   ranking=tuple(PlottedHypothesis.of(r) for r in data.ranking),
                   steps=tuple(PlottedStep.of(s) for s in data.steps),
                   left_out_rows=data.left_out)


def _rounded(values: Array) -> tuple[float, ...]:
    return tuple(_number(float(v)) for v in values)


def _number(value: float) -> float:
    """Return a number with six digits."""
    return float(f"{value:.6g}")
