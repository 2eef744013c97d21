"""Draw scenes of a Scenic program in a child process that may safely hang or die."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import select
import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, Self

from taxinet_ros.core.control_step import last_step
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import (
    BY_KEY,
    CAMERA,
    CAMERA_OFFSETS,
    CATALOGUES,
    CONTROL_RATE,
    DURATION,
    by_key,
)
from taxinet_ros.errors import InfraError, InfraKind, UsageError
from taxinet_ros.processes.child import exit_words, signal_name
from taxinet_ros.samplers.space import Point, Space
from taxinet_ros.scenes.overrides import (
    WEATHER,
    Contradiction,
    apply_overrides,
    check_offsets,
    check_overrides,
    without_idle,
)
from taxinet_ros.scenes.paper_names import key_of, our_values
from taxinet_ros.scenes.parameters import (
    Parameter,
    checked_overrides,
    checked_parameters,
    rain_notes,
)
from taxinet_ros.scenes.program_sampler import ProgramSampler, program_sampler
from taxinet_ros.scenes.programs import (
    MODEL,
    SUFFIX,
    beside,
    files_of_program,
    find_program,
    is_document_file,
    shipped_folder,
    shown_path,
    shown_place,
    stored_text,
)
from taxinet_ros.scenes.scenic_child import MAX_ITERATIONS
from taxinet_ros.scenes.scenic_server import ScenicChild, fork_child
from taxinet_ros.scenes.search_space import SearchSpace
from taxinet_ros.scenes.values import Place

MEMORY_BYTES = 4 << 30
"""Address space limit of the child; Scenic itself uses about a tenth of it."""

START_TIMEOUT_S = 120.0
"""Time limit for importing Scenic: 1.5 s on an idle machine, far more on a loaded one."""

GRACE_S = 3.0
"""Time after the limit in which the child may report the hanging line before it is killed."""

_PROBED_SCENES = 64
"""Scenes checked for a valid one, or for rain under an overridden sky, which S_falsif hides with
(2/3)**64."""

_FIRST_SCENES = 8
"""Scenes checked for the run's duration; each rejected one may take seconds."""

_FROM_OUTSIDE = (
    signal.SIGHUP, signal.SIGINT, signal.SIGKILL, signal.SIGQUIT, signal.SIGTERM,
)
"""Signals sent by users or the out-of-memory killer; our own limits do not use them."""

_NO_OVERRIDES: Mapping[str, str] = MappingProxyType({})


class Rejected(Exception):  # noqa: N818 (an outcome, not an error)
    """No valid scene was drawn; the run's outcome is ``REJECTED``.

    No draw met the program's requirements, or the program drew an impossible scenario: a start
    beside the runway, rain from a clear sky. It is the program's result, so it is not redrawn.

    Attributes:
        refused: number of draws or points that the requirements rejected.
    """

    def __init__(self, why: str, refused: int = 0) -> None:
        super().__init__(why)
        self.refused = refused


class Refused(Rejected):
    """A point violates the program's requirements; another may be tried for the same scene."""


