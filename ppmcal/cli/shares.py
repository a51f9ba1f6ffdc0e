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
    "finding commands": {
        "inverse kinematics": 4.0, "predicting errors without correction": 4.4,
        "predicting errors with correction": 0.5, "how sure they are": 2.9},
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
    "diagnose": {
        "reading the measurements": 0.05,
        "comparing the measurements with the nominal machine": 0.1,
        "choosing what to fit": 0.01, "fitting geometry": 0.5,
        "asking which causes are in the data": 10.3, "judging the campaign": 0.1,
        "writing the results": 1.6},
    "kinematics": {
        "reading the table": 0.15, "forward kinematics": 2.7, "inverse kinematics": 4.0,
        "writing the results": 1.0},
    "compensate": {"reading the table": 0.15, "finding commands": 11.9, "writing the results": 1.6},
    "export": {
        "reading the table": 0.15, "correcting the grid": 12.0, "how sure the model is": 5.0,
        "predicting errors of the grid": 2.5, "writing the results": 1.6},
    "simulate": {"simulating": 5.5, "writing the results": 1.2},
    "validate": {
        "reading the measurements": 0.01, "looking at the noise": 2.2,
        "predicting with and without each effect": 2.9, "writing the results": 1.0},
    "check": {"reading the measurements": 0.4, "checking": 4.0},
    "report": {"reading the results": 1.0, "drawing the page": 2.0, "writing the results": 0.1},
    "demo": {"check": 0.8, "identify": 0.8, "compensate": 0.2, "diagnose": 17.5, "kinematics": 0.05,
             "simulate": 0.1, "sensitivity": 1.6, "plan": 2.9, "report": 2.6},
}
"""By command."""


def shares(name: str) -> Mapping[str, float]:
    """Return the shares of a command's stages, none where they were not measured."""
    from ppmcal import commands

    return commands.command(name).shares if name in commands.names() else SHARES.get(name, {})
