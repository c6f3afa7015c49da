"""A DBC as a page for people: messages, layout pictures, timing, codes, nodes."""
