"""A recorded drive once more: in its time, onto a bus, or through the code of a node."""
