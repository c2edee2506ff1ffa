"""Zenoh sessions in memory and in virtual time. They have only the methods that callers need."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import zenoh

_numbers = itertools.count(1)


class Net:
    """Subscribers and liveliness tokens of all sessions."""

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
    """A subscriber that keeps only the latest sample, as `zenoh.handlers.RingChannel(1)` does."""

    def __init__(self, subscribers: list[_Subscriber], key: str) -> None:
        self.key, self._subscribers = key, subscribers
        self.sample: _Sample | None = None
        subscribers.append(self)

    def try_recv(self) -> _Sample | None:
        sample, self.sample = self.sample, None
        return sample

    def undeclare(self) -> None:
        if self in self._subscribers:
            self._subscribers.remove(self)


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
        self._notify(zenoh.SampleKind.PUT)

    def undeclare(self) -> None:
        if self._net.tokens.pop(self._number, None):
            self._notify(zenoh.SampleKind.DELETE)

    def _notify(self, kind: zenoh.SampleKind) -> None:
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
    """A replacement of `zenoh.Session`. All sessions of a `Net` are connected to each other."""

    def __init__(self, net: Net) -> None:
        self._net, self._number = net, next(_numbers)

    @property
    def info(self) -> MemorySession:
        return self

    def peers_zid(self) -> list[str]:
        """Return a constant peer, because a session in memory is always connected."""
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
