"""Signals of a log over time, with modes and codes: as a picture and as a page."""
