"""Processes of this package in tests: forked from one that has all imports behind it.

To start a Python with this package takes a second of processor time, and the tests start a thousand
of them. So each process of pytest keeps a server that has imported everything; what would start
``python -m taxinet_ros.…``, workers of a pool, or ``taxinet`` gets a fork of it instead: with the
same arguments, environment, folder, descriptors, signals and limits, as a child of whoever started
it, and with a server of its own for what it starts in turn. Whatever else is started, or asks for
something that is settled while Python starts, is started as ever. ``TAXINET_FORKSERVER=no`` starts
everything so.
"""

from __future__ import annotations

import _posixsubprocess
import atexit
import builtins
import contextlib
import ctypes
import dataclasses
import fcntl
import gc
import importlib
import io
import os
import pickle
import pkgutil
import resource
import runpy
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import types
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

_PYTHON = sys.executable  # which a test may replace
TAXINET = 'from taxinet_ros.cli.main import main; main()'
_SPAWNED = 'from multiprocessing.spawn import spawn_main;'
FORKED = '# forked\n'
"""First line of other code that a fork may run."""
_ALONE = (
    'taxinet_ros.cli.start', 'taxinet_ros.scenes.scenic_child',
    'taxinet_ros.core.perception.onnx.trial',
)
"""Modules that start no further processes."""
_COUNTS = 'taxinet_ros.nodes.graph.command_wrapper'
"""It counts the processes that are left, of which a server would be one."""
_LEFT_OUT = ('rclpy', 'torch', 'onnxruntime', 'distributed', 'mitsuba', 'jsbsim', 'pytest')
"""Libraries that begin threads when they are imported, or that few processes need."""
_MESSAGES = (
    'builtin_interfaces', 'diagnostic_msgs', 'geometry_msgs', 'nav_msgs', 'rosgraph_msgs',
    'sensor_msgs', 'std_msgs', 'taxinet_msgs', 'tf2_msgs', 'visualization_msgs',
)
_PADDING = 'x' * 8192
"""On the server's command line, where a fork puts down its own."""
_FIRST_FILE = 300
"""Descriptors from here on are nobody else's."""
_MOST_BYTES = 1 << 20
_LOADED = (
    'PYTHON', 'LD_PRELOAD', 'LC_', 'LANG', 'MALLOC_', 'OMP_', 'OPENBLAS_', 'OPENCV_', 'MKL_',
    'NPY_', 'ATEN_', 'TORCH_', 'AMENT_', 'RMW_', 'ROS_PYTHON_CHECK_FIELDS',
    'ROS_AUTOMATIC_DISCOVERY_RANGE',
)
"""Beginnings of variables that are read while Python or a library starts."""
_IF_AT_ALL = ('PYTHONHASHSEED', 'OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS')
"""Of these, those that a process may lack: results do not depend on them."""
_LIMITS = [value for name, value in vars(resource).items() if name.startswith('RLIMIT_')]
_PR_SET_CHILD_SUBREAPER, _PR_GET_CHILD_SUBREAPER = 36, 37
_prctl = ctypes.CDLL(None).prctl
_exit = os._exit  # before user code is loaded, which may not call it
_start = _posixsubprocess.fork_exec


class _Work(NamedTuple):
    """What a Python is started for: code (``-c``) or a module (``-m``); ``safe``: with ``-P``."""

    kind: str
    what: str
    arguments: list[str]
    safe: bool


