"""A complete planner: the whole stack in this process, and a left-hand circle driven on it.

Run it with `python examples/planner_in_ten_lines.py`. Everything below `InProcessStack` works the
same on a real bus: leave the stack away and connect to `"socketcan", "can0"`.
"""

from gateway.connect import connect
from runtime.launch import InProcessStack
from vehicles import load_vehicle


def main(duration_s: float = 10.0) -> float:
    """Drives a circle of 20 m radius at 2 m/s, stops, and returns the way driven in m."""
    vehicle = load_vehicle("tabby_evo")
    with (
        InProcessStack(vehicle=vehicle, channel="example") as stack,
        connect("virtual", "example", vehicle=vehicle) as car,
    ):
        start_ns = next(s.time_ns for s in car.ticks() if "button" in s.why_not_engaged)
        stack.press_button()
        car.engage()
        for state in car.ticks():  # every 20 ms
            car.command(speed_mps=2.0, curvature_per_m=0.05)
            if state.time_ns - start_ns > duration_s * 1e9:
                break
        car.disengage()  # a controlled stop
        return stack.truth().distance_m


if __name__ == "__main__":
    print(f"driven: {main():.1f} m")
