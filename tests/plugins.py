"""Packages that add to taxinet_ros, as pip would lay them down."""

from __future__ import annotations

from pathlib import Path


def lay_down(site: Path, name: str, code: str, version: str = '1.2', **points: str) -> Path:
    """Install a package of one module into a folder.

    Args:
        site: the folder, which has to be on Python's path.
        name: of the package; its module's is the same with ``_`` for ``-``.
        code: of the module.
        version: of the package.
        points: by extension point, ``name = object`` of the module.
    """
    module = name.replace('-', '_')
    info = site / f'{module}-{version}.dist-info'
    info.mkdir(parents=True)
    (info / 'METADATA').write_text(f'Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n')
    lines = []
    for point, entry in points.items():
        key, _, found = entry.partition(' = ')
        lines.append(f'[taxinet_ros.{point}]\n{key} = {module}:{found}\n')
    (info / 'entry_points.txt').write_text('\n'.join(lines))
    (site / f'{module}.py').write_text(code)
    return site
