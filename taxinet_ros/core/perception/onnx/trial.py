"""Try a third-party network in a process with resource limits before opening it here.

Opening a model runs part of it, in native code that cannot be interrupted from Python: a few
hundred bytes can demand gigabytes or hours. So the child process ``python -m
taxinet_ros.core.perception.onnx.trial NAME.onnx`` opens and evaluates it first, under limits of the
operating system, and reports the result; if it crashes, the user gets a one-line error. The same
bytes on the same machine then need the same time and memory in this process.

A network must be deterministic. Random layers are rejected by name anywhere in the model, and every
trial frame is evaluated twice in the child process and once in this one.
"""

from __future__ import annotations

import hashlib
import json
import signal
import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from taxinet_ros.core.perception.onnx.network import (
    MEMORY_BYTES,
    NetworkFiles,
    OnnxNetwork,
    too_large,
)
from taxinet_ros.core.perception.onnx.sidecar import file_error
from taxinet_ros.errors import InfraError, InfraKind, UsageError
from taxinet_ros.processes.child import (
    ChildProcess,
    exit_words,
    limit_cpu,
    limit_memory,
    module_command,
)

CPU_S = 30
"""CPU time limit of the trial [s]; a control step has much less."""

WALL_S = 600.0
"""Wall-clock limit of the trial [s]."""

RANDOM_LAYERS = frozenset({
    'Bernoulli', 'Multinomial', 'RandomNormal', 'RandomNormalLike', 'RandomUniform',
    'RandomUniformLike', 'Sampling',
})
"""Random operators of ONNX and of onnxruntime."""

_sound: set[str] = set()
"""Fingerprints of networks that passed a trial in this process."""


def tried_network(path: Path) -> tuple[OnnxNetwork, str]:
    """Load ``NAME.onnx`` and ``NAME.yaml`` after a trial; return the network and its fingerprint.

    Raises:
        UsageError: an unusable network; one line on the first error.
        InfraError: the trial process was killed from outside.
    """
    files = NetworkFiles.read(path)
    fingerprint = files.fingerprint
    if fingerprint in _sound:
        return OnnxNetwork(files), fingerprint
    answers = _try_elsewhere(files, fingerprint)
    network = OnnxNetwork(files)
    if _digest(network.trial()) != answers:
        raise _different(path)
    _sound.add(fingerprint)
    return network, fingerprint


def _try_elsewhere(files: NetworkFiles, fingerprint: str) -> str:
    """Run the trial in a child process; return the digest of the outputs.

    Raises:
        UsageError, InfraError: as :func:`tried_network`.
    """
    command = module_command(
        'taxinet_ros.core.perception.onnx.trial', str(files.path), str(MEMORY_BYTES), str(CPU_S)
    )
    with ChildProcess(
        'trial', command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        killed_with_parent=True,
    ) as child:
        try:
            said, _ = child.process.communicate(timeout=WALL_S)
        except subprocess.TimeoutExpired:
            raise file_error(files.path, f'was not tried within {WALL_S:g} s') from None
    if child.code:
        raise _lost(files.path, child.code)
    answer = json.loads(said)
    if 'error' in answer:
        raise UsageError(answer['error'])
    if answer['fingerprint'] != fingerprint:
        raise file_error(
            files.path, 'was changed during the check; name a file that does not change'
        )
    return str(answer['answers'])


def _lost(path: Path, code: int) -> UsageError | InfraError:
    """Error for a child process that did not finish."""
    if code == -signal.SIGXCPU:
        return file_error(
            path,
            f'needs more than {CPU_S} s of processor time to be opened and evaluated on a few '
            'frames; make it smaller',
        )
    how = exit_words(code)
    if code == -signal.SIGKILL:
        return InfraError(InfraKind.DIED, f'trial of {path}', -1, how)
    return file_error(path, f'crashes its trial process ({how}), which may use '
                     f'{MEMORY_BYTES >> 30} GiB of memory; make it smaller, or export it again')


def inspect(files: NetworkFiles) -> bytes:
    """Check a network in this process; return its outputs for the trial frames.

    Raises:
        UsageError: an unusable network; one line on the first error.
    """
    network = OnnxNetwork(files)
    _refuse_dice(files)
    answers = network.trial()
    if network.trial() != answers:
        raise _different(files.path)
    return answers


def _refuse_dice(files: NetworkFiles) -> None:
    import onnx

    try:
        model = onnx.load_model_from_string(files.model)
    except Exception:  # protobuf's have no other base class
        raise file_error(files.path, f'cannot be read by onnx {onnx.__version__}; export it again'
                  ) from None
    for node in (*_nodes(model.graph.node), *_nodes(n for f in model.functions for n in f.node)):
        if node.op_type in RANDOM_LAYERS or _drops_out(node):
            raise file_error(
                files.path,
                f'has a random layer, {node.op_type}; export it for '
                'inference, without random layers',
            )


def _nodes(nodes: Iterable[Any]) -> Iterator[Any]:
    """Nodes, including those of nested graphs."""
    for node in nodes:
        yield node
        for attribute in node.attribute:
            for graph in (attribute.g, *attribute.graphs):
                yield from _nodes(graph.node)


def _drops_out(node: Any) -> bool:
    """Whether a node is a dropout with a training-mode input."""
    return node.op_type == 'Dropout' and len(node.input) > 2 and node.input[2] != ''


def _different(path: Path) -> UsageError:
    return file_error(
        path,
        'answers the same frame differently each time; export it for inference, '
        'without random layers',
    )


def _digest(answers: bytes) -> str:
    return hashlib.sha256(answers).hexdigest()


def main() -> None:
    """Try a network (arguments ``NAME.onnx MEMORY_BYTES CPU_S``); print one line of JSON."""
    path, memory_bytes, cpu_s = sys.argv[1:]
    limit_memory(int(memory_bytes))
    limit_cpu(int(cpu_s))
    try:
        files = NetworkFiles.read(Path(path))
        found = {'fingerprint': files.fingerprint, 'answers': _digest(inspect(files))}
    except UsageError as error:
        found = {'error': str(error)}
    except MemoryError:
        found = {'error': str(too_large(Path(path)))}
    print(json.dumps(found))


if __name__ == '__main__':
    main()
