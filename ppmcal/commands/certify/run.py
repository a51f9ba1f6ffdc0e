"""A calibration certificate, once the results behind it have come out again."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from ppmcal.calibration.validation import Budget, Figure
from ppmcal.codec import in_units
from ppmcal.commands.certify.about import LARGEST, NONE, AboutFile, read_about
from ppmcal.commands.certify.dcc import certificate_xml
from ppmcal.commands.certify.evidence import Evidence, gathered, refuse_unknown_cause
from ppmcal.commands.certify.judge import FAIL, budget, decided, figures, places
from ppmcal.commands.certify.options import CertifyArguments
from ppmcal.commands.certify.printed import html_page, pdf_pages
from ppmcal.commands.result import Result
from ppmcal.errors import BadInput
from ppmcal.io import csv_text
from ppmcal.io.results.certificate import CertificateRecord, CertifiedParty
from ppmcal.io.results.parts import Range
from ppmcal.io.results.units import JOINT, MachineUnits
from ppmcal.model.dataset import ZERO_CELSIUS
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import NOTE, Note
from ppmcal.store.folder import read_record
from ppmcal.store.provenance import Provenance, source_of
from ppmcal.units import coordinate_quantity
from ppmcal.wording import number, pluralize, row_list
from ppmcal.wording.told import ShortTable, Told

CONDITION_UNITS = {"payload": "kg", "fx": "N", "fy": "N", "fz": "N", "mx": "N m", "my": "N m",
                   "mz": "N m"}
POSITION, LENGTH = "a position along any one direction", "a length that the instrument shows"
CLOSURE = "how far a limb is from closing"
GAUGE = ("No instrument: the machine measured itself by its joints. Lengths are those of its own "
         "drives, and the frames of base and platform are defined by the values that its file "
         "holds (gauge); what lies outside of the machine is not certified.")


@dataclass(frozen=True, eq=False, repr=False)
class CertificateResult(Result):
    """A calibration certificate.

    Attributes:
        mechanism: the machine that is certified.
        record: the content of certificate.json.
    """

    COMMAND: ClassVar[str] = "certify"
    TABLE: ClassVar[str] = "figures.csv"
    UNTOLD: ClassVar[tuple[str, ...]] = ("rows",)

    mechanism: Mechanism
    record: CertificateRecord

    def files(self) -> Mapping[str, str | bytes]:
        """Return the page, the PDF, the XML and certificate.json."""
        return {"certificate.html": html_page(self.record),
                "certificate.pdf": pdf_pages(self.record),
                "certificate.xml": certificate_xml(self.record),
                self.record.FILE: self.record.text()}

    def tables(self) -> Mapping[str, str | bytes]:
        """Return the figures as a table besides the files."""
        fields = {"where": "place"}
        heads = ("symbol", "name", "unit", "norm", "where", "why", "value", "expanded")
        return {self.TABLE: csv_text(heads, [
            [getattr(f, fields.get(h, h)) for f in self.record.figures] for h in heads])}

    def headline(self) -> str:
        """Return number, machine and the decision."""
        told = self.record.result
        return (f"Certificate {self.record.number} of {self.record.maker} "
                f"{self.record.serial}" + (f": {told}" if told else ""))

    def told(self) -> Iterator[Told]:
        """Yield what errors are of, the figures, the budget and the decision."""
        record = self.record
        yield f"{self.headline()}."
        yield record.basis
        if record.gauge:
            yield record.gauge
        yield ShortTable(["figure", "value", "U", "unit"], [
            [f.label, number(f.value), "" if f.expanded is None else number(f.expanded), f.unit]
            for f in record.figures if f.value is not None], (1, 2))
        yield from dict.fromkeys(f"Not given by {f.norm}: {f.why}." for f in record.figures
                                 if f.value is None)
        b, unit = record.budget, record.units.name("length")
        degrees = "infinitely many" if not math.isfinite(b.degrees) else number(b.degrees, 3)
        yield (f"Expanded uncertainty of {b.of}: U = {number(b.expanded)} {unit} "
               f"(k = {number(b.factor, 3)}, {degrees} effective degrees of freedom, about 95 %).")
        if record.result:
            yield (f"Decision by {record.rule}: {record.result}. The {record.decided} is "
                   f"{number(record.decided_value)} {unit}, the limit {number(record.limit)} "
                   f"{unit}, the acceptance limit {number(record.accepted)} {unit}.")


def run(asked: CertifyArguments) -> CertificateResult:
    """Certify a calibration that comes out again as it is."""
    about, folder = read_about(asked.about), Path(asked.identified)
    given = asked.validation
    evidence = gathered(folder, [given] if isinstance(given, str | os.PathLike) else given)
    diagnosed = folder / "diagnosis.json"
    if diagnosed.is_file():
        verdict = str(json.loads(diagnosed.read_bytes()).get("verdict", ""))
        refuse_unknown_cause(verdict, str(diagnosed))
    _refuse_instrument(about, evidence, str(asked.about))
    found = figures(evidence, about)
    uncertain = budget(evidence, about, _measurand(evidence))
    source = source_of("certify", [str(asked.about), *evidence.inputs], None)
    for path, digest in evidence.inputs.items():
        if digest and source["inputs"][path] != digest:
            raise BadInput("changed after it had come out again, so that nothing is certified",
                           path, "Run certify again")
    record = recorded(about, evidence, found, uncertain, source, folder)
    return CertificateResult(source, record.findings, evidence.mechanism, record)


def _refuse_instrument(about: AboutFile, evidence: Evidence, path: str) -> None:
    """Refuse to certify what an unnamed instrument measured, and one that measured nothing.

    Raises:
        BadInput: at the file about the certificate.
    """
    blind = all(r.data.kind.blind for r in evidence.rows)
    if about.instrument is None and not blind:
        raise BadInput("the key 'instrument' is missing, and these rows were measured by one", path,
                       "Add it: make, serial, certificate, calibrated, uncertainty, "
                       "coverage_factor")
    if about.instrument is not None and blind:
        raise BadInput("these rows are of joint values alone, which no instrument measured",
                       f"{path}: instrument", "Leave the key out")
    late = about.instrument is not None and about.instrument.calibrated > about.date
    if late:
        raise BadInput("the instrument was calibrated after the measurement",
                       f"{path}: instrument.calibrated",
                       "Give the calibration that was valid on that day")


def recorded(about: AboutFile, evidence: Evidence, found: list[Figure], uncertain: Budget,
             source: Mapping[str, Any], folder: Path) -> CertificateRecord:
    """Return the certificate, in the units of the machine's file."""
    mechanism = evidence.mechanism
    units = MachineUnits.of(mechanism)
    expanded = uncertain.expanded
    shown = tuple(replace(one, expanded=expanded) if one.of_position else one for one in found)
    decision = _decision(about, found, expanded)
    unit, f = units.name("length"), units.factor("length")
    failed = (Note(f"{decision['decided']}: {number(decision['decided_value'] / f)} {unit} is more "
                   f"than the {number(decision['accepted'] / f)} {unit} that the rule "
                   f"'{decision['rule']}' accepts"),) if decision.get("result") == FAIL else ()
    told = (*(Note(str(f), NOTE) for f in mechanism.findings),
            *(f for r in evidence.rows for f in r.data.findings), *_left_out(evidence))
    blind = all(r.data.kind.blind for r in evidence.rows)
    return CertificateRecord.filled(
        None, units, format=CertificateRecord.FORMAT, name=mechanism.name, **_people(about),
        maker=about.machine.maker, model=about.machine.model or "",
        serial=about.machine.serial, of_file=mechanism.name,
        basis=_basis(evidence), gauge=GAUGE if blind else "", held_out=evidence.seen,
        figures=in_units(shown, units), budget=uncertain, **decision,
        validity=_validity(mechanism, units),
        rows=in_units(tuple(places(evidence)), units),
        findings=(*failed, *told), units=mechanism.units,
        digests={n: w.digest for n, w in sorted(read_record(folder).files.items())},
        provenance=Provenance(**source))


