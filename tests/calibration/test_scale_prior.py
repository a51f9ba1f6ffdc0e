"""A scale that its file knows by a standard deviation: it counts as one more measured value."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calibration.test_file_scale import OPEN, session
from helpers.instruments import SIGMA
from helpers.paths import ROOT
from helpers.posteriors import sigma_of

from ppmcal.calibration.fit.fit_result import Fit, FitOptions, posterior, prediction_covariance
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.gauss_newton import cost, prior_square
from ppmcal.calibration.fit.noise_estimate import with_noise
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.sessions.change_detection import posterior_of
from ppmcal.calibration.validation.summary import rank_of
from ppmcal.design.virtual_instrument import default_instrument
from ppmcal.errors import BadInput
from ppmcal.io import read_mechanism
from ppmcal.io.sidecar import read_instrument
from ppmcal.io.sidecar_values import scale_of
from ppmcal.model.dataset import Dataset, Unknown
from ppmcal.model.instruments import DISTANCE, PLANE
from ppmcal.model.mechanism import Mechanism


def near(value: float, sigma: float) -> Unknown:
    return Unknown(True, np.array([value]), sigma=sigma)


def lengths(mechanism: Mechanism) -> tuple[int, ...]:
    return tuple(p for p in mechanism.free if mechanism.names[p].endswith(".offset"))


def fitted(mechanism: Mechanism, data: Dataset, scale: Unknown, method: str) -> Fit:
    return identify(Problem(mechanism, (replace(data, scale=scale),), lengths(mechanism)),
                    FitOptions(method, robust=False))


def told(fit: Fit) -> tuple[float, float]:
    """Return the scale of the only file and its standard deviation."""
    return (fit.state.registrations[0].scale,
            float(np.sqrt(prediction_covariance(fit)[-1, -1])))


@pytest.mark.parametrize("method", ["prior", "flat", "gcv"])
@pytest.mark.parametrize("kind", ["pose", "point"])
def test_it_is_one_more_value_beside_the_rows(kind: str, method: str) -> None:
    """Rows say s_r +- d and the file s_f +- d: the middle of both, +- d over the root of 2."""
    mechanism, data, _ = session("6-UPS", kind, 60, 5, SIGMA)
    by_rows, sigma = told(fitted(mechanism, data, OPEN, method))
    stated = by_rows + 3.0 * sigma
    fit = fitted(mechanism, data, near(stated, sigma), method)
    found, left = told(fit)
    tolerance = 0.2 if method == "gcv" else 0.02    # which chooses its tolerances by the rows
    assert found == pytest.approx((by_rows + stated) / 2.0, abs=tolerance * sigma)
    assert left == pytest.approx(sigma / np.sqrt(2.0), rel=0.02)
    # the search, its cost and its end count it alike
    step = np.zeros(len(fit.problem.columns))
    step[-1] = 0.1 * sigma
    for there in (fit.problem.moved(fit.state, sign * step) for sign in (1.0, -1.0)):
        assert cost(fit.problem, there, fit.keep, fit.prior, None) > cost(
            fit.problem, fit.state, fit.keep, fit.prior, None)
    assert prior_square(fit.problem, fit.state, fit.stated) == pytest.approx(
        ((found - stated) / sigma) ** 2)


def test_noisier_rows_leave_it_as_sure_as_it_was() -> None:
    mechanism, data, _ = session("6-UPS", "pose", 60, 5, SIGMA)
    _, sigma = told(fitted(mechanism, data, OPEN, "prior"))
    fit = fitted(mechanism, data, near(1.0, sigma), "prior")
    _, left = told(with_noise(fit, 100.0, FitOptions("prior")))
    assert 0.98 * sigma < left <= sigma


def test_check_and_identify_count_it_as_seen() -> None:
    mechanism, data, _ = session("6-UPS", "pose", 30, 5, SIGMA)
    fit = fitted(mechanism, data, near(1.0, 1e-3), "prior")
    # rows that tell nothing of the scale: what the file says is all
    blind = fit.information.root.copy()
    blind[:, -1] = 0.0
    open_ = replace(fit, information=replace(fit.information, root=blind))
    closed = replace(open_, prior=fit.prior - fit.stated)
    assert rank_of(open_)[1] == rank_of(closed)[1] + 1
    assert posterior(open_)[-1, -1] == pytest.approx(1e-6) and np.isinf(posterior(closed)[-1, -1])


@pytest.mark.parametrize("sigma", [1e-4, 1.0])
def test_a_calibration_carried_on_knows_what_its_file_said(sigma: float) -> None:
    """The rows that stand for it, with the tolerances, have the parameters' covariance."""
    mechanism, data, _ = session("delta-linear", "pair", 40, 3, SIGMA)
    fit = identify(Problem(mechanism, (replace(data, scale=near(0.9975, sigma)),),
                           mechanism.free), FitOptions(robust=False))
    count = len(mechanism.free)
    np.testing.assert_allclose(sigma_of(posterior_of(fit, {"0": "distances"})),
                               np.sqrt(np.diagonal(posterior(fit))[:count]), rtol=1e-3)


# ---------------------------------------------------------------- the file


def test_a_sidecar_states_it(tmp_path: Path) -> None:
    found = scale_of({"value": 0.995, "sigma": 0.0015}, DISTANCE, "side.yaml")
    assert found.fitted and found.sigma == 0.0015 and found.value.tolist() == [0.995]
    mechanism = read_mechanism(ROOT / "configs" / "6-UPS.yaml")
    (tmp_path / "i.yaml").write_text(
        "format: ppmcal/dataset/1\nunits: {length: mm, angle: deg}\n"
        "instrument: {kind: position, sigma: {position: 0.01}}\nframe: unknown\n"
        "target: known\nscale: {value: 1.001, sigma: 0.002}\n")
    instrument = read_instrument(tmp_path / "i.yaml", mechanism)
    assert instrument.scale.sigma == 0.002 and instrument.registration.scale == 1.001
    assert default_instrument(mechanism).scale.sigma is None


@pytest.mark.parametrize(("raw", "place", "words"), [
    ({"value": 0.995}, "scale", "standard deviation"),
    ({"value": 0.995, "sigma": 0.0015, "mean": 1}, "scale", "{value: 0.995, sigma: 0.0015}"),
    ({"value": 25.4, "sigma": 0.1}, "scale.value", "0.5 to 2"),
    ({"value": "unknown", "sigma": 0.1}, "scale.value", "0.5 to 2"),
    ({"value": 0.995, "sigma": 0}, "scale.sigma", "value alone"),
    ({"value": 0.995, "sigma": True}, "scale.sigma", "between 0 and 1"),
    ({"value": 0.995, "sigma": float("nan")}, "scale.sigma", "between 0 and 1")])
def test_a_wrong_one_is_refused(raw: object, place: str, words: str) -> None:
    with pytest.raises(BadInput) as error:
        scale_of(raw, DISTANCE, "side.yaml")
    assert error.value.where == f"side.yaml: {place}" and words in str(error.value)


def test_heights_have_none() -> None:
    with pytest.raises(BadInput, match="heights"):
        scale_of({"value": 0.995, "sigma": 0.0015}, PLANE, "side.yaml")
