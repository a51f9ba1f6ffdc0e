"""The printer's own fit again: are the numbers that it saved what its touches give?

Klipper fits delta_radius, two angles and three endstops, with measured distances three rods as
well, without any prior; a height then counts n_distances / (0.5 n_heights) of a distance
(``delta_calibrate.py``: ``MEASURE_WEIGHT``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import yaml

from ppmcal.calibration.fit import Fit, FitOptions, Problem, identify
from ppmcal.controllers.delta.geometry import ANGLES, MM, TOWERS, DeltaGeometry, triple, unit_of
from ppmcal.controllers.delta.importer import DISTANCE, HEIGHT, machine_yaml, touches
from ppmcal.controllers.delta.printer import Printer
from ppmcal.errors import PpmcalError
from ppmcal.io import read_mechanism
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note
from ppmcal.units import LENGTHS
from ppmcal.wording import too_long

CLOSE = 0.002
"""A fit agrees with the saved numbers if all do to this, mm, angles at the radius. Of 28 saved
calibrations 25 do so to 0.0003 mm; three were edited by hand, by 0.1 mm and more."""
MEASURE_WEIGHT = 0.5
ONE = 0.05
NEARLY = 0.05
"""A unit is looked for where distances are off by its factor to within this part."""


def with_own_fit(printer: Printer) -> Printer:
    """Return a printer with what its own fit says of the numbers that it saved, and its size."""
    found = refit(printer) if printer.calibrated else None
    off = {} if found is None else differences(printer.calibration, found)
    return replace(printer, off=off, size=size_sentence(printer),
                   findings=(*printer.findings, *([sentence(off)] if off else [])))


def refit(printer: Printer) -> DeltaGeometry | None:
    """Return what the printer's own fit makes of its own touches, mm and degrees.

    None where the touches are too few, or the fit does not settle.
    """
    if len(printer.heights) < 6:
        return None
    own = replace(printer, nominal=replace(printer.nominal, geometry=printer.calibration))
    found = _fitted(own, "single" if printer.distances else "fixed")
    return None if found is None else _geometry(found)


def size_sentence(printer: Printer) -> str:
    """Return both readings of a printer's size: by its distances, and by its rods.

    A longer rod and distances that are all too small fit the same touches. Empty where there are
    too few touches or distances.
    """
    if len(printer.heights) < 6 or len(printer.distances) < 3:
        return ""
    by_rods, by_parts = (_fitted(printer, rods, scale) for rods, scale in (
        ("fixed", "unknown"), ("shared", "known")))
    if by_rods is None or by_parts is None:
        return ""
    rods = sum(_geometry(by_parts).arms) / len(TOWERS)
    meant = printer.nominal.geometry.arms
    own = f"{meant[0]:.6g}" if len(set(meant)) == 1 else "as long as the file says"
    scale = by_rods.state.registrations[1].scale
    shown = too_long(scale) + "".join(
        f": are they in {unit}, not mm?" for unit, size in LENGTHS.items()
        if unit != "mm" and abs(scale * size / MM - 1.0) < NEARLY)
    return (f"Size: longer rods and longer distances look alike. If the distances are true, the "
            f"rods are {rods:.2f} mm; if the rods are {own}"
            f"{' mm' if len(set(meant)) == 1 else ''}, the distances read {shown}")


def _fitted(printer: Printer, rods: str, scale: str = "known") -> Fit | None:
    """Return a fit without prior of the nominal printer to its touches, None where none is had."""
    try:
        mechanism = read_mechanism(yaml.safe_load(machine_yaml(printer, rods)))
        found = identify(Problem(mechanism, _data(printer, mechanism, scale), mechanism.free),
                         FitOptions("flat", robust=False))
    except PpmcalError:
        return None
    return found if found.converged else None


def _geometry(found: Fit) -> DeltaGeometry:
    """Return a fit in Klipper's numbers."""
    names = found.problem.mechanism.names
    v = dict(zip(names, found.state.g.tolist(), strict=True))
    radius = v["delta_radius"] / MM
    arms = [v[f"{t}.length" if f"{t}.length" in v else "rod"] / MM for t in TOWERS]
    turns = [float(np.degrees(v[f"{t}.base.point.angle"])) for t in TOWERS]
    ends = [v[f"{t}.offset"] / MM - float(np.sqrt(a**2 - radius**2))
            for t, a in zip(TOWERS, arms, strict=True)]
    turned = [a + 360.0 * round((usual - a) / 360.0)
              for a, usual in zip(turns, ANGLES, strict=True)]
    return DeltaGeometry(radius, triple(turned), triple(arms), triple(ends))


def _data(printer: Printer, mechanism: Mechanism, scale: str) -> tuple[Dataset, ...]:
    share = len(printer.distances) / (MEASURE_WEIGHT * len(printer.heights)) or 1.0
    out = [_one(mechanism, "heights", HEIGHT, printer.heights, {
        "kind": "plane", "sigma": {"height": ONE / float(np.sqrt(share))}})]
    if printer.distances:
        out.append(_one(mechanism, "distances", DISTANCE, printer.distances, {
            "kind": "distance", "sigma": {"distance": ONE}}, scale))
    return tuple(out)


def _one(mechanism: Mechanism, name: str, header: Sequence[str],
         rows: Sequence[Sequence[float]], instrument: Mapping[str, object], scale: str = "known"
         ) -> Dataset:
    return touches(mechanism, name, header, np.array(rows, dtype=float), {
        "name": name, "instrument": instrument, "frame": "known", "target": "known",
        **({} if scale == "known" else {"scale": scale})})


def differences(saved: DeltaGeometry, found: DeltaGeometry) -> dict[str, float]:
    """Return by how much each saved number is off, mm and degrees; none where all are close."""
    one, two = saved.named(), found.named()
    off = {key: one[key] - two[key] for key in one}
    far = {key: np.radians(v) * saved.radius if key.endswith("angle") else v
           for key, v in off.items()}
    if max(map(abs, far.values())) <= CLOSE:
        return {}
    return {key: off[key] for key in off if abs(far[key]) > CLOSE}


def sentence(off: Mapping[str, float]) -> Note:
    """Return what the differences of saved numbers mean."""
    words = ", ".join(f"{key} by {v:+.3f} {unit_of(key)}"
                      for key, v in sorted(off.items(), key=lambda kv: -abs(kv[1])))
    return Note(f"the saved numbers are not what these touches give with the printer's own fit: "
                f"off are {words}. They were edited by hand, written by `ppmcal export`, or "
                "saved with other touches")
