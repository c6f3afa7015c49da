"""UNICAMP's experiments, in the order of the paper's sections."""

from __future__ import annotations

from experiments.result import Experiment
from experiments.unicamp import circles, profile, robustness, whole

EXPERIMENTS: tuple[Experiment, ...] = (
    Experiment(
        id="unicamp-profile",
        title="Speed of the rear wheels over a profile",
        source="UNICAMP 6.1, Fig. 4",
        run=profile.run,
    ),
    Experiment(
        id="unicamp-circles",
        title="Circles by curvature control",
        source="UNICAMP 4.1 and 6.2, Fig. 3 and 5",
        run=circles.run,
    ),
    Experiment(
        id="unicamp-stack",
        title="The circles by the whole stack",
        source="UNICAMP 4.1 and 6.2, Fig. 5",
        run=whole.run,
    ),
    Experiment(
        id="unicamp-robustness",
        title="Curvature control in cars with errors",
        source="not in the paper",
        run=robustness.run,
    ),
)
