"""certificate.json, and what stands on a certificate, its PDF and in reports, part by part."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, ClassVar, TypeVar

from ppmcal.calibration.validation import Budget, Figure, PlacedError
from ppmcal.codec import unsaid
from ppmcal.io.results.parts import Range
from ppmcal.io.results.record import Finite, Flag, Part, Record, Text
from ppmcal.store.provenance import Provenance
from ppmcal.units import Key, Length, Units
from ppmcal.wording import number

K = TypeVar("K")
V = TypeVar("V")


class CertifiedParty(Part):
    """A customer or a laboratory."""

    name: Text = ""
    city: Text = ""
    country: Text = ""
    accreditation: Text = ""

    @property
    def words(self) -> str:
        """Name, city and country."""
        return ", ".join(filter(None, (self.name, self.city, self.country)))


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


NONE = "–"
ISO_POSES, ISO_AXES = 30, 5
"""Repeats that ISO 9283 and ISO 230-2 ask for, from one side."""
ASKED = {"ISO 9283": ISO_POSES, "ISO 230-2": ISO_AXES}


@dataclass(frozen=True)
class Heading:
    """The beginning of a chapter."""

    text: str


@dataclass(frozen=True)
class NamedLines:
    """Names and what they are."""

    pairs: Sequence[tuple[str, str]]


@dataclass(frozen=True)
class PrintedTable:
    """A table; ``widths``: of its columns, parts of the page's; ``right``: columns of numbers."""

    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    widths: Sequence[float]
    right: Sequence[int] = ()


@dataclass(frozen=True)
class Words:
    """A paragraph."""

    text: str


@dataclass(frozen=True)
class ErrorMap:
    """The picture of the errors over the measured volume."""


Block = Heading | NamedLines | PrintedTable | Words | ErrorMap


def title(record: CertificateRecord) -> str:
    """Return the certificate's title."""
    return f"Calibration certificate {record.number}"


def blocks(record: CertificateRecord) -> Iterator[Block]:
    """Yield the parts of a certificate in their order."""
    yield from _who(record)
    yield Heading("Results")
    yield Words(record.basis)
    if record.gauge:
        yield Words(record.gauge)
    yield from _figures(record)
    yield from _budget(record)
    yield from _decision(record)
    if record.rows:
        yield Heading("Errors over the measured volume")
        yield ErrorMap()
    yield from _validity(record)
    yield from _provenance(record)


def _value(value: float | None, unit: str = "", digits: int = 4) -> str:
    return NONE if value is None or math.isnan(value) else f"{number(value, digits)} {unit}".strip()


def _who(record: CertificateRecord) -> Iterator[Block]:
    unit = record.units.name("length")
    lab = record.laboratory
    accredited = f", accreditation {lab.accreditation}" if lab.accreditation else ""
    low, high = record.temperature[0], record.temperature[-1]
    warm = _value(low) if low == high else f"{_value(low)} to {_value(high)}"
    yield NamedLines([
        ("Machine", " ".join(filter(None, (record.maker, record.model)))
         + f", serial number {record.serial} ({record.of_file})"),
        ("Customer", record.customer.words), ("Laboratory", lab.words + accredited),
        ("Measured", f"{record.date} by {record.operator}"), ("Issued", record.issued),
        ("Instrument", "none: joint values alone" if record.instrument is None else
         f"{record.instrument}, serial number {record.instrument_serial}, certificate "
         f"{record.instrument_certificate} of {record.calibrated}, "
         f"U = {_value(record.uncertainty, unit)} (k = {_value(record.coverage_factor)})"),
        ("Temperature", f"{warm} °C"),
        *((name[:1].upper() + name[1:], told) for name, told in record.conditions.items())])


