"""Many futures of one world, each in a forked process.

A world cannot be copied (`copy.deepcopy` leaves the closures that wire nodes to the car on the old
one), and driving to a state costs far more than what happens after it. A fork copies everything,
exactly and in milliseconds.
"""

from __future__ import annotations

import os
import pickle
import sys
import traceback
from collections.abc import Callable
from typing import TypeVar

AnswerT = TypeVar("AnswerT")


def in_a_fork(work: Callable[[], AnswerT]) -> AnswerT:
    """The answer of `work`, done in a child process; nothing changes in this one.

    Only for a process of one thread.

    Raises:
        RuntimeError: The child failed; its traceback is on standard error.
    """
    read_end, write_end = os.pipe()
    child = os.fork()
    if child == 0:
        _work_and_exit(work, write_end)
    os.close(write_end)
    with os.fdopen(read_end, "rb") as pipe:
        data = pipe.read()
    _, status = os.waitpid(child, 0)
    if status != 0:
        raise RuntimeError(f"a forked run failed with status {status}")
    answer: AnswerT = pickle.loads(data)
    return answer


def _work_and_exit(work: Callable[[], object], write_end: int) -> None:
    """In the child: never returns, so that nothing of the parent's runs twice."""
    code = 1
    try:
        data = pickle.dumps(work())
        with os.fdopen(write_end, "wb") as pipe:
            pipe.write(data)
        code = 0
    except BaseException:  # whatever it is, the parent must not go on in the child
        traceback.print_exc()
        sys.stderr.flush()
    finally:
        os._exit(code)
