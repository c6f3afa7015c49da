"""Frames of a log as tables, one for each message; and as lines, files and data frames."""