class _Server:
    """A process that forks children for this one."""

    def __init__(self, environment: Mapping[str, str], control: socket.socket) -> None:
        self.environment = dict(environment)
        self._control = control
        self._group = os.getpgrp()
        self._lock = threading.Lock()

    @classmethod
    def begun(cls) -> _Server:
        """One that imports everything."""
        from taxinet_ros.processes.child import child_environment

        environment = child_environment()
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            server = subprocess.Popen(
                [sys.executable, '-P', __file__, str(theirs.fileno()), _PADDING],
                pass_fds=(theirs.fileno(),), stdin=subprocess.DEVNULL, env=environment,
            )
        server.returncode = 0  # it ends with this process, which need not wait for it
        atexit.register(ours.close)
        if not ours.recv(_MOST_BYTES):
            raise RuntimeError('the fork server does not start; see its complaints above')
        return cls(environment, ours)

    def serves(self, environment: Mapping[str, str], own_group: bool) -> bool:
        """Whether a child with this environment can be a fork."""
        names = {
            name for name in {*self.environment, *environment}
            if name.startswith(_LOADED) and name != 'PYTHONPATH'
            and not (name in _IF_AT_ALL and name not in environment)
        }
        return (own_group or os.getpgrp() == self._group) and all(
            environment.get(name) == self.environment.get(name) for name in names
        )

    def start(self, request: Mapping[str, Any], files: Sequence[int]) -> int:
        """Have a child forked; its process id."""
        words = pickle.dumps({
            **request,
            'blocked': signal.pthread_sigmask(signal.SIG_BLOCK, ()),
            'ignored': [
                number for number in signal.valid_signals()
                if signal.getsignal(number) is signal.SIG_IGN
            ],
            'limits': {limit: resource.getrlimit(limit) for limit in _LIMITS},
            'umask': _umask(),
        })
        reaper = ctypes.c_int()
        with self._lock:
            before = signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
            try:
                _prctl(_PR_GET_CHILD_SUBREAPER, ctypes.byref(reaper), 0, 0, 0)
                # The fork's parent ends at once, and the kernel gives the orphan to this process.
                _prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
                socket.send_fds(self._control, [words], files)
                pid = int(self._control.recv(_MOST_BYTES) or b'-1')
                adopted = self._control.recv(_MOST_BYTES)
            finally:
                _prctl(_PR_SET_CHILD_SUBREAPER, reaper.value, 0, 0, 0)
                signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if not adopted:
            raise RuntimeError('the fork server has ended')
        return pid


_server: _Server | None = None


def install() -> None:
    """From now on, processes of this package that this one starts are forks."""
    if os.environ.get('TAXINET_FORKSERVER') != 'no':
        # In both places: subprocess took the name along, multiprocessing asks for it each time.
        _posixsubprocess.fork_exec = subprocess._fork_exec = _fork_or_start  # type: ignore


def _fork_or_start(*arguments: Any) -> int:
    """Stand in for ``_posixsubprocess.fork_exec``."""
    (words, programs, close_files, kept, folder, variables, stdin, _, _, stdout, _, stderr, _,
     errors, _, new_session, group, *others) = arguments
    gid, gids, uid, umask, before = others[:5]
    work = _work_of([os.fsdecode(word) for word in words], [os.fsdecode(name) for name in programs])
    environment = dict(os.environ) if variables is None else dict(
        os.fsdecode(pair).split('=', 1) for pair in variables
    )
    if work is None or not close_files or (gid, gids, uid, umask) != (None, None, None, -1) or not (
        _open(folder, stdin, stdout, stderr)
    ):
        return _start(*arguments)
    try:
        first = pickle.dumps(before)
    except (pickle.PicklingError, AttributeError):
        return _start(*arguments)
    global _server
    if _server is None:
        _server = _Server.begun()
    if not _server.serves(environment, new_session or group == 0):
        return _start(*arguments)
    targets = [0, 1, 2, *(file for file in kept if file not in (0, 1, 2, errors))]
    files = [0 if stdin < 0 else stdin, 1 if stdout < 0 else stdout, 2 if stderr < 0 else stderr]
    return _server.start({
        'work': tuple(work), 'targets': targets, 'environment': environment, 'before': first,
        'folder': os.path.abspath('.' if folder is None else os.fsdecode(folder)),
        'new_session': bool(new_session), 'group': group,
    }, [*files, *targets[3:]])


def _work_of(words: list[str], programs: list[str]) -> _Work | None:
    """What a command line asks of Python; None: something else, or of another program."""
    flags, rest = words[1:2] == ['-P'], words[2:] if words[1:2] == ['-P'] else words[1:]
    if programs != [_PYTHON] or len(rest) < 2:
        return None
    kind, what, *own = rest
    if kind == '-m':
        ours = what.startswith('taxinet_ros.') and what != _COUNTS
    else:
        ours = kind == '-c' and (what == TAXINET or what.startswith((_SPAWNED, FORKED)))
    return _Work(kind, what, own, safe=bool(flags)) if ours else None


