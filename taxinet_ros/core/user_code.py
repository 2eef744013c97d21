"""User-supplied perceptions and controllers: a function in a Python file, or an external node.

``FILE.py:NAME``: a function (frame or estimate in, answer out), or a class or function without
arguments that creates such a callable. It is created anew for every run, unless it has a method
``reset()``, which is then called instead, so that no run depends on earlier ones. The file is code
and runs with the user's rights, like a Scenic program. It is not executed until a node needs it.

``external``: a node started by the user, in any language. ``cmd:COMMAND``: a node that the graph
starts, supervises and ends, e.g. ``cmd:ros2 run my_pkg my_node``.
"""

from __future__ import annotations

import ast
import contextlib
import hashlib
import inspect
import os
import re
import shlex
import sys
import types
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, TypeGuard, TypeVar

from taxinet_ros.arguments import can_be_called, has_parameter
from taxinet_ros.core.sensors import Measured
from taxinet_ros.errors import UsageError, plain_line
from taxinet_ros.files.reading import MAX_TEXT_BYTES, read_file
from taxinet_ros.registry import Extension

EXTERNAL: Final = 'external'
COMMAND: Final = 'cmd:'
NO_NODE_HERE: Final = (
    'is a node of a graph, but this command runs without one; name something callable here: a '
    'word, a file, or FILE.py:NAME'
)


def is_node_elsewhere(word: str) -> bool:
    """Whether a word means an external node or a user command."""
    return word == EXTERNAL or word.startswith(COMMAND)


def command_of(word: str) -> list[str] | None:
    """Program and arguments of a ``cmd:`` word, split as by a shell; None for other words.

    Raises:
        UsageError: it has no program, or an unterminated quote.
    """
    if not word.startswith(COMMAND):
        return None
    try:
        words = shlex.split(word.removeprefix(COMMAND))
    except ValueError as error:
        raise UsageError(f'{word}: {error}') from error
    if not words:
        raise UsageError(
            f"{word!r}: names no program; expected e.g. {COMMAND}'ros2 run my_pkg my_node'"
        )
    return words


def node_command(word: str, name: str, remaps: Sequence[str] = ()) -> list[str] | None:
    """As :func:`command_of`, with the arguments that set the node's name in the graph.

    Args:
        word: as for :func:`command_of`.
        name: name of the node.
        remaps: further remap rules, ``FROM:=TO``.

    Raises:
        UsageError: as :func:`command_of`.
    """
    words = command_of(word)
    if words is None:
        return None
    rules = [part for rule in (f'__node:={name}', *remaps) for part in ('-r', rule)]
    return [*words, '--ros-args', *rules]


def short_word(word: str) -> str:
    """Short form of a word for folder names: the stem of a file, or ``cmd``."""
    if word.startswith(COMMAND):
        return COMMAND.removesuffix(':')
    return Path(word.partition('.py:')[0]).stem if '.py:' in word else Path(word).stem


IMPLEMENTATION = 'python'
"""Implementation name reported by a node that runs such code; its hash identifies the code."""
_WORD = re.compile(r'(?P<file>.+\.py):(?P<name>[^\W\d]\w*)', re.DOTALL)
_ALONE = re.compile(r'.+\.py:?', re.DOTALL)
_FILES = 'FILES'
_SAID_CHARACTERS = 300
_NAMED = ('rig', 'sensors')
"""Further arguments that a function gets if it has parameters of these names."""
_Answer = TypeVar('_Answer')


class UserCodeError(RuntimeError):
    """User code failed during a run; the message gives the line in the file."""


