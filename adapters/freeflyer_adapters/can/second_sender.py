"""Detection of two nodes that send the same CAN identifier, by counters and contents.

Counter: number in a frame that its sender increments with each frame. Content: data bytes of a
frame. Stream: sequence of frames with one continuous counter. Evidence: see `SecondSender`.
"""

from __future__ import annotations

REACH = 8
"""Largest distance between the counter of a frame and the last counter of its stream.

A frame within this distance may be late, or may follow a loss of frames. After a restart of the
sender or a long loss, the counter jumps. A link may reorder frames by up to 8 places. Then frames
that were sent before and after the jump are mixed. The mixture is 16 frames long."""
EVIDENCE = 3
"""Number of pieces of evidence that are needed to detect a second sender.

Each piece of evidence must be more than REACH frames after the previous piece. Therefore one
mixture of frames (see REACH) gives only one piece of evidence."""
ALONE, OLD = 16, 32
"""Numbers of frames after which the evidence is discarded.

ALONE: if this number of consecutive frames belongs to one stream, the other stream counts as ended.
OLD: if this number of frames gives no new evidence, the earlier evidence is too old."""
REMEMBERED = 64
"""Number of recent frames whose content is kept for each stream."""
LISTEN = 160
"""Number of frames to receive before the first transmission.

Within this number of frames, two senders are detected, even if the senders send bursts of up to
seven frames."""

Content = bytes | bytearray


class Stream:
    """Sequence of frames with one continuous counter."""

    __slots__ = ("advanced", "following", "last_contents")

    def __init__(self, counter: int, mask: int, content: Content | None) -> None:
        self.following = (counter + 1) & mask
        self.advanced = 0
        """Number of counter steps since the second stream started.

        The steps in the present run are not included. Run: consecutive frames of one stream.
        """
        self.last_contents: list[Content | None] = [None] * REMEMBERED
        self.last_contents[counter % REMEMBERED] = content


