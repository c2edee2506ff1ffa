"""Tells whether two nodes send one identifier: by the frames' counters and contents, in the order of arrival."""

from __future__ import annotations

REACH = 8
"""A frame at most this far from a stream's last counter belongs to it: late, or after a loss. A link that delivers frames up to
8 places late mixes those of before and after a restart, or a long loss, over 16 frames."""
EVIDENCE = 3
"""Pieces of evidence, each more than REACH frames after the last: such a mixture gives one."""
ALONE, OLD = 16, 32
"""After so many frames of one stream alone, the other has ended; after so many without evidence, the earlier pieces count no more."""
REMEMBERED = 64
"""Counters behind a stream's last one whose content is kept."""
LISTEN = 160
"""Frames to look at before anything is sent: two senders show within them, also in bursts of up to seven of each."""

Content = bytes | bytearray


class Stream:
    """Frames that continue one counter."""

    __slots__ = ("advanced", "following", "last_contents")

    def __init__(self, counter: int, mask: int, content: Content | None) -> None:
        self.following = (counter + 1) & mask
        self.advanced = 0
        """Counters since there are two streams, less the present run."""
        self.last_contents: list[Content | None] = [None] * REMEMBERED
        self.last_contents[counter % REMEMBERED] = content


class SecondSender:
    """Sees each frame of one identifier whose checksum is right; `found` once two senders' counters both go on.

    On a CAN bus one node sends an identifier (ISO 11898-1). A sender adds one to its counter with each frame (AUTOSAR E2E
    profile 5: 8 bit), so two senders show as two streams that take turns. Evidence is a frame that continues the other stream
    than the frame before did, where its counter came before with other content, or where the two streams are apart. Loss,
    duplication, reordering by up to REACH places, delay, a counter that stands still, and a restart now and then do not make
    two streams take turns for long enough. The contents are compared whole, and kept by reference.

    Found after 15 frames of each sender (median; at most 24 where they alternate, 27 in changing order, 39 in bursts of up to
    four). With 20 % lost: 16 frames received of each (median; 99.9 % within 30 where they alternate).

    Not found: equal counters with equal content; a second sender with less than a fifteenth of the first one's rate; bursts of
    more than seven frames with equal counters; three or more senders whose counters are all far apart. Taken for two: a sender
    that repeats a counter with different content at every eighth frame or oftener; every 128th frame or so of one sender; and,
    once in thousands of trials, restarts or long losses within 32 frames of each other, all reordered.
    """

    def __init__(self, counters: int = 256) -> None:
        if counters < 32 or counters & (counters - 1):
            raise ValueError(
                f"the number of counter values must be a power of two and at least 32, not {counters}"
            )
        self._mask = counters - 1
        self._remembered = min(REMEMBERED, counters // 2)
        self._run, self._since, self._evidence = 0, 0, 0
        self.forget()

    def forget(self) -> None:
        """Start anew: a new run, or frames were thrown away unread."""
        self.found = False
        self._current: Stream | None = None
        self._other: Stream | None = None
        self._begin()

    @property
    def counters(self) -> tuple[int, int]:
        """The last counters of the two streams, for a message. -1 where there is none."""
        return self._last(self._current), self._last(self._other)

    def see(self, counter: int, content: Content) -> bool:
        """Take one frame. True once two senders are there."""
        current = self._current
        if current is not None and counter == current.following and not self.found:
            current.last_contents[counter % REMEMBERED] = content
            current.following = (counter + 1) & self._mask
            self._run += 1
            return False
        return self.found or self._see_irregular(counter, content)

    def _see_irregular(self, counter: int, content: Content) -> bool:
        current, other = self._current, self._other
        if current is None:
            self._current = Stream(counter, self._mask, content)
            return False
        known = self._known(current, counter)
        known_to_other = None if other is None else self._known(other, counter)
        if content in (known, known_to_other):
            return False  # a duplicate
        ahead = (counter - current.following) & self._mask
        fits = known is None and self._belongs(current, counter)
        if other is not None and known_to_other is None:
            ahead_of_other = (counter - other.following) & self._mask
            if ahead_of_other < REACH and (ahead_of_other < ahead or not fits):
                return self._change(current, other, counter, content, known is not None, fits)
        if fits:
            self._add(current, counter, content)
            self._run += 1
        elif other is None or not self._belongs(other, counter):
            self._begin()
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
        """The other stream goes on. Evidence, unless one stream may be the late frames that the other left out."""
        current.advanced += self._run
        if self._run >= ALONE or self._since >= OLD:
            self._begin()
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

    def _begin(self) -> None:
        self._run = self._since = self._evidence = 0

    def _known(self, stream: Stream, counter: int) -> Content | None:
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
