"""Short equations of learned terms: found with their powers, none where there is none."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import ppmcal
from helpers.learned import WEATHER, campaign, diagnosed, dip, squared, warped

from ppmcal.diagnosis.equation_forms import Equation, InputForm, products_of, same_form, values_of
from ppmcal.diagnosis.equations import likeliest
from ppmcal.diagnosis.result import LearnedTerms
from ppmcal.io.results.learned import equation_fields
from ppmcal.model.effects.learned import LearnedCurve, learned_kind
from ppmcal.model.effects.setting import Setting
from ppmcal.model.motions import SPATIAL
from ppmcal.units import Units

MM = Units("mm", "deg")


def evaluated(text: str, **inputs: Any) -> Any:
    """Return what a printed equation says, by Python's own arithmetic, in its unit."""
    line = text.split(": ", 1)[1].replace("^", "**")
    line = re.sub(r"\|(.*?)\|", r"abs(\1)", line)
    line = re.sub(r"(?<=\d) (mm/s|mm|deg/s|degC|deg|K)(?![a-zA-Z])", "", line)
    names = {"abs": np.abs, "sign": np.sign, "max": np.maximum}
    return eval(line, {"__builtins__": {}}, names | inputs)


def test_the_sparsest_set_is_chosen() -> None:
    """Two of forty columns make the target: both and no other, and none of noise."""
    rng = np.random.default_rng(1)
    x = rng.standard_normal((300, 40))
    noise = rng.standard_normal(300)
    kinks, forms = np.zeros(40, dtype=bool), np.arange(40)

    def chosen(y: Any, some: Any) -> set[int]:
        return set(likeliest(x.T @ x, x.T @ y, float(y @ y), 300, forms, some)[0])

    target = 2.0 * x[:, 7] - 3.0 * x[:, 30] + noise
    assert chosen(target, kinks) == {7, 30}
    assert chosen(noise, kinks) == set()
    # several kinks would be a spline
    kinks[[7, 30]] = True
    assert chosen(target, kinks) == {30}


def test_what_an_equation_may_be_made_of() -> None:
    one = LearnedCurve("velocity", np.linspace(-2.0, 3.0, 5), np.zeros(5), np.zeros((5, 5)))
    forms = {(f.form, f.degree) for (f,) in products_of(one)}
    assert {("power", 2), ("abs", 1), ("sign", 1), ("above", 1), ("below", 1)} <= forms
    two = LearnedCurve("travel", np.linspace(1.0, 3.0, 5), np.zeros(10), np.zeros((10, 10)),
                       by="temperature", by_nodes=np.array([-5.0, 8.0]))
    wanted = (InputForm("travel", degree=2), InputForm("temperature"))
    assert wanted in products_of(two)
    assert not any(same_form(wanted, p) for p in products_of(two) if p != wanted)


def test_an_equation_is_its_products_and_nothing_beyond() -> None:
    products = ((InputForm("travel", degree=2, origin=1.0),), (InputForm("temperature", "above"),))
    found = Equation("travel", np.array([0.0, 4.0]), np.array([2.0, -1.0]), np.zeros((2, 2)),
                     by="temperature", by_nodes=np.array([-3.0, 3.0]), products=products)
    x, by = np.array([3.0, 3.0, 5.0, 3.0]), np.array([-2.0, 1.5, 0.0, 4.0])
    np.testing.assert_allclose(found.at(x, by), [8.0, 6.5, np.nan, np.nan])
    assert values_of(products, {"travel": x, "temperature": by}).shape == (4, 2)


