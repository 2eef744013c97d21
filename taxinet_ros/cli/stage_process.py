"""``taxinet`` as a stage of a case study runs it: told to end when the study is gone."""

from __future__ import annotations

import signal

from taxinet_ros.cli.main import main
from taxinet_ros.processes.child import die_with_parent

if __name__ == '__main__':
    # A shell has what it starts in the background ignore Ctrl-C; the study passes its own on.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    # The same signal as Ctrl-C: campaigns end what they are at and can be resumed.
    die_with_parent(signal.SIGINT)
    main()
