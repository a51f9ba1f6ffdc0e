"""The tool's own height, where touches beside the tool leave it open because the platform can tilt.

A probe beside the tool (a printer's nozzle) shows its own height. Where the platform tilts, the
tool's height differs, and the tilt over the flat is known only as far as heights of one point
constrain the parts that cause it. Touches at a second offset, best of the tool itself, determine
it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ppmcal import algebra as cga
from ppmcal.calibration.fit import Fit, prediction_root, typical_noise
from ppmcal.linalg import Array, Ints
from ppmcal.model.dataset import Dataset, Unknown
from ppmcal.notes import NOTE, Note
from ppmcal.wording import number

PLACES = 60
"""Number of touches, spread over the rows, by which the tool's height is judged."""
MOST = 12
"""Maximum number of proposed touches."""
AS_GOOD = 1.25
"""The tool's height is known if its standard uncertainty is below this many of the probe's."""
OPEN = 1.5
"""It is open if above this many of the probe's, and of the noise of a touch."""
BESIDE = 1e-3
"""A probe closer to the tool than this part of the length scale is not beside it."""


@dataclass(frozen=True)
class ToolHeight:
    """How well the tool's height over the touched flat is known, SI, rms over the touches.

    Attributes:
        dataset: index of the touches.
        offset: of the probe from the tool (2,), platform axes.
        probe, tool: standard uncertainties of their heights.
        expected, left: standard uncertainty of their difference due to tilt, by the tolerances
            alone, and with all measurements; inf if nothing constrains it.
        open: whether the tool's height is known much worse than the probe's.
        found: range of the probe's height relative to the tool, beyond that of a level platform,
            at the machine as it is now.
        at: rows where the tool itself should touch (n,); with_tool: its standard uncertainty with
            these touches; with_other: with as many of a probe on the other side of the tool.
    """

    dataset: int
    offset: tuple[float, float]
    probe: float
    tool: float
    expected: float
    left: float
    open: bool
    found: tuple[float, float]
    at: tuple[int, ...]
    with_tool: float
    with_other: float


def tool_height(fit: Fit) -> ToolHeight | None:
    """Return how well the tool's height is known after touches by a probe beside it.

    None if the platform cannot tilt, or nothing was touched beside the tool; of several files the
    one that leaves most open.

    Args:
        fit: of a machine, or before a fit.
    """
    motion = fit.problem.mechanism.motion
    if motion.planar or not motion.turns:
        return None
    found = [own for i in range(len(fit.problem.datasets)) if (own := _judged(fit, i)) is not None]
    return max(found, key=lambda f: f.tool) if found else None


def _judged(fit: Fit, i: int) -> ToolHeight | None:
    data = fit.problem.datasets[i]
    target = fit.state.registrations[i].target
    offset = float(np.hypot(*target[:2]))
    rows = np.flatnonzero(fit.keep[i])
    if (not data.kind.touches or data.target.fitted or not rows.size
            or offset < BESIDE * fit.problem.mechanism.length_scale):
        return None
    rows = rows[np.linspace(0, rows.size - 1, min(PLACES, rows.size)).astype(int)]
    own, tool, other = (_slopes(fit, i, rows, place) for place in (
        target, np.array([0.0, 0.0, target[2]]), target * [-1.0, -1.0, 1.0]))
    by_own, by_tool, by_other, apart = prediction_root(fit, np.stack(
        [own, tool, other, own - tool]))
    noise = typical_noise(data) * fit.noise
    probe, known = _rms(by_own), _rms(by_tool)
    open_ = known > OPEN * max(probe, noise)
    pose = fit.state.poses[i][rows, :8]
    arm = cga.rotation_matrix(pose) @ target
    safe = _within(cga.translation(pose)[:, :2], arm[:, :2])
    at, with_tool = _touched(by_tool, by_tool[safe], noise, max(AS_GOOD * probe, 0.5 * noise)
                             ) if open_ else ([], known)
    _, with_other = _touched(by_tool, by_other, noise, 0.0, len(at))
    tilted = arm[:, 2] - target[2]
    return ToolHeight(i, (float(target[0]), float(target[1])), probe, known,
                      _by_tolerances(fit, own - tool), _rms(apart), open_,
                      (float(tilted.min()), float(tilted.max())),
                      tuple(int(rows[safe[n]]) for n in at), with_tool, with_other)


def _within(tool: Array, arm: Array) -> Ints:
    """Return which places of the tool (n, 2) are no farther out than those the probe touched.

    ``arm`` (n, 2): from the tool to the probe. All, if none is.
    """
    touched = tool + arm
    middle = touched.mean(axis=0)
    inside = np.hypot(*(tool - middle).T) <= np.hypot(*(touched - middle).T).max()
    return np.flatnonzero(inside | ~inside.any())