@dataclass(frozen=True)
class UserCode:
    """A callable in an existing file.

    Attributes:
        path: the file as given.
        name: name of the function or class.
        sha256: hash of the file and the files it lists as ``FILES = [...]``, such as weights,
            relative to its folder.
    """

    path: Path
    name: str
    sha256: str

    @property
    def word(self) -> str:
        """Implementation name reported by its node."""
        return IMPLEMENTATION

    @property
    def where(self) -> str:
        """Prefix of error messages."""
        return str(self.path)

    def make(self) -> Callable[..., Any]:
        """The callable, created anew if the file has a factory.

        Raises:
            UsageError: the file's code fails, or its result is not callable.
        """
        found = self._found
        with _same_place(), self.running(UsageError):
            made = found() if _is_maker(found) else found
        if not callable(made):
            raise UsageError(
                f'{self.where}: {self.name}() returned {type(made).__name__}, which cannot be '
                'called; expected a function of one argument'
            )
        self._check_call(made)
        return made

    def _check_call(self, made: Callable[..., Any]) -> None:
        """Check that what answers takes one argument, and maybe some of :data:`_NAMED`.

        Raises:
            UsageError: it takes more, or none.
        """
        asked = {name: None for name in _NAMED if has_parameter(made, name)}
        if not can_be_called(made, 'seen', **asked):
            raise UsageError(
                f'{self.where}: {self.name} cannot be called with one argument; expected a '
                'function of one argument'
            )

    @contextlib.contextmanager
    def running(self, failed: type[UsageError | UserCodeError]) -> Iterator[None]:
        """Context in which the file's code runs, and may print.

        Raises:
            failed: it raises any exception, including ``SystemExit``: this ends the run, not the
            process.
            KeyboardInterrupt: a signal asked this process to end.
        """
        with contained(lambda error: failed(self.failure(error))):
            yield

    def failure(self, error: BaseException) -> str:
        """Error message for an exception of the file, with its line if known."""
        trace, line = error.__traceback__, 0
        while trace is not None:
            if trace.tb_frame.f_code.co_filename == str(self.path):
                line = trace.tb_lineno
            trace = trace.tb_next
        place = f'{self.path}:{line}' if line else f'{self.path}: {self.name}'
        return plain_line(f'{place}: {_said(error)}')

    @cached_property
    def _found(self) -> Callable[..., Any]:
        module = types.ModuleType(f'taxinet_user_{self.path.stem}')
        module.__file__ = str(self.path)
        sys.modules[module.__name__] = module  # needed by dataclasses and pickle
        folder = str(self.path.resolve().parent)
        if folder not in sys.path:
            sys.path.append(folder)  # last, so that it cannot shadow our modules
        with _same_place(), self.running(UsageError):
            exec(compile(_source(self.path), str(self.path), 'exec'), module.__dict__)
            found: Any = getattr(module, self.name)
        if not callable(found):
            raise UsageError(
                f'{self.path}: {self.name} is {type(found).__name__}; expected a function or class'
            )
        function: Callable[..., Any] = found
        return function


@dataclass(frozen=True)
class PluginCode(UserCode):
    """A callable registered by an installed package.

    Attributes:
        path: folder or only file of the package.
        name: name of the function or class.
        sha256: hash of the whole package, see :attr:`.Extension.fingerprint`.
        extension: the extension that it belongs to.
    """

    extension: Extension

    @property
    def word(self) -> str:
        """Implementation name reported by its node."""
        return self.extension.name

    @property
    def where(self) -> str:
        """Prefix of error messages."""
        return self.extension.words

    def failure(self, error: BaseException) -> str:
        """Error message for an exception of the package, with its last line."""
        trace, place = error.__traceback__, ''
        while trace is not None:
            file = trace.tb_frame.f_code.co_filename
            if Path(file).is_relative_to(self.path):
                place = f'{file}:{trace.tb_lineno}: '
            trace = trace.tb_next
        return plain_line(f'{self.where}: {place}{_said(error)}')

    @cached_property
    def _found(self) -> Callable[..., Any]:
        with _same_place():
            found: Any = self.extension.load()
        if not callable(found):
            raise UsageError(
                f'{self.where}: {self.extension.target} is {type(found).__name__}; expected a '
                'function or class'
            )
        if not _is_maker(found):
            self._check_call(found)
        function: Callable[..., Any] = found
        return function


def find_plugin_code(extension: Extension) -> PluginCode:
    """The callable of an extension; imports its package.

    Raises:
        UsageError: the import fails, or it is not callable.
    """
    found = PluginCode(
        path=extension.package or Path(), name=extension.target.partition(':')[2],
        sha256=extension.fingerprint, extension=extension,
    )
    _ = found._found
    return found


