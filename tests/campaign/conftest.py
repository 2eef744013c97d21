"""A Scenic child to talk to without a parent in between."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, TextIO

import pytest
from waiting import PATIENT_S

from taxinet_ros.campaign.scenes.programs import shipped_folder

ROOT = Path(__file__).parents[2]


class Client:
    """Speaks the child's protocol."""

    def __init__(self, requests: TextIO, answers: TextIO) -> None:
        self._requests, self._answers = requests, answers
        first = {'ticket': ''}
        assert json.loads(answers.readline()) == first, 'the first line says that Scenic is there'

    def ask(self, **request: Any) -> dict[str, Any]:
        print(json.dumps({**request, 'ticket': 'one'}), file=self._requests, flush=True)
        answer: dict[str, Any] = json.loads(self._answers.readline())
        assert answer.pop('ticket') == 'one'
        return answer


@pytest.fixture(scope='session')
def scenic_child() -> Callable[..., AbstractContextManager[Client]]:
    """What starts a child, in a with statement that gives a :class:`Client`."""
    return start


@contextmanager
def start(*, timeout_s: float = PATIENT_S) -> Iterator[Client]:
    request_read, request_write = os.pipe()
    answer_read, answer_write = os.pipe()
    arguments = {'request-fd': request_read, 'response-fd': answer_write, 'seed': 1,
                 'memory-bytes': 4 << 30, 'timeout-s': timeout_s, 'shipped': shipped_folder()}
    child = subprocess.Popen(
        [sys.executable, '-m', 'taxinet_ros.campaign.scenes.scenic_child',
         *(f'--{name}={value}' for name, value in arguments.items())],
        pass_fds=(request_read, answer_write), stdout=subprocess.DEVNULL, cwd=ROOT,
    )
    os.close(request_read)
    os.close(answer_write)
    with child, open(request_write, 'w') as requests, open(answer_read) as answers:
        yield Client(requests, answers)
        requests.close()
        assert child.wait() == 0, 'the child has to end when its parent hangs up'
