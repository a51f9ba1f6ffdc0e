"""The certificate as a Digital Calibration Certificate (PTB's DCC 3.3.0), numbers in D-SI."""

from __future__ import annotations

import math
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


def certificate_xml(record: CertificateRecord) -> str:
    """Return the XML."""
    ET.register_namespace("dcc", DCC)
    ET.register_namespace("si", SI)
    root = ET.Element(f"{{{DCC}}}digitalCalibrationCertificate", {
        "schemaVersion": VERSION,
        "{http://www.w3.org/2001/XMLSchema-instance}schemaLocation":
            f"{DCC} {DCC}/v{VERSION}/dcc.xsd"})
    _administrative(root, record)
    results = _sub(_sub(root, "measurementResults"), "measurementResult")
    _text(results, "name", f"Calibration of {record.name}")
    _rich(results, "description", *filter(None, (record.basis, record.gauge)))
    _methods(results, record)
    if record.instrument is not None:
        _instrument(_sub(results, "measuringEquipments"), record)
    _conditions(results, record)
    found = _sub(results, "results")
    for figure in record.figures:
        if figure.value is not None:
            _figure(found, figure, record)
    _budget(found, record)
    _validity(found, record)
    _decision(results, record)
    ET.indent(root)
    return ET.tostring(root, "unicode", xml_declaration=False).join((
        '<?xml version="1.0" encoding="UTF-8"?>\n', "\n"))


def _sub(parent: ET.Element, name: str, text: str = "", space: str = DCC) -> ET.Element:
    out = ET.SubElement(parent, f"{{{space}}}{name}")
    if text:
        out.text = printable(text)    # XML has no control characters
    return out


def _text(parent: ET.Element, name: str, text: str) -> None:
    """Add a text in English: a name."""
    _sub(_sub(parent, name), "content", text).set("lang", "en")


def _rich(parent: ET.Element, name: str, *texts: str) -> None:
    """Add paragraphs in English."""
    if texts:
        inner = _sub(parent, name)
        for text in texts:
            _sub(inner, "content", text).set("lang", "en")


def _identified(parent: ET.Element, issuer: str, value: str, name: str) -> None:
    one = _sub(_sub(parent, "identifications"), "identification")
    _sub(one, "issuer", issuer)
    _sub(one, "value", value)
    _text(one, "name", name)


# ---- who


def _administrative(root: ET.Element, record: CertificateRecord) -> None:
    part = _sub(root, "administrativeData")
    software = _sub(_sub(part, "dccSoftware"), "software")
    _text(software, "name", "ppmcal")
    _sub(software, "release", record.provenance.version)
    core = _sub(part, "coreData")
    _sub(core, "countryCodeISO3166_1", record.laboratory.country)
    _sub(core, "usedLangCodeISO639_1", "en")
    _sub(core, "mandatoryLangCodeISO639_1", "en")
    _sub(core, "uniqueIdentifier", record.number)
    _sub(core, "beginPerformanceDate", record.date)
    _sub(core, "endPerformanceDate", record.date)
    _sub(core, "performanceLocation", "other")
    _sub(core, "issueDate", record.issued)
    items = _sub(part, "items")
    item = _sub(items, "item")
    _text(item, "name", record.name)
    _text(_sub(item, "manufacturer"), "name", record.maker)
    if record.model:
        _sub(item, "model", record.model)
    _identified(item, "manufacturer", record.serial, "serial number")
    laboratory = _sub(part, "calibrationLaboratory")
    if record.laboratory.accreditation:
        _sub(laboratory, "calibrationLaboratoryCode", record.laboratory.accreditation)
    _contact(_sub(laboratory, "contact"), record.laboratory)
    person = _sub(_sub(part, "respPersons"), "respPerson")
    _text(_sub(person, "person"), "name", record.operator)
    _sub(person, "mainSigner", "true")
    _contact(_sub(part, "customer"), record.customer)


def _contact(parent: ET.Element, who: CertifiedParty) -> None:
    _text(parent, "name", who.name)
    place = _sub(parent, "location")
    if who.city:
        _sub(place, "city", who.city)
    _sub(place, "countryCode", who.country)


def _methods(results: ET.Element, record: CertificateRecord) -> None:
    part = _sub(results, "usedMethods")
    one = _sub(part, "usedMethod")
    _text(one, "name", "Kinematic calibration, judged by rows that no fit has seen")
    for norm in dict.fromkeys(f.norm for f in record.figures if f.norm and f.value is not None):
        one = _sub(part, "usedMethod")
        _text(one, "name", norm)
        _sub(one, "norm", NOTE.get(norm, norm))
    one = _sub(part, "usedMethod")
    _text(one, "name", "Uncertainty of measurement")
    _sub(one, "norm", "JCGM 100:2008")


