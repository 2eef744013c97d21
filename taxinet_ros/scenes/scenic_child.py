"""Child process in which Scenic compiles programs and draws scenes.

``python -m taxinet_ros.scenes.scenic_child`` is a server, which imports Scenic and forks a
child for each program (:mod:`.scenic_server`). A Scenic program is code. It may loop forever, call
exit() or exhaust the memory, and Scenic keeps global state; so it runs in a separate process with
limits, which may die without harm to the test bench. The limits protect against accidents, not
against malice.

Requests and answers are JSON lines over two pipes other than stdin and stdout, so a program may
print anything (it appears on stderr). The first line has the child's pid. Then each request gets
one answer:

==========================================  ============================================
``{"op": "compile", "program": ...}``        ``{"loaded": [...], "named": [...], "sampler": …,
                                             "params": …, "overrides": …, "objects": …}``: the
                                             files that were read, names of documents, and what
                                             the program says (:mod:`.parameters`)
``{"op": "space"}``                          ``{"choices": [...], "unsearched": [...], …}``
``{"op": "scene", "index": i}``              ``{"values": {...}, "refused": n}``, drawn after
                                             ``n`` others, or ``{"rejected": n}``
``{"op": "scene", "index": i, "point": u,    the same with choice k at quantile ``u[k]``, in
"attempt": a}``                              one try
==========================================  ============================================

or ``{"error": {"file", "line", "message"}}``. The values are plain numbers, words and switches in
human units, by the names that the program gives them.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import importlib
import importlib.util
import json
import os
import random
import signal
import socket
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import FrameType, ModuleType
from typing import IO, Any, NoReturn

import numpy as np

from taxinet_ros.processes.child import die_with_parent, limit_memory
from taxinet_ros.scenes.programs import MODEL, SUFFIX, is_document_file, shipped_folder
from taxinet_ros.scenes.values import ProgramError, scene_values

MAX_ITERATIONS = 2000
"""Draws that may break a program's requirements before a scene counts as rejected."""

_COMPARED, _COMPARED_DRAWS = 3, 100
"""Scenes that a program has to draw again when it is compiled again, and draws for each."""

_MOST_BYTES = 65536
MAX_CHARACTERS = 1000
"""Maximum length of an error message; a program may raise one with any text."""


_WITHOUT_MODEL = f'; write "model {MODEL}" as first line'
_HINTS = {
    'Plane': _WITHOUT_MODEL, 'CLOUDS': _WITHOUT_MODEL, 'RAIN_CLOUDS': _WITHOUT_MODEL,
    'DotMap': '; a dict does as well: {"alpha": 0.9}',
}
"""Fixes of an undefined name."""


class _WhenUsed(ModuleType):
    """A module that is imported when something of it is used, and not when that is imported."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith('__'):  # of the import system, which asks whether it is a package
            raise AttributeError(name)
        if sys.modules.get(self.__name__) is self:
            return lambda *words, **named: self._found(name)(*words, **named)
        return self._found(name)

    def _found(self, name: str) -> Any:
        if sys.modules.get(self.__name__) is self:
            del sys.modules[self.__name__]
        return getattr(importlib.import_module(self.__name__), name)


@contextlib.contextmanager
def _some_when_used() -> Iterator[None]:
    """Import later what takes a third of Scenic's time, and few programs use by way of trimesh."""
    names = 'networkx', 'scipy.optimize', 'scipy.ndimage', 'numpy.f2py'
    stand_ins = {name: _WhenUsed(name) for name in names if name not in sys.modules}
    sys.modules.update(stand_ins)
    if 'numpy.f2py' in stand_ins:  # scipy takes all there is of numpy
        vars(np)['f2py'] = stand_ins['numpy.f2py']
    yield
    for name, stand_in in stand_ins.items():
        if sys.modules.get(name) is stand_in:
            del sys.modules[name]


class OutOfTime(BaseException):
    """A request exceeded its time; not an Exception, so that programs cannot swallow it."""


