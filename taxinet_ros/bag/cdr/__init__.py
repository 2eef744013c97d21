"""Serialised messages (CDR): decode, canonicalise, and fill templates.

Messages are processed as bytes here, not as objects, for two reasons:

* *Equal runs give equal bags.* CDR aligns numbers with gaps of undefined content.
  :mod:`.alignment` determines the gaps of a type once and zeroes them in place; decoding and
  serialising each message again would take 45 us instead of 6 us.
* *A run has two to three thousand messages.* rclpy converts an object field by field, including the
  216,000 bytes of an image. :mod:`.image` appends pixels to a serialised header, and
  :mod:`.fields` writes numbers into a serialised message: this saves 0.2 of 0.7 ms of a control
  step on the truth.

:mod:`.decode` decodes with rosbags' generated code, whose objects cost a third of rclpy's. Nodes
call ``bag/run/messages.py``, one function per message.
"""
