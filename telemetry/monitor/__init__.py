"""`dbw monitor`: the bus as lines of text, or as a screen. No I/O: frames and time come in."""