class Programs:
    """The compiled program of this process; draws its scenes.

    Attributes:
        seed: seed of the scenes.
    """

    def __init__(self, seed: int, shipped: str) -> None:
        """``shipped``: folder in which programs from elsewhere find the world model."""
        gc.disable()  # What is imported stays; to look for garbage in it takes a tenth of the time.
        with _some_when_used():
            import scenic

        from taxinet_ros.scenes import chance, choices, constructs, verifai_choices

        gc.freeze()
        gc.enable()
        verifai_choices.install()
        choices.keep_order()
        self._words = verifai_choices
        self._constructs = constructs.watch_constructs()
        sys.path.append(shipped)  # after the program's own folder, which Scenic prepends
        self._compile = scenic.scenarioFromFile
        self._chance = chance
        self._find_choices = choices.Choices
        self.seed = seed
        self._scenario: Any = None
        self._sampler: dict[str, Any] = {}
        self._choices: Any = None
        self._loaded: set[str] = set()
        self._loading = False
        sys.addaudithook(self._note_loaded)

    def compile(self, program: str) -> dict[str, Any]:
        """Compile ``program`` and read it; refuse constructs without effect."""
        self._choices = self._scenario = None
        self._loaded.clear()
        scenario = self._chance.compile_twice(
            Path(program), lambda: self._begin(program),
            lambda attempt: self._reseed(0, attempt),  # a program may draw while it is compiled
            self._first_scenes, self._constructs.place_of,
        )
        loaded = sorted(self._loaded)
        read = self._constructs.read(scenario, [program, *loaded])
        if scenario.externalSampler is not None:
            raise ProgramError(
                'external parameters of its own making cannot be searched; mark choices with '
                'VerifaiRange or VerifaiOptions instead'
            )
        self._scenario = scenario
        named = {word for one in read['params'].values() for word in one['words']
                 if is_document_file(word)}
        return {**read, 'loaded': loaded, 'named': sorted(named), 'sampler': self._sampler}

    def _note_loaded(self, event: str, args: tuple[Any, ...]) -> None:
        """Remember the files that are read while a program is compiled, as an audit hook."""
        if not self._loading or event != 'open' or isinstance(args[0], int):
            return
        if args[2] & os.O_ACCMODE != os.O_WRONLY:
            path = os.path.abspath(os.fsdecode(args[0]))
            with contextlib.suppress(ValueError):  # no bytecode, which stands for its source
                path = importlib.util.source_from_cache(path)
            self._loaded.add(path)

    def _begin(self, program: str) -> Any:
        self._constructs.begin()
        self._words.begin()
        self._loading = True
        try:
            scenario = self._compile(program)
        finally:
            self._loading = False
        self._sampler = self._words.sampler_request(scenario.params, self._constructs.params)
        return scenario

    def _first_scenes(self, scenario: Any) -> list[Any]:
        """The first scenes, or what is wrong with them, to be compared."""
        # Drawing changes what requirements are bound to, hence the order of choices.
        self._choices = None
        with contextlib.suppress(Exception):  # of the program; it is reported when they are asked
            self._choices = self._find_choices(scenario)
        found: list[Any] = []
        for index in range(_COMPARED):
            self._reseed(index)
            try:
                found.append(_generated(scenario, _COMPARED_DRAWS))
            except Exception as error:  # of the program; it is reported when the scene is drawn
                found.append(type(error).__name__)
        return found

    def space(self) -> dict[str, Any]:
        """The random choices of the program that can be set to a quantile."""
        return self._found().describe()

    def scene(
        self, index: int, point: Sequence[float | None] | None = None, attempt: int = 0
    ) -> dict[str, Any]:
        """Draw scene ``index``: a function of the program, the seed and the arguments.

        Without a point, it is redrawn until it meets the requirements. At a point there is one try:
        another would be a scene that the sampler did not request, and accepting every point would
        change the prior. The sampler may try another point for the same scene, with the next
        ``attempt``: choices without a quantile are then redrawn.

        Scenic decides once per scene which soft requirements (``require[p]``) are enforced, and
        draws until they are met. So they are decided by the index, and are the same in every
        attempt: redeciding would enforce hard-to-meet ones in too few scenes.
        """
        self._reseed(index)
        if point is None:
            return _generated(self._scenario, MAX_ITERATIONS)
        requirements = self._scenario.userRequirements
        active = [random.random() <= requirement.prob for requirement in requirements]
        self._reseed(index, attempt)
        with self._found().placed(point), _decided(requirements, active):
            return _generated(self._scenario, 1)

    def _found(self) -> Any:
        if self._choices is None:
            self._choices = self._find_choices(self._scenario)
        return self._choices

    def _reseed(self, index: int, attempt: int = 0) -> None:
        # Scenic draws from Python's and NumPy's generators. Reseeding both for every scene makes it
        # independent of earlier scenes, hence of the number of workers.
        key = [self.seed, index, attempt] if attempt else [self.seed, index]
        words = np.random.SeedSequence(key).generate_state(8)
        random.seed(int.from_bytes(words[:4].tobytes(), 'little'))
        np.random.seed(words[4:])  # noqa: NPY002 (the one Scenic uses)


def _generated(scenario: Any, iterations: int) -> dict[str, Any]:
    from scenic.core.distributions import RejectionException

    try:
        scene, drawn = scenario.generate(maxIterations=iterations)
    except RejectionException:
        return {'rejected': iterations}
    return {'values': scene_values(scene), 'refused': drawn - 1}


@contextlib.contextmanager
def _decided(requirements: Sequence[Any], active: Sequence[bool]) -> Iterator[None]:
    """Context in which Scenic enforces the soft requirements given by ``active``."""
    before = [requirement.prob for requirement in requirements]
    for requirement, wanted in zip(requirements, active, strict=True):
        requirement.prob = 1.0 if wanted else -1.0
    try:
        yield
    finally:
        for requirement, probability in zip(requirements, before, strict=True):
            requirement.prob = probability


def describe(error: BaseException, program: str, allowed_s: float) -> dict[str, Any]:
    """Describe an error in one line, with its file and line (0 if unknown)."""
    file, line = _place(error, Path(program))
    return {'file': file, 'line': line, 'message': _message(error, allowed_s)}


