"""Detection of two nodes that send the same CAN identifier, by counters and contents."""

from __future__ import annotations

REACH = 8
"""Largest distance between a frame's counter and the last counter of its stream.

The frame is then late, or follows a loss. A link that delays frames by up to 8 places mixes the
frames before and after a restart or a long loss over 16 frames."""
EVIDENCE = 3
"""Pieces of evidence that are needed, each more than REACH frames after the previous one.

One mixture of frames (see REACH) gives one piece."""
ALONE, OLD = 16, 32
"""ALONE: consecutive frames of one stream after which the other stream has ended.

OLD: frames without new evidence after which the earlier evidence is discarded."""
REMEMBERED = 64
"""Number of recent frames whose content is kept for each stream."""
LISTEN = 160
"""Frames to receive before the first transmission.

Two senders are detected within them, also where they send in bursts of up to seven frames."""

Content = bytes | bytearray


class Stream:
    """Sequence of frames with one continuous counter."""

    __slots__ = ("advanced", "following", "last_contents")

    def __init__(self, counter: int, mask: int, content: Content | None) -> None:
        self.following = (counter + 1) & mask
        self.advanced = 0
        """Counter steps since the second stream started, without those of the present run."""
        self.last_contents: list[Content | None] = [None] * REMEMBERED
        self.last_contents[counter % REMEMBERED] = content


class SecondSender:
    """Detector of a second sender of one identifier. `found`: two counters both advance.

    `counters`: number of counter values, a power of two. Frames with a wrong CRC must not be added.

    Method: on a CAN bus one node sends an identifier (ISO 11898-1). A sender increments its counter
    with each frame (AUTOSAR E2E profile 5: 8 bit), so two senders give two alternating streams.
    A frame is evidence if it continues the stream that the previous frame did not belong to, and:
    - its counter was received before with different content, or
    - the counters of the two streams do not overlap.

    Loss, duplication, reordering by up to REACH places, delay, a counter that stops, and an
    occasional restart do not make two streams alternate for long enough. The contents are compared
    completely, and kept by reference.

    Detection takes 15 frames of each sender (median). The maximum is 24 where they alternate, 27 in
    changing order, 39 in bursts of up to four. At 20 % loss it takes 16 received frames of each
    (median; 99.9 % within 30 where they alternate).

    Not detected:
    - equal counters with equal content;
    - a second sender with less than a fifteenth of the rate of the first one;
    - bursts of more than seven frames with equal counters;
    - three or more senders whose counters are all far apart.

    False detections:
    - a sender that repeats a counter with different content in every eighth frame or more often;
    - one sender of which only about every 128th frame is received;
    - once in thousands of trials: restarts or long losses within 32 frames of each other, all
      reordered.
    """

    def __init__(self, counters: int = 256) -> None:
        if counters < 32 or counters & (counters - 1):
            raise ValueError(
                f"the number of counter values must be a power of two and at least 32, not {counters}"
            )
        self._mask = counters - 1
        self._remembered = min(REMEMBERED, counters // 2)
        self._run, self._since, self._evidence = 0, 0, 0
        self.reset()

    def reset(self) -> None:
        """Discard all streams and evidence. Call it for a new run, or after discarded frames."""
        self.found = False
        self._current: Stream | None = None
        self._other: Stream | None = None
        self._clear_evidence()

    @property
    def counters(self) -> tuple[int, int]:
        """The last counters of the two streams, for messages; -1 for a missing stream."""
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
        """Add a frame that does not continue the current stream. Return as `observe`."""
        current, other = self._current, self._other
        if current is None:
            self._current = Stream(counter, self._mask, content)
            return False
        # A frame with counter and content of an earlier one is a duplicate.
        earlier = self._earlier(current, counter)
        earlier_of_other = None if other is None else self._earlier(other, counter)
        if content in (earlier, earlier_of_other):
            return False
        ahead = (counter - current.following) & self._mask
        fits = earlier is None and self._belongs(current, counter)
        # The frame continues the other stream, if it is closer to that one.
        if other is not None and earlier_of_other is None:
            ahead_of_other = (counter - other.following) & self._mask
            if ahead_of_other < REACH and (ahead_of_other < ahead or not fits):
                return self._change(current, other, counter, content, earlier is not None, fits)
        # Otherwise it belongs to the current stream, or starts a new one.
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
        """Make the other stream the current one. Return whether two senders are detected.

        The change is no evidence if one stream may consist of late frames of the other one.
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
        """Return the content of an earlier frame with this counter, or None."""
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
