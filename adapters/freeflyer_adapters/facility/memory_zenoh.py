"""Zenoh sessions within one process, in virtual time: what the links use of a session, and no more."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import zenoh

_numbers = itertools.count(1)


class Net:
    """Everybody's subscribers and tokens."""

    def __init__(self) -> None:
        self.subscribers: list[_Subscriber] = []
        self.token_subscribers: list[_Subscriber] = []
        self.tokens: dict[int, str] = {}


@dataclass(frozen=True)
class _Bytes:
    data: bytes

    def to_bytes(self) -> bytes:
        return self.data


@dataclass(frozen=True)
class _Sample:
    key_expr: str
    payload: _Bytes
    attachment: _Bytes | None
    kind: Any = field(default_factory=lambda: zenoh.SampleKind.PUT)


@dataclass(frozen=True)
class _Reply:
    ok: _Sample


class _Subscriber:
    """The freshest sample only, as RingChannel(1) has it."""

    def __init__(self, everybody: list[_Subscriber], key: str) -> None:
        self.key, self._everybody = key, everybody
        self.sample: _Sample | None = None
        everybody.append(self)

    def try_recv(self) -> _Sample | None:
        sample, self.sample = self.sample, None
        return sample

    def undeclare(self) -> None:
        if self in self._everybody:
            self._everybody.remove(self)


class _Publisher:
    def __init__(self, net: Net, key: str) -> None:
        self.key, self._net = key, net

    def put(self, payload: bytes, *, attachment: bytes) -> None:
        for subscriber in self._net.subscribers:
            if subscriber.key == self.key:
                subscriber.sample = _Sample(self.key, _Bytes(payload), _Bytes(attachment))

    def undeclare(self) -> None:
        pass


class _Token:
    def __init__(self, net: Net, key: str) -> None:
        self._net, self._number, self._key = net, next(_numbers), key
        net.tokens[self._number] = key
        self._tell(zenoh.SampleKind.PUT)

    def undeclare(self) -> None:
        if self._net.tokens.pop(self._number, None):
            self._tell(zenoh.SampleKind.DELETE)

    def _tell(self, kind: zenoh.SampleKind) -> None:
        for subscriber in self._net.token_subscribers:
            if zenoh.KeyExpr(subscriber.key).intersects(zenoh.KeyExpr(self._key)):
                subscriber.sample = _Sample(self._key, _Bytes(b""), None, kind)


class _Liveliness:
    def __init__(self, net: Net) -> None:
        self._net = net

    def declare_token(self, key: str) -> _Token:
        return _Token(self._net, key)

    def declare_subscriber(self, key: str, handler: object) -> _Subscriber:
        return _Subscriber(self._net.token_subscribers, key)

    def get(self, key: str, timeout: float) -> Iterator[_Reply]:
        wanted = zenoh.KeyExpr(key)
        for token in list(self._net.tokens.values()):
            if wanted.intersects(zenoh.KeyExpr(token)):
                yield _Reply(_Sample(token, _Bytes(b""), None))


class MemorySession:
    """See `zenoh.Session`; endpoints mean nothing here: everybody meets everybody of the same `Net`."""

    def __init__(self, net: Net) -> None:
        self._net, self._number = net, next(_numbers)

    @property
    def info(self) -> MemorySession:
        return self

    def peers_zid(self) -> list[str]:
        """Everybody is in this process."""
        return ["here"]

    def routers_zid(self) -> list[str]:
        return []

    def zid(self) -> str:
        return f"{self._number:032x}"

    def declare_subscriber(self, key: str, handler: object) -> _Subscriber:
        return _Subscriber(self._net.subscribers, key)

    def declare_publisher(self, key: str, **how: Any) -> _Publisher:
        return _Publisher(self._net, key)

    def liveliness(self) -> _Liveliness:
        return _Liveliness(self._net)

    def close(self) -> None:
        pass