class SceneSource:
    """The scenes of one program and seed; a context manager that owns the child process.

    Scene ``i`` depends only on the program's text, the seed, ``i`` and the point, if any: any
    number of workers, in any order, after any interruption, draw the same scenes. Not thread-safe.

    Attributes:
        refused: draws rejected by the requirements before the last scene without a point.
        sampler: sampler requested by ``verifaiSamplerType``; None if there is none.
        notes: notes on likely mistakes in the program.
        feedback: robustness that a sampler is to learn for a refused point, or None.
        text: the program with all that it runs; see :func:`program_text`.
    """

    def __init__(
        self, program: str | Path, *, seed: int, overrides: Mapping[str, str] = _NO_OVERRIDES,
        laid_over: Mapping[str, str] = _NO_OVERRIDES, timeout_s: float = 60.0,
        meanwhile: Callable[[], None] = lambda: None,
    ) -> None:
        """Check the arguments; ``with`` starts the child and compiles the program.

        Args:
            program: name of a shipped program, or path of a ``.scenic`` file.
            seed: seed of the campaign, 0..2^63-1.
            overrides: human keys, or their short forms, and values that replace drawn ones, also
                those of the program's own ``param overrides``; choices that they make ineffective
                are not dimensions.
            laid_over: like overrides, but without effect on the dimensions: a point gives the same
                scene as without them, with these values changed.
            timeout_s: wall-clock limit for compiling, and for each scene [s].
            meanwhile: called while the child imports Scenic, which takes seconds.

        Raises:
            UsageError: unknown program, bad seed or bad override.
        """
        if not 0 <= seed < 1 << 63:
            raise UsageError(f'seed is {seed}; it has to be within 0..2^63-1')
        overrides, laid_over = by_key(overrides), by_key(laid_over)
        check_overrides({**overrides, **laid_over})
        self.program = find_program(program)
        self._seed = seed
        self._overrides = overrides
        self._values = {**overrides, **laid_over}
        self._timeout_s = timeout_s
        self._meanwhile = meanwhile
        self._child: ScenicChild | None = None
        self._fds: tuple[int, int] = (-1, -1)
        self._unread = b''
        self._space: SearchSpace | None = None
        self.refused = 0
        self.sampler: ProgramSampler | None = None
        self.notes: tuple[str, ...] = ()
        self.feedback: float | None = None
        self.text = ''
        self._documents: frozenset[Path] = frozenset()
        self._params: dict[str, Parameter] = {}
        self._valid: bool | None = None

    def __enter__(self) -> Self:
        """Start the child, compile, and check for overrides that contradict the program.

        Raises:
            UsageError: ``file:line: message`` on an error in the program.
            InfraError: another process killed the child; any later request may raise it too.
        """
        self._child, *fds = fork_child(
            seed=self._seed, memory_bytes=MEMORY_BYTES, timeout_s=self._timeout_s,
        )
        self._fds = (fds[0], fds[1])
        try:
            self._send({'op': 'compile', 'program': str(self.program)})
            self._meanwhile()
            self._child.pid = self._receive(START_TIMEOUT_S)['pid']
            self._read(**self._receive(self._timeout_s + GRACE_S))
            self._probe()
        except BaseException:
            self._stop()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop the child."""
        self._stop()

    def _read(
        self, *, params: Mapping[str, Mapping[str, Any]],
        overrides: Sequence[tuple[Place, Mapping[str, str]]],
        objects: Sequence[tuple[Place, str]], random_objects: int, sampler: Mapping[str, Any],
        loaded: Sequence[str], named: Sequence[str],
    ) -> None:
        """Check what a compiled program says, and read its files."""
        self._params = checked_parameters(self.program, params, objects, random_objects)
        own = {key: BY_KEY[key].settled(text)
               for key, text in checked_overrides(self.program, overrides).items()}
        self._overrides = {**own, **self._overrides}
        self._values = {**own, **self._values}
        check_overrides(self._values)
        places = {name: shown_place(*place) for name, place in sampler['places'].items()}
        self.sampler = program_sampler(sampler['kind'], sampler['params'], places)
        self.feedback = sampler['feedback']
        self.notes = rain_notes(self._params)
        files = files_of_program(self.program, loaded, named)
        self.text = stored_text(files)
        self._documents = frozenset(path.resolve() for path in files.values())

    @property
    def fixed_length(self) -> Mapping[str, str]:
        """The overrides of duration and control rate, if given."""
        keys = (DURATION.key, CONTROL_RATE.key)
        return {key: value for key, value in self._values.items() if key in keys}

    @property
    def drawn_notes(self) -> tuple[str, ...]:
        """The notes for draws without a sampler, including that a requested one is unused."""
        if self.sampler is None or self.sampler.word == 'random':
            return self.notes
        said, place = self.sampler.said, self.sampler.place
        return (*self.notes, f'scenes are drawn as the program has them, without a sampler: {said} '
                             f'of {place} is for taxinet falsify')

    def search_space(self) -> SearchSpace:
        """The program's random choices, and which of them a point controls.

        Raises:
            UsageError: the program failed, hung or died.
        """
        if self._space is None:
            answer = self._ask({'op': 'space'})
            for choice in answer['choices']:
                choice['feeds'] = [key_of(name, self._params) for name in choice['feeds']]
            answer['drawn'] = [key_of(name, self._params) for name in answer['drawn']]
            self._space = SearchSpace.from_json(answer, self._overrides)
        return self._space

    def space(self) -> Space:
        """The dimensions of a point.

        Raises:
            UsageError: as :meth:`search_space`, or there is nothing to search.
        """
        return self.search_space().dimensions

    def scene(self, index: int, point: Point | None = None, attempt: int = 0) -> Scenario:
        """Scene ``index`` (from 0) with the overrides applied.

        Args:
            index: determines, with the seed, everything that the point does not.
            point: a quantile in [0, 1) of its own prior for each dimension of :meth:`space` that
                is not idle there, None for the others.
            attempt: number of points rejected for this scene before; values that the point does not
                determine are redrawn for each.

        Raises:
            Refused: this point does not meet the requirements.
            Rejected: no draw met them, or the drawn values are no valid scenario.
            UsageError: the program failed, hung or died, or no scene can be a valid scenario.
            ValueError: the point does not belong to this space.
        """
        return self._scenario(
            self._drawn(index, point, attempt), f'{self.program.name}: scene {index}'
        )

    def _scenario(self, values: Mapping[str, Any], where: str) -> Scenario:
        try:
            return apply_overrides(values, self._values, where)
        except UsageError as error:
            kept = without_idle(values, self._values, self.search_space().drawn)
            if len(kept) < len(values):
                return self._scenario(kept, where)
            refused, valid = self.refused, self._draws_valid_scenes()
            self.refused = refused
            if valid:
                raise Rejected(str(error), refused) from error
            raise

    def _drawn(self, index: int, point: Point | None, attempt: int) -> dict[str, Any]:
        """Human values of a scene as drawn by the program."""
        request: dict[str, Any] = {'op': 'scene', 'index': index}
        if point is not None:
            request |= {'point': self.search_space().spread(point), 'attempt': attempt}
        answer = self._ask(request)
        where = f'{self.program.name}: scene {index}'
        if 'values' in answer:
            self.refused = answer['refused']
            try:
                values = our_values(self._with_own_files(answer['values']), self._values)
            except UsageError as error:
                raise UsageError(f'{where}: {error}') from error
            check_offsets({**values, **self._values}, where)  # no draw would fix it
            return values
        if point is not None:
            raise Refused(f'{where}: the point does not meet the requirements', 1)
        tries = answer['rejected']
        raise Rejected(f'{where}: no draw met the requirements in {tries} tries', tries)

    def _with_own_files(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """A scene's values, with documents named as they are found beside the program."""
        found = dict(values)
        for key in (found.keys() & CATALOGUES.keys()) - self._values.keys():
            if is_document_file(name := str(found[key])):
                path = beside(self.program, name)
                if path.is_file() and path.resolve() not in self._documents:
                    raise UsageError(
                        f'{key} {name}: this name is put together by chance, so nothing would tell '
                        "if the file changed; write whole names: Uniform('a.yaml', 'b.yaml')"
                    )
                found[key] = str(path)
        return found

    def _draws_valid_scenes(self) -> bool:
        """Whether any of the first scenes is a valid scenario; else the program is in error."""
        if self._valid is None:
            drawn = self.search_space().drawn
            self._valid = bool(drawn) and any(error is None for error in self._first_errors())
        return self._valid

    def _probe(self) -> None:
        # Otherwise scenes would be rejected for an override that the user can correct.
        moved = any(field.key in self._values for field in CAMERA_OFFSETS)
        cameras = moved and CAMERA.key not in self._values  # the program's, drawn by chance
        if sum(key in self._values for key in WEATHER) == 1 or cameras:
            for error in self._first_errors():
                if isinstance(error, Contradiction):
                    raise error

    def _first_errors(self) -> Iterator[UsageError | None]:
        """What is wrong with the first scenes, None for valid ones; rejected ones are left out."""
        for index in range(_PROBED_SCENES):
            try:
                values = self._drawn(index, None, 0)
                kept = without_idle(values, self._values, self.search_space().drawn)
                apply_overrides(kept, self._values, f'{self.program.name}: scene {index}')
            except Rejected:
                continue
            except UsageError as error:
                if self._child is None:
                    raise
                yield error
            else:
                yield None

    def _stop(self) -> None:
        for fd in self._fds:
            if fd >= 0:
                os.close(fd)
        self._fds = (-1, -1)
        if self._child is not None:
            self._child.kill()  # with its descendants, even if it is dead itself
            self._child.wait()
        self._child = None

    def _ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        if self._child is None:
            raise RuntimeError('SceneSource: not running; use it in a with statement')
        self._send(request)
        try:
            return self._receive(self._timeout_s + GRACE_S)
        except (UsageError, InfraError):
            raise
        except BaseException:
            self._stop()  # interrupted: a late answer must not be taken for the next one
            raise

    def _send(self, request: Mapping[str, Any]) -> None:
        with contextlib.suppress(BrokenPipeError):  # then _receive reports how it died
            os.write(self._fds[1], json.dumps(request).encode() + b'\n')

    def _receive(self, allowed_s: float) -> dict[str, Any]:
        deadline = time.monotonic() + allowed_s
        while b'\n' not in self._unread:
            left_s = deadline - time.monotonic()
            if left_s <= 0 or not select.select([self._fds[0]], [], [], left_s)[0]:
                self._stop()
                raise UsageError(f'{shown_path(self.program)}: Scenic hung for {allowed_s:g} s')
            part = os.read(self._fds[0], 65536)
            if not part:
                raise self._lost()
            self._unread += part
        line, _, self._unread = self._unread.partition(b'\n')
        try:
            answer: dict[str, Any] = json.loads(line)
        except ValueError:
            self._stop()
            text = f'{shown_path(self.program)}: the program has written into a pipe of Scenic'
            raise UsageError(text) from None
        if 'error' in answer:
            error = answer['error']
            place = shown_place(error['file'] or str(self.program), error['line'])
            raise UsageError(f"{place}: {error['message']}")
        return answer

    def _lost(self) -> UsageError | InfraError:
        """The exception for a child that has exited."""
        assert self._child is not None
        status = self._child.wait(GRACE_S) or 0  # its pipe closes shortly before it exits
        self._stop()
        program = shown_path(self.program)
        if -status in _FROM_OUTSIDE:
            how = exit_words(status)
            return InfraError(InfraKind.DIED, f'the Scenic process of {program}', -1, how)
        if status < 0:
            how = f'was ended by {signal_name(-status)}'
        else:
            how = f'ended with status {status}; a program must not end it'
        return UsageError(f'{program}: the Scenic process {how}')


