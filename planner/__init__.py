"""Reference planner: a road, a line on it, a speed plan, a pose estimate and Pure Pursuit.

Depends on numpy and scipy only, and meets the vehicle through the public gateway API alone.
All of it is pure: times are integer nanoseconds handed in, noise comes from a generator handed in.
"""