def _instrument(parent: ET.Element, record: CertificateRecord) -> None:
    one = _sub(parent, "measuringEquipment")
    _text(one, "name", record.instrument or "")
    _rich(one, "description",
          f"Calibration certificate {record.instrument_certificate} of {record.calibrated}")
    _identified(one, "manufacturer", record.instrument_serial, "serial number")
    if record.uncertainty is not None and record.coverage_factor:
        quantity = _sub(_sub(one, "measuringEquipmentQuantities"), "measuringEquipmentQuantity")
        _text(quantity, "name", "expanded uncertainty of a length")
        _real(quantity, record.uncertainty, record.units.name("length"))


def _conditions(results: ET.Element, record: CertificateRecord) -> None:
    part = _sub(results, "influenceConditions")
    one = _sub(part, "influenceCondition")
    _text(one, "name", "air temperature")
    data = _sub(one, "data")
    for name, value in zip(("lowest", "highest"), (record.temperature[0], record.temperature[-1]),
                           strict=True):
        quantity = _sub(data, "quantity")
        _text(quantity, "name", name)
        _real(quantity, value or 0.0, "°C")
    for name, words in record.conditions.items():
        one = _sub(part, "influenceCondition")
        _text(one, "name", name)
        _rich(_sub(one, "data"), "text", words)


# ---- numbers


def _real(parent: ET.Element, value: float, unit: str, expanded: float | None = None,
          factor: float | None = None, coverage: float | None = None) -> None:
    """Add a number with its unit, and its uncertainty where it has one."""
    name, times = UNITS[unit]
    real = _sub(parent, "real", space=SI)
    _sub(real, "value", repr(float(value * times)), SI)
    _sub(real, "unit", name, SI)
    if expanded is not None:
        own = _sub(_sub(real, "measurementUncertaintyUnivariate", space=SI), "expandedMU", space=SI)
        _sub(own, "valueExpandedMU", repr(float(expanded * times)), SI)
        _sub(own, "coverageFactor", repr(float(factor or 2.0)), SI)
        _sub(own, "coverageProbability", repr(float(coverage or 0.95)), SI)


def _quantity(data: ET.Element, name: str, value: float, unit: str, *described: str) -> None:
    quantity = _sub(data, "quantity")
    _text(quantity, "name", name)
    _rich(quantity, "description", *described)
    _real(quantity, value, unit)


def _figure(found: ET.Element, f: Figure, record: CertificateRecord) -> None:
    result = _sub(found, "result")
    _text(result, "name", f.label)
    told = (f"{f.norm}, {f.place}, {f.repeats} repeats of {f.asked} asked" if f.norm else f.place)
    _rich(result, "description", *filter(None, (told,)))
    quantity = _sub(_sub(result, "data"), "quantity")
    _text(quantity, "name", f.label)
    b = record.budget
    _real(quantity, f.value or 0.0, f.unit, f.expanded, b.factor, b.coverage)


def _budget(found: ET.Element, record: CertificateRecord) -> None:
    b, unit = record.budget, record.units.name("length")
    result = _sub(found, "result")
    _text(result, "name", f"uncertainty budget of {b.of}")
    data = _sub(result, "data")
    for line in b.lines:
        degrees = "infinite" if not math.isfinite(line.degrees) else f"{line.degrees:.6g}"
        _quantity(data, f"standard uncertainty: {line.source}", line.standard, unit,
                  f"type {line.kind}, {line.distribution}, degrees of freedom {degrees}, "
                  f"sensitivity {line.sensitivity:g}; {line.note}")
    _quantity(data, "combined standard uncertainty", b.combined, unit)
    _quantity(data, "expanded uncertainty", b.expanded, unit)
    _quantity(data, "coverage factor", b.factor, "")
    if math.isfinite(b.degrees):
        _quantity(data, "effective degrees of freedom", b.degrees, "")


def _validity(found: ET.Element, record: CertificateRecord) -> None:
    some = [r for r in record.validity if r.unit in UNITS and None not in (r.low, r.high)]
    if not some:
        return
    result = _sub(found, "result")
    _text(result, "name", "range of validity")
    data = _sub(result, "data")
    for r in some:
        _quantity(data, f"{r.name}, lowest", r.low or 0.0, r.unit)
        _quantity(data, f"{r.name}, highest", r.high or 0.0, r.unit)


def _decision(results: ET.Element, record: CertificateRecord) -> None:
    unit = record.units.name("length")
    if not record.result:
        return
    one = _sub(_sub(results, "measurementMetaData"), "metaData")
    _text(one, "name", "statement of conformity")
    _sub(one, "norm", "ILAC-G8:09/2019")
    _sub(one, "norm", "JCGM 106:2012")
    _rich(one, "declaration", f"{record.rule}: {record.decided} against the limit, accepted "
          f"up to {record.accepted!r} {unit}")
    _sub(one, "conformity", record.result)
    data = _sub(one, "data")
    _quantity(data, "limit", record.limit or 0.0, unit)
    _quantity(data, "acceptance limit", record.accepted or 0.0, unit)