def program_text(program: str | Path) -> str:
    """A program with all that it runs, as one text: part of a campaign's record.

    These are its own file, the modules and files below its folder that were read while it was
    compiled, however they were imported or opened, the world model, and the documents (places,
    aircraft, cameras, others on the ground) that its parameters name. What only a drawn scene reads
    is not included, nor are installed packages. Each file is headed by its name within the folder,
    so that a checkout and an installed copy give the same text.

    Raises:
        UsageError: it does not compile, or a file cannot be read.
    """
    path = find_program(program)
    if path.resolve().parent == shipped_folder().resolve():  # these run the world model alone
        return stored_text({file.name: file for file in (path, path.parent / f'{MODEL}{SUFFIX}')})
    with SceneSource(path, seed=0) as source:
        return source.text


def program_digest(program: str | Path) -> str:
    """SHA-256 of :func:`program_text`, in hexadecimal: equal digests draw equal scenes."""
    return hashlib.sha256(program_text(program).encode()).hexdigest()


def accepted_scene(
    source: SceneSource, index: int, point: Point, again: Callable[[], Point]
) -> tuple[Scenario, int]:
    """The scene at the first sampler point that meets the program's requirements.

    Args:
        source: source of the scenes.
        index: number of the scene.
        point: first point to try.
        again: returns another point for the same scene.

    Returns:
        The scene, and the number of points rejected before it.

    Raises:
        Rejected: as :meth:`SceneSource.scene`, or too many points were rejected.
        UsageError: as :meth:`SceneSource.scene`.
    """
    for attempt in range(MAX_ITERATIONS):
        try:
            return source.scene(index, point, attempt), attempt
        except Refused:
            point = again()
        except Rejected as error:
            raise Rejected(str(error), attempt) from error
    raise Rejected(
        f'{source.program.name}: scene {index}: no point met the requirements in '
        f'{MAX_ITERATIONS} tries', MAX_ITERATIONS,
    )


