"""An example node with faults of the command line: ``wrong_node.py controller seq,stamp``."""

from __future__ import annotations

import math
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[3] / 'examples'))
sys.path.insert(0, str(Path(__file__).parents[3] / 'examples' / 'my_perception_package'))

import own_controller
import rclpy
from my_perception_package import perception as own_perception
from rclpy.qos import ReliabilityPolicy
from taxinet_msgs.msg import NodeStatus, Scenario

ROLE, FAULTS = sys.argv[1], set(sys.argv[2].split(','))
EXAMPLE = {'perception': own_perception.OwnPerception, 'controller': own_controller.OwnController}
LISTENS = {'perception': 'camera/image_raw', 'controller': 'perception/tracking_error'}[ROLE]


def ready(run_id: str) -> NodeStatus:
    node = {'perception': 'perception', 'controller': 'steering_controller'}[ROLE]
    listens = [LISTENS] if 'listens' in FAULTS else [LISTENS, 'scenario']
    return NodeStatus(
        run_id=run_id, node=node, state=NodeStatus.READY, implementation='wrong', listens=listens,
    )


class Answers:
    """Stands before the publisher of the answers, and spoils them."""

    def __init__(self, publisher):
        self.publisher, self.count = publisher, 0

    def __getattr__(self, name):
        return getattr(self.publisher, name)

    def publish(self, answer):
        self.count += 1
        if 'silent' in FAULTS:
            return
        if {'slow', 'very_slow'} & FAULTS:
            time.sleep(0.5 if 'very_slow' in FAULTS else 0.11)
        if ROLE == 'controller':
            self.spoil_command(answer)
        if 'seq' in FAULTS:
            answer.seq += 1
        for _ in range(2 if 'twice' in FAULTS else 1):
            self.publisher.publish(answer)

    def spoil_command(self, command):
        if 'nan' in FAULTS or ('unusable' in FAULTS and command.speed == 0):
            command.steering_angle = math.nan
        if 'away' in FAULTS:
            command.steering_angle *= -57.3
        if 'remembers' in FAULTS:
            command.speed += self.count / 100
        if 'int' in FAULTS:
            command.speed = 5
        if 'random' in FAULTS:
            command.speed += random.random()


class Wrong(EXAMPLE[ROLE]):
    def __init__(self):
        super().__init__()
        name = 'estimates' if ROLE == 'perception' else 'commands'
        self.answers = Answers(getattr(self, name))
        setattr(self, name, self.answers)
        self.begun, self.hurt = 0, False
        if 'topics' in FAULTS:
            self.create_publisher(Scenario, 'scenario', own_controller.LATCHED)

    def create_publisher(self, kind, topic, qos):
        if topic == 'taxi_command' and 'types' in FAULTS:
            kind = NodeStatus
        if topic == 'taxi_command' and 'qos' in FAULTS:
            qos = rclpy.qos.QoSProfile(depth=16, reliability=ReliabilityPolicy.BEST_EFFORT)
        return super().create_publisher(kind, topic, qos)

    def create_subscription(self, kind, topic, callback, qos):
        if topic == 'scenario' and 'qos' in FAULTS:
            qos = own_controller.EACH_STEP
        return super().create_subscription(kind, topic, callback, qos)

    def begin(self, scenario):
        self.begun += 1
        if ('dies_at_2' in FAULTS and self.begun == 2) or self.hurt:
            os._exit(7)
        if 'remembers' not in FAULTS:
            self.answers.count = 0
        if 'waits' in FAULTS:
            self.status.publish(ready(scenario.run_id))
        elif not ('ready_again' in FAULTS and self.begun > 1):
            super().begin(scenario)

    def see(self, image):
        if 'strange_image' in FAULTS and image.encoding == 'mono8':
            raise SystemExit('no colours')
        self.hurt = 'dies_later' in FAULTS and image.encoding == 'mono8'
        super().see(image)


def main():
    if 'starts' in FAULTS:
        raise SystemExit('out of paint')
    args = ['--ros-args', '-r', '__node:=somebody'] if 'name' in FAULTS else None
    rclpy.init(args=args)
    if 'leaves' in FAULTS:
        subprocess.Popen(['sleep', '1000'], start_new_session=True)
    node = Wrong()
    others = []
    if 'two' in FAULTS:
        others.append(rclpy.create_node('x'))  # called as the first, by the command line
    if 'deaf' in FAULTS:
        rclpy.signals.uninstall_signal_handlers()
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        pass
    except Exception:
        if rclpy.ok():  # else it is the end, which comes to rclpy at odd moments
            raise
    if 'traceback' in FAULTS:  # however rclpy told of the end: it may as well just return
        raise RuntimeError('told to end')


if __name__ == '__main__':
    main()
