"""certificate.json: what is certified, its figures, their uncertainty, and the decision."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import ClassVar

from ppmcal.codec import unsaid
from ppmcal.io.results.parts import Range
from ppmcal.io.results.record import Finite, Flag, Part, Record, Text, Whole
from ppmcal.store.provenance import Provenance
from ppmcal.units import Length, OfUnit, Units


class CertifiedParty(Part):
    """A customer or a laboratory."""

    name: Text = ""
    city: Text = ""
    country: Text = ""
    accreditation: Text = ""


class CertifiedMachine(Part):
    """The machine: maker, model, serial number, name of its file."""

    maker: Text = ""
    model: Text = ""
    serial: Text = ""
    name: Text = ""


class CertifiedInstrument(Part):
    """What measured; ``uncertainty``: expanded, of a length, by its own certificate."""

    make: Text = ""
    serial: Text = ""
    certificate: Text = ""
    calibrated: Text = ""
    uncertainty: Length[Finite | None] = None
    coverage_factor: Finite | None = None


class CertifiedFigure(Part):
    """One figure in ``unit``; ``value`` None where the rows do not allow it, and ``why``.

    ``expanded``: its expanded uncertainty; ``repeats``: fewest behind it, of those ``asked``.
    """

    symbol: Text = ""
    name: Text = ""
    value: OfUnit[Finite | None] = None
    expanded: OfUnit[Finite | None] = None
    unit: Text = ""
    norm: Text = ""
    repeats: Whole = 0
    asked: Whole = 0
    where: Text = ""
    why: Text = ""

    @property
    def label(self) -> str:
        """What it is called, with its symbol."""
        return f"{self.name}, {self.symbol}" if self.symbol else self.name


class CertifiedContribution(Part):
    """A line of the budget; ``degrees`` None: taken as known; ``sensitivity`` is bare."""

    source: Text = ""
    kind: Text = ""
    distribution: Text = ""
    standard: Length[Finite | None] = None
    degrees: Finite | None = None
    sensitivity: Finite | None = None
    part: Length[Finite | None] = None
    note: Text = ""


class CertifiedBudget(Part):
    """The uncertainty by the GUM, ``of`` a position along any one direction, or of a closure.

    ``degrees``: effective ones by Welch and Satterthwaite, None where all are known; ``factor``:
    that the combined one is expanded by.
    """

    of: Text = ""
    lines: tuple[CertifiedContribution, ...] = ()
    combined: Length[Finite | None] = None
    degrees: Finite | None = None
    factor: Finite | None = None
    coverage: Finite | None = None
    expanded: Length[Finite | None] = None


class CertifiedDecision(Part):
    """The decision: ``accepted``: the largest figure that passes; ``result`` pass or fail."""

    rule: Text = ""
    of: Text = ""
    limit: Length[Finite | None] = None
    value: Length[Finite | None] = None
    accepted: Length[Finite | None] = None
    result: Text = ""


class CertifiedRow(Part):
    """A place (base frame) and the error there, in ``units``, for the map."""

    place: Length[tuple[Finite | None, ...]] = ()
    error: Length[Finite | None] = None


class CertificateRecord(Record):
    """certificate.json, in ``units``.

    ``basis``: what the errors are of; ``gauge``: of a machine that measures itself, what its frames
    stand on; ``rows``: of the judged data; ``digests``: SHA-256 of what is certified;
    ``held_out``: whether errors are of poses that identify held out, for want of others.
    """

    FILE: ClassVar[str] = "certificate.json"
    FORMAT: ClassVar[str] = "ppmcal/certificate/1"

    name: Text = ""
    number: Text = ""
    machine: CertifiedMachine = CertifiedMachine()
    customer: CertifiedParty = CertifiedParty()
    laboratory: CertifiedParty = CertifiedParty()
    instrument: CertifiedInstrument | None = None
    date: Text = ""
    issued: Text = ""
    operator: Text = ""
    temperature: tuple[Finite | None, ...] = ()
    conditions: Mapping[Text, Text] = field(default_factory=dict)
    basis: Text = ""
    gauge: Text = ""
    held_out: Flag = False
    figures: tuple[CertifiedFigure, ...] = ()
    budget: CertifiedBudget = CertifiedBudget()
    decision: CertifiedDecision = CertifiedDecision()
    validity: tuple[Range, ...] = ()
    rows: tuple[CertifiedRow, ...] = ()
    findings: tuple[Text, ...] = ()
    units: Units = unsaid(Units)
    digests: Mapping[Text, Text] = field(default_factory=dict)
    provenance: Provenance = Provenance()
