"""UAH's experiments, in the order of the paper's sections."""

from __future__ import annotations

from experiments.result import Experiment
from experiments.uah import (
    accuracy,
    odometry,
    path,
    reliability,
    silence,
    steps,
    switching,
    vernier,
)

EXPERIMENTS: tuple[Experiment, ...] = (
    Experiment(
        id="uah-odometry",
        title="Odometry from the rear wheels",
        source="UAH 3.4, Fig. 8",
        run=odometry.run,
    ),
    Experiment(
        id="uah-vernier",
        title="Angle sensor, encoder and DAC",
        source="UAH 4.1 and 4.2, Eq. 1-3",
        run=vernier.run,
    ),
    Experiment(
        id="uah-accuracy",
        title="Errors of sensors and dimensions in curvature and speed",
        source="UAH 4.6, Eq. 15-20",
        run=accuracy.run,
    ),
    Experiment(
        id="uah-silence",
        title="No setpoint for a second",
        source="UAH 4.5",
        run=silence.run,
    ),
    Experiment(
        id="uah-steps",
        title="Step responses of steering and speed",
        source="UAH 5.1, Fig. 25 and 26",
        run=steps.run,
    ),
    Experiment(
        id="uah-path",
        title="Path tracking on the campus",
        source="UAH 5.2, Fig. 27",
        run=path.run,
    ),
    Experiment(
        id="uah-switching",
        title="Manual and automatic in turn",
        source="UAH 5.3, Fig. 28",
        run=switching.run,
    ),
    Experiment(
        id="uah-reliability",
        title="Reliability",
        source="UAH 5.4, Eq. 21-25",
        run=reliability.run,
    ),
)
