"""A bag's description, put together from parts, is the YAML of the whole."""

import yaml
from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.bag.definitions import describe_topic
from taxinet_ros.bag.metadata import BagContent, record_text
from taxinet_ros.bag.topics import offered_qos
from taxinet_ros.bag.yaml_text import dump_yaml

QOS = offered_qos(
    history='keep_last', depth=16, reliability='reliable', durability='transient_local'
)
TYPES = 'nav_msgs/msg/Odometry', 'taxinet_msgs/msg/TrackingError', 'rosgraph_msgs/msg/Clock'
NAMES = st.from_regex(r'/[a-z_]{1,20}', fullmatch=True)
TOPICS = st.builds(
    describe_topic, name=NAMES, type_name=st.sampled_from(TYPES), qos=st.just(QOS)
)
COUNTED = st.lists(st.tuples(TOPICS, st.integers(0, 10**6)), max_size=4)
WORDS = st.dictionaries(st.text(max_size=9), st.text(max_size=30), max_size=3)


@given(COUNTED, WORDS, st.integers(0, 2**62))
def test_given_any_bag_when_described_then_the_text_is_that_of_its_content_dumped_whole(
    topics, custom, duration_ns
):
    text = record_text(BagContent(
        file='run.mcap', start_ns=0, duration_ns=duration_ns, topics=topics, custom=custom,
    ))
    content = yaml.safe_load(text)
    assert dump_yaml(content) == text
    assert content['message_count'] == sum(count for _, count in topics)
    told = content['topics_with_message_count']
    assert [
        (one['topic_metadata']['name'], one['topic_metadata']['type'], one['message_count'])
        for one in told
    ] == [(topic.name, topic.type, count) for topic, count in topics]
    assert content['custom_data'] == custom