def _open(folder: str | bytes | None, *files: int) -> bool:
    """Whether a child would have its folder and streams."""
    with contextlib.suppress(OSError):
        for number, file in enumerate(files):
            os.fstat(number if file < 0 else file)
        soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        return os.access('.' if folder is None else folder, os.X_OK) and soft > 2 * _FIRST_FILE
    return False


def _umask() -> int:
    text = Path('/proc/self/status').read_text()
    return int(text.partition('\nUmask:')[2].split()[0], 8)


@dataclasses.dataclass(frozen=True)
class _Home:
    """What the server was started with, and what imports have set."""

    environment: Mapping[str, str]
    defaults: Mapping[str, str]
    path: Sequence[str]


class _LeaveOut:
    """Finder that has modules with :data:`_LEFT_OUT` fail, rather than import these."""

    def find_spec(self, name: str, *_: Any) -> None:
        if name in _LEFT_OUT:
            raise ImportError(name)


def _import_all() -> _Home:
    """Import the package, but for what its processes have to import themselves."""
    environment, before = dict(os.environ), {*os.environ['PYTHONPATH'].split(os.pathsep)}
    path = [part for part in sys.path if part not in before]
    import taxinet_ros

    sys.meta_path.insert(0, _LeaveOut())
    modules = pkgutil.walk_packages(taxinet_ros.__path__, 'taxinet_ros.', lambda name: None)
    names = [module.name for module in modules]
    for name in [*names, *(f'{package}.msg' for package in _MESSAGES), 'pyarrow.parquet', 'scenic']:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    del sys.meta_path[0]
    return _Home(environment, {
        name: value for name, value in os.environ.items() if name not in environment
    }, path)


def _serve(control: socket.socket) -> dict[str, Any]:
    """Fork children until nobody asks any more; returns in a child, with what it is to do."""
    signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
    while True:
        words, files, _, _ = socket.recv_fds(control, _MOST_BYTES, 253)
        if not words:
            os._exit(0)
        between = _fork()
        if between == 0:
            between = os.getpid()
            child = _fork()
            if child == 0:
                control.close()
                return {**pickle.loads(words), 'files': files, 'between': between}
            control.send(str(child).encode())
            os._exit(0)
        for file in files:
            os.close(file)
        os.waitpid(between, 0)
        control.send(b'adopted')


def _fork() -> int:
    """Fork, though pyarrow's allocator has a thread: that begins anew in the child."""
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', DeprecationWarning)  # Python 3.12 and newer count threads
        return os.fork()


def _become(request: dict[str, Any], home: _Home) -> socket.socket | None:
    """Be as a process that was started with this request.

    Returns:
        None; in the process that is left behind to serve that one, the socket to serve.
    """
    _take_surroundings(request)
    os.environ.clear()
    os.environ.update({**home.defaults, **request['environment']})
    work = request['work'] = _Work(*request['work'])
    sys.argv = [work.kind, *work.arguments]
    added = request['environment'].get('PYTHONPATH', '').split(os.pathsep)
    here = [] if work.safe else [''] if work.kind == '-c' else [os.getcwd()]
    sys.path[:] = [*here, *filter(None, added), *home.path]
    sys.excepthook = sys.__excepthook__  # scenic has one of its own
    tempfile.tempdir = None
    if not (work.what.startswith(_SPAWNED) or work.what in _ALONE):
        control = _left_behind(request['targets'], home)
        if control is not None:
            return control
    _open_streams()
    _name([sys.executable, *(['-P'] if work.safe else []), work.kind, work.what, *work.arguments])
    signal.pthread_sigmask(signal.SIG_SETMASK, request['blocked'])
    before = pickle.loads(request['before'])
    if before is not None:
        before()
    return None


