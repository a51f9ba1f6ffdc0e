"""A weak campaign: part of identification.json and diagnosis.json, and what is said of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field

from ppmcal.calibration.fit import WeakCampaign
from ppmcal.io.results.parts import Range
from ppmcal.io.results.record import Part, Text, Whole
from ppmcal.units import Units, coordinate_quantity
from ppmcal.wording import pluralize

FEW = 3


class CampaignSummary(Part):
    """Poses that cannot tell what was fitted.

    ``shapes``: what is weak; ``unknown``: parameters where more than half the tolerance stays
    open, in groups, ``parameters`` by name; ``poses``: how many measurements would tell them, in
    ``file``; ``where``: the coordinates in which they go beyond the campaign.
    """

    shapes: tuple[Text, ...] = ()
    unknown: tuple[Text, ...] = ()
    parameters: tuple[Text, ...] = ()
    poses: Whole = 0
    where: Mapping[Text, Range] = field(default_factory=dict)
    file: Text | None = None
    text: Text = ""

    @classmethod
    def of(cls, found: WeakCampaign | None, units: Units) -> CampaignSummary | None:
        """Return the entry of a campaign, None where it is not weak."""
        if found is None:
            return None
        where = {name: Range.filled(None, units, low=low, high=high,
                                        unit=coordinate_quantity(name))
                 for name, low, high in found.missing.where}
        return cls(shapes=found.shapes, unknown=found.groups, parameters=found.unknown,
                   poses=len(found.missing.q), where=where, file="next.csv",
                   text=_sentence(found, where))


def campaign_sentences(found: CampaignSummary | None) -> list[str]:
    """Return what to say of a weak campaign, nothing of another: no fault of data or machine."""
    return [f"{found.text}."] if found is not None and found.text else []


def _sentence(found: WeakCampaign, where: Mapping[str, Range]) -> str:
    """Return what a campaign leaves unknown and which measurements are missing."""
    first, *more = found.shapes
    shape = "; ".join([first[:1].upper() + first[1:], *more])
    text = (f"{shape}, so these stay unknown to more than half their tolerance: "
            f"{'; '.join(found.groups)}")
    what = "touch" if found.touches else "pose"
    count = len(found.missing.q)
    many = pluralize(count, what) if not found.touches or count == 1 else f"{count} touches"
    ranges = [f"{name} from {r.low:.4g} to {r.high:.4g} {r.unit}"
              for name, r in list(where.items())[:FEW]]
    beyond = f" ({', '.join(ranges)})" if ranges else ""
    return f"{text}. {many} more{beyond} would fix that, see next.csv"
