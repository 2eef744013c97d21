"""What help shows: :data:`EXAMPLES`, lines to copy, and of many options a first page."""

from __future__ import annotations

from typing import Any

import typer
from typer.core import TyperCommand

EXAMPLES: dict[str, tuple[str, ...]] = {
    'demo': ('taxinet demo',),
    'run': (
        'taxinet run s_falsif --perception original --set clouds=overcast --set time_of_day=9:30',
        'taxinet run s_falsif --runs 20 --perception my_net.onnx --controller my_file.py:steer',
        'taxinet run --from bags/found/RUN --perception truth',
    ),
    'keys': ('taxinet keys', 'taxinet keys wind'),
    'up': ('taxinet up --perception taxinet',),
    'node': (
        'taxinet node scenario_sampler --ros-args -p program:=s_falsif',
        'taxinet node live_monitor --ros-args --params-file monitor.yaml',
    ),
    'check-node': ("taxinet check-node 'ros2 run my_pkg my_node'",),
    'falsify': (
        'taxinet falsify s_falsif --perception original --runs 200 --workers 2 --out bags/found',
        'taxinet falsify s_falsif --runs 1000 --engine loop --until failures=10',
        'taxinet falsify s_falsif --runs 50 --sampler coverage --odd s_falsif',
    ),
    'estimate': (
        'taxinet estimate s_falsif --perception taxinet --runs 4000 --workers 2 --engine loop',
    ),
    'why': ('taxinet why bags/found', 'taxinet why bags/found/RUN'),
    'analyze': ('taxinet analyze bags/found',),
    'localize': ('taxinet localize bags/found --workers 2',),
    'explain': ('taxinet explain bags/found/RUN',),
    'shrink': ('taxinet shrink bags/found/RUN --nominal time_of_day=12',),
    'fork': (
        'taxinet fork bags/found/RUN --at 7.3 --set rain=0',
        'taxinet fork bags/found/RUN --find --perception truth',
    ),
    'experiment': ('taxinet experiment shadows_afternoon --runs 120 --perception original',),
    'gate': (
        'taxinet gate bags/found --min-satisfaction 0.95 --junit gate.xml',
        'taxinet gate my_net.onnx --baseline bags/before --junit gate.xml',
    ),
    'check': ('taxinet check my_net.onnx', 'taxinet check original --allow 30 --quiet'),
    'plan': (
        'taxinet plan --min-satisfaction 0.999',
        'taxinet plan bags/found --min-satisfaction 0.999 --if-true 0.9995',
    ),
    'odd': (
        'taxinet odd s_falsif',
        'taxinet odd s_falsif bags/found --plot coverage.png',
        'taxinet odd my_odd.yaml bags/one bags/two --below 0.05',
    ),
    'forecast calibrate': ('taxinet forecast calibrate bags/found --out bound.json',),
    'forecast check': ('taxinet forecast check bound.json bags/other',),
    'forecast show': ('taxinet forecast show bound.json bags/found/RUN',),
    'assure calibrate': (
        'taxinet assure calibrate training_original --perception original --out mine.npz',
    ),
    'assure judge': (
        'taxinet assure judge s_falsif --perception original --monitor original --runs 300',
    ),
    'evidence write': (
        'taxinet evidence write bags/found --requirement requirement.txt --out bags/evidence',
        "taxinet evidence write bags/found --claim '99 %' --odd s_falsif --out bags/evidence",
    ),
    'evidence verify': ('taxinet evidence verify bags/evidence --sample 10',),
    'compare': ('taxinet compare original taxinet s_falsif', 'taxinet compare bags/old bags/new'),
    'bisect': ('taxinet bisect first.safetensors next.safetensors --scene bags/found/RUN',),
    'monitor': ("taxinet monitor bags/found --spec 'always[10 s:inf](abs(cte) <= 1 m)'",),
    'spec': ("taxinet spec 'always[10 s:inf](abs(steering) <= 3 deg)'",),
    'mine': ("taxinet mine 'always[T:30](abs(cte) <= A)' bags/found --share 0.95",),
    'evaluate': (
        'taxinet evaluate s_falsif --perception taxinet --images 500',
        'taxinet evaluate bags/pictures --perception mine.onnx',
    ),
    'score': (
        'taxinet score --topics drive',
        'taxinet score drive --place kmwh_04 --image /camera/image_raw --truth /fix --heading /imu',
        'taxinet score drive --place mine.yaml --perception mine.onnx --against taxinet --out out',
        'taxinet score drive --place mine.yaml --perception /lane:-vector.y=ft,vector.z=deg',
    ),
    'dataset': ('taxinet dataset training_full --count 5000 --out bags/pictures',),
    'train': (
        'taxinet train training_full --images 20000 --out mine.safetensors',
        'taxinet train s_falsif --start original --add-runs bags/found=4000 --out next.safetensors',
    ),
    'network from-nnet': (
        'taxinet network from-nnet TinyTaxiNet.nnet --out tiny.onnx --description tinytaxinet',
    ),
    'network describe': ('taxinet network describe my_net.onnx',),
    'network see': ('taxinet network see tiny.onnx --set distance=400 --set cross_track=3',),
    'improve': ('taxinet improve s_falsif --start original --rounds 2 --out bags/improved',),
    'tune': (
        'taxinet tune s_falsif --perception taxinet --candidates 30 --out bags/tuned',
        "taxinet tune --vary 'steering.max_intercept_rad=10 deg:60 deg' --scenes 20",
    ),
    'case-study': ('taxinet case-study --scale 0.02 --out bags/smoke',),
    'place': ('taxinet place', 'taxinet place kmwh_04'),
    'aircraft': ('taxinet aircraft', 'taxinet aircraft caravan'),
    'camera': ('taxinet camera', 'taxinet camera wing'),
    'frame': (
        'taxinet frame --set time_of_day=17:30 --set clouds=broken',
        'taxinet frame --hours 6,9,12,17 --clouds clear,broken',
    ),
    'flightgear start': ('taxinet flightgear start --at BIKF',),
    'flightgear doctor': ('taxinet flightgear doctor',),
    'xplane doctor': ('taxinet xplane doctor',),
    'bag info': ('taxinet bag info bags/found/RUN',),
    'bag recover': ('taxinet bag recover broken.mcap --out whole',),
    'bag export': ('taxinet bag export bags/found/RUN --out run.mp4',),
    'bag split': ('taxinet bag split recorded --out runs',),
    'bag render': ('taxinet bag render bags/found/RUN',),
    'bag replay': ('taxinet bag replay bags/found/RUN --perception my_net.onnx',),
    'bag compare': ('taxinet bag compare bags/found/RUN bags/again/RUN',),
    'bag golden': ('taxinet bag golden',),
    'doctor': ('taxinet doctor', 'taxinet doctor bags/found', 'taxinet doctor bags/found/RUN'),
    'setup-messages': (
        'taxinet setup-messages', 'taxinet setup-messages simulation_interfaces',
    ),
    'plugins': ('taxinet plugins', 'taxinet plugins taxinet'),
    'bench': ('taxinet bench camera loop', 'taxinet bench graph --guard'),
}
"""Lines to copy, by command; the tests parse each."""

