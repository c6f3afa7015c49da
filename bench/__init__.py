"""What the project claims in numbers, measured: `python -m bench`, kept in docs/benchmarks.md."""