def _message(error: BaseException, allowed_s: float) -> str:
    text = ' '.join(str(error)[:MAX_CHARACTERS].split())
    if isinstance(error, OutOfTime):
        return f'still running after {allowed_s:g} s; does a loop never end?'
    if isinstance(error, SystemExit):
        return 'the program calls exit(); it has to run to its end'
    if isinstance(error, MemoryError):
        return 'the program needs more memory than it may have'
    if isinstance(error, ProgramError) or type(error).__module__.startswith('scenic.'):
        return text
    if text.startswith('multiple choices for scenario to run'):
        return 'there are several scenarios; call the one to be run Main'
    if isinstance(error, NameError) and error.name in _HINTS:
        text += _HINTS[error.name]
    return f'{type(error).__name__}: {text}'


def _place(error: BaseException, program: Path) -> tuple[str, int]:
    location = getattr(error, '_scenic_location', None)
    if location is not None:
        return location.filename, location.lineno
    file, line = getattr(error, 'filename', None), getattr(error, 'lineno', None)
    if isinstance(line, int):  # of a syntax error
        return str(file or program), line
    place = (str(program), 0)
    step = error.__traceback__
    while step is not None:
        name = step.tb_frame.f_code.co_filename
        if _is_users(Path(name), program):
            place = (name, step.tb_lineno)
        step = step.tb_next
    return place


def _is_users(file: Path, program: Path) -> bool:
    if file.stem == MODEL:  # errors there are caused by a program
        return False
    return file.suffix == SUFFIX or file.parent == program.resolve().parent


def _alarm(_signal: int, _frame: FrameType | None) -> NoReturn:
    raise OutOfTime


def _answer(response_fd: int, answer: Mapping[str, Any]) -> None:
    data = json.dumps(answer).encode() + b'\n'
    while data:
        data = data[os.write(response_fd, data):]


def _serve(programs: Programs, requests: IO[str], response_fd: int, timeout_s: float) -> None:
    operations: dict[str, Callable[..., dict[str, Any]]] = {
        'compile': programs.compile, 'space': programs.space, 'scene': programs.scene,
    }
    program = ''
    for line in requests:
        request = json.loads(line)
        program = request.get('program', program)
        operation = operations[request.pop('op')]
        try:
            signal.setitimer(signal.ITIMER_REAL, timeout_s)
            answer = operation(**request)
            signal.setitimer(signal.ITIMER_REAL, 0)
        except BaseException as error:  # whatever user code raises, exit() included
            signal.setitimer(signal.ITIMER_REAL, 0)
            answer = {'error': describe(error, program, timeout_s)}
        _answer(response_fd, answer)


def _run_child(
    programs: Programs | str, descriptors: Sequence[int], *, seed: int, memory_bytes: int,
    timeout_s: float, folder: str,
) -> None:
    """Serve the requests of one program in a forked process, until the parent hangs up or dies.

    Args:
        programs: what compiles it, or why Scenic cannot be imported.
        descriptors: to read requests from, to write answers to, and for what the program prints.
        seed: seed of the scenes.
        memory_bytes: limit of the address space.
        timeout_s: limit of each request [s].
        folder: working directory; '' if there is none.
    """
    request_fd, response_fd, errors = descriptors
    die_with_parent(signal.SIGKILL)  # the server, which ends with the parent
    os.setsid()  # a group that can be killed with all that the program has started
    os.dup2(errors, 1)
    os.dup2(errors, 2)
    os.close(errors)
    with contextlib.suppress(OSError):
        os.chdir(folder)
    if isinstance(programs, str):
        _answer(response_fd, {'error': {'file': '', 'line': 0, 'message': programs}})
        return
    signal.signal(signal.SIGALRM, _alarm)
    limit_memory(memory_bytes)
    programs.seed = seed
    _answer(response_fd, {'pid': os.getpid()})
    with open(request_fd) as requests:
        _serve(programs, requests, response_fd, timeout_s)


def main() -> None:
    """Fork a child for each request until the parent closes its end or dies."""
    parser = argparse.ArgumentParser()
    parser.add_argument('--control-fd', type=int, required=True)
    control = socket.socket(fileno=parser.parse_args().control_fd)
    control.set_inheritable(False)
    programs: Programs | str
    try:
        programs = Programs(0, str(shipped_folder()))
    except ImportError as error:
        programs = f'Scenic cannot be imported ({error}); install scenic==3.1.1'
    while True:
        data, descriptors, *_ = socket.recv_fds(control, _MOST_BYTES, 3)
        if not data:
            return
        request = json.loads(data)
        if 'wait' in request:
            control.send(json.dumps({'status': _status(request['wait'])}).encode())
        elif not os.fork():
            control.close()
            try:
                _run_child(programs, descriptors, **request)
            finally:
                os._exit(0)
        for descriptor in descriptors:
            os.close(descriptor)


def _status(pid: int) -> int | None:
    """Exit code of a child, negative for a signal; None while it runs."""
    found, status = os.waitpid(pid, os.WNOHANG)
    return os.waitstatus_to_exitcode(status) if found else None


if __name__ == '__main__':
    main()
