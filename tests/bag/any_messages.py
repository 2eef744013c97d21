"""Messages of any type with any values, for property tests."""

import numpy as np
from hypothesis import strategies as st
from rosbags.interfaces import Nodetype

from taxinet_ros.bag.topics import describe_topic

# Gaps that depend on texts, gaps that do not, and numbers that touch.
TYPES = [
    'nav_msgs/msg/Odometry', 'taxinet_msgs/msg/TrackingError', 'taxinet_msgs/msg/Robustness',
    'taxinet_msgs/msg/NodeStatus', 'sensor_msgs/msg/BatteryState', 'sensor_msgs/msg/CameraInfo',
    'rosgraph_msgs/msg/Clock',
]


def topic_of(name):
    """A topic whose messages are of a type that is installed."""
    return describe_topic(name='/told', type_name=name, qos='')


def messages_of(store, name):
    """Objects of the type ``name`` that ``store`` knows."""
    fields = {key: values_of(store, kind) for key, kind in store.fielddefs[name][1]}
    return st.builds(store.types[name], **fields)


def values_of(store, kind):
    """Anything that a field may hold."""
    node, what = kind
    if node is Nodetype.BASE:
        return base_values(what[0])
    if node is Nodetype.NAME:
        return messages_of(store, what)
    element, count = what
    sizes = {'min_size': count, 'max_size': count} if node is Nodetype.ARRAY else {'max_size': 3}
    inner = st.lists(values_of(store, element), **sizes)
    if element[0] is Nodetype.BASE and element[1][0] != 'string':
        name = {'bool': 'bool', 'byte': 'uint8', 'char': 'uint8', 'octet': 'uint8'}
        dtype = np.dtype(name.get(element[1][0], element[1][0]))
        return inner.map(lambda values: np.array(values, dtype))
    return inner


def base_values(name):
    if name == 'string':
        return st.text(st.characters(codec='ascii', exclude_characters='\0'), max_size=9)
    if name == 'bool':
        return st.booleans()
    if name.startswith('float'):
        return st.floats(width=int(name[5:]))
    return st.integers(0, 100)


def fields_in(store, name, prefix=''):
    """Names of a type's numbers, and of its texts, but for those within arrays and sequences."""
    numbers, texts = [], []
    for field, (node, what) in store.fielddefs[name][1]:
        if node is Nodetype.NAME:
            inner = fields_in(store, what, f'{prefix}{field}.')
            numbers, texts = numbers + inner[0], texts + inner[1]
        elif node is Nodetype.BASE:
            (texts if what[0] == 'string' else numbers).append(prefix + field)
    return numbers, texts