def _people(about: AboutFile) -> dict[str, Any]:
    """Return who certifies what for whom, and by what."""
    i = about.instrument
    by: dict[str, Any] = {"instrument": None} if i is None else {
        "instrument": i.make, "instrument_serial": i.serial,
        "instrument_certificate": i.certificate, "calibrated": i.calibrated,
        "uncertainty": i.uncertainty * about.length, "coverage_factor": i.coverage_factor}
    parties = {k: CertifiedParty(name=p.name, city=p.city or "", country=p.country,
                                 accreditation=p.accreditation or "")
               for k, p in (("customer", about.customer), ("laboratory", about.laboratory))}
    return {"number": about.number, **parties, **by, "date": about.date,
            "issued": about.issued or about.date, "operator": about.operator,
            "temperature": tuple(about.temperature), "conditions": dict(about.conditions)}


def _left_out(evidence: Evidence) -> Iterator[Note]:
    """Yield which rows count in no figure: typed wrong, or the model cannot predict them."""
    for r in evidence.rows:
        if r.left_out:
            yield Note(f"{r.data.name}: {row_list([n - 1 for n in r.left_out])} of "
                       f"{len(r.left_out) + int(r.keep.sum())} left out of every figure: typed "
                       "wrong, or such that the model cannot predict them")


