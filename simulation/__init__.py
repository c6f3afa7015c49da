"""Deterministic simulation: the same nodes, a car and a wire, in virtual time."""
