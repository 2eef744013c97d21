"""One class of processors: libraries use AVX2 and FMA (x86-64-v3), and nothing newer.

numpy, its BLAS, OpenCV and IPP select code by processor when they are loaded, and such code rounds
differently. Environment variables keep them to the code for x86-64-v3, so that every such processor
computes the same bits. The C library has no newer variants of the functions used here, and this
package's compiled code rounds identically on every processor.
"""

from __future__ import annotations

import os
import re
import sys
import warnings
from functools import cache
from importlib.util import find_spec
from pathlib import Path

_NEEDED = frozenset({'avx2', 'fma'})
_NEWER = frozenset({'avx512f', 'avx512cd', 'avx512bw', 'avx512dq', 'avx512vl'})


def _newer_of_numpy() -> str:
    """What numpy calls the code for newer processors; it warns of words that it does not know."""
    spec = find_spec('numpy')
    text = Path(spec.origin).with_name('version.py').read_text() if spec and spec.origin else ''
    if re.search(r'^version = "(1|2\.[0-3])\.', text, re.MULTILINE):
        return 'AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL'
    return 'X86_V4 AVX512_ICL AVX512_SPR'


PINS = {
    'NPY_DISABLE_CPU_FEATURES': _newer_of_numpy(),
    'OPENBLAS_CORETYPE': 'Haswell',
    'OPENCV_IPP': 'avx2',
    'OPENCV_CPU_DISABLE': 'AVX512-SKX',
}
"""Environment variables that restrict libraries to x86-64-v3; values set by users have priority."""


def pin() -> None:
    """Restrict the libraries that are loaded later, in this process and its children.

    A processor without AVX2 and FMA is left alone: libraries would fail there.

    Warns:
        UserWarning: numpy or OpenCV was loaded before, with newer instructions.
    """
    if lacking():
        return
    if early := _loaded_early():
        # Frames: this, the package, the module that imports it.
        warnings.warn(
            f'imported before taxinet_ros, so with AVX-512: {early}; results may differ from those '
            'of the command line and of other machines; import taxinet_ros first '
            '(docs/determinism.md)', stacklevel=3)
    for name, value in PINS.items():
        # OpenCV prints a line about a feature to disable that the processor lacks.
        if name != 'OPENCV_CPU_DISABLE' or processor_flags() >= _NEWER:
            os.environ.setdefault(name, value)


def _loaded_early() -> str:
    """Libraries that chose newer instructions before they could be restricted; '' if none."""
    if not processor_flags() >= _NEWER:
        return ''
    variables = {'numpy': 'NPY_DISABLE_CPU_FEATURES', 'cv2': 'OPENCV_CPU_DISABLE'}
    return ', '.join(
        name for name, variable in variables.items()
        if name in sys.modules and variable not in os.environ
    )


def lacking() -> str:
    """Features that this processor lacks for results equal to those of others; '' if none."""
    if machine() != 'x86_64':
        return f'x86-64 (this is {machine()})'
    return ' and '.join(sorted(name.upper() for name in _NEEDED - processor_flags()))


def machine() -> str:
    """Architecture of this machine."""
    return os.uname().machine


@cache
def processor_flags() -> frozenset[str]:
    """Instruction sets of this processor, in the words of Linux."""
    return frozenset((cpuinfo('flags') or cpuinfo('Features')).split())


def cpuinfo(key: str) -> str:
    """A fact of the first processor, as reported by the kernel; '' if unknown."""
    try:
        with Path('/proc/cpuinfo').open(encoding='utf-8') as lines:
            for name, _, value in (line.partition(':') for line in lines):
                if name.strip() == key:
                    return value.strip()
    except OSError:
        pass
    return ''