_VERBATIM = '\b'
LATER = 'later'
"""Help panel (``typer.Option(rich_help_panel)``) of options that a first page leaves out."""
_FIRST_PAGE = 20
_ALL = '--help-all'


class PagedCommand(TyperCommand):
    """A command whose help shows at most a page of its options; all of them with --help-all."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments, unless they ask for the whole help.

        Raises:
            typer.Exit: the help was printed.
        """
        if _ALL in args and self._later():
            ctx.meta[_ALL] = True
            print(ctx.get_help())
            raise typer.Exit
        return super().parse_args(ctx, args)

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the options of the first page, or all."""
        later = [] if ctx.meta.get(_ALL) else self._later()
        for one in later:
            one.hidden = True
        super().format_options(ctx, formatter)
        for one in later:
            one.hidden = False
        if later:
            formatter.write_text(f'{len(later)} more options: {ctx.command_path} {_ALL}')

    def _later(self) -> list[Any]:
        later = [one for one in self.params if getattr(one, 'rich_help_panel', None) == LATER]
        return later if len(self.params) > _FIRST_PAGE else []


def command_group(help_text: str) -> typer.Typer:
    """A group of commands, which prints its help where no command is named.

    Args:
        help_text: what its commands are for.
    """
    group = typer.Typer(rich_markup_mode=None, help=help_text)

    @group.callback(invoke_without_command=True)
    def show_help(context: typer.Context) -> None:
        if context.invoked_subcommand is None:
            print(context.get_help())

    return group


def add_examples(app: typer.Typer, above: str = '') -> None:
    """Give every command of an app, and of the apps in it, its lines of :data:`EXAMPLES`."""
    for info in app.registered_commands:
        name = info.name or getattr(info.callback, '__name__', '').replace('_', '-')
        lines = EXAMPLES.get(f'{above}{name}')
        if lines:
            title = 'Examples' if len(lines) > 1 else 'Example'
            info.epilog = '\n'.join([_VERBATIM, f'{title}:', *(f'  {line}' for line in lines)])
    for group in app.registered_groups:
        if group.typer_instance is not None:
            add_examples(group.typer_instance, f'{above}{group.name} ')
