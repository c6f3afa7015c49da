"""Properties of a running world, judged by code that shares nothing with the nodes.

An `Oracle` is told every frame on the wire, the truth about car and driver every 10 ms, and every
fault that is injected; it answers with violations and reactions. Its decoding, its counter rule,
its limits and its tables are its own: a mistake in the nodes' is not repeated here.
"""