class RunCode:
    """User code that is reset to its initial state for each run.

    Attributes:
        needs_sensors: whether its function has a parameter ``sensors``.
    """

    def __init__(self, code: UserCode) -> None:
        """Load the file.

        Raises:
            UsageError: as :meth:`UserCode.make`.
        """
        self.code = code
        self.function = code.make()
        self.needs_sensors = has_parameter(self.function, 'sensors')
        self._measured: Measured | None = None
        self._fresh = True

    def sense(self, measured: Measured) -> None:
        """Take what the sensors deliver for the next answer."""
        self._measured = measured

    def begin(self) -> None:
        """Reset; called before each run.

        Raises:
            UserCodeError: the file's code fails.
        """
        self._measured = None
        if self._fresh:
            return
        with self.code.running(UserCodeError):
            reset = getattr(self.function, 'reset', None)
            if reset is not None:
                reset()
                return
        try:
            self.function = self.code.make()
        except UsageError as error:
            raise UserCodeError(str(error)) from error

    def answer(
        self, argument: Any, read: Callable[[Any], _Answer | None], expected: str, **named: Any
    ) -> _Answer:
        """Call the function.

        Args:
            argument: its argument.
            read: converts its result, or returns None; may also run its code.
            expected: description of the expected result.
            named: further arguments, for which it has parameters.

        Raises:
            UserCodeError: it fails, or its result is invalid.
            UsageError: it needs sensors, which are not there.
        """
        self._fresh = False
        if self.needs_sensors:
            named['sensors'], self._measured = given_sensors(
                self._measured, f'{self.code.where}: {self.code.name}'), None
        with self.code.running(UserCodeError):
            answer = self.function(argument, **named)
            found = read(answer)
            shown = _text(answer, repr)[:60] if found is None else ''
        if found is None:
            raise UserCodeError(plain_line(
                f'{self.code.where}: {self.code.name} returned {shown}; expected {expected}'
            ))
        return found


def given_sensors(measured: Measured | None, who: str) -> Measured:
    """What the sensors delivered to a function with a parameter ``sensors``.

    Raises:
        UsageError: nothing can have been, as it is called outside of a run with sensors.
    """
    if measured is None:
        raise UsageError(
            f'{who} has a parameter sensors, which it gets only in a run or replay of a scene with '
            'some, as with sensors=standard, or a hold_line'
        )
    return measured


def pair_of_numbers(answer: Any) -> tuple[float, float] | None:
    """Two numbers from a tuple, list or array; None if invalid, text or booleans."""
    try:
        first, second = answer
        if any(isinstance(one, str | bytes) for one in (answer, first, second)):
            return None
        if any(type(one).__name__ in ('bool', 'bool_') for one in (first, second)):
            return None
        return float(first), float(second)
    except KeyboardInterrupt:
        raise
    except BaseException:  # the result may have a user-defined __iter__ or __float__
        return None


def names_user_code(word: str) -> bool:
    """Whether a word has the form ``FILE.py:NAME``."""
    return not is_node_elsewhere(word) and bool(_ALONE.fullmatch(word) or _WORD.fullmatch(word))


def find_user_code(word: str, role: str) -> UserCode:
    """Find the code named by a word, without running it.

    Args:
        word: ``FILE.py:NAME``.
        role: ``perception`` or ``controller``, for the error message.

    Raises:
        UsageError: no such file, not valid Python, or no such name in it.
    """
    match = _WORD.fullmatch(word)
    path = Path(match['file'] if match else word.removesuffix(':'))
    source = _source(path, role)
    tree = _parsed(path, source)
    names = _names(tree)
    if match is None or match['name'] not in names:
        what = 'name a function' if match is None else f'no {match["name"]} in it'
        known = ', '.join(sorted(name for name in names if not name.startswith('_'))) or 'nothing'
        raise UsageError(f'{role} {path}: {what}, as in {path}:NAME; it has: {known}')
    for node in tree.body:
        if isinstance(node, ast.AsyncFunctionDef) and node.name == match['name']:
            raise UsageError(
                f'{path}:{node.lineno}: {node.name} is an async function; expected a plain one'
            )
    return UserCode(path, match['name'], _digest(path, source, tree))


def _parsed(path: Path, source: bytes) -> ast.Module:
    try:
        return ast.parse(source, str(path))
    except (SyntaxError, ValueError) as error:
        line = f':{error.lineno}' if isinstance(error, SyntaxError) and error.lineno else ''
        said = error.msg if isinstance(error, SyntaxError) else str(error)
        raise UsageError(f'{path}{line}: {said}') from error
    except (RecursionError, MemoryError) as error:
        raise UsageError(
            f'{path}: an expression in it is too long or too deep for Python to read'
        ) from error


def _source(path: Path, role: str = '') -> bytes:
    try:
        return read_file(path, MAX_TEXT_BYTES)
    except OSError as error:
        raise UsageError(f'{role} {path}: {error.strerror}'.strip()) from error