def first_scene(source: SceneSource) -> Scenario:
    """A program's first accepted scene, or the default scenario if none is.

    Raises:
        UsageError: as :meth:`SceneSource.scene`, or its duration is no multiple of the control
            period.
    """
    first: Scenario | None = None
    for index in range(_FIRST_SCENES):
        with contextlib.suppress(Rejected):
            first = source.scene(index)
            break
        if DURATION.key in source.fixed_length:
            break
    if first is None:
        first = apply_overrides({}, source.fixed_length, source.program.name)
    last_step(first)
    return first


def some_scenes(source: SceneSource, runs: int) -> Iterator[Scenario]:
    """Draw a few of the program's own scenes, without rejected ones.

    Raises:
        UsageError: as :meth:`SceneSource.scene`.
    """
    for index in range(min(runs, _FIRST_SCENES)):
        with contextlib.suppress(Rejected):
            yield source.scene(index)


def sample_scenarios(
    program: str | Path, seed: int, n: int, overrides: Mapping[str, str] = _NO_OVERRIDES
) -> list[Scenario]:
    """The first ``n`` scenes of a program, for inspection before a campaign.

    Raises:
        Rejected, UsageError: as :meth:`SceneSource.scene`.
    """
    with SceneSource(program, seed=seed, overrides=overrides) as source:
        return [source.scene(index) for index in range(n)]
