"""The papers' experiments, run again here, and the same with this stack on the same plant."""
