"""certificate.json: what is certified, its figures, their uncertainty, and the decision."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Annotated, ClassVar

from ppmcal.calibration.validation import Budget, Figure, PlacedError
from ppmcal.codec import unsaid
from ppmcal.io.results.parts import Range
from ppmcal.io.results.record import Finite, Flag, Part, Record, Text
from ppmcal.store.provenance import Provenance
from ppmcal.units import Key, Length, Units


class CertifiedParty(Part):
    """A customer or a laboratory."""

    name: Text = ""
    city: Text = ""
    country: Text = ""
    accreditation: Text = ""


class CertificateRecord(Record):
    """certificate.json, in ``units``.

    ``basis``: what the errors are of; ``gauge``: of a machine that measures itself, what its frames
    stand on; ``rows``: of the judged data; ``digests``: SHA-256 of what is certified;
    ``instrument``: what measured, null where nothing did, with the expanded ``uncertainty`` of a
    length by its own certificate; ``accepted``: the largest ``decided`` figure that passes;
    ``result``: pass or fail.
    ``held_out``: whether errors are of poses that identify held out, for want of others.
    """

    FILE: ClassVar[str] = "certificate.json"
    FORMAT: ClassVar[str] = "ppmcal/certificate/1"

    name: Text = ""
    number: Text = ""
    maker: Annotated[Text, Key("machine.maker")] = ""
    model: Annotated[Text, Key("machine.model")] = ""
    serial: Annotated[Text, Key("machine.serial")] = ""
    of_file: Annotated[Text, Key("machine.name")] = ""
    customer: CertifiedParty = CertifiedParty()
    laboratory: CertifiedParty = CertifiedParty()
    instrument: Annotated[Text | None, Key("instrument.make", whole=True)] = None
    instrument_serial: Annotated[Text, Key("instrument.serial")] = ""
    instrument_certificate: Annotated[Text, Key("instrument.certificate")] = ""
    calibrated: Annotated[Text, Key("instrument.calibrated")] = ""
    uncertainty: Annotated[Length[Finite | None], Key("instrument.uncertainty")] = None
    coverage_factor: Annotated[Finite | None, Key("instrument.coverage_factor")] = None
    date: Text = ""
    issued: Text = ""
    operator: Text = ""
    temperature: tuple[Finite | None, ...] = ()
    conditions: Mapping[Text, Text] = field(default_factory=dict)
    basis: Text = ""
    gauge: Text = ""
    held_out: Flag = False
    figures: tuple[Figure, ...] = ()
    budget: Budget = unsaid(Budget)
    rule: Annotated[Text, Key("decision.rule")] = ""
    decided: Annotated[Text, Key("decision.of")] = ""
    limit: Annotated[Length[Finite | None], Key("decision.limit")] = None
    decided_value: Annotated[Length[Finite | None], Key("decision.value")] = None
    accepted: Annotated[Length[Finite | None], Key("decision.accepted")] = None
    result: Annotated[Text, Key("decision.result")] = ""
    validity: tuple[Range, ...] = ()
    rows: tuple[PlacedError, ...] = ()
    findings: tuple[Text, ...] = ()
    units: Units = unsaid(Units)
    digests: Mapping[Text, Text] = field(default_factory=dict)
    provenance: Provenance = Provenance()
