"""The commands of ``taxinet bag``, in the order of its help."""

from taxinet_ros.cli.bag.compare import compare
from taxinet_ros.cli.bag.export import export
from taxinet_ros.cli.bag.golden import golden
from taxinet_ros.cli.bag.info import info
from taxinet_ros.cli.bag.recover import recover
from taxinet_ros.cli.bag.render import render
from taxinet_ros.cli.bag.replay import replay
from taxinet_ros.cli.bag.split import split
from taxinet_ros.cli.help import command_group

bag_app = command_group(
    'Inspect, repair and export bags; taxinet doctor BAG checks one. Exit codes: 0 the bag is '
    'whole, 2 bad input, or nothing in the bag can be read, 3 something in it is lost or wrong, 4 '
    'no disk space for the output.',
)
bag_app.command('info')(info)
bag_app.command('recover')(recover)
bag_app.command('export')(export)
bag_app.command('split')(split)
bag_app.command('render')(render)
bag_app.command('replay')(replay)
bag_app.command('compare')(compare)
bag_app.command('golden')(golden)