def test_the_derivatives_of_an_equation_are_its_differences() -> None:
    """By its size, and by every product's own, as an effect of rows and joints."""
    products = ((InputForm("travel", degree=2), InputForm("temperature")),
                (InputForm("travel", "abs"),))
    sizes = np.array([0.3, -0.2])
    found = Equation("travel", np.array([-4.0, 4.0]), sizes, np.eye(2), True, by="temperature",
                     by_nodes=np.array([-3.0, 3.0]), products=products)
    rng, on = np.random.default_rng(2), np.array([True, False])
    at = _rows(rng.uniform(-3.0, 3.0, (6, 2)), rng.uniform(-2.0, 2.0, 6),
               rng.choice([-1.0, 1.0], (6, 2)))
    kind, h = learned_kind(found), 1e-6
    up, down = (kind.evaluate(at, on, {"scale": 1.1 + d}).shift.slots[0, "offset"]
                for d in (h, -h))
    by = kind.evaluate(at, on, {"scale": 1.1}).by["scale"].slots[0, "offset"]
    np.testing.assert_allclose((up - down) / (2.0 * h), by, rtol=1e-8)
    for i, mode in enumerate(np.eye(2)):
        one, other = (found.shift(at, on, sizes + d * mode).slots[0, "offset"] for d in (h, -h))
        x, warm, s = at.travel[:, 0], at.temperature, at.approach[:, 0]
        np.testing.assert_allclose((one - other) / (2.0 * h),
                                   s * (x**2 * warm if i == 0 else np.abs(x)), rtol=1e-8)


def _rows(travel: Any, warm: Any, way: Any) -> Setting:
    from ppmcal.model.effects.setting import LimbSetting

    n, nothing = len(warm), np.zeros((len(warm), 6))
    limbs = tuple(LimbSetting(a, {}, {}, {}) for a in range(2))
    return Setting(SPATIAL, np.zeros(2, dtype=bool), travel, np.zeros((2, 2)), way, travel, warm,
                   nothing, warm, np.arange(float(n)), limbs, lambda w: travel, lambda w: w,
                   nothing[:, :3], np.zeros(3), np.tile(np.eye(3), (n, 1, 1)))


TOLD = [
    (((InputForm("travel", degree=2), InputForm("temperature")),), [-3.1e-4],
     "leg2: -0.031 mm * (travel/100 mm)^2 * (temperature - 20 degC)/10 K"),
    (((InputForm("travel", "above", origin=0.35),), (InputForm("travel"),)), [0.02, -0.003],
     "leg2: 2 mm * max((travel - 350 mm)/100 mm, 0) - 0.3 mm * (travel/100 mm)"),
    (((InputForm("travel", "abs", origin=0.2),), (InputForm("travel", "sign", origin=0.2),)),
     [0.02, 1e-5],
     "leg2: 2 mm * |(travel - 200 mm)/100 mm| + 0.01 mm * sign(travel - 200 mm)")]


@pytest.mark.parametrize(("products", "sizes", "text"), TOLD)
def test_it_is_printed_with_units_and_says_what_it_is(products: Any, sizes: Any, text: str) -> None:
    """The text, evaluated by Python in the file's units, is the function in SI."""
    found = Equation("travel", np.array([0.1, 0.5]), np.array(sizes), np.zeros((len(sizes),) * 2),
                     by="temperature", by_nodes=np.array([-10.0, 10.0]), products=products,
                     probability=1.0)
    told = equation_fields(found, "leg2", MM)
    assert told["equation"] == text
    x, warm = np.array([0.12, 0.34, 0.47]), np.array([-7.0, 3.0, 9.0])
    np.testing.assert_allclose(evaluated(told["equation"], travel=1e3 * x, temperature=warm + 20.0),
                               1e3 * found.at(x, warm), rtol=1e-9)


def learned(folder: Path, effects: list[dict[str, Any]], seed: int, **changes: Any
            ) -> LearnedTerms | None:
    return diagnosed(*campaign(folder, effects, seed, count=80, **changes), seed).learned


