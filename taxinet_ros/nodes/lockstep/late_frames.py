"""Camera frames that are added to a bag after its run."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

_PAUSE_S = 0.001


class LateFrames:
    """Renders frames one by one between a node's messages, so that the node stays responsive."""

    def __init__(
        self, node: Node, on_frame: Callable[[int], None], on_end: Callable[[str], None]
    ) -> None:
        """Create it; rendering starts with :meth:`begin`.

        Args:
            node: node whose executor does the work.
            on_frame: called with every control step rendered.
            on_end: called at the end with '', or with the reason why frames cannot be rendered.
        """
        self._on_frame, self._on_end = on_frame, on_end
        self._frames: Iterator[int] = iter(())
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(_PAUSE_S, self._render, clock=steady)
        self._timer.cancel()

    def begin(self, bag: Path, min_free_bytes: int) -> None:
        """Add frames to the bag of a finished run."""
        # Imported here because it reads bags, which takes 30 ms that no other run needs.
        from taxinet_ros.bag.rewrite.frames import restore_in_place

        self._frames = restore_in_place(bag, min_free_bytes)
        self._timer.reset()

    @property
    def under_way(self) -> bool:
        """Whether frames are being rendered."""
        return not self._timer.is_canceled()

    def cancel(self) -> None:
        """Cancel any rendering; the bag stays unchanged."""
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
        self._on_end(trouble)
