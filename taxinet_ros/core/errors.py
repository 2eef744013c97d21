"""The two kinds of trouble: the user's (mend the input) and the bench's (a part of it failed)."""

from __future__ import annotations


class UsageError(Exception):
    """Bad input. The message is one line: what is wrong, where, and how to mend it. CLI exit 2."""


class InfraError(Exception):
    """A part of the test bench failed, so the run has no verdict. CLI exit 4.

    Attributes:
        kind: short machine-readable word, e.g. ``timeout``, ``died``, ``not_ready``, ``sim``.
        who: name of the node or part that failed.
        step: control step at which it happened, or -1 before the first.
    """

    def __init__(self, kind: str, who: str, step: int, detail: str) -> None:
        super().__init__(f'{kind}: {who} at step {step}: {detail}')
        self.kind = kind
        self.who = who
        self.step = step
        self.detail = detail

    def __reduce__(self) -> tuple[type[InfraError], tuple[str, str, int, str]]:
        """Survive the way home from a worker process."""
        return InfraError, (self.kind, self.who, self.step, self.detail)
