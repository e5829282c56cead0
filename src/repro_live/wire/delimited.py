"""A stream of bytes cut at a delimiter: whole packets out, whatever the chunks, and never more than one kept."""

from __future__ import annotations

from repro_live.wire.frame import Counters


class Splitter:
    """Cut a stream at a delimiter of one byte.

    Parameters
    ----------
    delimiter
        The byte that ends a packet; packets do not hold it.
    longest
        Length of the longest packet [bytes]. A longer run without a delimiter is dropped as it comes, up to the
        next delimiter, and counted as ``oversized``: so no more than this is ever kept.
    counters
        Where that is counted; ``discarded_bytes`` counts no delimiters.
    """

    def __init__(self, delimiter: bytes, longest: int, counters: Counters) -> None:
        self._delimiter = delimiter
        self._longest = longest
        self._counters = counters
        self._begun = b""
        self._oversized = False
        self._opened = True

    def split(self, chunk: bytes) -> tuple[list[bytes], bool]:
        """Take the next bytes; return the packets that they complete, without delimiters.

        Returns
        -------
        packets, cut
            The packets, in order, and whether the first of them is the first since the port was opened: what came
            before it is then unknown.
        """
        packets = (self._begun + chunk).split(self._delimiter)
        self._begun = packets.pop()
        cut = False
        if packets:
            cut, self._opened = self._opened, False
            if self._oversized:
                self._counters.discarded_bytes += len(packets.pop(0))
                self._oversized = cut = False
            if packets and max(map(len, packets)) > self._longest:
                cut = cut and len(packets[0]) <= self._longest
                for packet in packets:
                    if len(packet) > self._longest:
                        self._counters.oversized += 1
                        self._counters.discarded_bytes += len(packet)
                packets = [packet for packet in packets if len(packet) <= self._longest]
        if self._oversized:
            self._drop_begun()
        elif len(self._begun) > self._longest:
            self._oversized = True
            self._counters.oversized += 1
            self._drop_begun()
        return packets, cut

    def reopened(self) -> None:
        """Drop a packet begun; the next one may be the end of one only."""
        self._drop_begun()
        self._oversized, self._opened = False, True

    def _drop_begun(self) -> None:
        self._counters.discarded_bytes += len(self._begun)
        self._begun = b""
