"""Which share of its time each stage takes, of stages that several commands have.

The time left is reckoned from these, and from what each command says of its own stages.

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
    "finding commands": {
        "inverse kinematics": 4.0, "predicting errors without correction": 4.4,
        "predicting errors with correction": 0.5, "how sure they are": 2.9},
    "registering the nominal machine": {
        "looking for gross errors": 0.5, "fitting all rows": 0.5, "judging each row": 1.4},
    "predicting held-out poses": {
        "looking for gross errors": 0.6, "fitting all rows": 1.2, "judging each row": 0.5},
}
"""By stage."""