class SecondSender:
    """Detector of a second sender of one identifier.

    `counters`: number of counter values, a power of two. `found`: whether two senders were
    detected. Frames with a wrong CRC must not be added.

    Method: On a CAN bus, only one node may send an identifier (ISO 11898-1). A sender increments
    its counter with each frame (AUTOSAR E2E profile 5: 8 bits). Therefore the frames of two senders
    form two streams, and the two streams alternate. A frame is evidence of a second sender under
    two conditions. First, the frame continues one stream, and the previous frame belonged to the
    other stream. Second, at least one of these statements is true:

    - A frame with the same counter and different content was received before.
    - The two streams have passed through different counter values, without overlap.

    Faults of one sender or of the link do not make two streams alternate for long enough. These
    faults are loss, duplication, reordering by up to REACH places, delay, a counter that stops, and
    an occasional restart. The contents of frames are compared completely. The detector stores
    references to the contents, not copies.

    Number of frames of each sender until the detection:

    - Without loss, the median is 15 frames. The maximum is 24 frames if the two senders alternate.
      The maximum is 27 frames if the order of the senders changes. The maximum is 39 frames if the
      senders send bursts of up to four frames.
    - With 20 % loss, the median is 16 received frames. If the two senders alternate, 99.9 % of the
      detections take at most 30 received frames.

    Cases that are not detected:

    - Two senders have equal counters and equal content.
    - The second sender has less than a fifteenth of the rate of the first sender.
    - Two senders with equal counters send bursts of more than seven frames.
    - Three or more senders have counters that are all far apart.

    Cases of a false detection:

    - One sender repeats a counter with different content in every eighth frame or more often.
    - Only about every 128th frame of one sender is received.
    - Restarts or long losses occur within 32 frames of each other, and frames are reordered at each
      of them. This case gives a false detection once in thousands of trials.
    """

    def __init__(self, counters: int = 256) -> None:
        if counters < 32 or counters & (counters - 1):
            raise ValueError(
                f"the number of counter values is {counters}; a power of two of at least 32 is expected"
            )
        self._mask = counters - 1
        self._remembered = min(REMEMBERED, counters // 2)
        self._run, self._since, self._evidence = 0, 0, 0
        self.reset()

    def reset(self) -> None:
        """Discard all streams and all evidence.

        Call this method before a new run, and after frames were discarded without a check.
        """
        self.found = False
        self._current: Stream | None = None
        self._other: Stream | None = None
        self._clear_evidence()

    @property
    def counters(self) -> tuple[int, int]:
        """Last counters of the two streams, for messages. -1: this stream does not exist."""
        return self._last(self._current), self._last(self._other)

    def observe(self, counter: int, content: Content) -> bool:
        """Add one frame. Return whether two senders were detected."""
        current = self._current
        if current is not None and counter == current.following and not self.found:
            current.last_contents[counter % REMEMBERED] = content
            current.following = (counter + 1) & self._mask
            self._run += 1
            return False
        return self.found or self._observe_irregular(counter, content)

    def _observe_irregular(self, counter: int, content: Content) -> bool:
        """Add a frame that does not continue the current stream.

        Return whether two senders were detected.
        """
        current, other = self._current, self._other
        if current is None:
            self._current = Stream(counter, self._mask, content)
            return False
        # A frame with the counter and the content of an earlier frame is a duplicate.
        earlier = self._earlier(current, counter)
        earlier_of_other = None if other is None else self._earlier(other, counter)
        if content in (earlier, earlier_of_other):
            return False
        ahead = (counter - current.following) & self._mask
        fits = earlier is None and self._belongs(current, counter)
        # The frame continues the other stream if its counter is closer to the other stream.
        if other is not None and earlier_of_other is None:
            ahead_of_other = (counter - other.following) & self._mask
            if ahead_of_other < REACH and (ahead_of_other < ahead or not fits):
                return self._change(current, other, counter, content, earlier is not None, fits)
        # Otherwise the frame belongs to the current stream, or starts a new stream.
        if fits:
            self._add(current, counter, content)
            self._run += 1
        elif other is None or not self._belongs(other, counter):
            self._clear_evidence()
            current.advanced = 0
            self._current, self._other = Stream(counter, self._mask, content), current
        return False

    def _change(
        self,
        current: Stream,
        other: Stream,
        counter: int,
        content: Content,
        repeated: bool,
        fits: bool,
    ) -> bool:
        """Make the other stream the current stream. Return whether two senders were detected.

        The change is not evidence if one stream may consist of late frames of the other stream.

        `current`, `other`: the streams before the change. The frame (`counter`, `content`)
        continues `other`. `repeated`: whether an earlier frame of `current` has the same counter
        and different content. `fits`: whether the frame could also belong to `current`.
        """
        current.advanced += self._run
        if self._run >= ALONE or self._since >= OLD:
            self._clear_evidence()
            current.advanced = other.advanced = 0
        apart = (counter - current.following + 1) & self._mask
        self._since += self._run
        disjoint = (
            not fits and apart > other.advanced and self._mask + 1 - apart >= current.advanced
        )
        if self._since > REACH and (repeated or disjoint):
            self._evidence += 1
            self._since = 0
        self._add(other, counter, content)
        self._current, self._other, self._run = other, current, 1
        self.found = self._evidence >= EVIDENCE
        return self.found

    def _clear_evidence(self) -> None:
        self._run = self._since = self._evidence = 0

    def _earlier(self, stream: Stream, counter: int) -> Content | None:
        """Return the content of an earlier frame with this counter, or None if there is none."""
        behind = (stream.following - 1 - counter) & self._mask
        return stream.last_contents[counter % REMEMBERED] if behind < self._remembered else None

    def _belongs(self, stream: Stream, counter: int) -> bool:
        return (counter - stream.following + 1 + REACH) & self._mask <= 2 * REACH

    def _add(self, stream: Stream, counter: int, content: Content) -> None:
        lost = (counter - stream.following) & self._mask
        if lost < REACH:
            for i in range(lost):
                stream.last_contents[(stream.following + i) % REMEMBERED] = None
            stream.advanced += lost
            stream.following = (counter + 1) & self._mask
        stream.last_contents[counter % REMEMBERED] = content

    def _last(self, stream: Stream | None) -> int:
        return -1 if stream is None else (stream.following - 1) & self._mask