def _figures(record: CertificateRecord) -> Iterator[Block]:
    given = [f for f in record.figures if f.value is not None]
    yield PrintedTable(["figure", "standard", "value", "U", "unit", "of"], [
        [f.label, f.norm or NONE, _value(f.value), _value(f.expanded), f.unit, _of(f)]
        for f in given], (0.34, 0.13, 0.12, 0.11, 0.06, 0.24), (2, 3))
    missing = _by(((f.norm, f.why), f) for f in record.figures if f.value is None)
    if missing:
        yield Words("Figures of the standards that these rows do not allow:")
        yield PrintedTable(["standard", "figures", "why"], [
            [norm, "; ".join(alike(figures)), why] for (norm, why), figures in missing.items()],
            (0.13, 0.35, 0.52))


def alike(figures: Sequence[Figure]) -> Iterator[str]:
    """Yield symbols, of which joints, in which files: what is the same for several at once."""
    symbols = _by(((f.file, f.where), f.symbol) for f in figures)
    joints = _by(((file, ", ".join(own)), where) for (file, where), own in symbols.items())
    files = _by((f"{told} of {', '.join(own)}" if any(own) else told, file)
                for (file, told), own in joints.items())
    yield from (f"{of} ({', '.join(own)})" if any(own) else of for of, own in files.items())


def _by(pairs: Iterable[tuple[K, V]]) -> dict[K, list[V]]:
    """Return the second of each pair by the first, in their order."""
    found: dict[K, list[V]] = {}
    for key, value in pairs:
        found.setdefault(key, []).append(value)
    return found


def _of(f: Figure) -> str:
    if not f.asked:
        return f.place or "all rows"
    fewer = f", n = {f.repeats}" + (f" ({f.asked} agreed)" if f.asked < ASKED[f.norm] else "")
    return f.place + fewer


def _budget(record: CertificateRecord) -> Iterator[Block]:
    b, unit = record.budget, record.units.name("length")
    yield Heading("Uncertainty (GUM)")
    yield PrintedTable(["contribution", "type", "distribution", f"u, {unit}", "degrees", "c",
                f"c u, {unit}", "from"], [
        [c.source, c.kind, c.distribution, _value(c.standard),
         "∞" if not math.isfinite(c.degrees) else _value(c.degrees, digits=3),
         _value(c.sensitivity), _value(c.part), c.note] for c in b.lines],
        (0.16, 0.06, 0.13, 0.11, 0.10, 0.04, 0.11, 0.29), (3, 4, 5, 6))
    degrees = "∞" if not math.isfinite(b.degrees) else _value(b.degrees, digits=3)
    yield Words(f"Combined u = {_value(b.combined, unit)}; effective degrees of freedom {degrees} "
                f"(Welch-Satterthwaite); k = {_value(b.factor, digits=3)}; expanded uncertainty "
                f"U = {_value(b.expanded, unit)}, of {b.of}, for a coverage probability of about "
                "95 %.")


def _decision(record: CertificateRecord) -> Iterator[Block]:
    unit = record.units.name("length")
    yield Heading("Decision")
    if not record.result:
        yield Words("No decision rule was agreed.")
        return
    how = ("the limit less the expanded uncertainty" if record.accepted != record.limit else
           "the limit itself")
    yield Words(f"{record.result.upper()} by {record.rule} (ILAC-G8, JCGM 106): the "
                f"{record.decided} is {_value(record.decided_value, unit)}, the limit "
                f"{_value(record.limit, unit)}, the acceptance limit "
                f"{_value(record.accepted, unit)} ({how}).")


def _validity(record: CertificateRecord) -> Iterator[Block]:
    if not record.validity:
        return
    yield Heading("Range of validity")
    yield PrintedTable(["", "from", "to", "unit"], [
        [r.name, _value(r.low, digits=6), _value(r.high, digits=6), r.unit]
        for r in record.validity], (0.4, 0.2, 0.2, 0.2), (1, 2))


def _provenance(record: CertificateRecord) -> Iterator[Block]:
    yield Heading("Made again")
    yield Words("Before this certificate was written, ppmcal "
                f"{record.provenance.version} made the results again from the measurements; every "
                "file came out as it is, by the bounds of verify. SHA-256:")
    yield PrintedTable(["file", "SHA-256"], [[n, d] for n, d in record.digests.items()],
                       (0.21, 0.79))
