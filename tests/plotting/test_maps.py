"""Pictures of maps and curves: what they show, and that no numbers break them."""

import io
import subprocess
import sys
from functools import cache

import numpy as np
import pytest
from matplotlib import image
from matplotlib.contour import ContourSet

from ppmcal.io import read_mechanism
from ppmcal.io.grid import read_grid
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.partial_pose import inverse_partial
from ppmcal.kinematics.region import Grid, Map, named, slice_axes, slice_grid
from ppmcal.plotting import style as picture
from ppmcal.plotting.curves import draw_curves
from ppmcal.plotting.map_panel import NO_VALUE, SINGULAR_CURVE, ColourScale, draw_panel
from ppmcal.plotting.maps import _view, draw_map
from ppmcal.plotting.style import (
    SINGULAR,
    figure,
    lines_of,
    look,
    number_words,
    plain,
    robust_range,
    round_numbers,
)

NAN, INF = np.nan, np.inf


@cache
def machine(name="3-RPR"):
    return read_mechanism(f"configs/{name}.yaml")


def pixels(png):
    """Return a PNG as (height, width, 3) with values 0 to 1."""
    assert png.startswith(b"\x89PNG\r\n\x1a\n")
    return image.imread(io.BytesIO(png))[..., :3]


def near(shot, colour, by=0.02):
    """Return which pixels have a colour ``#rrggbb``."""
    wanted = np.array([int(colour[i:i + 2], 16) / 255 for i in (1, 3, 5)])
    return np.abs(shot - wanted).max(axis=-1) < by


def values_over(mechanism, grid):
    """Return the smallest singular value of A and its determinant over a grid."""
    found = inverse_partial(Model(mechanism.nominal()), grid.poses(mechanism))
    good = np.isfinite(found.q).all(axis=1) & np.isfinite(found.pose).all(axis=1)
    a = Model(mechanism.nominal()).closure(found.q[good]).pose_matrix(found.pose[good])
    value, determinant = np.full((2, len(good)), NAN)
    value[good] = np.linalg.svd(a, compute_uv=False)[:, -1]
    determinant[good] = np.linalg.det(a)
    return value.reshape(grid.shape), determinant.reshape(grid.shape)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "axes"), [
    ("3-RPR", 1), ("3-RPR", 2), ("3-RPR", 3), ("linapod", 2), ("delta-linear", 3), ("3-RPS", 1),
    ("6-UPS", 2), ("mixed-planar", 2)])
def test_every_machine_has_a_picture(name, axes):
    m = machine(name)
    counts = {1: (41,), 2: (21, 21), 3: (7, 7, 3)}[axes]
    grid = slice_grid(m, named(m)[:axes], counts)
    value, determinant = values_over(m, grid)
    shown = Map("condition", "smallest singular value", "1", value, log=axes == 2)
    png = draw_map(m, grid, shown, determinant)
    assert name != "3-RPR" or png == draw_map(m, grid, shown, determinant)
    height, width, _ = pixels(png).shape
    assert 400 < width < 1600
    assert 300 < height < 1600
    assert b"tIME" not in png
    assert b"Software" not in png


@pytest.fixture
def coarse(monkeypatch):
    """Draw with few dots: only whether it can be drawn counts."""
    monkeypatch.setattr(picture, "DPI", 40)