@contextlib.contextmanager
def _same_place() -> Iterator[None]:
    """Restore the working directory after user code, since our paths are relative to it."""
    before = os.getcwd()
    try:
        yield
    finally:
        os.chdir(before)


@contextlib.contextmanager
def contained(
    failed: Callable[[BaseException], Exception], passing: tuple[type[Exception], ...] = ()
) -> Iterator[None]:
    """Context in which user code runs: whatever it raises, the process goes on.

    A process that it forks ends with the context, since only this one may go on with the run. What
    it prints goes to stderr, except on a terminal.

    Args:
        failed: converts any exception, including ``SystemExit``, to the one to raise.
        passing: exceptions that are raised as they are, beside KeyboardInterrupt.
    """
    process = os.getpid()
    aside = sys.stdout if sys.stdout and sys.stdout.isatty() else sys.stderr
    with contextlib.redirect_stdout(aside):
        try:
            yield
        except KeyboardInterrupt:
            raise
        except passing:
            raise
        except BaseException as error:
            raise failed(error) from error
        finally:
            if os.getpid() != process:
                os._exit(0)


def _said(error: BaseException) -> str:
    text = _text(error, str).partition('\n')[0]
    said = type(error).__name__ + (f': {text}' if text else '')
    return f'{said[:_SAID_CHARACTERS]}…' if len(said) > _SAID_CHARACTERS else said


def _text(value: object, how: Callable[[object], str]) -> str:
    """Text of a user object, even if its conversion fails."""
    try:
        return how(value)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        return f'<{type(value).__name__} whose {how.__name__}() fails: {type(error).__name__}>'


_SCOPES = ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp, ast.Lambda


def _names(tree: ast.Module) -> set[str]:
    """Names bound at the top level of a module."""
    found: set[str] = set()
    nodes: list[ast.AST] = [*tree.body]
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            found.add(node.name)
            found.update(name for one in ast.walk(node) if isinstance(one, ast.Global)
                         for name in one.names)
            continue
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.add(node.id)
        elif isinstance(node, ast.ImportFrom | ast.Import):
            found |= {(one.asname or one.name).split('.')[0] for one in node.names}
        elif isinstance(node, _SCOPES):
            continue
        nodes += ast.iter_child_nodes(node)
    return found


def _digest(path: Path, source: bytes, tree: ast.Module) -> str:
    digest = hashlib.sha256(source)
    node = _files(path, tree)
    for name in _listed(path, node) if node is not None else ():
        content = _source(path.parent / name, f'{path}: {_FILES}')
        digest.update(hashlib.sha256(content).digest())
    return digest.hexdigest()


def _files(path: Path, tree: ast.Module) -> ast.Assign | ast.AnnAssign | None:
    """The assignment that lists further files; None if there is none.

    Raises:
        UsageError: it is not a single plain assignment at top level.
    """
    bound = [node for node in ast.walk(tree) if _binds_files(node)]
    plain = {
        id(target): node for node in tree.body if isinstance(node, ast.Assign | ast.AnnAssign)
        for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
    }
    for node in bound[-1:]:
        if len(bound) > 1 or id(node) not in plain:
            raise UsageError(
                f'{path}:{node.lineno}: {_FILES}: expected one assignment of a list at top level'
            )
    return plain[id(bound[0])] if bound else None


def _binds_files(node: ast.AST) -> TypeGuard[ast.Name | ast.alias]:
    if isinstance(node, ast.alias):
        return (node.asname or node.name) == _FILES
    return isinstance(node, ast.Name) and node.id == _FILES and not isinstance(node.ctx, ast.Load)


def _listed(path: Path, node: ast.Assign | ast.AnnAssign) -> list[str]:
    try:
        names = ast.literal_eval(node.value) if node.value is not None else None
    except (ValueError, TypeError, RecursionError, MemoryError):
        names = None
    if not isinstance(names, list | tuple) or not all(isinstance(name, str) for name in names):
        raise UsageError(
            f"{path}:{node.lineno}: {_FILES}: expected a list of file names, as in ['net.pt']"
        )
    return list(names)


def _is_maker(found: Callable[..., Any]) -> bool:
    """Whether it takes no argument; a class without a readable signature counts as such."""
    try:
        parameters = inspect.signature(found).parameters.values()
    except (TypeError, ValueError):
        return inspect.isclass(found)
    kinds = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    return not any(one.kind in kinds and one.default is one.empty for one in parameters)
