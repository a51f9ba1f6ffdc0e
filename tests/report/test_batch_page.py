"""The page of a batch: the ranking, what is the design's, what has changed; self-contained."""

import re
from math import comb

import numpy as np
import pytest
from helpers.report_files import own, specs

from ppmcal.calibration.sessions.common_parameters import common_errors, share_interval
from ppmcal.io.results.batch import (
    CampaignQuantity,
    CampaignRecord,
    effect_changes,
    farthest_parameter,
    left,
    ranking,
    shared_effects,
    shared_parameters,
)
from ppmcal.report.batch import batch_page, common_sentences


def error(stage, value, unit="mm"):
    return CampaignQuantity(what="error", name="position", parameter=stage, value=value, unit=unit)


def effect(kind, value, sigma=0.001, on="leg1"):
    return CampaignQuantity(what="effect", name=kind, on=on, parameter="width", value=value,
                            sigma=sigma, unit="mm", status="named")


def record(machine, *quantities, date="2026-01-10", command="identify", design="hexapod", **more):
    return CampaignRecord(
        campaign=f"{machine}/{date}/{command}", machine=machine, date=date, design=design,
        command=command, quantities=quantities, **{"verdict": "done"} | more)


def diagnosed(machine, *effects, **more):
    return record(machine, *effects, command="diagnose", verdict="named", **more)


def test_machines_are_ranked_by_what_is_left_where_no_fit_has_seen():
    records = [record("a", error("before", 0.9), error("after", 0.01), error("holdout", 0.02)),
               record("b", error("before", 0.3), error("after", 0.02), error("holdout", 0.05)),
               # in another unit, and without held-out poses
               record("c", error("before", 40.0, "um"), error("after", 30.0, "um")),
               # an earlier campaign does not count
               record("a", error("holdout", 9.0), date="2025-01-01")]
    assert [r.machine for r in ranking(records)] == ["b", "c", "a"]
    assert left(records[2]).value == 30.0
    page = batch_page(records)
    heads = re.findall(r'<th scope="row"[^>]*><a href="([^"]+)">(\w)</a>', page)
    assert [name for _, name in heads] == ["b", "c", "a"]
    assert heads[0][0] == "b/2026-01-10/identify/"
    assert "RMS distances." in page and "from closing" not in page
    alone = CampaignQuantity(what="error", name="closure", parameter="after", value=1.0, unit="mm")
    both = batch_page([*records, record("d", alone)])
    assert "RMS distances; of joint values alone: the uncalibrated machine; errors are how" in both


def test_an_effect_that_most_have_is_the_designs():
    records = [diagnosed(f"m{i}", effect("backlash", 0.02 + 0.001 * i)) for i in range(8)]
    records += [diagnosed("m8", effect("gain", 1e-4)), diagnosed("m9")]
    backlash, gain = shared_effects(records)
    assert (backlash.kind, len(backlash.machines), backlash.of) == ("backlash", 8, 10)
    (size,) = backlash.sizes
    assert (size.parameter, size.unit) == ("width", "mm")
    assert (size.mean, size.spread) == (pytest.approx(0.0235), pytest.approx(0.00245, rel=1e-3))
    assert gain.sizes[0].spread is None
    assert backlash.whose == "perhaps the design's"      # 8 of 10: 44 to 97 %
    assert gain.whose == "the units'"
    more = records + [diagnosed(f"n{i}", effect("backlash", 0.02)) for i in range(4)]
    assert shared_effects(more)[0].whose == "the design's"
    assert common_sentences(more) == ["backlash is the design's: 12 of 14 machines have it."]
    assert "12 of 14" in batch_page(more)


def test_designs_are_apart():
    records = [diagnosed(f"m{i}", effect("backlash", 0.02)) for i in range(8)]
    records += [diagnosed(f"n{i}", design="delta") for i in range(8)]
    page = batch_page(records)
    assert "8 of 8" in page
    assert "8 of 16" not in page


def test_only_the_latest_diagnosis_of_a_machine_counts():
    records = [diagnosed(f"m{i}", effect("backlash", 0.02), date="2025-01-01") for i in range(8)]
    records += [diagnosed(f"m{i}") for i in range(8)]
    assert not shared_effects(records)


def test_effects_that_came_went_or_grew_are_told():
    old = diagnosed("m", effect("backlash", 0.020), effect("gain", 1.0), effect("lag", 1.0, on=""))
    new = diagnosed("m", effect("backlash", 0.030), effect("drift", 1.0), effect("lag", 1.003,
                                                                               on=""))
    came, went, grew = effect_changes(old, new)
    assert (came.what, came.kind, went.what, went.kind) == ("new", "drift", "no longer named",
                                                            "gain")
    assert (grew.what, grew.kind, grew.on, grew.old.value, grew.new.value) == (
        "changed", "backlash", "leg1", 0.020, 0.030)
    page = batch_page([old, new.changed(date="2026-02-10")])
    assert ("new: drift on leg1; no longer named: gain on leg1; backlash on leg1: width 0.0200 → "
            "0.0300 mm") in page


def test_a_unit_as_older_versions_wrote_it_is_the_same_unit():
    old, new = (effect("windup", value).changed(parameter="give")
                for value in (0.020, 0.030))
    found = effect_changes(*(
        diagnosed("m", CampaignQuantity(**{**q.entries(whole=True), "unit": unit}))
        for q, unit in ((old, "deg/N m"), (new, "deg/(N m)"))))
    assert [(c.new.value, c.new.unit) for c in found] == [(0.030, "deg/(N m)")]


