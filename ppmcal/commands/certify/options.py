"""What ``ppmcal certify`` takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ppmcal.commands.spec import Arguments, Command, Path_, argument, needed


@dataclass(frozen=True)
class CertifyArguments(Arguments):
    """The calibration, what it is judged by, and who certifies what."""

    identified: Path_ = argument("IDENTIFIED", "Folder that identify or diagnose wrote.",
                                 folder=True)
    about: Path_ = needed("YAML file that names machine, customer, laboratory, instrument and "
                          "decision rule (format: ppmcal/about/1).", "--about")
    validation: Sequence[Path_] | Path_ = argument(
        "[VALIDATION]...", "Folders that validate wrote for it, or measurement files that no fit "
        "has seen.", default=(), kind="Machine", several=True)


COMMAND = Command(
    "certify", CertifyArguments,
    about=("Certify the calibration in {identified}, judged by {validation}.",
           "First the results are made again, as verify does: whatever does not come out as it "
           "is there is refused. Tells the errors on rows that no fit has seen, pose accuracy and "
           "repeatability by ISO 9283, accuracy of the axes by ISO 230-2 where the rows allow "
           "them, and their uncertainty by the GUM. Without {validation} the poses that identify "
           "held out are all there is. Writes certificate.html, certificate.pdf, certificate.xml "
           "(a Digital Calibration Certificate) and certificate.json."),
    examples=("ppmcal certify identified run2.csv --about about.yaml",), out="certificate",
    result="CertificateResult",
    record=("certificate", "ppmcal.io.results.certificate:CertificateRecord"),
    raises="BadInput: anything wrong in the files, results that do not come out again, or a "
           "calibration that cannot be certified.",
    shares={"making the results again": 10.0, "judging the rows": 2.0,
            "writing the results": 2.0})
