"""``taxinet`` as a stage of a case study runs it: told to end when the study is gone."""

from __future__ import annotations

import ctypes
import signal

from taxinet_ros.cli.main import main

_PR_SET_PDEATHSIG = 1

if __name__ == '__main__':
    # A shell has what it starts in the background ignore Ctrl-C; the study passes its own on.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    # The same signal as Ctrl-C: campaigns end what they are at and can be resumed.
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGINT)
    main()
