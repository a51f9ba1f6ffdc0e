"""Which share of its time each stage takes: what the time left is reckoned from.

CPU seconds of runs that are long enough to show a time left, on one core of an ordinary server;
only their proportions count. ``ppmcal COMMAND -v`` prints those of a run.
"""

from collections.abc import Mapping

Shares = Mapping[str, Mapping[str, float]]

FIT = {"looking for gross errors": 0.6, "fitting some of the rows": 0.3, "coming near": 0.4,
       "fitting all rows": 1.5, "judging each row": 0.5}
INNER: Shares = {
    "fitting": FIT,
    "judging the fit": {
        "explaining gross errors": 0.01, "widening intervals where rows disagree": 0.8,
        "registering the nominal machine": 2.4, "predicting each session": 2.4,
        "predicting held-out poses": 2.4, "what the data leave open": 0.02,
        "where the machine is another": 0.4},
    "registering the nominal machine": {
        "looking for gross errors": 0.5, "fitting all rows": 0.5, "judging each row": 1.4},
    "predicting held-out poses": {
        "looking for gross errors": 0.6, "fitting all rows": 1.2, "judging each row": 0.5},
}
"""By stage."""

SHARES: Shares = {
    "identify": {
        "reading the measurements": 0.4, "comparing the measurements with the nominal machine": 0.1,
        "choosing what to fit": 0.1, "fitting": 3.4, "looking for wrong rows": 0.1,
        "judging the fit": 6.4, "judging the campaign": 0.6, "writing the results": 2.5},
}
"""By command."""
