"""UWA's experiments, in the order of the paper's sections."""

from __future__ import annotations

from experiments.result import Experiment
from experiments.uwa import brake, silence, steering, throttle

EXPERIMENTS: tuple[Experiment, ...] = (
    Experiment(
        id="uwa-throttle",
        title="Throttle voltage through a filtered PWM",
        source="UWA 5 and 8",
        run=throttle.run,
    ),
    Experiment(
        id="uwa-silence",
        title="No command for 300 ms",
        source="UWA 7.1, Table 2 (ER5)",
        run=silence.run,
    ),
    Experiment(
        id="uwa-steering",
        title="Steering: linearity, errors and speed",
        source="UWA 8, Fig. 9 and 10, Table 3",
        run=steering.run,
    ),
    Experiment(
        id="uwa-brake",
        title="Brake servo: time and repeatability",
        source="UWA 8",
        run=brake.run,
    ),
)