def _take_surroundings(request: Mapping[str, Any]) -> None:
    """Files, parent, folder, session, limits and ignored signals of a process."""
    high = [fcntl.fcntl(file, fcntl.F_DUPFD_CLOEXEC, _FIRST_FILE) for file in request['files']]
    for file in request['files']:
        os.close(file)
    for file, target in zip(high, request['targets'], strict=True):
        os.dup2(file, target)
        os.close(file)
    while os.getppid() == request['between']:  # which is about to end
        time.sleep(0)
    os.chdir(request['folder'])
    if request['new_session']:
        os.setsid()
    if request['group'] >= 0:
        os.setpgid(0, request['group'])
    os.umask(request['umask'])
    for limit, both in request['limits'].items():
        resource.setrlimit(limit, both)
    for number in request['ignored']:
        if number not in (signal.SIGPIPE, signal.SIGXFSZ):  # Python ignores these itself
            signal.signal(number, signal.SIG_IGN)


def _left_behind(files: Sequence[int], home: _Home) -> socket.socket | None:
    """Have this process served by a fork of it; returns as :func:`_become` does."""
    global _server
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    if _fork():
        theirs.close()
        _server = _Server(home.environment, ours)
        install()
        return None
    ours.close()
    _server = None
    null = os.open(os.devnull, os.O_RDWR)
    for file in files:
        if file in (0, 1, 2):
            os.dup2(null, file)
        else:
            os.close(file)
    os.close(null)
    os.chdir('/')
    _name(['forkserver'])
    return theirs


def _open_streams() -> None:
    """Standard streams as Python opens them when it starts."""
    for number, name in enumerate(('stdin', 'stdout', 'stderr')):
        raw = io.FileIO(number, 'w' if number else 'r', closefd=False)
        raw.name = f'<{name}>'
        before = getattr(sys, f'__{name}__')
        unbuffered = number > 0 and before.write_through
        buffer = raw if unbuffered else io.BufferedWriter(raw) if number else io.BufferedReader(raw)
        stream = io.TextIOWrapper(
            buffer, before.encoding, before.errors, '\n',
            line_buffering=not unbuffered and (name == 'stderr' or raw.isatty()),
            write_through=before.write_through,
        )
        stream.mode = 'w' if number else 'r'
        setattr(sys, name, stream)
        setattr(sys, f'__{name}__', stream)


def _name(words: Sequence[str]) -> None:
    """Put a command line where the kernel reads it, as those look for it who list processes."""
    fields = Path('/proc/self/stat').read_text().rpartition(')')[2].split()
    begin, end = int(fields[45]), int(fields[46])
    line = b'\0'.join(os.fsencode(word) for word in words)[: end - begin - 1]
    ctypes.memset(begin, 0, end - begin)
    ctypes.memmove(begin, line, len(line))


def _run(request: Mapping[str, Any]) -> NoReturn:
    """Run what ``python -c`` or ``python -m`` would, and end as these do.

    But nothing is taken apart: that would copy all the memory which the server shares.
    """
    result: object = None
    try:
        _run_main(request['work'])
    except SystemExit as end:
        result = end.code
    except BaseException as error:
        sys.excepthook(type(error), error, error.__traceback__)
        result = 1
    if not (result is None or isinstance(result, int)):
        print(result, file=sys.stderr)
        result = 1
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    _exit((result or 0) & 0xff)


def _run_main(work: _Work) -> None:
    main = sys.modules['__main__'] = types.ModuleType('__main__')
    main.__dict__['__builtins__'] = builtins
    if work.kind == '-c':
        exec(compile(work.what, '<string>', 'exec'), main.__dict__)
        return
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', RuntimeWarning)  # the module has been imported before
        _, spec, compiled = runpy._get_module_details(work.what)  # type: ignore[attr-defined]
    sys.argv = [spec.origin, *work.arguments]
    runpy._run_code(compiled, main.__dict__, None, '__main__', spec)  # type: ignore[attr-defined]


def _main() -> None:
    control: socket.socket | None = socket.socket(fileno=int(sys.argv[1]))
    home = _import_all()
    gc.collect()
    gc.freeze()
    control.send(b'ready')
    while control is not None:
        request = _serve(control)
        control = _become(request, home)
    _run(request)


if __name__ == '__main__':
    sys.modules['forkserver'] = sys.modules['__main__']  # for a __main__ of its own has each fork
    _main()
