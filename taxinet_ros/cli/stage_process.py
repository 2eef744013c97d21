"""``taxinet`` as a stage of a case study: terminated when the study process dies."""

from __future__ import annotations

import signal

from taxinet_ros.cli.main import main
from taxinet_ros.processes.child import die_with_parent

if __name__ == '__main__':
    # A shell makes background processes ignore Ctrl-C; the study forwards its own.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    # The same signal as Ctrl-C: campaigns end their current runs and can be resumed.
    die_with_parent(signal.SIGINT)
    main()
