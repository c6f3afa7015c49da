"""`python -m bench socketcan` finds what it measures; how fast that is, is not tested."""

from __future__ import annotations

from bench.socketcan.echo import ECHOES, QUICK_ROUNDS, measure_subject, node_subject
from bench.socketcan.flood import QUICK_FRAMES, measure_flood

ANSWER_NS_MAX = 20_000_000


def test_every_way_of_answering_answers_every_request() -> None:
    for subject in (*ECHOES, node_subject("steering")):
        result = measure_subject(subject, QUICK_ROUNDS)
        assert len(result.spans_ns) == QUICK_ROUNDS
        assert 0 < min(result.spans_ns) <= max(result.spans_ns) < ANSWER_NS_MAX, subject.name


def test_every_reader_reads_the_whole_flood() -> None:
    results = measure_flood(quick=True)
    assert len(results) == 3
    for result in results:
        assert result.frames == QUICK_FRAMES and 0.0 < result.cpu_s < 10.0
