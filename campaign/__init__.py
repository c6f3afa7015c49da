"""Thousands of simulated hours under faults: drawn by seed, judged by the oracle, reported."""
