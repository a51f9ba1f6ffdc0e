"""The certificate as a Digital Calibration Certificate (PTB's DCC 3.3.0), numbers in D-SI."""

from __future__ import annotations

import math
from collections.abc import Sequence
from xml.etree import ElementTree as ET

from ppmcal.calibration.validation import Figure
from ppmcal.errors import printable
from ppmcal.io.results.certificate import CertificateRecord, CertifiedParty

DCC, SI = "https://ptb.de/dcc", "https://ptb.de/si"
VERSION = "3.3.0"
UNITS = {"m": ("\\metre", 1.0), "cm": ("\\centi\\metre", 1.0), "mm": ("\\milli\\metre", 1.0),
         "um": ("\\micro\\metre", 1.0),
         "in": ("\\milli\\metre", 25.4), "rad": ("\\radian", 1.0), "deg": ("\\degree", 1.0),
         "": ("\\one", 1.0), "°C": ("\\degreecelsius", 1.0), "kg": ("\\kilogram", 1.0),
         "N": ("\\newton", 1.0), "N m": ("\\newton\\metre", 1.0)}
"""A unit of ours in D-SI, and how many of that it is: D-SI knows no inch."""
NOTE = {"ISO 9283": "ISO 9283:1998", "ISO 230-2": "ISO 230-2:2014"}
Part = tuple[str, str | Sequence["Part"]]
"""An element: its name, and its text or the elements within it."""


def certificate_xml(record: CertificateRecord) -> str:
    """Return the XML."""
    ET.register_namespace("dcc", DCC)
    ET.register_namespace("si", SI)
    root = ET.Element(f"{{{DCC}}}digitalCalibrationCertificate", {
        "schemaVersion": VERSION,
        "{http://www.w3.org/2001/XMLSchema-instance}schemaLocation":
            f"{DCC} {DCC}/v{VERSION}/dcc.xsd"})
    _grow(root, [_administrative(record),
                 ("measurementResults", [("measurementResult", _results(record))])])
    ET.indent(root)
    return ET.tostring(root, "unicode", xml_declaration=False).join((
        '<?xml version="1.0" encoding="UTF-8"?>\n', "\n"))


def _grow(parent: ET.Element, parts: Sequence[Part]) -> None:
    """Add elements, and what is within them; texts are in English."""
    for name, content in parts:
        of_si = name.startswith("si:")
        one = ET.SubElement(parent, f"{{{SI if of_si else DCC}}}{name.removeprefix('si:')}")
        if name == "content":
            one.set("lang", "en")
        if not isinstance(content, str):
            _grow(one, content)
        elif content:
            one.text = printable(content)    # XML has no control characters


def _named(text: str) -> Part:
    return "name", [("content", text)]


def _given(name: str, text: str) -> list[Part]:
    """Return an element that is left out where there is no text."""
    return [(name, text)] if text else []


def _rich(name: str, *texts: str) -> list[Part]:
    """Return paragraphs, none without text."""
    return [(name, [("content", text) for text in texts if text])] if any(texts) else []


def _serial(number: str) -> Part:
    return "identifications", [("identification", [
        ("issuer", "manufacturer"), ("value", number), _named("serial number")])]


# ---- who


def _administrative(record: CertificateRecord) -> Part:
    laboratory = record.laboratory
    return "administrativeData", [
        ("dccSoftware", [("software", [
            _named("ppmcal"), ("release", record.provenance.version)])]),
        ("coreData", [
            ("countryCodeISO3166_1", laboratory.country), ("usedLangCodeISO639_1", "en"),
            ("mandatoryLangCodeISO639_1", "en"), ("uniqueIdentifier", record.number),
            ("beginPerformanceDate", record.date), ("endPerformanceDate", record.date),
            ("performanceLocation", "other"), ("issueDate", record.issued)]),
        ("items", [("item", [
            _named(record.name), ("manufacturer", [_named(record.maker)]),
            *_given("model", record.model), _serial(record.serial)])]),
        ("calibrationLaboratory", [
            *_given("calibrationLaboratoryCode", laboratory.accreditation),
            ("contact", _contact(laboratory))]),
        ("respPersons", [("respPerson", [
            ("person", [_named(record.operator)]), ("mainSigner", "true")])]),
        ("customer", _contact(record.customer))]


def _contact(who: CertifiedParty) -> list[Part]:
    return [_named(who.name),
            ("location", [*_given("city", who.city), ("countryCode", who.country)])]


# ---- how, by what and under which conditions


def _results(record: CertificateRecord) -> list[Part]:
    return [
        _named(f"Calibration of {record.name}"),
        *_rich("description", record.basis, record.gauge), _methods(record),
        *([] if record.instrument is None else [
            ("measuringEquipments", [_instrument(record.instrument, record)])]),
        _conditions(record),
        ("results", [*(_figure(f, record) for f in record.figures if f.value is not None),
                     _budget(record), *_validity(record)]),
        *_decision(record)]