def strange(shape, seed=3):
    """Return arrays of values that break careless pictures."""
    rng = np.random.default_rng(seed)
    plain_ = rng.uniform(1.0, 2.0, shape)
    one = np.full(shape, NAN)
    one.flat[plain_.size // 2] = 3.0
    holes, wild = plain_.copy(), plain_.copy()
    holes.flat[::2] = NAN
    wild.flat[:4] = INF, -INF, 1e300, -1e300
    return {"plain": plain_, "equal": np.full(shape, 4.2), "zero": np.zeros(shape),
            "nan": np.full(shape, NAN), "one": one, "holes": holes, "wild": wild,
            "inf": np.full(shape, INF), "almost": 11.5276 + 1e-13 * plain_,
            "tiny": 1e-310 * plain_, "small": 1e-9 * plain_, "large": 1e9 * plain_,
            "huge": 1e90 * plain_, "negative": -plain_, "signs": plain_ - 1.5,
            "wide": 10.0 ** (30.0 * (plain_ - 1.5)), "edge": np.where(plain_ > 1.3, 1.0, NAN)}


@pytest.mark.slow
@pytest.mark.usefixtures("coarse")
@pytest.mark.parametrize("case", list(strange((4, 4))))
@pytest.mark.parametrize(("shape", "log"), [((4, 5), True), ((4, 5), False)])
def test_no_numbers_break_a_picture(case, shape, log):
    check_picture(strange((4, 4))[case], shape, log)


@pytest.mark.usefixtures("coarse")
@pytest.mark.parametrize(("shape", "log"), [((2,), False), ((1, 4), True), ((4, 1), False),
                                            ((1, 1), False), ((2, 2), False), ((3, 2, 2), False),
                                            ((2, 2, 10), True)])
@pytest.mark.slow_cases("shape4-False", "shape6-True")
def test_no_shape_breaks_a_picture(shape, log):
    for case in ("one", "wild"):
        check_picture(strange((4, 4))[case], shape, log)


def check_picture(values, shape, log):
    grid = Grid((0, 1, 5)[:len(shape)],
                tuple(np.linspace(0.1 * i, 1.0, n) for i, n in enumerate(shape)))
    shown = Map("x", "anything", "mm", np.resize(values, shape), log)
    png = draw_map(machine(), grid, shown, np.resize(strange((4, 4))["signs"], shape))
    assert len(png) > 1000


@pytest.mark.usefixtures("coarse")
@pytest.mark.parametrize("fill", [NAN, INF, -INF, 0.0, 1e308])
@pytest.mark.slow_cases("-inf")
def test_no_determinant_breaks_a_picture(fill):
    m, value = machine(), np.ones((4, 5))
    grid = slice_grid(m, (0, 1), (4, 5))
    for determinant in (np.full((4, 5), fill), np.where(np.eye(4, 5) > 0, fill, -1.0)):
        assert draw_map(m, grid, Map("x", "x", "", value), determinant)


@pytest.mark.slow
def test_singular_curve_is_where_the_determinant_changes_sign():
    """The red pixels are an ellipse, twice as wide as high, and so are the points behind them."""
    m = machine()
    grid = Grid((0, 1), (np.linspace(-1.0, 1.0, 41), np.linspace(-1.0, 1.0, 41)))
    x, y = np.meshgrid(*grid.levels, indexing="ij")
    flat = Map("x", "x", "", np.ones((41, 41)))
    red = near(pixels(draw_map(m, grid, flat, x**2 + (2.0 * y)**2 - 0.6**2)), SINGULAR)
    assert not near(pixels(draw_map(m, grid, flat)), SINGULAR).any()
    red[-60:] = False  # the legend's own line
    rows, columns = np.nonzero(red)
    assert np.ptp(columns) / np.ptp(rows) == pytest.approx(2.0, rel=0.03)
    axes, _ = panel(flat.values, 0.5 * (x + y) + 0.2)
    (path,) = next(c for c in axes.collections if isinstance(c, ContourSet)).get_paths()
    across, up = 2.0 * path.vertices.T - 1.0  # the panel's axes go from 0 to 1
    assert np.ptp(across) > 1.0
    assert across + up == pytest.approx(np.full(across.size, -0.4))


def panel(values, determinant=None, home=None, **more):
    """Return the axes of one panel and its legend."""
    values = np.asarray(values, dtype=float)
    x, y = (np.linspace(0.0, 1.0, n) for n in values.shape)
    with look():
        axes = figure(4, 4).add_axes((0, 0, 1, 1))
        legend = draw_panel(axes, x, y, values, determinant, ColourScale.of(values, False),
                            None if home is None else np.array(home), **more)
    return axes, legend


def test_legend_explains_what_is_drawn_and_nothing_else():
    flat = np.ones((5, 5))
    half = np.where(np.arange(5)[:, None] < 2, NAN, flat)
    slope = np.linspace(-1.0, 1.0, 25).reshape(5, 5)
    assert panel(flat)[1].keys() == set()
    assert panel(half)[1].keys() == {NO_VALUE}
    assert panel(flat, slope)[1].keys() == {SINGULAR_CURVE}
    assert panel(flat, np.abs(slope))[1].keys() == set()
    assert panel(flat, home=(0.5, 0.5))[1].keys() == {"home"}
    assert panel(flat, home=(2.0, 0.5))[1].keys() == set()
    axes, _ = panel(np.full((5, 5), NAN))
    assert "no pose of this map can be reached" in [t.get_text() for t in axes.texts]
    axes, _ = panel(flat, home=(0.5, 0.5))
    assert "home" in [t.get_text() for t in axes.texts]


@pytest.mark.slow
def test_values_are_the_right_way_round():
    """Values grow along the first coordinate, which goes to the right."""
    m = machine()
    grid = Grid((0, 1), (np.linspace(0.0, 1.0, 9), np.linspace(0.0, 1.0, 9)))
    ramp = np.repeat(np.arange(9.0)[:, None], 9, axis=1)
    shot = pixels(draw_map(m, grid, Map("x", "x", "", ramp)))
    light = shot @ (0.3, 0.59, 0.11)
    h, w = light.shape
    row = light[h // 2]
    assert row[int(0.2 * w)] < row[int(0.4 * w)] < row[int(0.6 * w)]
    assert pixels(draw_map(m, grid, Map("x", "x", "", ramp.T)))[h // 4, w // 3] @ (1, 1, 1) > (
        pixels(draw_map(m, grid, Map("x", "x", "", ramp.T)))[h // 2, w // 3] @ (1, 1, 1))


def test_outliers_do_not_take_all_colours():
    values = np.concatenate([np.linspace(1.0, 2.0, 97), [1e3, 1e6, INF]])
    scale = ColourScale.of(values, False)
    assert scale.extend == "max"
    assert 2.0 < scale.high < 4.0
    assert scale.low == 1.0
    assert ColourScale.of(np.linspace(1.0, 2.0, 97), False).extend == "neither"
    assert ColourScale.of(np.append(values, -INF), False).extend == "both"
    scale = ColourScale.of(np.append(10.0 ** np.linspace(0, 2, 99), 1e30), True)
    assert scale.log
    assert 1e2 < scale.high < 1e5
    assert not ColourScale.of(-np.ones(4), True).log


def test_words_say_where_the_other_coordinates_are():
    def held(name, text):
        m = machine(name)
        grid = read_grid(text, m)
        return _view(m, grid, np.zeros(grid.shape), None).held

    assert held("3-RPR", "x=0:1:2,y=0:1:2") == "at rz = 30 deg"
    assert held("3-RPR", "x=0:1:2,y=0:1:2,rz=0:1:2") == ""
    assert held("linapod", "z=0:1:2") == "at x = 0 m, y = 0 m, rx = 0 deg, ry = 0 deg, rz = 0 deg"
    assert held("3-RPS", "z=90:110:2,rx=0:1:2").endswith("free")
    assert "mm" in held("delta-linear", "x=0:1:2,y=0:1:2")


def test_more_than_three_coordinates_are_cut_next_to_home():
    m = machine("6-UPS")
    grid = read_grid("x=0:1:2,y=0:1:3,z=1000:2000:2,rx=-10:10:5,ry=-10:10:3", m)
    values = np.broadcast_to(np.arange(5.0)[:, None], (2, 3, 2, 5, 3))
    view = _view(m, grid, np.array(values), None)
    assert view.values.shape == (2, 3, 2)
    assert np.all(view.values == 2.0)
    assert "rx = 0 deg, ry = 0 deg" in view.held
    assert draw_map(m, grid, Map("x", "x", "", np.array(values)))


def test_wrong_shape_is_refused():
    m = machine()
    grid = slice_grid(m, (0, 1), (4, 5))
    with pytest.raises(ValueError, match="shape"):
        draw_map(m, grid, Map("x", "x", "", np.ones((5, 4))))
    with pytest.raises(ValueError, match="shape"):
        draw_map(m, grid, Map("x", "x", "", np.ones((4, 5))), np.ones(20))


@pytest.mark.slow
@pytest.mark.usefixtures("coarse")
@pytest.mark.parametrize("words", ["$x_1$ costs $5", "百分比 µm·N/√Hz", "a\nb\tc", "", "x" * 500,
                                   "long words of a title that goes on and on " * 20, "\\frac{"])
def test_any_words_will_do(words):
    m = machine()
    for grid in (slice_grid(m, (0, 1), (4, 5)), slice_grid(m, (0,), (7,))):
        values = np.arange(float(np.prod(grid.shape))).reshape(grid.shape)
        assert draw_map(m, grid, Map("x", words, words, values))
    assert draw_curves(words, words, words, [(words, [1, 2], [1, 2])] * 3, marks=[(1.5, words)])


@pytest.mark.slow
@pytest.mark.usefixtures("coarse")
@pytest.mark.parametrize("log", [False, True])
@pytest.mark.parametrize("case", list(strange((9,))))
def test_no_numbers_break_a_curve(case, log):
    y = strange((9,))[case]
    for x in (y,) if log else (np.arange(9.0), y):
        png = draw_curves("t", "x", "y", [("a", x, y), ("b", x, -y)], log, log,
                          [(1.0, "one"), (NAN, "never"), (-1.0, "minus one"), (INF, "far")])
        assert len(png) > 1000


@pytest.mark.usefixtures("coarse")
@pytest.mark.parametrize("log", [False, True])
@pytest.mark.slow
def test_curves_without_points(log):
    for series in ([], [("empty", [], [])], [("one", [1.0], [2.0])], [("one", 3.0, NAN)],
                   [("upright", np.zeros(4), np.arange(4.0))], [("zero", [0, 1], [0, 0])]):
        assert draw_curves("t", "x", "y", series, log, log)
        assert draw_curves("t", "x", "y", series, log, log, [(3.0, "a mark")])


@pytest.mark.slow
def test_curves_are_told_apart_and_marks_are_drawn():
    x = np.arange(1.0, 30.0)
    bare = pixels(draw_curves("t", "x", "y", [("a", x, 1 / x), ("b", x, 2 / x)]))
    for colour in ("#1f62a6", "#b3692a"):
        assert near(bare, colour).sum() > 200
    marked = pixels(draw_curves("t", "x", "y", [("a", x, 1 / x), ("b", x, 2 / x)],
                                marks=[(15.0, "")]))
    dark = near(marked, "#1c2227", 0.1).sum(axis=0)
    assert dark.max() > near(bare, "#1c2227", 0.1).sum(axis=0).max() + 50


def test_ranges_ticks_and_words():
    assert robust_range(np.array([]), True) == (0.0, 1.0, False)
    low, high, log = robust_range(np.full(5, 7.0), True)
    assert low < 7.0 < high
    assert not log
    assert round_numbers(0.0, 1.0, False).tolist() == pytest.approx([0, .2, .4, .6, .8, 1.0])
    assert round_numbers(1.0, 1000.0, True).tolist() == pytest.approx(
        [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000])
    assert number_words([0.0, 0.2, 0.4]) == ["0.0", "0.2", "0.4"]
    assert number_words([-1.0, 1e-9]) == ["−1", "10⁻⁹"]
    assert number_words([11.5276, 11.5277]) == ["11.5276", "11.5277"]
    assert number_words([1e-3, 1.0, 1e3]) == ["0.001", "1", "1000"]
    assert number_words([]) == []
    assert len(lines_of("word " * 200, 3.0, 9.5, 3).splitlines()) == 3
    assert plain("a $5\n b") == "a $5 b"


@pytest.mark.slow
def test_pictures_leave_no_state_and_need_no_display():
    code = ("import sys, numpy as np, matplotlib\n"
            "from ppmcal.plotting.curves import draw_curves\n"
            "matplotlib.rcParams['lines.linewidth'] = 7\n"
            "a = draw_curves('t', 'x', 'y', [('a', [1, 2], [1, 2])])\n"
            "assert matplotlib.rcParams['lines.linewidth'] == 7\n"
            "matplotlib.rcParams['text.usetex'] = False\n"
            "matplotlib.rcParams['font.size'] = 30\n"
            "assert a == draw_curves('t', 'x', 'y', [('a', [1, 2], [1, 2])])\n"
            "assert 'matplotlib.pyplot' not in sys.modules\n")
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True, timeout=60)


@pytest.mark.slow
def test_slice_axes_are_drawn_to_one_scale_where_both_are_lengths():
    m = machine("linapod")
    grid = slice_grid(m, slice_axes(m), (9, 9))
    shot = pixels(draw_map(m, grid, Map("x", "x", "", np.full((9, 9), NAN))))
    grey = near(shot, "#e6e8ea", 0.01)
    columns = np.flatnonzero(grey.sum(axis=0) > 50)
    rows = np.flatnonzero(grey.sum(axis=1) > 50)
    ratio = np.ptp(grid.levels[1]) / np.ptp(grid.levels[0])
    assert np.ptp(rows) / np.ptp(columns) == pytest.approx(ratio, rel=0.03)
