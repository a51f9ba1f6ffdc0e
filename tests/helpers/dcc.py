"""The structure of a Digital Calibration Certificate 3.3.0, as far as one of ours uses it.

Written by hand after PTB's published documentation: of each element which children it has, in which
order, and what its text may be. It is a part of the schema and no copy of it: an element that it
does not list is refused, though the schema may allow it. Where the environment variable
``PPMCAL_DCC_XSD`` names the schema itself and the package xmlschema is there,
``against_the_schema`` takes that.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from xml.etree import ElementTree as ET

NAMES = {"https://ptb.de/dcc": "dcc", "https://ptb.de/si": "si"}
WORDS, DATE, DECIMAL = r"\S+(\s+\S+)*", r"\d{4}-\d{2}-\d{2}", r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?"
POSITIVE, RICH, NAMED = DECIMAL.removeprefix("[-+]?"), "content+", "content+"
QUANTITY = "name? description? (si:real|noQuantity)"
CONTACT = "name eMail? phone? location"
CHILDREN = {
    "digitalCalibrationCertificate": "administrativeData measurementResults",
    "administrativeData": "dccSoftware coreData items calibrationLaboratory respPersons customer",
    "dccSoftware": "software+", "software": "name release", "items": "item+",
    "coreData": "countryCodeISO3166_1 usedLangCodeISO639_1+ mandatoryLangCodeISO639_1+ "
                "uniqueIdentifier beginPerformanceDate endPerformanceDate performanceLocation "
                "issueDate?",
    "item": "name description? manufacturer? model? identifications",
    "identifications": "identification+", "identification": "issuer value name?",
    "calibrationLaboratory": "calibrationLaboratoryCode? contact", "contact": CONTACT,
    "customer": CONTACT, "manufacturer": "name location?", "location": "(city|countryCode)+",
    "respPersons": "respPerson+", "respPerson": "person role? mainSigner?", "person": "name",
    "measurementResults": "measurementResult+",
    "measurementResult": "name description? usedMethods? measuringEquipments? "
                         "influenceConditions? results measurementMetaData?",
    "usedMethods": "usedMethod+", "usedMethod": "name description? norm*",
    "measuringEquipments": "measuringEquipment+",
    "measuringEquipment": "name description? manufacturer? model? identifications? "
                          "measuringEquipmentQuantities?",
    "measuringEquipmentQuantities": "measuringEquipmentQuantity+",
    "measuringEquipmentQuantity": QUANTITY, "quantity": QUANTITY,
    "influenceConditions": "influenceCondition+",
    "influenceCondition": "name description? data", "results": "result+",
    "result": "name description? data", "data": "(text|quantity)+",
    "measurementMetaData": "metaData+",
    "metaData": "name? description? norm* declaration? conformity? data?",
    "name": NAMED, "description": RICH, "text": RICH, "declaration": RICH,
    "si:real": "si:value si:unit si:measurementUncertaintyUnivariate?",
    "si:measurementUncertaintyUnivariate": "si:expandedMU",
    "si:expandedMU": "si:valueExpandedMU si:coverageFactor si:coverageProbability",
}
UNIT = (r"(\\(milli|micro|kilo))?\\(metre|radian|degree|one|degreecelsius|newton|gram)(\\metre)?"
        r"|\\kilogram")
TEXTS = {
    "content": "(?s).+", "release": WORDS, "countryCodeISO3166_1": "[A-Z]{2}",
    "usedLangCodeISO639_1": "[a-z]{2}", "mandatoryLangCodeISO639_1": "[a-z]{2}",
    "uniqueIdentifier": WORDS, "beginPerformanceDate": DATE, "endPerformanceDate": DATE,
    "performanceLocation": "laboratory|customer|laboratoryBranch|customerBranch|other",
    "issueDate": DATE, "model": WORDS, "value": WORDS,
    "issuer": "manufacturer|calibrationLaboratory|customer|owner|other",
    "calibrationLaboratoryCode": WORDS, "city": WORDS, "countryCode": "[A-Z]{2}",
    "mainSigner": "true|false", "norm": WORDS, "conformity": "pass|fail",
    "si:value": DECIMAL, "si:unit": UNIT, "si:valueExpandedMU": POSITIVE,
    "si:coverageFactor": POSITIVE, "si:coverageProbability": r"0\.\d+|1(\.0)?",
}


def faults(text: str) -> list[str]:
    """Return what is not as a certificate has it, with its place."""
    root = ET.fromstring(text.encode())
    if root.get("schemaVersion") != "3.3.0":
        return ["schemaVersion"]
    return list(_faults(root, _name(root)))


def _name(element: ET.Element) -> str:
    space, _, own = element.tag[1:].partition("}")
    return own if NAMES[space] == "dcc" else f"si:{own}"


def _faults(element: ET.Element, place: str) -> list[str]:
    own, out = _name(element), []
    children = "".join(f"<{_name(c)}>" for c in element)
    if own in TEXTS and not children:
        return [] if re.fullmatch(TEXTS[own], element.text or "") else [f"{place}: {element.text}"]
    if own not in CHILDREN:
        return [f"{place}: not known"]
    order = re.sub(r"[\w:]+", lambda m: f"(<{m[0]}>)", CHILDREN[own]).replace(" ", "")
    if not re.fullmatch(order, children) or (element.text or "").strip():
        out.append(f"{place}: {children}")
    for n, child in enumerate(element):
        out += _faults(child, f"{place}/{_name(child)}[{n}]")
    return out


def against_the_schema(text: str) -> bool:
    """Return whether the schema itself was there to be asked; it may raise what it finds."""
    path = os.environ.get("PPMCAL_DCC_XSD", "")
    if not path or not Path(path).is_file():
        return False
    try:
        import xmlschema
    except ImportError:
        return False
    xmlschema.XMLSchema(path).validate(text)
    return True