@pytest.mark.long
def test_a_hidden_product_comes_back_with_its_powers(tmp_path: Path) -> None:
    """Error of one leg with the square of its travel and with the temperature."""
    found = learned(tmp_path, [warped()], 1, conditions=WEATHER)
    assert found is not None
    (term,), (curve,), (equation,) = found.learned.terms, found.learned.curves, found.equations
    assert term.on == (False, True, False)
    assert curve.inputs == ("travel", "temperature")
    assert equation is not None
    assert equation.products == ((InputForm("travel", degree=2), InputForm("temperature")),)
    # -0.004 mm per (100 mm)^2 and 10 K
    size, sigma = equation.values[0], np.sqrt(equation.covariance[0, 0])
    assert abs(size + 4e-6 / 0.1**2 / 10.0) < 3.0 * sigma
    assert sigma < 0.1 * abs(size)
    assert equation.after < found.gap.before
    # what goes with temperature is none of geometry's: the learned function and the equation agree
    x = np.linspace(curve.nodes[0], curve.nodes[-1], 50)
    warm, cold = np.full(50, 5.0), np.full(50, -5.0)
    basis = curve.basis(x, warm) - curve.basis(x, cold)
    band = np.sqrt(np.einsum("ij,jk,ik->i", basis, curve.covariance, basis))
    away = equation.at(x, warm) - equation.at(x, cold) - basis @ curve.values
    assert np.all(np.abs(away) < 3.5 * band)


@pytest.mark.long
def test_the_square_of_speed_comes_back(tmp_path: Path) -> None:
    """It does as well in held-out poses, and evaluates to what was learned, in the band."""
    found = learned(tmp_path, [squared()], 1)
    assert found is not None
    (equation,), (curve,) = found.equations, found.learned.curves
    assert equation is not None
    assert equation.products == ((InputForm("velocity", degree=2),),)
    told = equation_fields(equation, "all", MM)["equation"]
    x = np.linspace(-0.02, 0.02, 30)
    own = evaluated(told, velocity=1e3 * x)
    # zeros of the joints absorb a constant
    away = (own - own.mean()) - 1e3 * (curve.at(x) - curve.at(x).mean())
    sigma = 1e3 * np.sqrt(np.einsum("ij,jk,ik->i", curve.basis(x), curve.covariance,
                                    curve.basis(x)))
    assert np.all(np.abs(away) < 3.5 * sigma)


@pytest.mark.long
def test_what_is_no_short_equation_is_printed_as_none(tmp_path: Path) -> None:
    """A worn place of a screw is learned, and remains a shape."""
    found = learned(tmp_path, [dip()], 1)
    assert found is not None
    assert found.learned.curves[0].input == "travel"
    assert found.equations == (None,) * len(found.learned.terms)


@pytest.mark.long
def test_console_file_and_report_have_it_and_clean_data_none(tmp_path: Path) -> None:
    campaign(tmp_path, [squared(0.05)], 1, count=70)
    run = ppmcal("diagnose", "m.yaml", "s/measurements.csv", "--out", "d",
                 cwd=tmp_path)
    found = json.loads((tmp_path / "d" / "diagnosis.json").read_text())
    (entry,) = found["learned"]
    told = entry["equation"]
    assert re.fullmatch(r"leg1, leg2, leg3: 0\.00\d+ mm \* \(velocity/10 mm/s\)\^2", told["text"])
    (term,) = told["terms"]
    # 0.05 mm at 30 mm/s
    assert abs(term["size"] - 0.05 / 9.0) < 3.0 * term["sigma"]
    assert told["probability"] > 0.95
    assert told["text"] in " ".join(run.out.split())
    ppmcal("report", "d", "--out", "r", cwd=tmp_path, expect=0)
    assert "(velocity/10 mm/s)^2" in (tmp_path / "r" / "report.html").read_text(encoding="utf-8")
    campaign(tmp_path, [], 1, count=40, out="clean", conditions=WEATHER)
    run = ppmcal("diagnose", "m.yaml", "clean/measurements.csv", "--out", "c",
                 cwd=tmp_path)
    assert json.loads((tmp_path / "c" / "diagnosis.json").read_text())["learned"] == []
    assert "equation" not in run.out
