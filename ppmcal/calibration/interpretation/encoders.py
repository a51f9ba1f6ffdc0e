"""Other readings of an encoder's file: its sign, its unit, its joint.

Each reading is compared with the nominal machine: a closed limb determines each of its joints, and
readings of another joint, or in another unit, vary differently with the joint values. All are
compared at once with every single change of the joint columns.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase

import numpy as np

from ppmcal.calibration.fit import wrapped
from ppmcal.calibration.interpretation.candidates import TURNED, joint_readings, units_beside
from ppmcal.calibration.interpretation.limits import FEWEST_ROWS, MOST
from ppmcal.calibration.interpretation.readings import ColumnInterpretation, at_joint
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import newton
from ppmcal.kinematics.instrument_readings import own_readings
from ppmcal.linalg import Array, finite_rows, subsample
from ppmcal.model.dataset import Dataset
from ppmcal.model.instruments import InstrumentKind
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration
from ppmcal.units import LENGTHS

ROWS = 40
"""Number of rows by which readings are compared."""
STILL = 1e-9
"""A joint that moves by less, rad or m, carries no information."""


def encoder_readings(mechanism: Mechanism, data: Dataset) -> list[ColumnInterpretation]:
    """Return the candidate readings of an encoder's column, as declared first.

    At each of the machine's joints that may have one, with either sign, in each unit. If the file
    names a unit for the column, its quantity is taken as right.
    """
    name, own = data.kind.number, data.kind.quantity
    said = name in data.headed or any(fnmatchcase(name, p) for p in data.read.get("units", {}))
    out = []
    for kind in (None, *data.kind.elsewhere(mechanism)):
        quantity = kind.quantity if kind else own
        if said and quantity != own:
            continue
        plain = replace(ColumnInterpretation.as_declared(
            mechanism, at_joint(data, kind) if kind else data), kind=kind)
        units = units_beside(LENGTHS if quantity == "length" else TURNED, plain.numbers.factors[0])
        out += [replace(plain, numbers=replace(plain.numbers, signs=(sign,), units=(unit,)))
                for unit in ("", *units) for sign in (1, -1)]
    return out


def search_encoder(mechanism: Mechanism, data: Dataset
                   ) -> list[tuple[float, ColumnInterpretation]]:
    """Return readings of an encoder at a joint with their errors, best first.

    The error is the median one over the range of the joint; an unknown offset is set to the median.
    The reading as declared is among them.
    """
    few = data.take(subsample([finite_rows(data.q) & np.isfinite(data.value)], ROWS)[0])
    if len(few) < FEWEST_ROWS:
        return []
    model, readings = Model(replace(mechanism, effects=())), encoder_readings(mechanism, few)
    out: list[tuple[float, ColumnInterpretation]] = []
    for joints in joint_readings(mechanism, few):
        q = joints.of(few.q)
        pose, good, _ = newton(model.closure(q), np.tile(mechanism.home, (len(q), 1)))
        if good.mean() > MOST:
            own = few.take(good)
            out += [(miss, replace(reading, joints=joints)) for miss, reading in zip(
                _misses(model, own, readings, q[good], pose[good]), readings, strict=True)
                if not _mirrored((*joints.signs, *reading.numbers.signs))]
    return sorted(out, key=lambda found: found[0])


def _mirrored(signs: Sequence[int]) -> bool:
    """Whether all signs are inverted, as for a machine assembled mirrored.

    That is one mistake, not one for each column, and has a candidate of its own.
    """
    return all(sign < 0 for sign in signs)


def _misses(model: Model, data: Dataset, readings: Sequence[ColumnInterpretation], q: Array,
            pose: Array) -> Iterator[float]:
    """Yield the errors of readings of an encoder's column at joints (n, k) and poses (n, 8)."""
    expected: dict[str, Array] = {}
    for reading in readings:
        kind: InstrumentKind = reading.kind or data.kind
        if kind.at not in expected:
            expected[kind.at] = own_readings(kind, Registration(), model, q, pose)[:, 0]
        goes = _spread(expected[kind.at], kind)
        away = reading.of(data).value - expected[kind.at]
        left = (_spread(away, kind) if data.offset.fitted else
                float(np.median(np.abs(_within(away - data.offset.value[0], kind)))))
        yield left / goes if goes > STILL else np.inf


def _within(away: Array, kind: InstrumentKind) -> Array:
    """Return differences (n,), angles within half a turn."""
    return wrapped(away) if kind.quantity == "angle" else away


def _spread(values: Array, kind: InstrumentKind) -> float:
    """Return the median distance of values (n,) from their median, angles modulo whole turns."""
    middle = (float(np.angle(np.exp(1j * values).sum())) if kind.quantity == "angle"
              else float(np.median(values)))
    away = _within(values - middle, kind)
    return float(np.median(np.abs(away - np.median(away))))
