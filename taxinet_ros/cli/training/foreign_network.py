"""``taxinet network``: convert a network of others, and see what it sees."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.checked import check_new_file
from taxinet_ros.cli.completion import complete_program, one_of
from taxinet_ros.cli.help import command_group
from taxinet_ros.cli.options import PictureOption, ScenarioOption
from taxinet_ros.errors import UsageError
from taxinet_ros.files.outputs import check_output

network_app = command_group('Networks of others: convert them, and see what they see.')


@network_app.command('from-nnet')
def from_nnet(
    file: Annotated[Path, typer.Argument(metavar='FILE.nnet', help="network in Stanford's format")],
    out: Annotated[
        Path,
        typer.Option(
            metavar='NAME.onnx', writable=True, dir_okay=False,
            help='network to write, with its description NAME.yaml; must be new',
        ),
    ],
    description: Annotated[
        str,
        typer.Option(
            metavar='NAME|FILE.yaml', autocompletion=one_of('tinytaxinet'),
            help='what its inputs and outputs are, which the file does not say: tinytaxinet, as '
            'of the public TinyTaxiNet, or a YAML file as in docs/onnx.md',
        ),
    ],
) -> None:
    """Convert a .nnet file to ONNX, which `--perception NAME.onnx` then takes.

    With the normalisation of the file. Its answers are compared with the file's own sums before
    anything is written.
    """
    from taxinet_ros.core.perception.onnx.network import ONNX_SUFFIX
    from taxinet_ros.core.perception.onnx.nnet import (
        converted,
        description_of,
        read_nnet,
        write_converted,
    )
    from taxinet_ros.core.perception.onnx.sidecar import sidecar_path

    if out.suffix != ONNX_SUFFIX:
        raise UsageError(f'--out {out}: networks are {ONNX_SUFFIX} files; use {out.stem}.onnx')
    check_new_file(out)
    content, source = description_of(description)
    beside = sidecar_path(out)
    if not (beside.exists() and source.exists() and beside.samefile(source)):
        check_output(f'--out {out}: {beside}', beside, own=[beside.suffix])
        check_new_file(beside)
    found = converted(file, read_nnet(file), out, content, source)
    nnet = found.nnet
    hidden = ', '.join(map(str, nnet.sizes[1:-1])) or 'no'
    write_converted(found)
    print(f'{file}: {nnet.sizes[0]} inputs, {hidden} hidden neurons, {nnet.sizes[-1]} outputs; '
          f'SHA-256 {nnet.sha256}')
    print(f'as ONNX, its answers to random inputs differ by at most {found.difference:.1g}')
    print(f'written: {out}, {beside} (description: {source})')


@network_app.command('describe')
def describe(
    network: Annotated[Path, typer.Argument(metavar='NETWORK.onnx', help='an ONNX network')],
    program: Annotated[
        str, typer.Option(
            metavar='PROGRAM', autocompletion=complete_program,
            help='scenes like those that it was trained on',
        ),
    ] = 'training_original',
    images: Annotated[int, typer.Option(min=50, max=5000, help='pictures to show it')] = 200,
) -> None:
    """Find out how an ONNX network is fed and what its outputs are; write its description.

    It sees pictures whose truth is known, prepared in each usual way. If no way explains them, exit
    code 2: it was fed in another way, or trained in another world.
    """
    from taxinet_ros.core.perception.onnx.sidecar import sidecar_path
    from taxinet_ros.files.atomic import write_atomically
    from taxinet_ros.training.data.dataset import draw_scenes
    from taxinet_ros.training.network_description import (
        LEAST_EXPLAINED,
        description,
        find_ways,
        read_shapes,
    )

    beside = sidecar_path(network)
    if beside.exists() or beside.is_symlink():
        raise UsageError(f'{beside} already exists; move it away, or use it as it is')
    shapes = read_shapes(network)
    best, second, *_ = find_ways(network, shapes, draw_scenes(program, seed=0, images=images))
    print(f'best of the usual ways, on {images} pictures of {program}:\n  {best.words()}')
    print(f'next:\n  {second.words()}')
    if best.explained < LEAST_EXPLAINED:
        raise UsageError(
            f'{network}: no usual way explains {100 * LEAST_EXPLAINED:.0f} % of cross-track and '
            f'heading error on {program}; name scenes like those of its training (--program), or '
            f'write {beside.name} yourself (docs/onnx.md)'
        )
    about = f'Found by taxinet network describe on {images} pictures of {program}; check it.'
    write_atomically(beside, description(best, shapes.outputs, about).encode())
    print(f'written: {beside}; look at it, then: taxinet network see {network}')


@network_app.command('see')
def see(
    network: Annotated[Path, typer.Argument(metavar='NETWORK.onnx', help='an ONNX network')],
    settings: ScenarioOption = None,
    out: PictureOption = None,
) -> None:
    """Draw what an ONNX network gets to see of a scene's first frame, and print its answer."""
    from taxinet_ros.analysis.camera.sheets import draw_network_view
    from taxinet_ros.cli.training.pictures import new_picture, write_picture
    from taxinet_ros.core.perception.domain import domain_words
    from taxinet_ros.core.perception.onnx.trial import tried_network
    from taxinet_ros.core.perception.perception import find_domain
    from taxinet_ros.core.scenario import scenario_from_human
    from taxinet_ros.trials.options import read_settings

    scene = scenario_from_human(read_settings(settings or ()))
    loaded, _ = tried_network(network)
    path = new_picture(out, f'network-{network.stem}')
    answer = write_picture(path, lambda: draw_network_view(loaded, network.name, scene, path))
    print(f'{answer}\ndomain {domain_words(find_domain(str(network)))}\npicture: {path}')
