"""The command line `dbw`: the only place that prints."""
