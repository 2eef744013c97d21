"""A Scenic child to talk to without a parent in between."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TextIO

from waiting import PATIENT_S

from taxinet_ros.core.scenario_fields import by_key
from taxinet_ros.scenes.scenic_server import fork_child


class Client:
    """Speaks the child's protocol."""

    def __init__(self, requests: TextIO, answers: TextIO) -> None:
        self._requests, self._answers = requests, answers
        first = json.loads(answers.readline())
        assert {*first} == {'pid'}, 'the first line says that Scenic is there'
        self.pid: int = first['pid']

    def ask(self, **request: Any) -> dict[str, Any]:
        print(json.dumps(request), file=self._requests, flush=True)
        answer: dict[str, Any] = json.loads(self._answers.readline())
        if 'values' in answer:
            answer['values'] = by_key(answer['values'])
        return answer


@contextmanager
def scenic_child(*, timeout_s: float = PATIENT_S) -> Iterator[Client]:
    """A child that has just started."""
    child, answer_read, request_write = fork_child(
        seed=1, memory_bytes=4 << 30, timeout_s=timeout_s
    )
    with open(request_write, 'w') as requests, open(answer_read) as answers:
        client = Client(requests, answers)
        child.pid = client.pid
        yield client
        requests.close()
        assert child.wait() == 0, 'the child has to end when its parent hangs up'
