"""Camera frames of failed runs, put into their bags when it is known that they failed.

They are rendered once more from what is recorded: that costs a failed run about as much as
recording them would have, and all other runs nothing. Until then the bag is whole without them,
so whatever happens meanwhile, nothing is lost.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from taxinet_msgs.msg import RunStatus

from taxinet_ros.bag.frames import restore_in_place
from taxinet_ros.core.outcome import Outcome

_PAUSE_S = 0.001
_FAILURES = (Outcome.FAIL, Outcome.INFRA_ERROR)


class LateFrames:
    """Renders frame by frame, between a node's messages, so that it still answers."""

    def __init__(
        self, node: Node, on_frame: Callable[[int], None], on_end: Callable[[str], None]
    ) -> None:
        """Nothing happens before :meth:`begin`.

        Args:
            node: whose executor does the work.
            on_frame: called with every control step that has its frame.
            on_end: called at the end, with '' or with the reason why a judged run's frames cannot
                be had.
        """
        self._node = node
        self._on_frame, self._on_end = on_frame, on_end
        self._frames: Iterator[int] = iter(())
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(_PAUSE_S, self._render, clock=steady)
        self._timer.cancel()

    def begin(self, bag: Path, ended: RunStatus, min_free_bytes: int) -> None:
        """Put the frames into the bag of a run that has ended so, if it is worth looking at."""
        if ended.outcome not in _FAILURES:
            self._on_end('')
            return
        self._judged = Outcome(ended.outcome).judged
        self._frames = restore_in_place(bag, min_free_bytes)
        self._timer.reset()

    @property
    def under_way(self) -> bool:
        """Whether frames are being rendered."""
        return not self._timer.is_canceled()

    def give_up(self) -> None:
        """Leave the bag as it was, if one is under way."""
        self._timer.cancel()
        close = getattr(self._frames, 'close', None)
        if close is not None:
            close()

    def _render(self) -> None:
        try:
            self._on_frame(next(self._frames))
        except StopIteration:
            self._end('')
        except Exception as error:
            self._end(f'frames not kept: {type(error).__name__}: {error}'.splitlines()[0])

    def _end(self, trouble: str) -> None:
        self._timer.cancel()
        if trouble:
            self._node.get_logger().error(trouble)
        # A run that broke has a reason of its own to tell.
        self._on_end(trouble if self._judged else '')