def _slopes(fit: Fit, i: int, rows: Ints, target: Array) -> Array:
    """Return d height (n, C) of a platform point over the flat, at touches of a probe."""
    datasets = list(fit.problem.datasets)
    datasets[i] = replace(datasets[i], target=Unknown(False, target))
    problem = fit.problem.changed(datasets=tuple(datasets))
    registrations = list(fit.state.registrations)
    registrations[i] = replace(registrations[i], target=target)
    keep = np.isin(np.arange(len(datasets[i])), rows)
    state = replace(fit.state, registrations=tuple(registrations))
    return np.concatenate([part.raw_jacobian()[:, 0] for part in problem.rows_of(
        i, state, keep=keep)])


def _by_tolerances(fit: Fit, slopes: Array) -> float:
    """Return the standard uncertainty of slopes (n, C) . parameters by their tolerances, rms."""
    free = slice(len(fit.problem.free))
    with np.errstate(divide="ignore", invalid="ignore"):
        return _rms(np.where(slopes[:, free] == 0.0, 0.0, slopes[:, free] / fit.prior[free]))


def _rms(root: Array) -> float:
    """Return the standard uncertainty of n predictions with a root (n, r), rms over n."""
    return float(np.sqrt(np.mean(np.sum(root**2, axis=1))))


def _touched(wanted: Array, offered: Array, noise: float, enough: float, most: int = MOST
             ) -> tuple[list[int], float]:
    """Return where to touch next, one after the other, and the remaining uncertainty wanted.

    Args:
        wanted: root (n, r) of the covariance of the wanted heights.
        offered: the same for the heights that can be touched (m, r).
        noise: of a touch.
        enough: the standard uncertainty, rms over n, at which no more touches are needed.
        most: maximum number of touches.
    """
    half = np.concatenate([wanted, offered])
    if not np.isfinite(half).all():
        return [], float("inf")
    count, chosen = len(wanted), list[int]()
    covariance = half @ half.T
    while True:
        left = float(np.sqrt(max(np.mean(np.diagonal(covariance)[:count]), 0.0)))
        if left <= enough or len(chosen) == most:
            return chosen, left
        across, own = covariance[:count, count:], np.diagonal(covariance)[count:] + noise**2
        best = int(np.argmax(np.sum(across**2, axis=0) / own))
        chosen.append(best)
        column = covariance[:, count + best].copy()
        covariance -= np.outer(column, column) / own[best]


def tilt_sentences(fit: Fit, fitted: bool = True) -> Iterator[Note]:
    """Yield how well the tool's height is known, and which touches would improve it.

    ``fitted``: whether the machine was fitted to the measurements, so that its tilt is a finding.
    """
    found = tool_height(fit)
    if found is not None:
        data = fit.problem.datasets[found.dataset]
        yield Note(_sentence(found, data, fit, fitted), NOTE, "platform tilt")


def _sentence(found: ToolHeight, data: Dataset, fit: Fit, fitted: bool) -> str:
    factor, unit = data.units.factor("length"), data.units.length
    file = "`target: [0, 0, 0]`" + (
        f" and `frame: {{same_as: {data.name}}}`" if data.frame.fitted else "")

    def said(value: float) -> str:
        return number(value / factor, 2)

    x, y = (number(v / factor, 4) for v in found.offset)
    told = (f"{data.name}: the probe stands {x}, {y} {unit} beside the tool, and the platform can "
            "tilt. ")
    if not np.isfinite(found.tool):
        return (f"{told}These heights do not determine the tool's height over the flat, nor does "
                f"any tolerance: touch with the tool itself too, in a file with {file}.")
    told += (f"The tool's height over the flat is known to {said(found.tool)} {unit} (one standard "
             f"deviation), the probe's to {said(found.probe)}")
    if fitted:
        low, high = found.found
        told += f"; in the fit, tilt lifts the probe by {said(low)} to {said(high)} {unit}"
    if not found.open:
        return f"{told}."
    allowed = "" if data.frame.fitted else (
        f", of {said(found.expected)} that the tolerances allow")
    return (f"{told}. The measurements leave {said(found.left)} {unit} of the difference open"
            f"{allowed}. {len(found.at)} touches of the tool itself (at x, y "
            f"{_places(found, fit, factor)} {unit}, in a file with {file}) would bring the tool to "
            f"{said(found.with_tool)} {unit}; as many of a probe on the other side of it, to "
            f"{said(found.with_other)} {unit}.")


def _places(found: ToolHeight, fit: Fit, factor: float) -> str:
    """Return where to touch, to two digits of the farthest place."""
    at = cga.translation(fit.state.poses[found.dataset][list(found.at), :8])[:, :2] / factor
    least = BESIDE * fit.problem.mechanism.length_scale / factor
    digit = 10.0 ** np.floor(np.log10(max(float(np.max(np.abs(at))), least)) - 1.0)
    return "; ".join(f"{number(x)}, {number(y)}" for x, y in (
        np.round(at / digit) * digit + 0.0).tolist())
