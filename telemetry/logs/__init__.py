"""Logs of any common format as frames: objects one by one, or numpy columns by the chunk."""