def parameter(value, nominal=100.0, status="identified", name="leg1.offset"):
    return CampaignQuantity(what="parameter", name=name, value=value, nominal=nominal, sigma=0.01,
                            tolerance=0.3, unit="mm", status=status)


def test_the_parameter_that_is_most_tolerances_off():
    found = farthest_parameter(record("m", parameter(100.6), parameter(99.1, name="leg2.offset")))
    assert (found.name, found.tolerances, found.far) == ("leg2.offset", pytest.approx(3.0), False)
    assert farthest_parameter(record("m", parameter(103.0))).far
    assert farthest_parameter(record("m", error("after", 0.1))) is None


def test_parameters_that_are_fixed_are_not_judged():
    records = [record(f"m{i}", parameter(100.5 + 0.01 * i), parameter(5.0, 4.0, "fixed", "held"))
               for i in range(6)]
    (name, unit, tolerance, found), = shared_parameters(records)
    assert (name, unit, tolerance, found.machines) == ("leg1.offset", "mm", 0.3, 6)
    assert found.of_design
    assert found.mean == pytest.approx(0.525)
    assert "Off nominal in the same way on all units, so by design: leg1.offset." in (
        common_sentences(records))


def test_what_is_there_only_where_it_was_found_is_not_judged():
    """A backlash that three of six machines have is not off by design, though never 0."""
    width = [parameter(0.1 + 0.001 * i, 0.0, name="backlash.leg1.width") for i in range(6)]
    some = [diagnosed(f"m{i}", parameter(100.0 + (-0.1) ** i), width[i], effect("backlash", 0.1))
            for i in range(3)]
    rest = [diagnosed(f"m{i}", parameter(100.0 + (-0.1) ** i)) for i in range(3, 6)]
    assert [name for name, *_ in shared_parameters(some + rest)] == ["leg1.offset"]
    everyone = [diagnosed(r.machine, *r.quantities, effect("backlash", 0.1), width[i])
                for i, r in enumerate(some + rest)]
    assert [name for name, *_ in shared_parameters(everyone)] == ["leg1.offset"]
    other = [record(r.machine, parameter(100.0), parameter(0.1, 0.0, name="gain.leg1"))
             for r in some] + rest
    assert [name for name, *_ in shared_parameters(other)] == ["leg1.offset"]


@pytest.mark.long
def test_means_over_units_are_named_as_rarely_as_promised():
    """Units around nominal, 20 parameters of 6 machines: one wrong name in a hundred batches."""
    rng = np.random.default_rng(3)
    batches = 3000
    wrong = sum(any(f.of_design for f in common_errors(list(rng.normal(size=(20, 6)))))
                for _ in range(batches))
    # three standard deviations of a count of that chance
    assert abs(wrong - 0.01 * batches) < 3.0 * np.sqrt(0.01 * 0.99 * batches)


def test_errors_that_do_not_spread_say_nothing():
    assert common_errors([np.zeros(5), np.full(5, 0.1)])[0].p_value == 1.0
    assert common_errors([np.zeros(2)]) == [None]


@pytest.mark.parametrize("count, total", [(0, 5), (3, 7), (8, 8)])
def test_the_interval_of_a_share_leaves_as_much_on_either_side(count, total):
    low, high = share_interval(count, total)

    def chance(p, counts):
        return sum(comb(total, k) * p**k * (1 - p) ** (total - k) for k in counts)

    if count:
        assert chance(low, range(count, total + 1)) == pytest.approx(0.025)
    if count < total:
        assert chance(high, range(count + 1)) == pytest.approx(0.025)


def test_who_failed_or_changed_is_to_be_looked_at_and_nothing_is_fetched():
    records = [record("a", error("after", 0.1), error("before", 1.0)),
               record("b", error("after", 0.2), error("before", 1.0)),
               record("c", exit_code=3, verdict="failed", message="<gone> & lost", design="",
                      typed="ppmcal identify x.yaml"),
               record("a", CampaignQuantity(what="change", name="leg1.offset", value=0.4, sigma=0.1,
                                            unit="mm"), command="compare", verdict="changed",
                      exit_code=1)]
    page = batch_page(records)
    look = page[page.index('class="look"'):page.index("</section>")]
    assert "c/2026-01-10/identify failed: &lt;gone&gt; &amp; lost" in look
    assert "changed since last time: a" in look
    assert "leg1.offset 0.40 ± 0.20 mm" in page
    assert "ppmcal identify x.yaml" in page
    assert "Error in position of each machine" in specs(page)
    page = own(page)
    links = re.findall(r'(?:src|href)="([^"]*)"', page)
    assert {link for link in links if link[0] != "#"} == {"a/2026-01-10/identify/",
                                                          "b/2026-01-10/identify/"}
    assert "http" not in re.sub(r'xmlns(:\w+)?="http[^"]+"', "", page)


def test_a_batch_shows_the_interval_of_a_change():
    page = batch_page([record("a", CampaignQuantity(
        what="change", name="leg1.offset", value=0.4, sigma=0.1, half=0.31, unit="mm"),
        command="compare", verdict="changed", exit_code=1)])
    assert "leg1.offset 0.40 ± 0.31 mm" in page
