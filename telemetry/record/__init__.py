"""Keeps what is heard on a bus, or read from a log, in a file of any common format."""