def _measurand(evidence: Evidence) -> str:
    kinds = [r.data.kind for r in evidence.rows]
    if all(k.blind for k in kinds):
        return CLOSURE
    return LENGTH if all(k.blind or k.scalar for k in kinds) else POSITION


def _decision(about: AboutFile, found: list[Figure], expanded: float) -> dict[str, Any]:
    """Return what the rule says of the figure of position (of closure where there is no other).

    As fields of the record, SI.
    """
    rule, limit = about.decision.rule, about.decision.limit
    if rule == NONE or limit is None:
        return {"rule": NONE}
    which = about.decision.of or LARGEST
    one = next((f for f in found if f.name.startswith(f"{which} of ")
                and f.unit == "length" and f.value is not None), None)
    if one is None or one.value is None:
        raise BadInput(f"there is no {which} to decide on", "decision",
                       "Give measurements that no fit has seen, or write `rule: none`")
    result, accepted = decided(rule, one.value, limit * about.length, expanded)
    return {"rule": rule, "decided": one.name, "limit": limit * about.length,
            "decided_value": one.value, "accepted": accepted, "result": result}


def _basis(evidence: Evidence) -> str:
    """Return what the errors are of, in a sentence."""
    if evidence.seen:
        return ("Errors are those of poses that were held out of the fit; no other measurements "
                "were given.")
    rows = sum(int(r.keep.sum()) for r in evidence.rows)
    of = ", ".join(r.data.name for r in evidence.rows)
    return (f"Errors are those of {pluralize(rows, 'row')} of {of}, which no fit has seen, against "
            "the pose that the certified model gives at the commanded joint values.")


def _validity(mechanism: Mechanism, units: MachineUnits) -> tuple[Range, ...]:
    """Return what was measured for the calibration: its volume, joints and conditions."""
    out = list[Range]()
    for name, (low, high) in (mechanism.measured.ranges if mechanism.measured else {}).items():
        if name.startswith("temperature"):
            out.append(Range(name=name, low=low - ZERO_CELSIUS, high=high - ZERO_CELSIUS,
                                      unit="°C"))
        elif name in CONDITION_UNITS:
            out.append(Range(name=name, low=low, high=high, unit=CONDITION_UNITS[name]))
        elif name in ("x", "y", "z", "rx", "ry", "rz") or name.startswith("q_"):
            quantity = JOINT + name[2:] if name.startswith("q_") else coordinate_quantity(name)
            out.append(Range.filled(None, units, name=name, low=low, high=high,
                                             unit=quantity))
    return tuple(out)