def _methods(record: CertificateRecord) -> Part:
    norms = dict.fromkeys(f.norm for f in record.figures if f.norm and f.value is not None)
    return "usedMethods", [
        ("usedMethod", [_named("Kinematic calibration, judged by rows that no fit has seen")]),
        *(("usedMethod", [_named(norm), ("norm", NOTE.get(norm, norm))]) for norm in norms),
        ("usedMethod", [_named("Uncertainty of measurement"), ("norm", "JCGM 100:2008")])]


def _instrument(name: str, record: CertificateRecord) -> Part:
    known = record.uncertainty is not None and record.coverage_factor
    return "measuringEquipment", [
        _named(name),
        *_rich("description", f"Calibration certificate {record.instrument_certificate} of "
               f"{record.calibrated}"),
        _serial(record.instrument_serial),
        *([("measuringEquipmentQuantities", [("measuringEquipmentQuantity", [
            _named("expanded uncertainty of a length"),
            _real(record.uncertainty or 0.0, record.units.name("length"))])])] if known else [])]


def _conditions(record: CertificateRecord) -> Part:
    ends = ("lowest", record.temperature[0]), ("highest", record.temperature[-1])
    return "influenceConditions", [
        ("influenceCondition", [_named("air temperature"), ("data", [
            _quantity(name, value or 0.0, "°C") for name, value in ends])]),
        *(("influenceCondition", [_named(name), ("data", _rich("text", words))])
          for name, words in record.conditions.items())]


# ---- numbers


def _real(value: float, unit: str, expanded: float | None = None, factor: float | None = None,
          coverage: float | None = None) -> Part:
    """Return a number with its unit, and its uncertainty where it has one."""
    name, times = UNITS[unit]
    return "si:real", [
        ("si:value", repr(float(value * times))), ("si:unit", name),
        *([] if expanded is None else [
            ("si:measurementUncertaintyUnivariate", [("si:expandedMU", [
                ("si:valueExpandedMU", repr(float(expanded * times))),
                ("si:coverageFactor", repr(float(factor or 2.0))),
                ("si:coverageProbability", repr(float(coverage or 0.95)))])])])]


def _quantity(name: str, value: float, unit: str, described: str = "") -> Part:
    return "quantity", [_named(name), *_rich("description", described), _real(value, unit)]


def _figure(f: Figure, record: CertificateRecord) -> Part:
    told = f"{f.norm}, {f.place}, {f.repeats} repeats of {f.asked} asked" if f.norm else f.place
    budget = record.budget
    return "result", [
        _named(f.label), *_rich("description", told),
        ("data", [("quantity", [_named(f.label), _real(
            f.value or 0.0, f.unit, f.expanded, budget.factor, budget.coverage)])])]


def _budget(record: CertificateRecord) -> Part:
    b, unit, lines = record.budget, record.units.name("length"), list[Part]()
    for line in b.lines:
        degrees = f"{line.degrees:.6g}" if math.isfinite(line.degrees) else "infinite"
        lines.append(_quantity(
            f"standard uncertainty: {line.source}", line.standard, unit,
            f"type {line.kind}, {line.distribution}, degrees of freedom {degrees}, sensitivity "
            f"{line.sensitivity:g}; {line.note}"))
    return "result", [_named(f"uncertainty budget of {b.of}"), ("data", [
        *lines, _quantity("combined standard uncertainty", b.combined, unit),
        _quantity("expanded uncertainty", b.expanded, unit),
        _quantity("coverage factor", b.factor, ""),
        *([_quantity("effective degrees of freedom", b.degrees, "")]
          if math.isfinite(b.degrees) else [])])]


def _validity(record: CertificateRecord) -> list[Part]:
    some = [_quantity(f"{r.name}, {end}", value or 0.0, r.unit) for r in record.validity
            if r.unit in UNITS and None not in (r.low, r.high)
            for end, value in (("lowest", r.low), ("highest", r.high))]
    return [("result", [_named("range of validity"), ("data", some)])] if some else []


def _decision(record: CertificateRecord) -> list[Part]:
    if not record.result:
        return []
    unit = record.units.name("length")
    return [("measurementMetaData", [("metaData", [
        _named("statement of conformity"), ("norm", "ILAC-G8:09/2019"), ("norm", "JCGM 106:2012"),
        *_rich("declaration", f"{record.rule}: {record.decided} against the limit, accepted up to "
               f"{record.accepted!r} {unit}"),
        ("conformity", record.result),
        ("data", [_quantity("limit", record.limit or 0.0, unit),
                  _quantity("acceptance limit", record.accepted or 0.0, unit)])])])]
