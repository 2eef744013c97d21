"""Messages as bytes (CDR): decoded, compared, stripped of what is no part of them, filled in.

Everywhere else a message is an object. Here it is bytes, for two reasons:

* *Equal runs give equal bags.* CDR aligns numbers with gaps, whose content a serialiser leaves
  undefined. :mod:`.alignment` finds the gaps of a type once and zeroes them in place. Decoding each
  message and serialising it anew would do the same at 45 us in place of 6 us.
* *A run is two to three thousand messages.* rclpy converts an object field by field, a picture's
  216,000 bytes too. :mod:`.image` puts pixels behind a header that was serialised once, and
  :mod:`.fields` numbers into a message that was: 0.2 ms of a control step on the truth of 0.7 ms.

:mod:`.decode` is the way back, by rosbags' generated code, whose objects cost a third of rclpy's.
Nodes are unaffected: they call ``bag/run/messages.py``, one function for each message. What
was measured is in ``docs/performance.md``, entries 3, 5, 27 and 31.
"""
